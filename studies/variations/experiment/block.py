"""The unit of work of an experiment: a block of samples with every tracker, as columns.

A user's law for single states is copied for each simulation, so that its internal state is not shared between machines.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import Rollout
from linkplan.controllers.sampling import substeps_of
from linkplan.controllers.simulate import bytes_each, rollout_of, simulate
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.controllers.trackers.tracker import AnyTracker, Tracker, TrackerWithMemory
from linkplan.models.errors import ProblemError
from linkplan.studies.compare.compare import build_tracker
from linkplan.studies.compare.user_tracker import (
    CheckedMemory,
    known_tracker,
    knows_batches,
    tracker_named,
    users_code,
    users_tracker,
)
from linkplan.studies.variations.experiment.experiment import Experiment
from linkplan.studies.variations.experiment.metrics import measured, metrics_of
from linkplan.studies.variations.tasks.streaming import blocks_of


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


# A worker computes one block at a time, and an interruption loses at most one block. The largest number of samples of a
# block, and its approximate number of simulator steps, which take about ten seconds.
BLOCK_SAMPLES, BLOCK_STEPS = 128, 2_000_000
# Largest log of simulations that are stepped together; results do not depend on their number.
_MAX_LOG_BYTES = 256 << 20


def block_samples(experiment: Experiment) -> int:
    """Return the number of samples of a whole block."""
    reference, mechanism = experiment.reference, experiment.plan.problem.mechanism
    steps = reference.n * substeps_of(mechanism, reference.period_s) * len(experiment.settings.trackers)
    return max(1, min(BLOCK_SAMPLES, BLOCK_STEPS // steps))


def sample_blocks(experiment: Experiment) -> list[range]:
    """Return the samples of each block."""
    return blocks_of(experiment.n, block_samples(experiment))


def run_block(experiment: Experiment, block: int, threads: int = 0) -> dict[str, list]:
    """Return the results of a block as columns of equal length, ordered by sample and then by tracker.

    Args:
        experiment: the experiment.
        block: index of the block.
        threads: simulator threads; 0 for one per core.
    """
    samples = sample_blocks(experiment)[block]
    mechanism, reference = experiment.plan.problem.mechanism, experiment.reference
    together = max(1, min(BLOCK_SAMPLES, _MAX_LOG_BYTES // bytes_each(mechanism, reference.n)))
    found: dict[tuple[int, str], dict] = {}
    plant = MujocoPlant(mechanism=mechanism, loop=experiment.loop, threads=threads)
    laws = {name: law_of(name, experiment) for name in experiment.settings.trackers}
    for first in range(samples.start, samples.stop, together):
        part = range(first, min(samples.stop, first + together))
        machines = [experiment.machine(sample) for sample in part]  # built once, for all trackers
        for name, law in laws.items():
            ensemble = simulate(plant, law, reference, machines)
            for i, sample in enumerate(part):
                found[sample, name] = measured(ensemble, i, experiment)
    keys = [(sample, name) for sample in samples for name in experiment.settings.trackers]
    columns: dict[str, list] = {"sample": [key[0] for key in keys], "tracker": [key[1] for key in keys]}
    for name in ("success", "failure", *metrics_of(mechanism)):
        columns[name] = [found[key][name] for key in keys]
    for name, values in experiment.varied_values().items():
        columns[name] = [float(values[key[0]]) for key in keys]
    return columns


def replay(experiment: Experiment, tracker: str, sample: int) -> tuple[Rollout, dict]:
    """Return a tracker's run on a sample's machine, and its metrics.

    Raises:
        ProblemError: for an unknown sample, or one that failed before its first instant.
    """
    if not 0 <= sample < experiment.n:
        raise ProblemError(f"samples of this experiment must be from 0 to {experiment.n - 1}, got {sample}")
    mechanism, reference = experiment.plan.problem.mechanism, experiment.reference
    law = law_of(tracker if tracker in experiment.own else known_tracker(tracker), experiment)
    plant = MujocoPlant(mechanism=mechanism, loop=experiment.loop)
    ensemble = simulate(plant, law, reference, [experiment.machine(sample)])
    if ensemble.done[0] == 0:
        raise ProblemError(f"sample {sample} has no run: {ensemble.failure[0]}")
    labels = [factor.label for factor in experiment.section.factors]
    record = {
        "sample": sample,
        "tracker": tracker,
        "imperfections": dict(zip(labels, experiment.values[sample].tolist(), strict=True)),
        **measured(ensemble, 0, experiment),
    }
    run = rollout_of(plant, ensemble, reference)
    # The mechanism's model would give wrong closure gaps for a machine with other link lengths.
    return replace(run, gap_m=np.full(len(run.time_s), ensemble.gap_m[0])), record
