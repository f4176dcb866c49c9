"""`python -m linkplan` and the script `linkplan`: the command line.

Signals are heard from the first line on, before anything is loaded: what ends a command so early ends it as later on, with
exit code 130, 143 or 129 and a line. Before this file Python itself starts, for some hundredths of a second.
"""

import atexit
import gc
import os
import signal
import sys
from types import FrameType

# How many more objects are made than freed before the youngest are searched for cycles; 700 is Python's own.
_BETWEEN_COLLECTIONS = 100_000


def main() -> int:
    """Run the command of this process and return its exit code."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # What was ignored stays ignored, as under nohup.
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)
    # Loading makes many objects and no garbage: looking for cycles among them took a tenth of a command's time.
    gc.set_threshold(_BETWEEN_COLLECTIONS, 50, 100)
    codes: list[int] = []
    atexit.register(_leave, codes)  # the first that is registered is the last that is called
    from linkplan.studies.cli.main import main as run  # the time that this takes is what the handlers are for

    codes.append(run())
    return codes[0]


def _leave(codes: list[int]) -> None:
    """End the process that a command was run in, once threads and everybody else's handlers are done with.

    All is flushed and closed by then. Python would go on to free what was loaded, object by object, which for casadi and
    mujoco takes a quarter of what it took to load them; the system takes all of it at once.
    """
    if codes:
        os._exit(codes[0])


def _end(number: int, frame: FrameType | None) -> None:
    """End at once: nothing was begun. `listening` takes over from here."""
    del frame
    try:  # noqa: SIM105 (contextlib takes as long to load as all that is done before the handlers stand)
        os.write(2, b"linkplan: interrupted; nothing was written\n")
    except OSError:  # nobody reads it
        pass
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
