"""The study behind `linkplan bode`: a PD loop at chosen poses, predicted, and tried in MuJoCo."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controllers.feedforward import Feedforward
from controllers.pd import pd
from controllers.reference import SampledReference
from controllers.rollout import Loop, Rollout, run
from models.assembly import reach
from models.mechanism import Mechanism
from studies.frequency import Gains, PosePoint, pose_point

# A trial in MuJoCo starts with a kick of this joint speed [rad/s or m/s], small against any motion, and
# lasts this many periods: enough for a loop a few percent beyond its border to grow or to die away by orders.
_KICK_SPEED = 1e-2
_TRIAL_PERIODS = 2000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BodePoint:
    """A pose with its predicted loop and whether MuJoCo's own run of it settles."""

    predicted: PosePoint
    settles_in_mujoco: bool


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BodeStudy:
    """A PD loop over several poses."""

    mechanism: Mechanism
    gains: Gains
    points: tuple[BodePoint, ...]

    @property
    def stable(self) -> bool:
        """Whether the sampled loop is stable at every pose."""
        return all(point.predicted.sampled.margins.stable for point in self.points)

    @property
    def message(self) -> str:
        """The verdict in a sentence."""
        joint, index = self.mechanism.independent_joints[0], self.mechanism.independent[0]
        loop = f"kp = {self.gains.kp:g}, kd = {self.gains.kd:g} sampled every {self.gains.period_s:g} s"
        if self.gains.delay_periods:
            loop += f" with a delay of {self.gains.delay_periods} period(s)"
        bad = [p.predicted for p in self.points if not p.predicted.sampled.margins.stable]
        if not bad:
            margins = [p.predicted.sampled.margins.phase_margin_deg for p in self.points]
            known = [m for m in margins if m is not None]
            worst = f", phase margin {min(known):.1f} deg at the worst" if known else ""
            return f"stable at all {len(self.points)} poses: {loop}{worst}"
        where = ", ".join(f"{joint.shown(p.pose[index]):.4g}" for p in bad)
        return f"unstable at {joint.name} = {where} {joint.unit} ({len(bad)} of {len(self.points)} poses): {loop}"


def default_positions(mechanism: Mechanism, positions: np.ndarray | None = None) -> np.ndarray:
    """Return five positions of the independent joint: over given ones (n,), or over the middle of its reach."""
    if positions is not None and len(positions):
        return np.linspace(float(np.min(positions)), float(np.max(positions)), 5)
    can = reach(mechanism)
    low, high = can.lower.position, can.upper.position
    if can.turns_fully:
        low, high = mechanism.home[mechanism.independent[0]] + np.array([-0.5, 0.5]) * np.pi
    return np.linspace(low + 0.1 * (high - low), high - 0.1 * (high - low), 5)


def bode_study(
    mechanism: Mechanism, positions: np.ndarray, gains: Gains, effort_limit: np.ndarray, say: Callable[[str], None]
) -> BodeStudy:
    """Return the loop at independent positions (n,) [rad or m]."""
    joint, points = mechanism.independent_joints[0] if mechanism.dof else None, []
    for position in positions:
        say(f"{joint.name} = {joint.shown(position):.4g} {joint.unit}")
        predicted = pose_point(mechanism, np.array([position]), gains)
        trial = settle_trial(mechanism, predicted, gains, effort_limit)
        points.append(BodePoint(predicted=predicted, settles_in_mujoco=settles(trial)))
    return BodeStudy(mechanism=mechanism, gains=gains, points=tuple(points))


def settle_trial(mechanism: Mechanism, point: PosePoint, gains: Gains, effort_limit: np.ndarray) -> Rollout:
    """Return MuJoCo's run of the loop held at a pose after a small kick."""
    n = _TRIAL_PERIODS
    velocity = np.zeros((n, 1))
    velocity[0] = _KICK_SPEED
    reference = SampledReference(
        period_s=gains.period_s,
        time_s=gains.period_s * np.arange(n),
        pose=np.tile(point.pose, (n, 1)),
        position=np.tile(point.pose[mechanism.independent], (n, 1)),
        velocity=velocity,
        effort=np.tile(point.holding_effort, (n, 1)),
        cycle=None,
    )
    tracker = Feedforward(reference=reference, feedback=pd(mechanism, reference, gains.kp, gains.kd))
    return run(mechanism, reference, tracker, Loop(effort_limit=effort_limit, delay_periods=gains.delay_periods))


def settles(trial: Rollout) -> bool:
    """Return whether a kicked loop comes to rest: its speed falls over the run, and nothing swings between limits."""
    if not trial.stable:
        return False
    speed = np.abs(trial.velocity[1:, 0])
    quarter = len(speed) // 4
    return bool(speed[-quarter:].max() < speed[:quarter].max())


def bode_record(study: BodeStudy) -> dict:
    """Return what `linkplan bode --json` says."""
    mechanism, gains = study.mechanism, study.gains
    kinds = [(joint, "deg" if joint.kind == "hinge" else "m") for joint in mechanism.joints]
    points = []
    for point in study.points:
        predicted = point.predicted
        sampled = _margin_record(predicted.sampled.margins)
        points.append(
            {
                "q_deg": {j.name: j.shown(x) for (j, u), x in zip(kinds, predicted.pose, strict=True) if u == "deg"},
                "q_m": {j.name: float(x) for (j, u), x in zip(kinds, predicted.pose, strict=True) if u == "m"},
                "reduced_inertia_kgm2": predicted.reduced_inertia,
                "stiffness": predicted.stiffness,
                "damping": predicted.damping,
                "holding_effort": {a.name: u for a, u in zip(mechanism.actuators, predicted.holding_effort, strict=True)},
                "loops": {
                    "pd": {
                        **sampled,
                        "settles_in_mujoco": point.settles_in_mujoco,
                        "continuous": _margin_record(predicted.continuous.margins),
                    }
                },
            }
        )
    return {
        "mechanism": mechanism.name,
        "stable": study.stable,
        "message": study.message,
        "gains": {name: getattr(gains, name) for name in gains.__slots__},
        "points": points,
    }


def _margin_record(margins) -> dict:
    return {name: getattr(margins, name) for name in margins.__slots__}
