"""What ends a command for no fault of its input: little memory, a umask, what linkplan's makers did not foresee. Light."""

import errno
import os
import sys

from linkplan.models.errors import LinkplanError, one_line

# What libraries say of memory that there is not, each in its own words and of its own kind of error.
_WORDS = ("failed to map segment", "bad_alloc", "cannot allocate memory", "could not allocate", "unable to allocate")
# Commands that load none of the large libraries.
_LIGHT = ("list", "schema", "completion")
# Below these limits [bytes] of address space and of data the libraries cannot be loaded, or OpenBLAS waits for ever.
_LEAST = {"RLIMIT_AS": 500_000_000, "RLIMIT_DATA": 200_000_000}


def refuse_little_memory(command: str) -> None:
    """Refuse a process whose own limits are below what the libraries take that a command loads.

    Raises:
        LinkplanError: naming the limit.
    """
    if command in _LIGHT:
        return
    try:
        import resource
    except ImportError:  # not POSIX
        return
    for name, least in _LEAST.items():
        most = resource.getrlimit(getattr(resource, name))[0]
        if most != resource.RLIM_INFINITY and most < least:
            what = "address space" if name == "RLIMIT_AS" else "data"
            raise LinkplanError(
                f"this process may have {most / 1e6:.0f} MB of {what} (ulimit); what is loaded takes {least / 1e6:.0f} MB"
                " at least"
            )


def refuse_own_rights(command: str) -> None:
    """Refuse a process that may not read what it has just written: its own umask takes that right away.

    Raises:
        LinkplanError: naming the umask.
    """
    if command in _LIGHT or os.name != "posix":
        return
    mask = os.umask(0o077)
    os.umask(mask)
    if mask & 0o700:
        raise LinkplanError(
            f"this process's umask is {mask:04o}: it may not read and write the files that it makes; one of 0022 lets it"
        )


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
