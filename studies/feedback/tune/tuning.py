"""The gains that `linkplan tune` found, by joint and by motor."""

from typing import Any

import numpy as np
from msgspec import Struct

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.transfer.polytope import motor_gains as gains_at_motors
from linkplan.models.tree.joints import Joint, gain_units_of
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.feedback.tune.requirements import EvaluatedGains


class MotorGains(Struct, frozen=True, kw_only=True, eq=False):
    """Gains of one motor, its effort over its own motion, at the poses (n,) of a tuning.

    `ratio` is the motor's motion per motion of the joint. A single value is None if the ratio changes with the pose, and a
    range is None if some values (n,) are infinite or NaN, at a dead centre.
    """

    actuator: str
    joint: str
    gear: float
    ratio: float | None
    ratio_range: tuple[float, float] | None
    kp: float | None
    kp_range: tuple[float, float] | None
    kd: float | None
    kd_range: tuple[float, float] | None
    units: tuple[str, str]
    values: Beside[dict[str, np.ndarray]] = NOT_READ
    si_units: Beside[tuple[str, str]] = NOT_READ  # of the motor's and of the joint's motion

    @property
    def is_constant(self) -> bool:
        """True if the transmission has the same ratio at all poses, so that one pair of gains is valid for all of them."""
        return self.ratio is not None

    def gains_text(self) -> str:
        """Return the gains as text: one pair, or their ranges over the poses."""
        return ", ".join(f"{name} = {self._text(name)} {unit}" for name, unit in zip(("kp", "kd"), self.units, strict=True))

    def ratio_text(self) -> str:
        """Return the transmission's ratio as text: "ratio 20 to crank", "ratio 0.022 to 0.028 m/rad to K"."""
        own, driven = self.si_units
        return f"ratio {self._text('ratio')}{'' if own == driven else f' {own}/{driven}'} to {self.joint}"

    def _text(self, name: str) -> str:
        values = np.abs(self.values[name])
        low, high = (f"{value:.5g}" for value in (values.min(), values.max()))
        return low if self.is_constant else f"{low} to {high}"


def tuned_joints(mechanism: Mechanism) -> list[Joint]:
    """Return the joints with a feedback loop."""
    return [mechanism.independent_joints[channel] for channel in mechanism.channels]


def gains_by_joint(best: EvaluatedGains, mechanism: Mechanism) -> dict[str, tuple[float, float]]:
    """Return kp and kd of every joint with a loop, by its name."""
    gains = np.array(best.law.settings.gains(mechanism.independent_joints)).T
    names = (joint.name for joint in tuned_joints(mechanism))
    return {name: (float(gains[k, 0]), float(gains[k, 1])) for name, k in zip(names, mechanism.channels, strict=True)}


def tracking_values(best: EvaluatedGains, mechanism: Mechanism) -> dict[str, Any]:
    """Return the gains under the keys of the [tracking] table of a problem file; with several loops by joint."""
    settings, joints = best.law.settings, tuned_joints(mechanism)
    values: dict = {"kp": settings.kp, "kd": settings.kd}
    if best.law.by_errors:
        position, velocity = (joints[0].shown(float(weight[0])) for weight in settings.lqr_errors(joints))
        values = {f"lqr_position_{joints[0].unit}": position, f"lqr_velocity_{joints[0].unit}_s": velocity}
    values |= {"period_s": settings.period_s}
    if settings.delay_periods and float(settings.delay_periods).is_integer():
        values |= {"delay_periods": int(settings.delay_periods)}
    return values


def gains_by_motor(best: EvaluatedGains, mechanism: Mechanism) -> tuple[MotorGains, ...]:
    """Return the motors' gains that give the joints' gains, K_o = G^T K_m G at every pose, for motors of one joint each.

    A motor that moves with several joints is omitted, because it has no gains of its own.
    """
    joints = tuned_joints(mechanism)
    poses = np.array([loop.point.pose for loop in best.loops if loop.channel == mechanism.channels[0]])
    ratio = sampled(mechanism.dynamics.effort_map, poses)[:, list(mechanism.channels)].transpose(0, 2, 1)  # (n, n_u, n_o)
    gains = [np.diag(values) for values in zip(*gains_by_joint(best, mechanism).values(), strict=True)]
    kp, kd = (gains_at_motors(ratio, values) for values in gains)
    acts = np.abs(ratio).max(axis=0) > ROUNDING_SHARE * np.abs(ratio).max(axis=(0, 1))
    found = []
    for m in np.flatnonzero(acts.sum(axis=1) == 1):
        (o,) = np.flatnonzero(acts[m])
        if acts[:, o].sum() > 1:
            continue
        values = {"ratio": ratio[:, m, o], "kp": kp[:, m, m], "kd": kd[:, m, m]}
        one = bool(np.ptp(values["ratio"]) <= ROUNDING_SHARE * np.abs(values["ratio"]).max())
        figures: dict[str, Any] = {name: float(x[0]) if one else None for name, x in values.items()}
        for name, x in values.items():
            figures[f"{name}_range"] = (float(x.min()), float(x.max())) if np.isfinite(x).all() else None
        actuator, joint = mechanism.actuators[m], joints[o]
        found.append(
            MotorGains(
                actuator=actuator.name,
                joint=joint.name,
                gear=actuator.gear,
                units=gain_units_of(actuator.unit),
                **figures,
                values=values,
                si_units=(actuator.si_units[0], joint.si_units[0]),
            )
        )
    return tuple(found)
