"""The replay of one sample of an experiment: the identical run, with its whole log."""

from dataclasses import replace

import numpy as np

from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import Rollout
from linkplan.controllers.simulate import rollout_of, simulate
from linkplan.models.errors import ProblemError
from linkplan.studies.compare.user_tracker import known_tracker
from linkplan.studies.experiment.experiment import Experiment
from linkplan.studies.experiment.laws import law_of
from linkplan.studies.experiment.metrics import measured


def replay(experiment: Experiment, tracker: str, sample: int) -> tuple[Rollout, dict]:
    """Return a tracker's run on a sample's machine, and its metrics.

    Raises:
        ProblemError: for an unknown sample, or one that failed before its first instant.
    """
    if not 0 <= sample < experiment.n:
        raise ProblemError(f"samples of this experiment are from 0 to {experiment.n - 1}, got {sample}")
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
    # Closure gaps computed from the mechanism's model would be wrong for a machine with other link lengths.
    return replace(run, gap_m=np.full(len(run.time_s), ensemble.gap_m[0])), record
