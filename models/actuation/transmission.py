"""Transmissions: the moment arms of an actuator's force in internal coordinates, with MuJoCo's definitions.

    tau = B(q) u,   power = u l',   B = (dl / dq)^T

The transmission's length l is gear times a joint's position, a tendon's length or a slider-crank's travel. A wrench at a
site, or on a ball or free joint, has no length: B is then the transposed Jacobian times the gear's axes.
"""

from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.kinematics import path_to
from linkplan.models.symbolic_model import number
from linkplan.models.tree.coordinates import (
    BALL,
    FREE,
    HINGE,
    SLIDE,
    joint_label,
    rotation_from_quaternion,
    rotation_of,
    turned_quaternion,
)
from linkplan.models.tree.dynamics import Tree, common_ancestor
from linkplan.models.tree.tendons import tendon_label

TRN_JOINT, TRN_IN_PARENT = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
TRN_TENDON, TRN_CRANK, TRN_SITE = mujoco.mjtTrn.mjTRN_TENDON, mujoco.mjtTrn.mjTRN_SLIDERCRANK, mujoco.mjtTrn.mjTRN_SITE
KINDS = (TRN_JOINT, TRN_IN_PARENT, TRN_TENDON, TRN_CRANK, TRN_SITE)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Attachment:
    """The target of an actuator.

    `target` names it ("joint crank"). `dof` is the coordinate of the hinge or slide that the actuator drives, None for any
    other transmission. `unit` is the unit of the actuator's force: on a slide, a gear other than 1 or -1 [rad/m] is a rotary
    motor's screw or pinion, whose force is a torque.
    """

    target: str
    dof: int | None
    unit: str  # "N.m" or "N"


def gear_of(model: mujoco.MjModel, index: int) -> np.ndarray:
    """Return the gear (6,) of an actuator with one force."""
    return np.array(model.actuator_gear[model.actuator_outadr[index]], dtype=float)


def attachment(model: mujoco.MjModel, index: int) -> Attachment:
    """Return the target of actuator `index`."""
    kind = mujoco.mjtTrn(int(model.actuator_trntype[index]))
    first, second = (int(i) for i in model.actuator_trnid[index])
    if kind in (TRN_JOINT, TRN_IN_PARENT):
        label, of = joint_label(model, first), int(model.jnt_type[first])
        scalar = of in (HINGE, SLIDE)
        gear = gear_of(model, index)
        pushes = (of == SLIDE and abs(gear[0]) == 1.0) or (of == FREE and bool(np.any(gear[:3])))
        dof = int(model.jnt_dofadr[first]) if scalar else None
        return Attachment(target=f"joint {label}", dof=dof, unit="N" if pushes else "N.m")
    if kind == TRN_TENDON:
        return Attachment(target=f"tendon {tendon_label(model, first)}", dof=None, unit="N")
    if kind == TRN_CRANK:
        ends = "-".join(_site(model, site) for site in (first, second))
        return Attachment(target=f"slider-crank {ends}", dof=None, unit="N")
    if kind == TRN_SITE:
        pushes = bool(np.any(gear_of(model, index)[:3]))
        return Attachment(target=f"site {_site(model, first)}", dof=None, unit="N" if pushes else "N.m")
    return Attachment(target=kind.name.removeprefix("mjTRN_").lower(), dof=None, unit="N")


def _site(model: mujoco.MjModel, site: int) -> str:
    return model.site(site).name or f"site {site}"


def has_length(model: mujoco.MjModel, index: int) -> bool:
    """Return True if the actuator's length is not periodic, so that a servo's bias can depend on it.

    MuJoCo wraps rotations of ball joints and sites to one turn. A wrench without a reference site has no length.
    """
    kind = mujoco.mjtTrn(int(model.actuator_trntype[index]))
    if kind in (TRN_JOINT, TRN_IN_PARENT):
        return int(model.jnt_type[model.actuator_trnid[index, 0]]) in (HINGE, SLIDE)
    if kind == TRN_SITE:
        return int(model.actuator_trnid[index, 1]) >= 0 and not np.any(gear_of(model, index)[3:])
    return kind in (TRN_TENDON, TRN_CRANK)


