"""Writing to stdout and stderr, which may be closed, full, or of another encoding."""

import errno
import os
from typing import TextIO


def put(stream: TextIO | None, text: str) -> OSError | None:
    """Write a text and return why it cannot be: the stream is closed, its reader has left, the disk is full.

    What the stream's encoding has no characters for is escaped.
    """
    if stream is None or stream.closed:
        return OSError(errno.EBADF, os.strerror(errno.EBADF))
    encoding = getattr(stream, "encoding", None) or "utf-8"
    try:
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        stream.flush()
    except OSError as error:
        return error
    return None
