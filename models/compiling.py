"""The compiling of a model, bounded: MuJoCo's compiler simulates muscles until they rest, and where they never do, for ever.

A simulation that goes unstable begins again at its first instant, so no length of it in the model's own time is an end.
"""

import contextlib
import threading
import time
from collections.abc import Iterator

import mujoco

from linkplan.models.interrupts import asked, check

# Processor time of a compilation [s]: the muscles of a whole body take a few. It is looked at once in so many readings.
MOST_S, _READINGS = 20.0, 1000
# The clock that MuJoCo reads is one for the whole process: threads compile one after the other.
_ALONE = threading.Lock()


class _StopError(Exception):
    """A compilation was asked to end."""


@contextlib.contextmanager
def bounded(most_s: float = MOST_S) -> Iterator[None]:
    """Let MuJoCo's compiler have so much processor time [s] in this thread, and end it where an interrupt comes.

    Raises:
        RuntimeError: when it was not done by then, with what helps.
        KeyboardInterrupt: when a signal came meanwhile.
    """
    thread, until, readings, late = threading.get_ident(), time.thread_time() + most_s, 0, False

    def reading() -> float:
        """Return MuJoCo's clock, which it reads many times in a step and shows nobody here."""
        nonlocal readings, late
        readings += 1
        if readings % _READINGS == 0 and threading.get_ident() == thread:
            late = time.thread_time() > until
            if late or asked() is not None:
                raise _StopError
        return 0.0

    with _ALONE:
        before = mujoco.get_mjcb_time()
        mujoco.set_mjcb_time(reading)
        try:
            yield
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            check()
            if late:
                raise RuntimeError(
                    f"not done within {most_s:g} s: MuJoCo simulates muscles to find how long they can be, and comes to no"
                    " end; give each actuator its lengthrange, or <compiler> a <lengthrange/> of its own"
                ) from error
            raise
        finally:
            mujoco.set_mjcb_time(before)
