"""What ends a command for no fault of its input: too little memory, and errors that nobody foresaw. Loads nothing heavy."""

import errno
import sys

from linkplan.models.errors import one_line

# What libraries say of memory that there is not, each in its own words and of its own kind of error.
_WORDS = ("failed to map segment", "bad_alloc", "cannot allocate memory", "could not allocate", "unable to allocate")


def is_of_memory(error: BaseException) -> bool:
    """Return whether an error says that there is not enough memory, whatever kind it is."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    return any(word in str(error).lower() for word in _WORDS)


def told_to_the_makers(error: BaseException) -> str:
    """Return one line on an error that nobody foresaw, all that is known of it written into a file that it names."""
    import tempfile
    import traceback
    from importlib.metadata import version

    if is_of_memory(error):
        what = "there is not enough memory for it"
    else:
        what = f"a fault of linkplan's own ({type(error).__name__}: {one_line(error)[:200]})"
    said = "".join(traceback.format_exception(error)).encode("utf-8", "backslashreplace")
    about = f"linkplan {version('linkplan')}, Python {sys.version}\narguments: {sys.argv[1:]!r}\n\n"
    told = about.encode("utf-8", "backslashreplace")
    try:
        with tempfile.NamedTemporaryFile(prefix="linkplan-fault-", suffix=".txt", delete=False) as file:
            file.write(told + said)
    except OSError:
        return what
    return f"{what}; please send '{file.name}' to linkplan's makers"
