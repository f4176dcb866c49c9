"""Gravity equilibria of undriven joints: start and goal poses for a mechanism with fewer actuators than coordinates.

The drives hold their coordinates. The pose of least potential energy of the others is a stable equilibrium. A motion between
two such poses that is slow compared with the swings of the hanging joints needs little more than the holding effort.
"""

from collections.abc import Mapping

import mujoco
import numpy as np
import scipy

from linkplan.models.closure.initial_assembly import home_of
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.errors import AssemblyError, LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import sprung_freedoms
from linkplan.models.tree.joints import Joint, unit_steps
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.studies.check.drives import is_damped

GRAVITY_M_S2 = 9.81


def driven_columns(mechanism: Mechanism) -> np.ndarray:
    """Return the columns of the independent coordinates on which actuators act, without passive ones."""
    arms = np.abs(np.array(mechanism.dynamics.effort_map(mechanism.home))).max(axis=1)
    return np.flatnonzero((arms > 1e-9 * arms.max()) & mechanism.steered)


def rests_by_itself(mechanism: Mechanism, column: int) -> bool:
    """Tell if a coordinate is passive or held by springs, so that a motion does not name it."""
    return not mechanism.steered[column] or column in sprung_freedoms(mechanism)


def hanging_columns(mechanism: Mechanism) -> list[int]:
    """Return the columns of the coordinates that neither an actuator nor a spring holds."""
    driven = driven_columns(mechanism)
    return [k for k in range(mechanism.dof) if k not in driven and not rests_by_itself(mechanism, k)]


def at_gravity_equilibrium(mechanism: Mechanism) -> Mechanism | None:
    """Return a mechanism whose home is the gravity equilibrium of its undriven joints; None if home is."""
    if not hanging_columns(mechanism):
        return None
    held = mechanism.independent[driven_columns(mechanism)]
    off = 1e-3  # [rad or m], from an unstable equilibrium; where the energy is flat, the search ends where it begins
    pose = hanging_pose(mechanism, mechanism.home + off, {int(index): float(mechanism.home[index]) for index in held})
    same = 2 * off if is_equilibrium(mechanism, mechanism.home) else 1e-6
    if pose is None or np.abs(pose - mechanism.home).max() < same:
        return None
    return with_home(mechanism, np.array([_rounded(joint, x) for joint, x in zip(mechanism.joints, pose, strict=True)]))


def with_home(mechanism: Mechanism, pose: np.ndarray) -> Mechanism | None:
    """Return a mechanism with another home pose (n_q,), None if it cannot be assembled there."""
    source = {key: value for key, value in mechanism.source.items() if key not in ("home_deg", "home_m")}
    try:
        return mechanism_from_tables({"mechanism": source | home_of(mechanism.joints, pose)})
    except LinkplanError:
        return None


def _rounded(joint: Joint, position: float, decimals: int = 3) -> float:
    """Return a position rounded to decimals of a degree or metre."""
    return joint.read(round(joint.shown(position), decimals) + 0.0)


