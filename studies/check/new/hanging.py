"""Gravity equilibria of undriven joints: start and goal poses for a mechanism with fewer actuators than coordinates.

The drives hold their coordinates; the pose of least potential energy of the other coordinates is a stable equilibrium. A
motion between two such poses needs little more than the holding effort, if it is slow compared with the swings of the
hanging joints.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import scipy

from linkplan.models.closure.initial_assembly import home_of
from linkplan.models.errors import AssemblyError, LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import lock_words, sprung_freedoms
from linkplan.models.tree.joints import Joint, unit_steps
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.default_gains import driven_columns

GRAVITY_M_S2 = 9.81


def rests_by_itself(mechanism: Mechanism, column: int) -> bool:
    """Tell if a coordinate is passive, coasts or is held by springs, so that a motion need not name it."""
    return not mechanism.actuated[column] or column in sprung_freedoms(mechanism)


def hanging_columns(mechanism: Mechanism) -> list[int]:
    """Return the columns of the coordinates that neither an actuator nor a spring holds."""
    driven = driven_columns(mechanism)
    return [k for k in range(mechanism.dof) if k not in driven and not rests_by_itself(mechanism, k)]


def driven_at_home(mechanism: Mechanism) -> dict[int, float]:
    """Return the home positions [rad or m] of the driven coordinates by index into q."""
    return {int(index): float(mechanism.home[index]) for index in mechanism.independent[driven_columns(mechanism)]}


def at_gravity_equilibrium(mechanism: Mechanism) -> Mechanism | None:
    """Return a mechanism whose home is the gravity equilibrium of its undriven joints; None if its home already is."""
    if not hanging_columns(mechanism):
        return None
    off = 1e-3  # [rad or m], step away from an unstable equilibrium; if the energy is flat, the search ends where it begins
    pose = hanging_pose(mechanism, mechanism.home + off, driven_at_home(mechanism))
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


def resting_positions(mechanism: Mechanism, s: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return positions (n_s,) with the hanging joints moved to equilibrium; unchanged if home is no equilibrium.

    Args:
        mechanism: whose actuators hold the driven coordinates.
        s: positions (n_s,).
        near: an equilibrium pose (n_q,), the start of the search.

    Raises:
        AssemblyError: if there is no equilibrium on the branch of `near`.
    """
    hanging = hanging_columns(mechanism)
    if (
        not hanging
        or not is_equilibrium(mechanism, mechanism.home)
        or is_equilibrium(mechanism, close_at(mechanism, s, near))
    ):
        return s
    held = {int(mechanism.independent[k]): float(s[k]) for k in driven_columns(mechanism)}
    pose = hanging_pose(mechanism, near, held)
    rest = s.copy()
    for column in hanging if pose is not None else ():
        rest[column] = _rounded(mechanism.independent_joints[column], float(pose[mechanism.independent[column]]))
    if pose is None or not is_equilibrium(mechanism, close_at(mechanism, rest, near)):
        lock = lock_at_home(mechanism, hanging)
        raise AssemblyError(f"undriven joints have no equilibrium on the path{lock and f'; {lock} holds them'}")
    return rest


def lock_at_home(mechanism: Mechanism, columns: Sequence[int]) -> str:
    """Return the key that locks coordinates at home, including existing locks; "" if none of them can be locked."""
    home = mechanism.home[mechanism.independent]
    places = [(mechanism.independent_joints[k], float(home[k])) for k in columns]
    locked = [(joint, x) for joint, x in places if joint.chart is None]
    return lock_words(locked, mechanism.selection.lock) if locked else ""


def is_equilibrium(mechanism: Mechanism, pose: np.ndarray) -> bool:
    """Tell if the actuators, regardless of their limits, can hold a mechanism at rest in a pose (n_q,).

    The missing effort may be a thousandth of the weight at the extent: the accuracy of assembly and minimisation.
    """
    still = np.zeros((1, mechanism.dof))
    _, missing = needed_effort(mechanism, np.asarray(pose)[None], still, still)
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    return bool(np.abs(missing[0] * unit).max(initial=0.0) < 1e-3 * _energy_unit(mechanism))


def hanging_pose(mechanism: Mechanism, near: np.ndarray, held: Mapping[int, float]) -> np.ndarray | None:
    """Return the pose of `least_energy_pose` if it is an equilibrium, on no stop; None if none is found."""
    pose = least_energy_pose(mechanism, near, held)
    return pose if pose is not None and is_equilibrium(mechanism, pose) else None


def least_energy_pose(mechanism: Mechanism, near: np.ndarray, held: Mapping[int, float]) -> np.ndarray | None:
    """Return the closed pose (n_q,) of least potential energy, with joints on stops if need be; None if none is found.

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
    minimum = scipy.optimize.minimize(
        energy, start, method="SLSQP", bounds=bounds, constraints=closed, options={"maxiter": 500, "ftol": 1e-13}
    )
    if not np.all(np.isfinite(minimum.x)) or (closed and np.abs(gaps(minimum.x)).max(initial=0.0) > 1e-5):
        return None
    try:
        return close_at(mechanism, minimum.x[mechanism.independent], minimum.x)
    except AssemblyError:
        return None


def _energy_unit(mechanism: Mechanism) -> float:
    """Return the mechanism's weight times its extent [J]."""
    return float(mechanism.model.body_mass.sum()) * GRAVITY_M_S2 * mechanism.extent_m


def is_large(mechanism: Mechanism) -> bool:
    """Tell if a mechanism is as large as a robot's leg, or has loops solved by all rows. Each digit then costs seconds."""
    return mechanism.n_q > 10 or mechanism.dof > 5 or bool(mechanism.projected)


def many_hang(mechanism: Mechanism) -> bool:
    """Tell if several joints hang, so that a motion excites several pendulum modes."""
    return len(hanging_columns(mechanism)) > 1
