"""What a motion demands of each actuator: peak and rms effort, speed, power and energy, for the choice of a motor."""

import numpy as np
from msgspec import Struct

from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import actuator_speeds
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory


class Demand(Struct, frozen=True, kw_only=True):
    """The demand of a motion on one actuator, in its own effort and motion.

    Efforts are in `effort_unit`, speeds in `speed_unit`. `rms_effort` is over the whole motion. Powers are mechanical: the
    largest that the actuator gives as a motor and takes as a brake. `energy_given_j` and `energy_taken_j` are their
    integrals.
    """

    actuator: str
    effort_unit: str
    speed_unit: str
    peak_effort: float
    rms_effort: float
    peak_speed: float
    peak_motor_power_w: float
    peak_brake_power_w: float
    energy_given_j: float
    energy_taken_j: float


def demands_of(problem: Problem, trajectory: Trajectory) -> tuple[Demand, ...]:
    """Return the demand on each actuator.

    Raises:
        AssemblyError: when the loops cannot close along the motion.
    """
    inner, width = trajectory.quadrature()
    _, _, power = operating_points(problem, trajectory, inner)
    rms, time = rms_efforts(trajectory), trajectory.dense_times(20)
    given, taken = width @ np.maximum(power, 0.0), width @ np.maximum(-power, 0.0)
    speed, effort, power = operating_points(problem, trajectory, time)
    found = []
    for j, actuator in enumerate(problem.mechanism.actuators):
        per_unit, unit = shown_speed(actuator.si_units[0])
        found.append(
            Demand(
                actuator=actuator.name,
                effort_unit=actuator.unit,
                speed_unit=unit,
                peak_effort=float(np.abs(effort[:, j]).max()),
                rms_effort=float(rms[j]),
                peak_speed=float(per_unit * np.abs(speed[:, j]).max()),
                peak_motor_power_w=float(power[:, j].max(initial=0.0)),
                peak_brake_power_w=float(-power[:, j].min(initial=0.0)),
                energy_given_j=float(given[j]),
                energy_taken_j=float(taken[j]),
            )
        )
    return tuple(found)


def rms_efforts(trajectory: Trajectory) -> np.ndarray:
    """Return the rms efforts (n_u,) [N.m or N] of a motion."""
    inner, width = trajectory.quadrature()
    return np.sqrt(width @ trajectory.effort_at(inner) ** 2 / trajectory.duration_s)


def operating_points(
    problem: Problem, trajectory: Trajectory, time_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the actuators' speeds [rad/s or m/s], efforts [N.m or N] and powers [W] (n, n_u) at increasing times [s]."""
    poses = follow(problem.mechanism, trajectory.position_at(time_s), trajectory.start_pose)
    speed, effort = actuator_speeds(problem, poses, trajectory.velocity_at(time_s)), trajectory.effort_at(time_s)
    return speed, effort, speed * effort


def shown_speed(unit: str) -> tuple[float, str]:
    """Return the factor to the shown unit of an actuator's speed, and that unit."""
    return (float(np.degrees(1.0)), "deg/s") if unit == "rad" else (1.0, f"{unit}/s")
