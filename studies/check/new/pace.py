"""The pace of a first motion: a duration that the model's own simulation can follow."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.equilibrium import sprung_freedoms
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.problem.default_gains import fastest_feedback, with_gains
from linkplan.planner.problem.problem import Problem
from linkplan.studies.check.new.hanging import GRAVITY_M_S2, hanging_columns

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
    followed = _EIGHT_CYCLES / fastest_feedback(mechanism, problem.tracking.period_s)
    moderate = max(longer * shortest, least)
    return float(f"{max(moderate, followed):.2g}"), followed > moderate


def gains_table(problem: Problem) -> dict:
    """Return the default gains of a first motion, as its [tracking] table."""
    found = with_gains(problem.tracking.replace(kp=None, kd=None), problem.mechanism, problem.start_pose)
    return {"kp": found.kp, "kd": found.kd}


def is_large(mechanism: Mechanism) -> bool:
    """Tell if a mechanism is as large as a robot's leg, or has loops solved by all rows. Each digit then costs seconds."""
    return mechanism.n_q > 10 or mechanism.dof > 5 or bool(mechanism.projected)


def many_hang(mechanism: Mechanism) -> bool:
    """Tell if several joints hang, so that a motion excites several pendulum modes."""
    return len(hanging_columns(mechanism)) > 1
