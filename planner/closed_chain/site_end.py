"""Sites at the phase boundaries of a program, where waypoints and goals leave the pose free."""

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.limits.site import site_at_home
from linkplan.planner.problem.problem import Problem
from linkplan.planner.transcription.system import Endpoint


def coordinate_row(mechanism: Mechanism, site: int, axis: int, value: float) -> float:
    """Return the value of a site coordinate's row at the coordinate `value` [m]."""
    return float(value - site_at_home(mechanism, site)[axis]) / mechanism.extent_m


def site_endpoint(problem: Problem, unit: np.ndarray, n_z: int) -> tuple[Endpoint | None, np.ndarray]:
    """Return the endpoint rows of a motion with a free goal pose, and their parameters: the sites' coordinates [m].

    If the goal pose is prescribed, there is no endpoint and no parameter.

    Args:
        problem: the problem.
        unit: units of the independent positions (n_s,) [rad or m].
        n_z: the number of algebraic unknowns; the dependent joints come first.
    """
    mechanism, motion = problem.mechanism, problem.motion
    if not motion.goal_is_free:
        return None, np.zeros(0)
    n_s, n_dependent = mechanism.dof, len(mechanism.dependent)
    first, last, duration = (ca.SX.sym(*of) for of in (("first", 2 * n_s), ("last", 2 * n_s), ("duration", 1)))
    asked = ca.SX.sym("asked", len(motion.goal_rows))
    z = ca.SX.sym("z", n_z)
    order = np.argsort(np.concatenate([mechanism.independent, mechanism.dependent]))
    q = ca.vertcat(last[:n_s] * ca.DM(unit), z[:n_dependent])[[int(i) for i in order]]
    places = mechanism.dynamics.site_places(q)
    at = ca.vertcat(*[places[:, point.index] for point in motion.goal_at])[list(motion.goal_rows)]
    column = ca.vertcat((at - asked) / mechanism.extent_m, 0.0)
    inputs = [first, last, duration, asked, *([z] if n_dependent else [])]
    points = np.concatenate([point.point for point in motion.goal_at])[list(motion.goal_rows)]
    function = ca.Function("site_end", inputs, [column])
    return Endpoint(function=function, n_rows=len(motion.goal_rows), algebraic=bool(n_dependent)), points
