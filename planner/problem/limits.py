"""Limits at every instant of a motion, and the motors that some limits come from."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.models.errors import ProblemError, choose
from linkplan.models.ground import ground_normal
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.joint_forces import Pin, pins_of
from linkplan.models.tree.coordinates import joint_label
from linkplan.models.tree.dynamics import site_index
from linkplan.planner.problem.keys.limits import LIMIT_KEYS, LimitValues, Motor
from linkplan.planner.problem.keys.section import Section
from linkplan.planner.problem.settings import frozen, interval, joint_values
from linkplan.planner.problem.sites import BodyLimit, SiteLimit, body_limits_of, site_limits_of

# The fields of `Limits` with one row for each joint.
OF_JOINTS = tuple(name for name, key in LIMIT_KEYS.items() if key.by == "joint")


def free_bounds(n: int) -> np.ndarray:
    """Return infinite [low, high] rows (n, 2)."""
    return np.tile([-np.inf, np.inf], (n, 1))


def exact_bounds(asked: np.ndarray, free: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds, low and high, of prescribed values; infinite where these are NaN or `free`."""
    open_values = np.isnan(asked) if free is None else free
    return np.where(open_values, -np.inf, asked), np.where(open_values, np.inf, asked)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Limits(LimitValues):
    """Limits at every instant as rows [low, high], infinite without a limit.

    `effort` (n_u, 2) [N.m or N]; `position`, `speed`, `acceleration` and `jerk` (n_q, 2) [rad or m, and per second, its
    square and cube] of all joints; `effort_rate` (n_u, 2) [N.m/s or N/s]; `initial_effort` (n_u, 2), before the start;
    `power` (n_u, 2) [W], mechanical, of each actuator; `closure_force` (n_closures,) [N], the largest force of each
    closure; `pin_force` [N], that of pins of the tree by their names; `singular_margin`, the least |det J_z| relative to
    home; `site`, the `SiteLimit`s [m]; `body`, the `BodyLimit`s [rad]; `site_speed`, `site_acceleration` and `site_jerk`,
    the largest by site [m/s, m/s2, m/s3]. `effort` is the limit for plans, that of the actuators reduced by `reserve` (see
    `within_reserve`).
    """

    def __post_init__(self) -> None:
        like = {"actuator": len(self.effort), "joint": len(self.position)}
        for name, key in LIMIT_KEYS.items():
            given = getattr(self, name)
            if key.by in like:
                object.__setattr__(self, name, frozen(free_bounds(like[key.by]) if given is None else given))
            elif key.by == "closure":
                object.__setattr__(self, name, frozen(() if given is None else given))
            elif given is None:
                object.__setattr__(self, name, {})

    @property
    def actuators_effort(self) -> np.ndarray:
        """The actuators' own limits (n_u, 2) [N.m or N], including the reserve for feedback."""
        return within_reserve(self.effort, -self.reserve / (1.0 - self.reserve))

    @property
    def tasks(self) -> tuple[SiteLimit | BodyLimit, ...]:
        """The limits on sites and on bodies."""
        return (*self.site, *self.body)

    @property
    def limited_closures(self) -> tuple[int, ...]:
        """The closures with a limited force."""
        return tuple(int(i) for i in np.flatnonzero(np.isfinite(self.closure_force)))


def limits_from(section: Section, mechanism: Mechanism) -> Limits:
    """Return the limits of a [limits] table; the model's own limits are the default."""
    made = {name: _MADE.get(name) or _MADE_BY[key.by] for name, key in LIMIT_KEYS.items()}
    return Limits(**{name: make(section, LIMIT_KEYS[name].name, mechanism) for name, make in made.items()})


def _efforts(section: Any, _: str, mechanism: Mechanism) -> np.ndarray:
    """Return the efforts' [low, high] (n_u, 2), without the reserve for feedback."""
    effort = np.array(mechanism.effort_limit)
    for name, value in section.effort.items():
        effort[actuator_index(mechanism, name, "limits.effort")] = interval(value, f"limits.effort.{name}")
    return within_reserve(effort, section.reserve)


