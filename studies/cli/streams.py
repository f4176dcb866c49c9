"""Writing to stdout and stderr, which may be closed, on a full disk, or in another encoding."""

import errno
import os
from typing import TextIO


def is_terminal(stream: TextIO | None) -> bool:
    """Tell if a stream is a terminal."""
    try:
        return stream is not None and stream.isatty()
    except (OSError, ValueError):  # closed
        return False


def rewrites(stream: TextIO | None) -> bool:
    """Tell if a stream is a terminal on which a line can be overwritten."""
    return is_terminal(stream) and os.environ.get("TERM", "dumb") not in ("", "dumb")


def put(stream: TextIO | None, text: str) -> OSError | None:
    """Write a text and return the error, if any: a closed stream, a broken pipe, a full disk.

    Characters that the stream's encoding lacks are escaped.
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
