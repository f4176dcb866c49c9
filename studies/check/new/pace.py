"""The pace of a first motion: its duration, and feedback gains that the model's own simulation can follow."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.equilibrium import sprung_freedoms
from linkplan.models.poses.felt_inertia import felt_inertia
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.problem.problem import Problem
from linkplan.studies.check.new.hanging import GRAVITY_M_S2, driven_columns, hanging_columns

# The phase [rad] that a frequency [rad/s] covers in a first motion's duration [s].
_EIGHT_CYCLES = 8 * 2 * np.pi


def moderate_duration(problem: Problem) -> tuple[float, bool]:
    """Return a duration [s] with two digits, and True if only the simulation of the model makes it that long.

    It is some times the shortest one on a smooth path, so that the efforts are moderate.

    With hanging joints it is at least two swings of a pendulum of the mechanism's size, else at least 0.1 s. The model's own
    simulation must be able to follow it.
    """
    mechanism = problem.mechanism
    shortest = first_guess(problem, problem.start_pose()).duration_s
    swing = 2 * np.pi * np.sqrt(mechanism.extent_m / GRAVITY_M_S2)
    least = 2 * swing if hanging_columns(mechanism) else 0.1
    longer = 4 if sprung_freedoms(mechanism) else 2  # fast motions excite undriven springs
    followed = _EIGHT_CYCLES / _fastest_feedback(problem)
    moderate = max(longer * shortest, least)
    return float(f"{max(moderate, followed):.2g}"), followed > moderate


def _fastest_feedback(problem: Problem) -> float:
    """Return the largest natural frequency [rad/s] of tracking errors that the simulation of the model permits.

    A PD law sampled with period T is stable up to about kd = 2 J / T; a fifth of that gives omega = 0.2 / T. A soft closure
    with time constant tau (solref, at least two timesteps) has the natural frequency 1 / tau; twice that frequency is
    allowed.
    """
    mechanism = problem.mechanism
    time_constants = [2 * float(mechanism.model.opt.timestep)]
    for index in dict.fromkeys(closure.index for closure in mechanism.closures):
        first = float(mechanism.model.eq_solref[index, 0])
        time_constants.append(first if first >= 0 else (-first) ** -0.5)  # MuJoCo reads a negative number as a stiffness
    return min(0.2 / problem.tracking.period_s, 2 / max(time_constants))


def critical_gains(mechanism: Mechanism, problem: Problem, duration: float) -> dict:
    """Return PD gains for a duration: critically damped with the inertia at the start, zero for undriven coordinates.

    The natural frequency has eight cycles in the duration, or fewer if the simulation does not permit such fast feedback.
    """
    inertia = felt_inertia(mechanism, problem.start_pose())
    inertia = np.where(np.isin(np.arange(mechanism.dof), driven_columns(mechanism)), inertia, 0.0)
    frequency = min(_EIGHT_CYCLES / duration, _fastest_feedback(problem))
    gains = {"kp": inertia * frequency**2, "kd": 2 * inertia * frequency}
    names = [joint.name for joint in mechanism.independent_joints]
    rounded = {key: [float(f"{value:.2g}") for value in values] for key, values in gains.items()}
    return {key: v[0] if len(v) == 1 else dict(zip(names, v, strict=True)) for key, v in rounded.items()}


def is_large(mechanism: Mechanism) -> bool:
    """Tell if a mechanism is as large as a robot's leg, or has loops solved by all rows. Each digit then costs seconds."""
    return mechanism.n_q > 10 or mechanism.dof > 5 or bool(mechanism.projected)


def many_hang(mechanism: Mechanism) -> bool:
    """Tell if several joints hang, so that a motion excites several pendulum modes."""
    return len(hanging_columns(mechanism)) > 1