def within_reserve(effort: np.ndarray, reserve: float) -> np.ndarray:
    """Return ranges [low, high] (n_u, 2) without the shares at both ends that are reserved for feedback, in equal parts.

    Half the range times `reserve` is free at each end, so that [-L, L] becomes (1 - reserve) [-L, L]. A range with one
    infinite end counts as [-L, L] if it contains 0; otherwise it has no share, and stays. -r / (1 - r) undoes r.
    """
    half = np.diff(effort, axis=1) / 2
    room = np.where(np.isfinite(half), half, np.maximum(effort * [-1.0, 1.0], 0.0))
    return np.where(np.isfinite(effort), effort + reserve * np.where(np.isfinite(room), room, 0.0) * [1.0, -1.0], effort)


def _ranges(section: Any, _: str, mechanism: Mechanism) -> np.ndarray:
    """Return the joints' ranges (n_q, 2) [rad or m], within the model's own."""
    position = np.array([[joint.lower, joint.upper] for joint in mechanism.joints])
    for index, value in joint_values(section, "range", "limits", mechanism).items():
        joint = mechanism.joints[index]
        shown = interval(value, f"limits.range_{joint.unit}.{joint.name}")
        low, high = (joint.read(end) for end in shown)
        if low < joint.lower or high > joint.upper:
            raise ProblemError(
                f"limits.range_{joint.unit}.{joint.name} = [{shown[0]:g}, {shown[1]:g}] exceeds the model's own range"
                f" [{joint.shown(joint.lower):g}, {joint.shown(joint.upper):g}], at whose ends there are stops"
            )
        position[index] = low, high
    return position


def _of_actuators(section: Any, key: str, mechanism: Mechanism) -> np.ndarray:
    """Return [low, high] (n_u, 2) of a limit by actuator."""
    rows = free_bounds(mechanism.n_u)
    for name, value in getattr(section, key).items():
        where = f"limits.{key}"
        rows[actuator_index(mechanism, name, where)] = _including_rest(value, f"{where}.{name}")
    return rows


def _initial_efforts(section: Any, key: str, mechanism: Mechanism) -> np.ndarray:
    """Return the efforts before the start as rows [effort, effort] (n_u, 2), infinite where they are not given."""
    rows = free_bounds(mechanism.n_u)
    for name, value in section.initial_effort.items():
        rows[actuator_index(mechanism, name, f"limits.{key}")] = value
        if name not in section.effort_rate:
            raise ProblemError(f"limits.{key}.{name} needs limits.effort_rate.{name}: other efforts may begin with a jump")
    return rows


def _of_joints(section: Any, key: str, mechanism: Mechanism) -> np.ndarray:
    """Return [low, high] (n_q, 2), in SI, of a limit by joint whose key is in SI or, for hinges, in degrees."""
    rows = free_bounds(mechanism.n_q)
    if "_deg" not in key:
        for name, value in getattr(section, key).items():
            rows[mechanism.joint_index(name, ProblemError)] = _including_rest(value, f"limits.{key}.{name}")
        return rows
    for index, value in joint_values(section, key.replace("_deg", ""), "limits", mechanism).items():
        joint = mechanism.joints[index]
        ends = _including_rest(value, f"limits.{key.replace('deg', joint.unit)}.{joint.name}")
        rows[index] = [joint.read(end) for end in ends]
    return rows


def _of_closures(section: Any, key: str, mechanism: Mechanism) -> np.ndarray:
    """Return the largest values (n_closures,) of a limit by closure."""
    largest = np.full(len(mechanism.closure_names), np.inf)
    for name, value in getattr(section, key).items():
        largest[closure_index(mechanism, name)] = value
    for name, value in section.pin_force.items():
        if isinstance(at := pin_or_closure(mechanism, name), int):
            if np.isfinite(largest[at]):
                raise ProblemError(
                    f"limits.pin_force.{name} and limits.closure_force.{name} limit one force: keep one of them"
                )
            largest[at] = value
    return largest


def _of_pins(section: Any, key: str, mechanism: Mechanism) -> dict[str, float]:
    """Return the largest forces in pins of the tree by the pin's name."""
    largest: dict[str, float] = {}
    for name, value in getattr(section, key).items():
        at = pin_or_closure(mechanism, name)
        if isinstance(at, Pin):
            if at.name in largest:
                raise ProblemError(f"limits.{key} names joints {at.name}, which share one force, twice: keep one of them")
            largest[at.name] = value
    return largest


