"""The source document's experiment: a sinusoid under PD with two gain sets, on the printed and on the corrected model."""

from collections.abc import Callable, Mapping

import numpy as np

from linkplan.controllers.mujoco_plant import MujocoPlant, PlantAsItStands
from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.rollout import ControlLoop, Rollout
from linkplan.controllers.simulate import simulate_one
from linkplan.controllers.trackers.pd import pd, pd_gain
from linkplan.controllers.trackers.tracker import StateFeedback
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.reference import Sine

DOCUMENT_KP = 200.0
KD = (1.0, 10.0)
_DURATION_S = 2.0
AS_PRINTED, MENDED = "as printed", "mended"


def is_the_documents(plan: Plan) -> bool:
    """Return True if a plan is the document's experiment: its sinusoid, tracked exactly, on the knee without a payload."""
    problem = plan.problem
    return problem.mechanism.name == "optimus-knee" and problem.mechanism.payload is None and problem.motion.kind == "track"


def mended_runs(plan: Plan, say: Callable[[str], None]) -> dict[tuple[str, float], Rollout]:
    """Return the runs of the corrected model by (model, KD), on the plan of the document's sinusoid."""
    mechanism, runs = plan.problem.mechanism, {}
    plant = MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=plan.problem.limits.effort))
    reference = sample(mechanism, plan.require_motion("track"), float(mechanism.model.opt.timestep), _DURATION_S)
    for kd in KD:
        say(f"{MENDED}, KP = {DOCUMENT_KP:g}, KD = {kd:g}")
        runs[MENDED, kd] = simulate_one(plant, pd(mechanism, reference, DOCUMENT_KP, kd), reference)
    return runs


def printed_runs(sine: Sine, say: Callable[[str], None]) -> dict[tuple[str, float], Rollout]:
    """Return the runs of the document's model as printed, by (model, KD)."""
    source, runs = load_mechanism("optimus-knee-source"), {}
    plant = PlantAsItStands(mechanism=source)
    period_s = float(source.model.opt.timestep)
    time = period_s * np.arange(round(_DURATION_S / period_s))
    of_O, still = np.array([1.0, 0.0]), np.zeros(len(time))
    reference = SampledReference(
        period_s=period_s, time_s=time, pose_rad=np.tile(source.home, (len(time), 1)), cycle=None,
        position_rad=sine.derivative(time, 0) * of_O, velocity_rad_s=sine.derivative(time, 1) * of_O,
        effort=np.stack([still, still + 0.1], axis=1),  # the document sets its second actuator to a constant 0.1 N
    )  # fmt: skip
    for kd in KD:
        say(f"{AS_PRINTED}, KP = {DOCUMENT_KP:g}, KD = {kd:g}")
        gains = np.tile(pd_gain(np.diag(of_O), DOCUMENT_KP, kd), (reference.n, 1, 1))
        law = StateFeedback(reference=reference, gains=gains, name="pd+ff", feedforward=True)
        runs[AS_PRINTED, kd] = simulate_one(plant, law, reference)
    return runs


def document_rows(runs: Mapping[tuple[str, float], Rollout]) -> list[dict]:
    """Return the runs' metrics: error, loop gap over the second half, contacts, share of the time at the limit."""
    rows = []
    for (model, kd), rollout in runs.items():
        error = np.degrees(rollout.error_rad[:, 0])
        half = len(rollout.time_s) // 2
        rows.append(
            {
                "model": model,
                "kp": DOCUMENT_KP,
                "kd": kd,
                "rms_error_deg": float(np.sqrt(np.mean(error**2))),
                "steady_gap_mean_m": float(rollout.gap_m[half:].mean()),
                "steady_gap_max_m": float(rollout.gap_m[half:].max()),
                "contacts": rollout.contacts,
                "at_limit_fraction": float(np.mean(np.abs(rollout.applied[:, 0]) >= 0.999 * rollout.effort_limit[0, 1])),
                "stable": rollout.stable,
            }
        )
    return rows
