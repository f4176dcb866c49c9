"""Suppression of numpy's and MuJoCo's warnings in runs that may diverge; the logs record the divergence."""

import contextlib
from collections.abc import Iterator

import numpy as np

from linkplan.models.mujoco_warnings import mujoco_warnings


@contextlib.contextmanager
def divergence_expected() -> Iterator[None]:
    """Silence warnings about overflow and diverging simulations. Decorates functions that run a feedback loop."""
    with mujoco_warnings(), np.errstate(all="ignore"):
        yield
