"""Limits at every instant of a motion, and the motors that some limits come from."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from linkplan.models.errors import ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.dynamics import site_index
from linkplan.planner.problem.keys.motion_and_limits import LimitsSection, Motor
from linkplan.planner.problem.settings import DERIVED, frozen, interval, joint_values
from linkplan.planner.problem.sites import BodyLimit, SiteLimit, body_limits_of, site_limits_of

# The fields of `Limits` with one row for each actuator, and for each joint.
OF_ACTUATORS, OF_JOINTS = ("effort", "effort_rate", "power"), ("position", "speed", "acceleration", "jerk")


def free_bounds(n: int) -> np.ndarray:
    """Return infinite [low, high] rows (n, 2)."""
    return np.tile([-np.inf, np.inf], (n, 1))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Limits:
    """Limits at every instant as rows [low, high], infinite without a limit.

    `effort` (n_u, 2) [N.m or N]; `position`, `speed`, `acceleration` and `jerk` (n_q, 2) [rad or m, and per second, its
    square and cube] of all joints; `effort_rate` (n_u, 2) [N.m/s or N/s]; `power` (n_u, 2) [W], mechanical, of each
    actuator; `closure_force` (n_closures,) [N], the largest force of each closure; `singular_margin`, the least |det J_z|
    relative to home; `site`, limits on sites [m]; `body`, on bodies' angles [rad]; `site_acceleration` and `site_jerk`, the
    largest by site [m/s2, m/s3].
    `effort` is the limit for plans: `reserve` is the share of the actuators' own limits that is left to feedback.
    """

    effort: np.ndarray
    position: np.ndarray
    speed: np.ndarray = DERIVED
    acceleration: np.ndarray = DERIVED
    jerk: np.ndarray = DERIVED
    effort_rate: np.ndarray = DERIVED
    power: np.ndarray = DERIVED
    closure_force: np.ndarray = DERIVED
    singular_margin: float = 0.0
    reserve: float = 0.0
    site: tuple[SiteLimit, ...] = ()
    body: tuple[BodyLimit, ...] = ()
    site_acceleration: Mapping[str, float] = field(default_factory=dict)
    site_jerk: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "site", tuple(self.site))
        object.__setattr__(self, "body", tuple(self.body))
        object.__setattr__(self, "closure_force", frozen(() if self.closure_force is None else self.closure_force))
        for names, like in ((OF_ACTUATORS, self.effort), (OF_JOINTS, self.position)):
            for name in names:
                given = getattr(self, name)
                object.__setattr__(self, name, frozen(free_bounds(len(like)) if given is None else given))

    @property
    def actuators_effort(self) -> np.ndarray:
        """The actuators' own limits (n_u, 2) [N.m or N], including the reserve that plans leave to feedback."""
        return self.effort / (1.0 - self.reserve)

    @property
    def tasks(self) -> tuple[SiteLimit | BodyLimit, ...]:
        """The limits on sites and on bodies."""
        return (*self.site, *self.body)

    @property
    def limited_closures(self) -> tuple[int, ...]:
        """The closures with a limited force."""
        return tuple(int(i) for i in np.flatnonzero(np.isfinite(self.closure_force)))


def limits_from(section: LimitsSection, mechanism: Mechanism) -> Limits:
    """Return the limits of a [limits] table; the model's own limits are the default."""
    effort = np.array(mechanism.effort_limit)
    for name, value in section.effort.items():
        effort[actuator_index(mechanism, name, "limits.effort")] = interval(value, f"limits.effort.{name}")
    position = np.array([[joint.lower, joint.upper] for joint in mechanism.joints])
    for index, value in joint_values(section, "range", "limits", mechanism).items():
        joint = mechanism.joints[index]
        shown = interval(value, f"limits.range_{joint.unit}.{joint.name}")
        low, high = (joint.read(end) for end in shown)
        if low < joint.lower or high > joint.upper:
            raise ProblemError(
                f"limits.range_{joint.unit}.{joint.name} = [{shown[0]:g}, {shown[1]:g}] is wider than the model's own range"
                f" [{joint.shown(joint.lower):g}, {joint.shown(joint.upper):g}], where its stops act"
            )
        position[index] = low, high
    forces = np.full(len(mechanism.closure_names), np.inf)
    for name, value in section.closure_force.items():
        forces[closure_index(mechanism, name)] = value
    return Limits(
        effort=(1.0 - section.reserve) * effort,
        reserve=section.reserve,
        position=position,
        speed=_rate_rows(section, "speed", "_s", mechanism),
        acceleration=_rate_rows(section, "acceleration", "_s2", mechanism),
        jerk=_rate_rows(section, "jerk", "_s3", mechanism),
        effort_rate=_actuator_rows(section.effort_rate, "limits.effort_rate", mechanism),
        power=_actuator_rows(section.power_w, "limits.power_w", mechanism),
        closure_force=forces,
        singular_margin=section.singular_margin,
        site=site_limits_of(section.site, mechanism),
        body=body_limits_of(section.body_deg, mechanism),
        site_acceleration=_of_sites(section.site_acceleration_m_s2, "site_acceleration_m_s2", mechanism),
        site_jerk=_of_sites(section.site_jerk_m_s3, "site_jerk_m_s3", mechanism),
    )


