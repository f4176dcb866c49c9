"""Runs that may diverge: their logs say so, and neither numpy nor MuJoCo does on stderr."""

import contextlib
from collections.abc import Iterator

import mujoco
import numpy as np


@contextlib.contextmanager
def divergence_expected() -> Iterator[None]:
    """Let arithmetic overflow and simulations blow up without warnings. Decorates what runs a feedback loop."""
    mujoco.set_mju_user_warning(_ignore)  # MuJoCo would write a line for each into a log file
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        mujoco.set_mju_user_warning(None)


def _ignore(message: str) -> None:
    del message
