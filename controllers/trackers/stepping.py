"""A common interface for all trackers: efforts for a batch of states, with a memory that the caller stores."""

from dataclasses import dataclass
from typing import cast

import numpy as np

from linkplan.controllers.trackers.tracker import AnyTracker, Tracker, TrackerWithMemory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Memoryless:
    """A `Tracker` as a `TrackerWithMemory` with an empty memory (n, 0)."""

    law: Tracker
    batched: bool

    @property
    def name(self) -> str:
        """The law's name."""
        return self.law.name

    def start(self, n: int) -> np.ndarray:
        """Return the empty memory (n, 0)."""
        return np.empty((n, 0))

    def step(self, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N], for all states at once or, if the law is not batched, one by one."""
        if len(position) == 1:  # a small law takes half the time without the batch axis
            return np.asarray(self.law.effort(k, position[0], velocity[0]), dtype=float)[None], memory
        if self.batched:
            return self.law.effort(k, position, velocity), memory
        each = [self.law.effort(k, s, v) for s, v in zip(position, velocity, strict=True)]
        return np.array(each, dtype=float), memory


def steps_of(tracker: AnyTracker) -> TrackerWithMemory:
    """Return a tracker as a `TrackerWithMemory`."""
    if callable(getattr(tracker, "step", None)) and callable(getattr(tracker, "start", None)):
        return cast(TrackerWithMemory, tracker)
    return Memoryless(law=cast(Tracker, tracker), batched=bool(getattr(tracker, "batched", False)))
