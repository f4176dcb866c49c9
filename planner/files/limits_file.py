"""The [limits] and [motors] tables of a problem file."""

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.names import choose, nearest
from linkplan.planner.files.joint_values import joint_values
from linkplan.planner.files.sites_file import site_limits_of
from linkplan.planner.files.values import interval
from linkplan.planner.problem.limits import Limits, Motor, free
from linkplan.planner.problem.values import number

KEYS = (
    "effort",
    "range_deg",
    "range_m",
    "speed_deg_s",
    "speed_m_s",
    "effort_rate",
    "power_w",
    "closure_force",
    "singular_margin",
    "site",
)
MOTOR_KEYS = ("torque_constant", "resistance_ohm", "stall_effort", "no_load_speed_deg_s", "no_load_speed_m_s")


def limits_of(section: dict, mechanism: Mechanism) -> Limits:
    """Return the limits of a [limits] table, the model's own where it says nothing."""
    effort = np.array(mechanism.effort_limit)
    table = section.get("effort", {})
    if not isinstance(table, dict):
        raise ProblemError(f"limits.effort is a table of actuator = [low, high], got {table!r}")
    names = [actuator.name for actuator in mechanism.actuators]
    for name, value in table.items():
        index = names.index(choose("actuator in limits.effort", name, names, ProblemError))
        effort[index] = interval(value, f"limits.effort.{name}")
    position = np.array([[joint.lower, joint.upper] for joint in mechanism.joints])
    for index, value in joint_values(section, "range", "limits", mechanism).items():
        joint = mechanism.joints[index]
        low, high = (joint.read(end) for end in interval(value, f"limits.range_{joint.unit}.{joint.name}"))
        if low < joint.lower or high > joint.upper:
            raise ProblemError(
                f"limits.range_{joint.unit}.{joint.name} = {value!r} is wider than the model's own range"
                f" [{joint.shown(joint.lower):g}, {joint.shown(joint.upper):g}], where its stops act"
            )
        position[index] = low, high
    speed = np.tile([-np.inf, np.inf], (mechanism.n_q, 1))
    for index, value in joint_values(section, "speed_s", "limits", mechanism).items():
        joint = mechanism.joints[index]
        key = f"limits.speed_{joint.unit}_s.{joint.name}"
        if isinstance(value, list):
            ends = interval(value, key)
        else:
            ends = (-number(value, key, positive=True), number(value, key, positive=True))
        if not ends[0] <= 0 <= ends[1]:
            raise ProblemError(f"{key} admits rest, low <= 0 <= high, got {value!r}")
        speed[index] = [joint.read(end) for end in ends]
    return Limits(
        effort=effort,
        position=position,
        speed=speed,
        effort_rate=_actuator_rows(section, "effort_rate", mechanism),
        power=_actuator_rows(section, "power_w", mechanism),
        closure_force=_closure_forces(section, mechanism),
        singular_margin=number(section.get("singular_margin", 0.0), "limits.singular_margin", least=0.0),
        site=site_limits_of(section, mechanism),
    )


def _actuator_rows(section: dict, key: str, mechanism: Mechanism) -> np.ndarray:
    """Return [low, high] (n_u, 2) of a limit per actuator: a positive number both ways, or [low, high]."""
    rows, names = free(mechanism.n_u), [actuator.name for actuator in mechanism.actuators]
    table = section.get(key, {})
    if not isinstance(table, dict):
        raise ProblemError(f"limits.{key} is a table of actuator = value, got {table!r}")
    for name, value in table.items():
        where = f"limits.{key}.{name}"
        index = names.index(choose(f"actuator in limits.{key}", name, names, ProblemError))
        if isinstance(value, list):
            rows[index] = interval(value, where)
        else:
            rows[index] = np.array([-1.0, 1.0]) * number(value, where, positive=True)
        if not rows[index, 0] <= 0 <= rows[index, 1]:
            raise ProblemError(f"{where} admits rest, low <= 0 <= high, got {value!r}")
    return rows


def _closure_forces(section: dict, mechanism: Mechanism) -> np.ndarray:
    names, table = mechanism.closure_names, section.get("closure_force", {})
    if not isinstance(table, dict):
        raise ProblemError(f"limits.closure_force is a table of closure = newtons, got {table!r}")
    forces = np.full(len(names), np.inf)
    for name, value in table.items():
        if not names:
            raise ProblemError(f"limits.closure_force.{name}: mechanism '{mechanism.name}' has no closure")
        index = names.index(choose("closure in limits.closure_force", name, names, ProblemError))
        forces[index] = number(value, f"limits.closure_force.{name}", positive=True)
    return forces


def motors_of(section: dict, mechanism: Mechanism) -> tuple[Motor | None, ...]:
    """Return the motor behind each actuator, None where the [motors] table names none."""
    motors: list[Motor | None] = [None] * mechanism.n_u
    names = [actuator.name for actuator in mechanism.actuators]
    for name, table in section.items():
        index = names.index(choose("actuator in [motors]", name, names, ProblemError))
        where = f"motors.{name}"
        if not isinstance(table, dict):
            raise ProblemError(f"{where} is a table with keys {', '.join(MOTOR_KEYS)}, got {table!r}")
        for key in table:
            if key not in MOTOR_KEYS:
                raise ProblemError(
                    f"unknown key '{where}.{key}'{nearest(key, MOTOR_KEYS)}; keys are {', '.join(MOTOR_KEYS)}"
                )
        numbers = {key: number(value, f"{where}.{key}", positive=True) for key, value in table.items()}
        linear = mechanism.actuators[index].unit == "N"
        right, wrong = MOTOR_KEYS[4 if linear else 3], MOTOR_KEYS[3 if linear else 4]
        if wrong in numbers:
            raise ProblemError(
                f"actuator '{name}' gives {mechanism.actuators[index].unit}; use {where}.{right}, not {wrong}"
            )
        speed = numbers.get(right)
        for one, other in (("torque_constant", "resistance_ohm"), ("stall_effort", right)):
            if (one in numbers) != (other in numbers):
                raise ProblemError(f"{where}.{one} and {where}.{other} go together, got one of them alone")
        motors[index] = Motor(
            torque_constant=numbers.get("torque_constant"),
            resistance=numbers.get("resistance_ohm"),
            stall_effort=numbers.get("stall_effort"),
            no_load_speed=None if speed is None else speed if linear else float(np.radians(speed)),
        )
    return tuple(motors)
