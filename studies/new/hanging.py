"""Where freedoms that nothing drives hang at rest: the poses between which a mechanism with fewer actuators can be moved.

Drives hold what they are on; of the poses that are left the one of least potential energy is an equilibrium, and a stable
one. From such a pose to another a motion that is slow beside the swings of what hangs needs little beyond the effort that
holds it.
"""

from collections.abc import Mapping

import mujoco
import numpy as np
import scipy

from linkplan.models.closure.closed_pose import home_of
from linkplan.models.errors import AssemblyError, LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import sprung_freedoms
from linkplan.planner.files.problem_file import mechanism_from_tables

# What drives lack to hold a pose, as a share of the largest effort that holds one [of the weight at the extent]: below it
# the pose is an equilibrium, up to where assembly and the minimisation end.
_BALANCED = 1e-3
_GRAVITY = 9.81
# A coordinate that actuators move by less than this share of the one that they move best is not driven.
_UNDRIVEN = 1e-9
# A pose that differs from home by no more than this is home [rad or m]; where freedoms hang is written in so many decimals
# [deg or m].
_MOVED, _DECIMALS = 1e-6, 3
# What stands balanced is pushed by this [rad or m], or it would stay.
_NUDGE = 1e-3
# The minimisation: its most steps, and the potential energy [of the weight at the extent] that ends it.
_STEPS, _ENERGY = 500, 1e-13
# Loops that stand open by more than this share of the extent after it were not closed by it.
_CLOSED = 1e-5


def driven_columns(mechanism: Mechanism) -> np.ndarray:
    """Return the columns of the independent coordinates that actuators act on, and nothing else decides."""
    arms = np.abs(np.array(mechanism.dynamics.effort_map(mechanism.home))).max(axis=1)
    passive = {column for column, index in enumerate(mechanism.independent) if int(index) in mechanism.passive_dofs}
    return np.array([k for k, arm in enumerate(arms) if arm > _UNDRIVEN * arms.max() and k not in passive], dtype=int)


def rests_by_itself(mechanism: Mechanism, column: int) -> bool:
    """Return whether a coordinate stands by itself where a motion does not name it."""
    return int(mechanism.independent[column]) in mechanism.passive_dofs or column in sprung_freedoms(mechanism)


def hanging_columns(mechanism: Mechanism) -> list[int]:
    """Return the columns of the coordinates that neither an actuator nor a spring decides."""
    driven = driven_columns(mechanism)
    return [k for k in range(mechanism.dof) if k not in driven and not rests_by_itself(mechanism, k)]


def hung(mechanism: Mechanism) -> Mechanism | None:
    """Return a mechanism whose home is where its undriven freedoms hang; None where none do, or hang so already."""
    if not hanging_columns(mechanism):
        return None
    held = mechanism.independent[driven_columns(mechanism)]
    pose = hanging_pose(mechanism, mechanism.home + _NUDGE, {int(index): float(mechanism.home[index]) for index in held})
    if pose is None or np.abs(pose - mechanism.home).max() < _MOVED:
        return None
    pose = np.array([joint.read(round(joint.shown(x), _DECIMALS)) for joint, x in zip(mechanism.joints, pose, strict=True)])
    source = {key: value for key, value in mechanism.source.items() if key not in ("home_deg", "home_m")}
    try:
        return mechanism_from_tables({"mechanism": source | home_of(mechanism.joints, pose)})
    except LinkplanError:
        return None


def at_rest(mechanism: Mechanism, s: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return positions (n_s,) with what hangs moved to where it is at rest; as given where it is, or where home is not.

    Args:
        mechanism: whose actuators hold what they are on.
        s: positions (n_s,).
        near: a pose (n_q,) to begin from, at rest.

    Raises:
        AssemblyError: when there is no rest on the branch of `near`.
    """
    hanging = hanging_columns(mechanism)
    if not hanging or not is_equilibrium(mechanism, mechanism.home):
        return s
    if is_equilibrium(mechanism, close_at(mechanism, s, near)):
        return s
    held = {int(mechanism.independent[k]): float(s[k]) for k in driven_columns(mechanism)}
    pose = hanging_pose(mechanism, near, held)
    rest = s.copy()
    for column in hanging if pose is not None else ():
        joint, x = mechanism.independent_joints[column], pose[mechanism.independent[column]]
        rest[column] = joint.read(round(joint.shown(x), _DECIMALS))
    if pose is None or not is_equilibrium(mechanism, close_at(mechanism, rest, near)):
        raise AssemblyError(f"mechanism '{mechanism.name}' does not hang at rest with its drives at {s}")
    return rest


def is_equilibrium(mechanism: Mechanism, pose: np.ndarray) -> bool:
    """Return whether the actuators, whatever their limits, can hold a mechanism at rest in a pose (n_q,)."""
    still = np.zeros((1, mechanism.dof))
    _, missing = needed_effort(mechanism, np.asarray(pose)[None], still, still)
    unit = np.array([1.0 if j.kind == "hinge" else mechanism.extent_m for j in mechanism.independent_joints])
    return bool(np.abs(missing[0] * unit).max(initial=0.0) < _BALANCED * _energy_unit(mechanism))


def hanging_pose(mechanism: Mechanism, near: np.ndarray, held: Mapping[int, float]) -> np.ndarray | None:
    """Return the pose (n_q,) of least potential energy in which held joints stand at given positions; None where none is.

    Args:
        mechanism: its springs and weights make the energy.
        near: a pose (n_q,) to begin from; the minimum that is found is a local one.
        held: positions [rad or m] by index into q; all other joints may move, as far as loops and ranges let them.
    """
    dynamics, data = mechanism.dynamics, mujoco.MjData(mechanism.model)
    unit = _energy_unit(mechanism)
    start = np.array(near, dtype=float)
    bounds = [(joint.lower, joint.upper) for joint in mechanism.joints]
    for index, joint in enumerate(mechanism.joints):
        if joint.kind == "hinge":  # what turns fully turns no further than it needs
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
        energy, start, method="SLSQP", bounds=bounds, constraints=closed, options={"maxiter": _STEPS, "ftol": _ENERGY}
    )
    if not np.all(np.isfinite(found.x)) or (closed and np.abs(gaps(found.x)).max(initial=0.0) > _CLOSED):
        return None
    try:
        pose = close_at(mechanism, found.x[mechanism.independent], found.x)
    except AssemblyError:
        return None
    return pose if is_equilibrium(mechanism, pose) else None


def _energy_unit(mechanism: Mechanism) -> float:
    """Return the mechanism's weight times its extent [J]."""
    return float(mechanism.model.body_mass.sum()) * _GRAVITY * mechanism.extent_m
