"""One sample of an experiment run again: the same machine, the same noise, the same bits, with its whole log."""

import mujoco
import numpy as np

from linkplan.controllers.ensemble import Ensemble, run_ensemble
from linkplan.controllers.reference import state_at
from linkplan.controllers.rollout import Rollout, closure_gaps
from linkplan.models.errors import ProblemError
from linkplan.studies.compare.user_tracker import known_tracker
from linkplan.studies.experiment.experiment import Experiment
from linkplan.studies.experiment.laws import law_of
from linkplan.studies.experiment.metrics import measured, within_tube


def replay(experiment: Experiment, tracker: str, sample: int) -> tuple[Rollout, dict]:
    """Return a tracker's run on a sample's machine, and its metrics.

    Raises:
        ProblemError: for a sample that the experiment has not.
        LinkplanError: for a sample that failed before its first instant.
    """
    if not 0 <= sample < experiment.n:
        raise ProblemError(f"samples of this experiment are from 0 to {experiment.n - 1}, got {sample}")
    mechanism, reference = experiment.plan.problem.mechanism, experiment.reference
    law = law_of(known_tracker(tracker), experiment)
    ensemble = run_ensemble(mechanism, reference, law, experiment.loop, [experiment.machine(sample)])
    if ensemble.done[0] == 0:
        raise ProblemError(f"sample {sample} has no run: {ensemble.failure[0]}")
    labels = [factor.label for factor in experiment.section.factors]
    said = {
        "sample": sample,
        "tracker": tracker,
        "imperfections": dict(zip(labels, experiment.values[sample].tolist(), strict=True)),
        "failure": ensemble.failure[0],
        "success": within_tube(ensemble, 0, experiment.yardstick),
        **measured(ensemble, 0, experiment.yardstick),
    }
    return _rollout(experiment, ensemble), said


def _rollout(experiment: Experiment, ensemble: Ensemble) -> Rollout:
    mechanism = experiment.plan.problem.mechanism
    kept = slice(0, int(ensemble.done[0]))
    time, pose = ensemble.time_s[kept, 0], ensemble.pose[kept, 0]
    return Rollout(
        tracker=ensemble.tracker,
        time_s=time,
        position=pose[:, mechanism.independent],
        velocity=ensemble.velocity[kept, 0],
        reference=state_at(experiment.reference, time)[0],
        pose=pose,
        commanded=ensemble.commanded[kept, 0],
        applied=ensemble.applied[kept, 0],
        gap_m=np.full(len(time), ensemble.gap_m[0]),
        gap_rad=closure_gaps(mechanism, pose)[1],
        contacts=0,
        finite=ensemble.failure[0] is None,
        effort_limit=experiment.loop.effort_limit,
        conditions={
            "mechanism": mechanism.name,
            "mujoco": mujoco.__version__,
            "timestep_s": float(ensemble.timestep_s[0]),
            "integrator": mujoco.mjtIntegrator(int(mechanism.model.opt.integrator)).name.removeprefix("mjINT_"),
            "control_period_s": experiment.reference.period_s,
            "delay_periods": experiment.loop.delay_periods,
        },
    )
