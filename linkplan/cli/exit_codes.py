"""Exit codes of the command line, and errors that do not come from a command's input: out of memory, internal errors."""

import errno
import sys
from enum import IntEnum

from linkplan.models.errors import one_line

# Phrases by which libraries report too little memory; the types of their errors differ.
_WORDS = ("failed to map segment", "bad_alloc", "cannot allocate memory", "could not allocate", "unable to allocate")
# The exit code of a command ended by a signal is this plus the signal's number: 130 for Ctrl-C, 143 for SIGTERM.
SIGNAL_BASE = 128


def is_of_memory(error: BaseException) -> bool:
    """Tell if an error of any kind means that there is not enough memory."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    return any(word in str(error).lower() for word in _WORDS)


def saved_fault_report(error: BaseException) -> str:
    """Write a report on an unexpected error into a file, and return one line with the name of the file."""
    import tempfile
    import traceback
    from importlib.metadata import version

    if is_of_memory(error):
        what = "not enough memory"
    else:
        what = f"an internal error of linkplan ({type(error).__name__}: {one_line(error)[:200]})"
    said = "".join(traceback.format_exception(error)).encode("utf-8", "backslashreplace")
    about = f"linkplan {version('linkplan')}, Python {sys.version}\narguments: {sys.argv[1:]!r}\n\n"
    head = about.encode("utf-8", "backslashreplace")
    try:
        with tempfile.NamedTemporaryFile(prefix="linkplan-fault-", suffix=".txt", delete=False) as file:
            file.write(head + said)
    except OSError:
        return what
    return f"{what}; please send '{file.name}' to linkplan's developers"


class ExitCode(IntEnum):
    """The exit codes of commands that no signal ended."""

    DONE = 0
    ANSWER_IS_NO = 1  # infeasible, unstable, problems found: with a sentence
    BAD_INPUT = 2
    BROKEN_PIPE = 141  # stdout was closed before the result was written: the code that a shell shows for SIGPIPE


DONE, NO, BAD_INPUT = ExitCode.DONE, ExitCode.ANSWER_IS_NO, ExitCode.BAD_INPUT
