"""The choice of a mechanism's coordinates and of the independent rows of its closure, and whether its inertia allows it.

A reduced inertia is singular if some motion of the independent joints has no kinetic energy.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator, constant_arms
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.closure.rank import dependent_columns, independent_rows, numerical_rank, shares
from linkplan.models.errors import InertiaError, ModelError
from linkplan.models.tree.joints import Joint, index_of, where

# A named choice of coordinates is singular if the least singular value of J_z is below this share of the largest. The pose
# is then within some microradians of a dead centre.
_SINGULAR_CHOICE_SHARE = 1e-6
# M_r, scaled to a unit diagonal, is singular if its least eigenvalue is below this. Accelerations would have less than four
# correct digits; rounding leaves 1e-16.
_SINGULAR_EIGENVALUE = 1e-12


def choose_coordinates(
    loop: KinematicLoop,
    model: mujoco.MjModel,
    actuators: Sequence[Actuator],
    jacobians: Sequence[np.ndarray],
    asked: Sequence[str] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the independent rows of phi, the independent coordinates and the dependent coordinates.

    Named joints are independent. Driven joints are independent as far as the closure allows.

    Args:
        loop: the mechanism's closure.
        model: the compiled model.
        actuators: of the mechanism.
        jacobians: of phi at home and at nearby closed poses, (n_rows, n_q) each.
        asked: names of independent joints, or None.

    Raises:
        ModelError: if the named joints do not determine the others at home.
    """
    joints, share = loop.joints, loop.rank_tolerance
    rank = numerical_rank(jacobians[0], share)
    regular = [jacobian for jacobian in jacobians if numerical_rank(jacobian, share) == rank]
    rows = independent_rows(regular, rank, share)
    named, dof = [index_of(loop.name, joints, joint) for joint in asked or ()], len(joints) - rank
    if len(set(named)) < len(named) or len(named) > dof:
        raise ModelError(
            f"mechanism.independent has at most as many joints as '{loop.name}' has degrees of freedom ({dof}), and no joint"
            f" twice; got {', '.join(asked or ())}"
        )
    dependent = _dependent(joints, model, jacobians[0][rows], rank, actuators, named)
    independent = np.array([i for i in range(len(joints)) if i not in dependent], dtype=int)
    return rows, independent, dependent


def _dependent(joints, model, jacobian, rank: int, actuators, named: list[int]) -> np.ndarray:
    """Return the dependent columns: none of the named joints, and as few of the driven joints as possible."""
    driven = [actuator.joint for actuator in actuators if actuator.joint is not None]
    pulled = [dof for actuator in actuators if actuator.joint is None for dof in constant_arms(model, actuator.index)]
    groups, left = [], list(range(len(joints)))
    for group in (named, driven, pulled):
        groups.insert(0, [i for i in dict.fromkeys(group) if i in left])
        left = [i for i in left if i not in groups[0]]
    chosen = dependent_columns(jacobian, rank, [left, *groups])
    lost = [joints[i].name for i in named if i in chosen]
    if lost:
        raise ModelError(
            f"mechanism.independent = {[joints[i].name for i in named]} is singular at home: the loops fix joint"
            f" {', '.join(lost)} there whatever the other coordinates do; name another joint, or another home pose"
        )
    if named and rank and shares(jacobian[:, chosen])[-1] < _SINGULAR_CHOICE_SHARE:
        raise ModelError(
            f"mechanism.independent = {[joints[i].name for i in named]} is singular at home: the other joints are at a"
            " dead centre there; name another joint, or another home pose"
        )
    return chosen


def is_regular(inertia: np.ndarray) -> np.ndarray:
    """Return a mask (...) of the reduced inertias (..., n_s, n_s) that are finite and positive definite beyond rounding."""
    diagonal = np.diagonal(inertia, axis1=-2, axis2=-1)
    usable = np.asarray(np.isfinite(inertia).all(axis=(-2, -1)) & (diagonal > 0).all(axis=-1))
    scale = np.sqrt(np.where(usable[..., None], diagonal, 1.0))
    scaled = np.where(usable[..., None, None], inertia, np.eye(inertia.shape[-1])) / (
        scale[..., :, None] * scale[..., None, :]
    )
    try:  # a Cholesky factor of all exists if all are regular, in a tenth of the time of their eigenvalues
        np.linalg.cholesky(scaled - _SINGULAR_EIGENVALUE * np.eye(inertia.shape[-1]))
        return usable
    except np.linalg.LinAlgError:
        return usable & (np.linalg.eigvalsh(scaled)[..., 0] > _SINGULAR_EIGENVALUE)


def without_inertia(inertia: np.ndarray) -> list[int]:
    """Return the coordinates with a large part in the motion without kinetic energy of a singular inertia (n_s, n_s)."""
    diagonal = inertia.diagonal()
    bad = ~np.isfinite(inertia).all(axis=1) | ~(diagonal > 0)
    if bad.any():
        return np.flatnonzero(bad).tolist()
    scale = np.sqrt(diagonal)
    share = np.abs(np.linalg.eigh(inertia / np.outer(scale, scale))[1][:, 0])
    return np.flatnonzero(share >= 0.1 * share.max()).tolist()


def singular_inertia_text(joints: Sequence[Joint], inertia: np.ndarray) -> str:
    """Return a clause that names the independent joints (n_s,) that move without kinetic energy."""
    names = [joints[column].name for column in without_inertia(inertia)]
    if len(names) == 1:
        return f"joint {names[0]} moves without moving any mass"
    return f"joints {', '.join(names[:-1])} and {names[-1]} move together without moving any mass"


def refuse_singular_inertia(name: str, joints: Sequence[Joint], independent: np.ndarray, dynamics, pose: np.ndarray) -> None:
    """Refuse a mechanism whose reduced inertia is singular at its home pose (n_q,).

    Raises:
        InertiaError: if it is singular; the message names the coordinates that move without kinetic energy.
    """
    inertia = np.array(dynamics.reduced_inertia(pose))
    if len(inertia) == 0 or is_regular(inertia):
        return
    of = [joints[index] for index in independent]
    raise InertiaError(
        f"mechanism '{name}' has a singular inertia at home ({where(of, pose[independent])}):"
        f" {singular_inertia_text(of, inertia)}, so efforts do not determine their acceleration. Give a joint an armature"
        " or its"
        " bodies mass off its axis; remove all but one of several joints on one axis; or choose another home pose, if axes"
        " coincide at this pose only",
        len(inertia),
    )
