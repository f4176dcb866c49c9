"""The source document's experiment: a sinusoid under PD with two gain sets, on the printed and on the corrected model.

Its loop reads `data.sensordata` before `mj_step`. MuJoCo computes sensors before it integrates, so the loop sees the state
of one step earlier. Every run is made so, and with the present state.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

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

# The gains KP [N.m/rad] and KD [N.m.s/rad] of the document's two plots.
DOCUMENT_GAINS = ((200.0, 1.0), (200.0, 10.0))
_DURATION_S = 2.0
AS_PRINTED, CORRECTED = "as printed", "corrected"
# The same models with the other sensors: the printed one with the present state, the corrected one with late sensors.
PRINTED_IN_TIME, CORRECTED_LATE = "printed, in time", "corrected, late"
# Runs by (model, KP, KD).
DocumentRuns = dict[tuple[str, float, float], Rollout]


@dataclass(frozen=True, eq=False, slots=True)
class LateSensors:
    """A law of one state that sees the state of one control period earlier; the first period has the first state."""

    law: StateFeedback

    @property
    def name(self) -> str:
        """The law's name."""
        return self.law.name

    def start(self, n: int) -> np.ndarray:
        """Return the memory (n, 2 n_s): the state before, of which the first one is not a number."""
        return np.full((n, 2 * self.law.reference.position_rad.shape[1]), np.nan)

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] and the next memory."""
        now = np.hstack([position_rad, velocity_rad_s])
        position, velocity = np.split(np.where(np.isnan(memory), now, memory), 2, axis=1)
        return self.law.effort(k, position, velocity), now


def is_the_documents(plan: Plan) -> bool:
    """Return True if a plan is the document's experiment: its sinusoid, followed exactly, on the knee without a payload."""
    problem = plan.problem
    tracked = problem.motion.kind == "track" and isinstance(problem.reference, Sine)
    unloaded = problem.mechanism.payload is None and problem.mechanism.forces is None
    return problem.mechanism.name == "optimus-knee" and unloaded and tracked


def document_runs(plan: Plan, say: Callable[[str], None]) -> DocumentRuns:
    """Return the document's runs on the printed and on the corrected model, by (model, KP, KD).

    The gains are the two pairs of the document and, if they differ, those of the plan's problem.

    Args:
        plan: of the document's sinusoid.
        say: called with lines on the progress.
    """
    assert isinstance(plan.problem.reference, Sine)  # the period of the document
    kp, kd = (float(gain[0]) for gain in plan.problem.tracking.gains(plan.problem.mechanism.independent_joints))
    gains = tuple(dict.fromkeys((*DOCUMENT_GAINS, (kp, kd))))
    return _printed_runs(plan.problem.reference, gains, say) | _corrected_runs(plan, gains, say)


def _corrected_runs(plan: Plan, gains: Sequence[tuple[float, float]], say: Callable[[str], None]) -> DocumentRuns:
    mechanism, runs = plan.problem.mechanism, {}
    plant = MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=plan.problem.limits.effort))
    reference = sample(mechanism, plan.require_motion("track"), float(mechanism.model.opt.timestep), _DURATION_S)
    for kp, kd in gains:
        law = pd(mechanism, reference, kp, kd)
        for model, of in ((CORRECTED, law), (CORRECTED_LATE, LateSensors(law))):
            say(f"{model}, KP = {kp:g}, KD = {kd:g}")
            runs[model, kp, kd] = simulate_one(plant, of, reference)
    return runs


def _printed_runs(sine: Sine, gains: Sequence[tuple[float, float]], say: Callable[[str], None]) -> DocumentRuns:
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
    for kp, kd in gains:
        gain = np.tile(pd_gain(np.diag(of_O), kp, kd), (reference.n, 1, 1))
        law = StateFeedback(reference=reference, gains=gain, name="pd+ff", feedforward=True)
        for model, of in ((AS_PRINTED, LateSensors(law)), (PRINTED_IN_TIME, law)):
            say(f"{model}, KP = {kp:g}, KD = {kd:g}")
            runs[model, kp, kd] = simulate_one(plant, of, reference)
    return runs


def document_rows(runs: Mapping[tuple[str, float, float], Rollout]) -> list[dict]:
    """Return the runs' metrics: error, loop gap over the second half, contacts, share of the time at the limit."""
    rows = []
    for (model, kp, kd), rollout in runs.items():
        error = np.degrees(rollout.error_rad[:, 0])
        half = len(rollout.time_s) // 2
        rows.append(
            {
                "model": model,
                "kp": kp,
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
