"""Trackers: pure laws from a control instant and the measured state to efforts.

The feedback loop calls every tracker through `steps_of` (stepping.py). There are two kinds:

* `Tracker`: `effort(k, position, velocity)` for one state. With the class attribute `batched = True`, `effort` also accepts
  leading batch axes: position and velocity (..., n_s) -> efforts (..., n_u). Otherwise states are passed one by one.
* `TrackerWithMemory`: `start(n)` and `step(k, position, velocity, memory)`, always for a batch of n states. The feedback
  loop stores the memory. The law receives it, returns the next memory and stores nothing itself.

The efforts of one state must not depend on the other states of its batch, to the last bit. `times` (linear.py) ensures
this for products.
"""

from typing import Protocol

import numpy as np


class Tracker(Protocol):
    """A law u = f(k, s, v) without history, filter, saturation or delay, which belong to the feedback loop.

    Example:
        class Stiff:
            name = "stiff"

            def __init__(self, reference):
                self.reference = reference

            def effort(self, k, position, velocity):  # rad and rad/s on hinges
                wanted = self.reference
                return 200.0 * (wanted.position[k] - position) + (wanted.velocity[k] - velocity) + wanted.effort[k]

        print(linkplan.track(linkplan.plan("knee-reach"), Stiff))
    """

    @property
    def name(self) -> str:
        """The name in tables and files."""
        ...

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return efforts (n_u,) [N.m or N] at instant k for measured s [rad or m] and v [rad/s or m/s], both (n_s,)."""
        ...


class TrackerWithMemory(Protocol):
    """A law (u_k, m_k+1) = f(k, s, v, m_k) over a batch of states; the feedback loop stores the memory m."""

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