def moment(model: mujoco.MjModel, tree: Tree, index: int) -> ca.SX:
    """Return the actuator's column of B (n_q,), sparse."""
    kind = mujoco.mjtTrn(int(model.actuator_trntype[index]))
    gear, first = model.actuator_gear[model.actuator_outadr[index]], int(model.actuator_trnid[index, 0])
    if kind in (TRN_JOINT, TRN_IN_PARENT):
        return _on_joint(model, tree, first, gear, in_parent=kind == TRN_IN_PARENT)
    if kind == TRN_TENDON:
        length = tree.tendon_lengths[first]
        assert length is not None, "a tendon without an expression is no transmission: see actuators.unusable_reason"
        return gear[0] * ca.jacobian(length, tree.q).T
    if kind == TRN_CRANK:
        return gear[0] * ca.jacobian(_crank_travel(model, tree, index), tree.q).T
    return _at_site(model, tree, index, gear)


def _on_joint(model, tree: Tree, joint: int, gear: np.ndarray | ca.SX, in_parent: bool) -> ca.SX:
    column, dof = ca.SX(tree.q.numel(), 1), int(model.jnt_dofadr[joint])
    kind = int(model.jnt_type[joint])
    if kind not in (BALL, FREE):
        column[dof] = gear[0]
        return column
    if kind == FREE:
        column[dof : dof + 3] = ca.DM(gear[:3])
        dof, gear = dof + 3, gear[3:]
    axis = ca.SX(ca.DM(gear[:3]))
    if in_parent:
        chart = tree.coordinates.chart_of(joint)
        turned = turned_quaternion(chart, tree.q)
        axis = rotation_of(turned).T @ ca.DM(rotation_from_quaternion(chart.centre)).T @ axis
    turning = slice(dof, dof + 3)
    column[turning] = tree.velocity_matrix[turning, turning].T @ axis
    return column


def _crank_travel(model, tree: Tree, index: int) -> ca.SX:
    """Return the slider's position [m] on its axis. As in MuJoCo, a rod that is too short counts as normal to the axis."""
    crank, slider = (int(i) for i in model.actuator_trnid[index])
    to_crank = tree.site(crank) - tree.site(slider)
    frame = tree.frames[int(model.site_bodyid[slider])]
    axis = frame.R_world_B @ ca.DM(rotation_from_quaternion(model.site_quat[slider])[:, 2])
    along = ca.dot(to_crank, axis)
    rod = number(model.actuator_cranklength[index])
    square = along**2 + rod**2 - ca.dot(to_crank, to_crank)
    # The inner if_else keeps the derivative of the square root finite in the branch that is not used.
    return along - ca.if_else(square > 0, ca.sqrt(ca.if_else(square > 0, square, 1)), 0)


def _at_site(model, tree: Tree, index: int, gear: np.ndarray) -> ca.SX:
    """Return J^T times a wrench along a site's axes, or along a reference site's axes with the relative Jacobian."""
    site, reference = (int(i) for i in model.actuator_trnid[index])
    body = int(model.site_bodyid[site])
    holder = site if reference < 0 else reference
    holder_body = int(model.site_bodyid[holder])
    R = tree.frames[holder_body].R_world_B @ ca.DM(rotation_from_quaternion(model.site_quat[holder]))
    J = _jacobian(model, tree, site) - (_jacobian(model, tree, reference) if reference >= 0 else 0)
    column = ca.SX(tree.q.numel(), 1)
    for rows, axis in ((J[:3, :], gear[:3]), (J[3:, :], gear[3:])):
        if np.any(axis):
            column += rows.T @ (R @ ca.DM(axis))
    if reference < 0:
        return column
    # MuJoCo ignores the joints that carry both sites.
    keep = ca.DM.ones(tree.q.numel())
    for above in path_to(model, common_ancestor(model, body, holder_body)):
        start = int(model.body_dofadr[above])
        keep[[start + k for k in range(int(model.body_dofnum[above]))]] = 0
        keep[[model.nv + 6 * above + k for k in range(6) if tree.displacement.numel()]] = 0
    return ca.sparsify(column * keep)


def _jacobian(model, tree: Tree, site: int) -> ca.SX:
    """Return the Jacobian (6, n_q) of a site's velocity and angular velocity, twice Q' conj(Q) of its quaternion."""
    quaternion = tree.frames[int(model.site_bodyid[site])].quaternion
    w, v, rates = quaternion[0], quaternion[1:], ca.jacobian(quaternion, tree.q)
    turning = 2 * (w * rates[1:, :] - v @ rates[0, :] + ca.skew(v) @ rates[1:, :])
    return ca.vertcat(ca.jacobian(tree.site(site), tree.q), turning)
