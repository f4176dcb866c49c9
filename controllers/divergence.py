"""Suppression of numpy's and MuJoCo's warnings in runs that may diverge; the logs record the divergence."""

import contextlib
from collections.abc import Iterator

import mujoco
import numpy as np


@contextlib.contextmanager
def divergence_expected() -> Iterator[None]:
    """Silence warnings about overflow and diverging simulations. Decorates functions that run a feedback loop."""
    mujoco.set_mju_user_warning(_ignore)  # otherwise MuJoCo writes each warning to a log file
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        mujoco.set_mju_user_warning(None)


def _ignore(message: str) -> None:
    del message
