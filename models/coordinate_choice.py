"""The choice of independent and dependent coordinates of a mechanism, and of the independent rows of its closure."""

from collections.abc import Sequence

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator, constant_arms
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.closure.rank import dependent_columns, independent_rows, numerical_rank, shares
from linkplan.models.errors import ModelError
from linkplan.models.tree.joints import Joint, index_of

# A named choice of coordinates is singular if the least singular value of J_z is below this share of the largest. The pose
# is then within some microradians of a dead centre.
_SINGULAR_CHOICE_SHARE = 1e-6


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
    named = _named(loop.name, joints, asked, len(joints) - rank)
    dependent = _dependent(joints, model, jacobians[0][rows], rank, actuators, named)
    independent = np.array([i for i in range(len(joints)) if i not in dependent], dtype=int)
    return rows, independent, dependent


def _named(name: str, joints: tuple[Joint, ...], asked: Sequence[str] | None, dof: int) -> list[int]:
    """Return the indices of the joints named as independent coordinates."""
    if asked is None:
        return []
    named = [index_of(name, joints, joint) for joint in asked]
    if len(set(named)) < len(named) or len(named) > dof:
        raise ModelError(
            f"mechanism.independent has at most as many joints as '{name}' has degrees of freedom ({dof}), and no joint"
            f" twice; got {', '.join(asked)}"
        )
    return named


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
