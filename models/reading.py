"""Reading of user files: regular files of bounded size, printable text, and TOML of bounded depth; keys of TOML."""

import contextlib
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from linkplan.models.errors import LinkplanError, ProblemError, one_line, refusals

# Largest result that is read back: a trajectory of 20,000 intervals x 10 x 40 joints x 8 bytes, a record of 10,000 cases.
MAX_FILE_BYTES = 64_000_000
# Largest TOML file that is read, far above any problem or batch file.
MOST_TOML_BYTES = 16_000_000
# Deepest nesting of tables: the parser recurses at each level.
_MAX_DEPTH = 100
# A key with more parts than that. The parser's memory grows with the square of the number of parts.
_LONG_KEY = re.compile(rf"""(?<![\w."'-])(?:(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_MAX_DEPTH}}}""")

# Keys that need no quotes (TOML 1.0, "Keys").
_BARE = re.compile(r"[A-Za-z0-9_-]+")
# Characters that a basic string must escape (TOML 1.0, "String"), and the short escapes.
_ESCAPED = re.compile(r'[\x00-\x1f\x7f"\\]')
_SHORT = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}


def read_file(path: Path, what: str, most_bytes: int, error: type[LinkplanError] = ProblemError) -> bytes:
    """Return a file's content.

    Args:
        path: of the file.
        what: name of the file in messages, such as "problem 'x.toml'".
        most_bytes: largest size.
        error: to raise.

    Raises:
        error: if the file is not a regular file (a pipe or a device may never end), too large, or unreadable.
    """
    with _opened(path, what, error) as (file, size):
        if size > most_bytes:
            raise error(f"{what} has {size} bytes; at most {most_bytes} are read")
        content = file.read(size + 1)  # Python allocates the requested size, so it is not most_bytes
        if len(content) > size:
            content += file.read(most_bytes + 1 - len(content))
    if len(content) > most_bytes:
        raise error(f"{what} grows while it is read; at most {most_bytes} bytes are")
    return content


def read_head(path: Path, what: str, count: int, error: type[LinkplanError] = ProblemError) -> bytes:
    """Return the first `count` bytes of a regular file, or fewer if it is shorter. Errors are those of `read_file`."""
    with _opened(path, what, error) as (file, _):
        return file.read(count)


@contextlib.contextmanager
def _opened(path: Path, what: str, error: type[LinkplanError]) -> Iterator[tuple[BinaryIO, int]]:
    """Yield an open regular file and its size [bytes]. Errors of the system are raised as `error`."""
    with refusals(f"{what} cannot be read", ValueError, error=error):
        # Without O_NONBLOCK opening a pipe waits for a writer.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
        with os.fdopen(descriptor, "rb") as file:
            found = os.fstat(descriptor)
            if not stat.S_ISREG(found.st_mode):
                raise error(f"{what} is not a regular file (a folder, a pipe or a device)")
            yield file, found.st_size


def read_toml(path: Path, what: str) -> dict:
    """Return the tables of a TOML file.

    Raises:
        ProblemError: if it cannot be read or is not TOML.
    """
    try:
        text = read_file(path, what, MOST_TOML_BYTES).decode("utf-8-sig")  # editors on Windows write a byte order mark
    except UnicodeDecodeError as error:
        raise ProblemError(f"{what} is not UTF-8 text") from error
    return parse_toml(text, what)


def parse_toml(text: str, what: str) -> dict:
    """Return the tables of a TOML text.

    Raises:
        ProblemError: if it is not TOML, is nested too deeply, or has numbers that are too long.
    """
    if _LONG_KEY.search(text):
        raise ProblemError(f"{what} is nested more than {_MAX_DEPTH} levels deep")
    try:
        tables = tomllib.loads(text)
    except RecursionError as error:
        raise ProblemError(f"{what} is nested too deeply") from error
    except ValueError as error:  # from tomllib, or from int for a number with thousands of digits
        why = one_line(error).replace("Cannot overwrite a value", "a key is given twice")
        raise ProblemError(f"{what} is not TOML: {why}") from error
    if too_deep(tables):
        raise ProblemError(f"{what} is nested more than {_MAX_DEPTH} levels deep")
    return tables


def too_deep(tables: object) -> bool:
    """Return True if tables are nested too deeply."""
    level = [tables]
    for _ in range(_MAX_DEPTH):
        inner: list[object] = []
        for item in level:
            values = item.values() if isinstance(item, dict) else item if isinstance(item, list) else ()
            inner += [value for value in values if isinstance(value, dict | list)]
        if not inner:
            return False
        level = inner
    return True


def key_text(key: str) -> str:
    """Return a key in TOML's syntax, quoted if necessary."""
    return key if _BARE.fullmatch(key) else quoted(key)


def quoted(text: str) -> str:
    """Return a text as a basic string of TOML, in quotes."""
    return '"' + _ESCAPED.sub(lambda found: _SHORT.get(found[0], f"\\u{ord(found[0]):04x}"), text) + '"'
