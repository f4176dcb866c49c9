"""One way to ask every tracker: for the efforts of a batch of states, with a memory that the caller holds."""

from dataclasses import dataclass
from typing import cast

import numpy as np

from linkplan.controllers.trackers.tracker import AnyTracker, Tracker, TrackerWithMemory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Memoryless:
    """A `Tracker` as a `TrackerWithMemory` whose memory is empty (n, 0)."""

    law: Tracker
    batched: bool

    @property
    def name(self) -> str:
        """The law's name."""
        return self.law.name

    def start(self, n: int) -> np.ndarray:
        """Return no memory (n, 0)."""
        return np.empty((n, 0))

    def step(self, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N]: of all states at once, or or one by one where it knows single ones."""
        if len(position) == 1:  # without the axis a small law takes half the time
            return np.asarray(self.law.effort(k, position[0], velocity[0]), dtype=float)[None], memory
        if self.batched:
            return self.law.effort(k, position, velocity), memory
        each = [self.law.effort(k, s, v) for s, v in zip(position, velocity, strict=True)]
        return np.array(each, dtype=float), memory


def steps_of(tracker: AnyTracker) -> TrackerWithMemory:
    """Return a tracker as one that is asked for a batch and given its memory."""
    if callable(getattr(tracker, "step", None)) and callable(getattr(tracker, "start", None)):
        return cast(TrackerWithMemory, tracker)
    return Memoryless(law=cast(Tracker, tracker), batched=bool(getattr(tracker, "batched", False)))
