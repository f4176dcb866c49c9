"""The laws of an experiment: built-in trackers, and users' trackers adapted to many simulations at once.

A user's law for single states is copied for each simulation, so that its internal state is not shared between machines.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.controllers.trackers.tracker import AnyTracker, Tracker, TrackerWithMemory
from linkplan.studies.compare.compare import build_tracker
from linkplan.studies.compare.user_tracker import CheckedMemory, knows_batches, tracker_named, users_code, users_tracker
from linkplan.studies.variations.experiment.experiment import Experiment


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OneByOne:
    """A law for single states as a `TrackerWithMemory`: the memory (n, 1) holds a copy of the law for each simulation."""

    name: str
    make: Callable[[], AnyTracker]
    batched: bool = False

    def start(self, n: int) -> np.ndarray:
        """Return the laws (n, 1) of n simulations."""
        laws = np.empty((n, 1), dtype=object)
        for i in range(n):
            laws[i, 0] = self.make()
        return laws

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] of states (n, n_s), each from its own law."""
        each = [law.effort(k, s, v) for (law,), s, v in zip(memory, position_rad, velocity_rad_s, strict=True)]
        return np.array(each, dtype=float), memory


def law_of(name: str, experiment: Experiment) -> AnyTracker:
    """Return the law of an experiment's tracker.

    Raises:
        LinkplanError: if it cannot be built for this plan.
    """
    plan, reference = experiment.plan, experiment.reference
    if name in TRACKERS:
        return build_tracker(name, plan, reference)
    asked = experiment.own[name] if name in experiment.own else tracker_named(name)
    mechanism = plan.problem.mechanism

    def made() -> Tracker | TrackerWithMemory:
        law = users_tracker(asked, mechanism, reference)
        if isinstance(law, CheckedMemory):
            law.start(1)
        return law

    def copied() -> Tracker | TrackerWithMemory:
        law = made()
        with users_code(name, "cannot be copied, one for each machine"):
            return copy.deepcopy(law)

    first = made()
    if knows_batches(first):
        return first
    copied()
    return OneByOne(name=name, make=copied)


def unbatched_notes(experiment: Experiment) -> list[str]:
    """Return a line for each user's tracker without batches; refuse trackers that cannot be built."""
    laws = {name: law_of(name, experiment) for name in experiment.settings.trackers if name not in TRACKERS}
    return [
        f"{name} is evaluated for one state at a time, which is slower, because it has neither batched = True nor start and"
        " step"
        for name, law in laws.items()
        if isinstance(law, OneByOne)
    ]