def _of_contacts(section: Any, key: str, mechanism: Mechanism) -> dict[str, float]:
    """Return the coefficients of friction by closure, each of a site and a point of the world."""
    for name in getattr(section, key):
        if ground_normal(mechanism.model, mechanism.equalities[closure_index(mechanism, name, key)]) is None:
            raise ProblemError(f"limits.{key}.{name}: closure {name} does not connect a site and a site of the world")
    return dict(getattr(section, key))


def _of_sites(section: Any, key: str, mechanism: Mechanism) -> dict[str, float]:
    """Return the largest values by site, refused for unknown names."""
    for name in getattr(section, key):
        site_index(mechanism.model, name, f"limits.{key}", ProblemError)
    return dict(getattr(section, key))


# The functions that give a key's values in SI: for single limits, and by the kind of part that has the values.
_MADE: dict[str, Callable[[Any, str, Mechanism], Any]] = {
    "effort": _efforts,
    "initial_effort": _initial_efforts,
    "position": _ranges,
    "site": lambda section, _, mechanism: site_limits_of(section.site, mechanism) if section.site else (),
    "body": lambda section, _, mechanism: body_limits_of(section.body_deg, mechanism) if section.body_deg else (),
}
_MADE_BY: dict[str, Callable[[Any, str, Mechanism], Any]] = {
    "actuator": _of_actuators,
    "joint": _of_joints,
    "closure": _of_closures,
    "pin": _of_pins,
    "contact": _of_contacts,
    "site": _of_sites,
    "": lambda section, key, _: getattr(section, key),
}


def actuator_index(mechanism: Mechanism, name: str, where: str) -> int:
    """Return the index of a named actuator.

    Raises:
        ProblemError: for an unknown name.
    """
    names = [actuator.name for actuator in mechanism.actuators]
    return names.index(choose(f"actuator in {where}", name, names, ProblemError))


def closure_index(mechanism: Mechanism, name: str, key: str = "closure_force") -> int:
    """Return the index of a closure named in a key of [limits].

    Raises:
        ProblemError: for an unknown name.
    """
    names = mechanism.closure_names
    if not names:
        raise ProblemError(
            f"limits.{key}.{name}: mechanism '{mechanism.name}' has no closure; limits.pin_force limits joints"
        )
    return names.index(choose(f"closure in limits.{key} (joints: limits.pin_force)", name, names, ProblemError))


def pin_or_closure(mechanism: Mechanism, name: str) -> Pin | int:
    """Return the pin of a joint named in limits.pin_force, or the index of the closure of that name.

    Raises:
        ProblemError: for a name that is unknown, or that both a joint and a closure have.
    """
    pins, closures = pins_of(mechanism), mechanism.closure_names
    of = {joint: pin for pin in pins for joint in pin.joints}
    if name in of and name in closures:
        raise ProblemError(
            f"limits.pin_force.{name} is the name of a joint and of a closure: limits.pin_force.'{of[name].name}' limits the"
            f" joint, limits.closure_force.{name} the closure"
        )
    of |= {pin.name: pin for pin in pins if pin.joints[0] in closures}
    free = [joint_label(mechanism.model, joint) for joint in range(mechanism.model.njnt)]
    if name in free and name not in (*of, *closures):
        raise ProblemError(f"limits.pin_force.{name}: joint {name} leaves its body all six freedoms and carries no force")
    chosen = choose("joint or closure in limits.pin_force", name, [*of, *closures], ProblemError)
    return of[chosen] if chosen in of else closures.index(chosen)


def _including_rest(value: float | list[float], where: str) -> tuple[float, float]:
    """Return [low, high] of a limit, from a positive number for both directions or an interval that contains zero."""
    if not isinstance(value, list):
        return -value, value
    low, high = interval(value, where)
    if not low <= 0 <= high:
        raise ProblemError(f"{where} must admit rest, low <= 0 <= high, got [{low:g}, {high:g}]")
    return low, high


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
            raise ProblemError(f"actuator '{name}' has the unit {unit}; use {where}.{right}, not {wrong}")
        for one, other in (("torque_constant", "resistance_ohm"), ("stall_effort", right)):
            if (getattr(motor, one) is None) != (getattr(motor, other) is None):
                raise ProblemError(f"{where}.{one} and {where}.{other} must be given together, got only one of them")
        motors[index] = motor
    return tuple(motors)
