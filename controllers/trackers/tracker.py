"""What a tracker is: a pure law from a control instant and the measured state to efforts.

Whatever runs a tracker asks it through `steps_of` (stepping.py), which knows all kinds:

* `Tracker`: `effort(k, position, velocity)`, for one state. Where the class says `batched = True`, its `effort` takes
  leading batch axes as well, position and velocity (..., n_s) -> efforts (..., n_u); without it, states are given one by
  one.
* `TrackerWithMemory`: `start(n)` and `step(k, position, velocity, memory)`, always for a batch of n states, a single run
  being a batch of one. The memory is the loop's: the law is given it and returns the next one, and keeps nothing.

The efforts of one state must not depend on the other states of its batch, to the last bit: `times` (linear.py) multiplies
so.
"""

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


class TrackerWithMemory(Protocol):
    """A law (u_k, m_k+1) = f(k, s, v, m_k) over a batch of states, its memory m held by the loop that runs it."""

    @property
    def name(self) -> str:
        """The name in tables and files."""
        ...

    def start(self, n: int) -> np.ndarray:
        """Return the memory (n, n_m) before the first control instant of n simulations."""
        ...

    def step(self, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] at instant k for measured s and v (n, n_s), and the next memory (n, n_m)."""
        ...


AnyTracker = Tracker | TrackerWithMemory