def actuator_index(mechanism: Mechanism, name: str, where: str) -> int:
    """Return the index of a named actuator.

    Raises:
        ProblemError: for an unknown name.
    """
    names = [actuator.name for actuator in mechanism.actuators]
    return names.index(choose(f"actuator in {where}", name, names, ProblemError))


def closure_index(mechanism: Mechanism, name: str) -> int:
    """Return the index of a closure named in limits.closure_force.

    Raises:
        ProblemError: for an unknown name.
    """
    names = mechanism.closure_names
    if not names:
        raise ProblemError(f"limits.closure_force.{name}: mechanism '{mechanism.name}' has no closure")
    return names.index(choose("closure in limits.closure_force", name, names, ProblemError))


def _including_rest(value: float | list[float], where: str) -> tuple[float, float]:
    """Return [low, high] of a limit, from a positive number for both ways or an interval that contains zero."""
    if not isinstance(value, list):
        return -value, value
    low, high = interval(value, where)
    if not low <= 0 <= high:
        raise ProblemError(f"{where} must admit rest, low <= 0 <= high, got [{low:g}, {high:g}]")
    return low, high


def _rate_rows(section: LimitsSection, name: str, per: str, mechanism: Mechanism) -> np.ndarray:
    """Return [low, high] (n_q, 2) of a limit on joints' rates, accelerations or jerk, in SI."""
    rows = free_bounds(mechanism.n_q)
    for index, value in joint_values(section, name + per, "limits", mechanism).items():
        joint = mechanism.joints[index]
        ends = _including_rest(value, f"limits.{name}_{joint.unit}{per}.{joint.name}")
        rows[index] = [joint.read(end) for end in ends]
    return rows


def _of_sites(table: dict[str, float], key: str, mechanism: Mechanism) -> dict[str, float]:
    """Return the largest values by site, refused for unknown names."""
    for name in table:
        site_index(mechanism.model, name, f"limits.{key}", ProblemError)
    return dict(table)


def _actuator_rows(table: dict[str, float | list[float]], where: str, mechanism: Mechanism) -> np.ndarray:
    """Return [low, high] (n_u, 2) of a limit per actuator."""
    rows = free_bounds(mechanism.n_u)
    for name, value in table.items():
        rows[actuator_index(mechanism, name, where)] = _including_rest(value, f"{where}.{name}")
    return rows


def motors_of(section: dict[str, Motor], mechanism: Mechanism) -> tuple[Motor | None, ...]:
    """Return the motor of each actuator; None if the [motors] table does not name it."""
    motors: list[Motor | None] = [None] * mechanism.n_u
    for name, motor in section.items():
        index = actuator_index(mechanism, name, "[motors]")
        where, unit = f"motors.{name}", mechanism.actuators[index].unit
        right, wrong = "no_load_speed_m_s", "no_load_speed_deg_s"
        if unit != "N":
            right, wrong = wrong, right
        if getattr(motor, wrong) is not None:
            raise ProblemError(f"actuator '{name}' gives {unit}; use {where}.{right}, not {wrong}")
        for one, other in (("torque_constant", "resistance_ohm"), ("stall_effort", right)):
            if (getattr(motor, one) is None) != (getattr(motor, other) is None):
                raise ProblemError(f"{where}.{one} and {where}.{other} go together, got one of them alone")
        motors[index] = motor
    return tuple(motors)
