"""What a tracker is: a pure law from a control instant and the measured state to efforts."""

from typing import Protocol

import numpy as np


class Tracker(Protocol):
    """A law u = f(k, s, v), with no history, filter, saturation or delay of its own: those belong to the loop."""

    @property
    def name(self) -> str:
        """The name in tables and files."""
        ...

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return efforts (n_u,) [N.m or N] at control instant k for measured s and v (n_s,)."""
        ...