def at_rest(mechanism: Mechanism, s: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return positions (n_s,) with the hanging joints moved to equilibrium; unchanged if home is no equilibrium.

    A hanging joint that rests anywhere, as a cart on a rail, is where its momentum, which stays zero, takes it.

    Args:
        mechanism: whose actuators hold the driven coordinates.
        s: positions (n_s,).
        near: an equilibrium pose (n_q,), the start of the search.

    Raises:
        AssemblyError: if there is no equilibrium on the branch of `near`.
    """
    hanging = hanging_columns(mechanism)
    if not hanging or not is_equilibrium(mechanism, mechanism.home):
        return s
    if is_equilibrium(mechanism, close_at(mechanism, s, near)):
        return _carried_along(mechanism, s, near, [k for k in hanging if _keeps_momentum(mechanism, s, near, k)])
    held = {int(mechanism.independent[k]): float(s[k]) for k in driven_columns(mechanism)}
    pose = hanging_pose(mechanism, near, held)
    rest = s.copy()
    for column in hanging if pose is not None else ():
        rest[column] = _rounded(mechanism.independent_joints[column], float(pose[mechanism.independent[column]]))
    if pose is None or not is_equilibrium(mechanism, close_at(mechanism, rest, near)):
        raise AssemblyError(f"mechanism '{mechanism.name}' does not hang at rest with its drives at {s}")
    return rest


def _keeps_momentum(mechanism: Mechanism, s: np.ndarray, near: np.ndarray, column: int) -> bool:
    """Tell if nothing acts on a coordinate wherever it is: no potential, no damping, and the same inertia."""
    moved = s + 0.1 * np.eye(mechanism.dof)[column] * unit_steps(mechanism.independent_joints, mechanism.extent_m)
    try:
        here, there = close_at(mechanism, s, near), close_at(mechanism, moved, near)
    except AssemblyError:
        return False
    inertia = [np.array(mechanism.dynamics.reduced_inertia(pose)) for pose in (here, there)]
    same = np.abs(inertia[1] - inertia[0]).max() <= ROUNDING_SHARE * np.abs(inertia[0]).max()
    return bool(same and not is_damped(mechanism, here, column) and is_equilibrium(mechanism, there))


def _carried_along(mechanism: Mechanism, s: np.ndarray, near: np.ndarray, loose: list[int]) -> np.ndarray:
    """Return positions (n_s,) with the `loose` columns moved from a pose by M_ll s_l' + M_lr s_r' = 0, on a straight way."""
    begin = near[mechanism.independent]
    rest = np.setdiff1d(np.arange(mechanism.dof), loose).tolist()
    if not loose or np.array_equal(s[rest], begin[rest]):
        return s

    def rate(share: float, moved: np.ndarray) -> np.ndarray:
        at = begin + share * (s - begin)
        at[loose] = moved
        M = np.array(mechanism.dynamics.reduced_inertia(close_at(mechanism, at, near)))
        return -np.linalg.solve(M[np.ix_(loose, loose)], M[np.ix_(loose, rest)] @ (s - begin)[rest])

    found = s.copy()
    solution = scipy.integrate.solve_ivp(rate, (0.0, 1.0), begin[loose], method="DOP853", rtol=1e-10, atol=1e-12)
    for column, x in zip(loose, solution.y[:, -1].tolist(), strict=True):
        found[column] = _rounded(mechanism.independent_joints[column], x, 9)  # an idle roller does not turn by 1e-11 deg
    return found


def is_equilibrium(mechanism: Mechanism, pose: np.ndarray) -> bool:
    """Tell if the actuators, regardless of their limits, can hold a mechanism at rest in a pose (n_q,).

    The missing effort may be a thousandth of the weight at the extent: the accuracy of assembly and minimisation.
    """
    still = np.zeros((1, mechanism.dof))
    _, missing = needed_effort(mechanism, np.asarray(pose)[None], still, still)
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    return bool(np.abs(missing[0] * unit).max(initial=0.0) < 1e-3 * _energy_unit(mechanism))


def hanging_pose(mechanism: Mechanism, near: np.ndarray, held: Mapping[int, float]) -> np.ndarray | None:
    """Return the pose (n_q,) of least potential energy with held joints at given positions; None if none is found.

    Args:
        mechanism: with the springs and weights that store the energy.
        near: a pose (n_q,), the start of the search for a local minimum.
        held: positions [rad or m] by index into q; all other joints may move within loops and ranges.
    """
    dynamics, data = mechanism.dynamics, mujoco.MjData(mechanism.model)
    unit = _energy_unit(mechanism)
    start = np.array(near, dtype=float)
    bounds = [(joint.lower, joint.upper) for joint in mechanism.joints]
    for index, joint in enumerate(mechanism.joints):
        if joint.kind == "hinge":  # at most half a turn to each side
            bounds[index] = (max(joint.lower, start[index] - np.pi), min(joint.upper, start[index] + np.pi))
    for index, value in held.items():
        bounds[index], start[index] = (value, value), value

    def energy(q: np.ndarray) -> float:
        data.qpos[:] = mechanism.qpos_of(q)
        mujoco.mj_fwdPosition(mechanism.model, data)
        mujoco.mj_energyPos(mechanism.model, data)
        return float(data.energy[0]) / unit

    def gaps(q: np.ndarray) -> np.ndarray:
        return np.array(dynamics.independent_closure(q)).ravel() / mechanism.extent_m

    closed = [{"type": "eq", "fun": gaps}] if mechanism.closures else []
    found = scipy.optimize.minimize(
        energy, start, method="SLSQP", bounds=bounds, constraints=closed, options={"maxiter": 500, "ftol": 1e-13}
    )
    if not np.all(np.isfinite(found.x)) or (closed and np.abs(gaps(found.x)).max(initial=0.0) > 1e-5):
        return None
    try:
        pose = close_at(mechanism, found.x[mechanism.independent], found.x)
    except AssemblyError:
        return None
    return pose if is_equilibrium(mechanism, pose) else None


def _energy_unit(mechanism: Mechanism) -> float:
    """Return the mechanism's weight times its extent [J]."""
    return float(mechanism.model.body_mass.sum()) * GRAVITY_M_S2 * mechanism.extent_m
