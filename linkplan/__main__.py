"""`python -m linkplan` and the script `linkplan`: the command line.

Signal handlers are set before the imports, so that a signal always ends a command with one line and exit code 130, 143 or
129. Only the start of Python itself, a few hundredths of a second, is not covered.
"""

import atexit
import gc
import os
import signal
import sys
from types import FrameType


def main() -> int:
    """Run the command of this process and return its exit code."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # Ignored signals stay ignored, as with nohup.
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)
    # Imports create many objects and no garbage: with the default threshold of 700, collection took a tenth of the time.
    gc.set_threshold(100_000, 50, 100)
    # One thread: for matrices with tens of rows, waking numpy's second thread takes longer than the product, and sums would
    # depend on the number of processors. Loops over machines and cases have threads and processes of their own.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    codes: list[int] = []
    atexit.register(_leave, codes)  # the first registered function is called last
    from linkplan.cli.main import main as run  # after the signal handlers are set

    codes.append(run())
    return codes[0]


def _leave(codes: list[int]) -> None:
    """End the process of a command after all threads and all other exit handlers.

    At that point everything is flushed and closed. Otherwise Python would free every object, which for casadi and mujoco
    takes a quarter of their loading time.
    """
    if codes:
        os._exit(codes[0])


def _end(number: int, frame: FrameType | None) -> None:
    """End the process immediately, before the command starts. Later, `listening` handles signals."""
    del frame
    try:  # noqa: SIM105 (contextlib takes as long to load as everything before the handlers)
        os.write(2, b"linkplan: interrupted; nothing was written\n")
    except OSError:  # nobody reads it
        pass
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
