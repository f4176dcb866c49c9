"""Symbolic dynamics of a kinematic tree, read from a compiled MuJoCo model.

    M(q) q'' + h(q, q') = tau_passive(q, q') + tau

The recursion is Newton-Euler in world axes (Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 5), run once
over CasADi SX with the accelerations kept symbolic; M is the derivative of the result by q''. Frames, inertias,
anchors, axes and references come from the compiled `mjModel`, so that MuJoCo's own reading of the file is kept:
quantities agree with MuJoCo's `qM`, `qfrc_bias` and `qfrc_passive` to rounding.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.tree.coordinates import BALL, FREE, HINGE, SLIDE, Coordinates, read_coordinates, turned_quaternion
from linkplan.models.tree.friction import TRANSITION, dry_friction
from linkplan.models.tree.passive import (
    compensates,
    disabled,
    joint_armature,
    joint_passive,
    tendon_inertias,
    tendon_passive,
)
from linkplan.models.tree.size import extent_m
from linkplan.models.tree.tendons import tendon_length


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Frame:
    """A body's frame in the world, as expressions of q, with the motion of its origin."""

    p_world_B: ca.SX  # (3,) [m] position of the body frame's origin
    R_world_B: ca.SX  # (3, 3)
    quaternion: ca.SX  # (4,) of R_world_B, continuous in q
    v_world_B: ca.SX  # (3,) [m/s] velocity of the origin
    w_world_B: ca.SX  # (3,) [rad/s] angular velocity
    acceleration_B: ca.SX  # (3,) [m/s2] of the origin, gravity not included
    alpha_world_B: ca.SX  # (3,) [rad/s2] angular acceleration


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Tree:
    """Expressions of a tree's dynamics over its symbols `q`, `qd`, `qdd` (n_q each).

    `inverse_dynamics` is M q'' + h without passive forces; `passive` is the generalised force of springs and dampers,
    positive along +q, `friction` that of dry friction. [N.m] on a hinge, [N] on a slide. `tendon_lengths` [m] holds None for
    a tendon whose length has no expression here.
    """

    model: mujoco.MjModel
    coordinates: Coordinates
    q: ca.SX
    qd: ca.SX
    qdd: ca.SX
    frames: tuple[Frame, ...]
    inverse_dynamics: ca.SX
    mass_matrix: ca.SX
    bias: ca.SX
    gravity: ca.SX
    passive: ca.SX
    friction: ca.SX
    kinetic_energy: ca.SX
    potential_energy: ca.SX
    velocity_matrix: ca.SX  # T (n_q, n_q), MuJoCo's qvel = T q'
    tendon_lengths: tuple[ca.SX | None, ...]

    def point(self, body: int, p_B: np.ndarray) -> ca.SX:
        """Return the world position (3,) [m] of a point fixed to a body, given in the body's frame."""
        return self.frames[body].p_world_B + self.frames[body].R_world_B @ ca.DM(p_B)


def rotation_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a unit quaternion (w, x, y, z), exact zeros kept."""
    w, x, y, z = np.asarray(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Inertial:
    """A body's mass [kg], centre of mass (3,) [m] and inertia (3, 3) [kg m2] about it, in the body's frame."""

    mass: ca.SX | float
    com: ca.SX | ca.DM
    inertia: ca.SX | ca.DM


def common_ancestor(model: mujoco.MjModel, first: int, second: int) -> int:
    """Return the nearest body that carries both, the world (0) where that one does not move."""
    above = {0}
    while first:
        above.add(first)
        first = int(model.body_parentid[first])
    while second not in above:
        second = int(model.body_parentid[second])
    return second if model.body_weldid[second] != 0 else 0


def frame_in(tree: Tree, ancestor: int, body: int) -> Frame:
    """Return a body's frame as its ancestor's frame sees it, an expression of the joints between the two alone."""
    if ancestor == 0:
        return tree.frames[body]
    frame, still = _fixed_frame(), ca.SX.zeros(tree.q.numel())
    chain = []
    while body != ancestor:
        chain.append(body)
        body = int(tree.model.body_parentid[body])
    for link in reversed(chain):
        frame = _child_frame(tree.model, tree.coordinates, link, frame, tree.q, still, still, {})
    return frame


def build_tree(
    model: mujoco.MjModel,
    reference: np.ndarray | None = None,
    inertials: Mapping[int, Inertial] | None = None,
    transition: float = TRANSITION,
) -> Tree:
    """Return the symbolic dynamics of a model in its internal coordinates.

    On a hinge or slide q_i is MuJoCo's `qpos`, the joint's `ref` included; the rotation applied is qpos - qpos0. The charts
    of ball and free joints are centred at `reference` (nq,), a qpos, `qpos0` by default. Bodies in `inertials` have those in
    place of the model's own. `transition` is the speed of dry friction, see `models.tree.friction`.
    """
    n_q = model.nv
    coordinates = read_coordinates(model, model.qpos0 if reference is None else reference)
    q, qd, qdd = (ca.SX.sym(name, n_q) for name in ("q", "qd", "qdd"))
    T = coordinates.velocity_matrix(q)
    velocity, acceleration = qd, qdd  # MuJoCo's qvel and its derivative
    if not coordinates.trivial:
        velocity = T @ qd
        acceleration = T @ qdd + ca.jtimes(velocity, q, qd)
    frames = [_fixed_frame()]
    joints: dict[int, tuple[ca.SX, ca.SX]] = {}  # dof -> (axis, anchor) in the world
    for body in range(1, model.nbody):
        parent = frames[model.body_parentid[body]]
        frames.append(_child_frame(model, coordinates, body, parent, q, velocity, acceleration, joints))
    lengths = tuple(tendon_length(model, frames, q, tendon) for tendon in range(model.ntendon))

    gravity = ca.DM(model.opt.gravity) if not disabled(model, mujoco.mjtDisableBit.mjDSBL_GRAVITY) else ca.DM.zeros(3)
    tau, kinetic, potential = _newton_euler(model, frames, joints, gravity, inertials or {})
    armature = ca.DM(joint_armature(model))
    weight = ca.substitute(tau, ca.vertcat(qd, qdd), ca.SX.zeros(2 * n_q))
    tau = tau + armature * acceleration
    kinetic += 0.5 * ca.dot(armature, velocity**2)
    if not coordinates.trivial:
        tau, weight = T.T @ tau, T.T @ weight
    for inertia, length in tendon_inertias(model, lengths, q):
        arm = ca.jacobian(length, q)
        speed = arm @ qd
        tau = tau + inertia * arm.T * (arm @ qdd + ca.jtimes(speed, q, qd))
        kinetic += 0.5 * inertia * speed**2
    passive, spring_energy = joint_passive(model, q, velocity)
    if not coordinates.trivial:
        passive = T.T @ passive
    of_tendons, tendon_energy = tendon_passive(model, lengths, q, qd)
    carried = _carried(model, frames, gravity)
    held = -ca.jacobian(carried, q).T
    return Tree(
        model=model,
        coordinates=coordinates,
        q=q,
        qd=qd,
        qdd=qdd,
        frames=tuple(frames),
        inverse_dynamics=tau,
        mass_matrix=ca.jacobian(tau, qdd),
        bias=ca.substitute(tau, qdd, ca.SX.zeros(n_q)),
        gravity=weight - held,
        passive=passive + of_tendons + held,
        friction=dry_friction(model, lengths, q, qd, velocity, T, transition, extent_m(model)),
        kinetic_energy=kinetic,
        potential_energy=potential + spring_energy + tendon_energy + carried,
        velocity_matrix=T,
        tendon_lengths=lengths,
    )


def _fixed_frame() -> Frame:
    zero = ca.SX.zeros(3)
    return Frame(
        p_world_B=zero,
        R_world_B=ca.SX.eye(3),
        quaternion=ca.SX([1, 0, 0, 0]),
        v_world_B=zero,
        w_world_B=zero,
        acceleration_B=zero,
        alpha_world_B=zero,
    )


def _child_frame(model, coordinates: Coordinates, body, parent: Frame, q, velocity, acceleration, joints) -> Frame:
    """Return a body's frame and motion, its joints applied in file order; records each dof's axis and anchor.

    `velocity` is MuJoCo's qvel and `acceleration` its derivative; the axis of a slide is a direction to push along.
    """
    offset = parent.R_world_B @ ca.DM(model.body_pos[body])
    p = parent.p_world_B + offset
    R = parent.R_world_B @ ca.DM(rotation_from_quaternion(model.body_quat[body]))
    quaternion = product(parent.quaternion, ca.SX(ca.DM(model.body_quat[body])))
    w, alpha = parent.w_world_B, parent.alpha_world_B
    v = parent.v_world_B + ca.cross(w, offset)
    a = parent.acceleration_B + _rigid_acceleration(w, alpha, offset)
    start = model.body_jntadr[body]
    for joint in range(start, start + model.body_jntnum[body]):
        dof, kind = int(model.jnt_dofadr[joint]), int(model.jnt_type[joint])
        if kind == FREE:  # stands in the world by itself, whatever its body's own place
            p, v, a = q[dof : dof + 3], velocity[dof : dof + 3], acceleration[dof : dof + 3]
            R, quaternion = ca.SX.eye(3), ca.SX([1, 0, 0, 0])
            joints.update({dof + k: (ca.SX(ca.DM(np.eye(3)[k])), p) for k in range(3)})
            dof += 3
        arm = R @ ca.DM(model.jnt_pos[joint])
        anchor = p + arm
        anchor_velocity = v + ca.cross(w, arm)
        anchor_acceleration = a + _rigid_acceleration(w, alpha, arm)
        if kind == SLIDE:
            axis = R @ ca.DM(model.jnt_axis[joint])
            joints[dof] = (axis, anchor)
            travel = axis * (q[dof] - model.qpos0[model.jnt_qposadr[joint]])
            p = p + travel
            a = a + _rigid_acceleration(w, alpha, travel) + 2 * ca.cross(w, axis * velocity[dof]) + axis * acceleration[dof]
            v = v + ca.cross(w, travel) + axis * velocity[dof]
            continue
        if kind == HINGE:
            axis = R @ ca.DM(model.jnt_axis[joint])
            joints[dof] = (axis, anchor)
            angle = q[dof] - model.qpos0[model.jnt_qposadr[joint]]
            spin, spin_rate = axis * velocity[dof], axis * acceleration[dof]
            R = R @ _rotation(model.jnt_axis[joint], angle)
            unit = model.jnt_axis[joint] / np.linalg.norm(model.jnt_axis[joint])
            turn = ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) * ca.DM(unit))
        else:
            (chart,) = [chart for chart in coordinates.charts if chart.joint == joint]
            turned = turned_quaternion(chart, q)
            turn = product(ca.SX(ca.DM(chart.centre)), turned)
            R = R @ ca.DM(rotation_from_quaternion(chart.centre)) @ rotation_of(turned)
            joints.update({dof + k: (R[:, k], anchor) for k in range(3)})
            spin, spin_rate = R @ velocity[dof : dof + 3], R @ acceleration[dof : dof + 3]
        quaternion = product(quaternion, turn)
        alpha = alpha + ca.cross(w, spin) + spin_rate
        w = w + spin
        arm = R @ ca.DM(model.jnt_pos[joint])
        p = anchor - arm
        v = anchor_velocity - ca.cross(w, arm)
        a = anchor_acceleration + _rigid_acceleration(w, alpha, -arm)
    return Frame(
        p_world_B=p,
        R_world_B=R,
        quaternion=quaternion,
        v_world_B=v,
        w_world_B=w,
        acceleration_B=a,
        alpha_world_B=alpha,
    )


def product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return the Hamilton product of two quaternions (4,)."""
    v = a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:])
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:], b[1:]), v)


def rotation_of(quaternion: ca.SX) -> ca.SX:
    """Return the rotation matrix of a unit quaternion's expression."""
    w, v = quaternion[0], quaternion[1:]
    return ca.SX.eye(3) + 2 * w * ca.skew(v) + 2 * ca.skew(v) @ ca.skew(v)


def _rigid_acceleration(w: ca.SX, alpha: ca.SX, arm: ca.SX) -> ca.SX:
    """Return the acceleration of a point relative to another of the same rigid body, `arm` away."""
    return ca.cross(alpha, arm) + ca.cross(w, ca.cross(w, arm))


def _rotation(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    """Return Rodrigues' rotation, written so that a coordinate axis leaves exact zeros and ones."""
    a = np.asarray(axis) / np.linalg.norm(axis)
    along = np.outer(a, a)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return ca.DM(along) + ca.cos(angle) * ca.DM(np.eye(3) - along) + ca.sin(angle) * ca.DM(cross)


def _carried(model: mujoco.MjModel, frames: list[Frame], gravity: ca.DM) -> ca.SX:
    """Return the energy [J] that gravity compensation takes off the bodies' weight: sum of gravcomp m g . p."""
    energy = ca.SX(0)
    if not compensates(model):
        return energy
    for body in range(1, model.nbody):
        if model.body_gravcomp[body]:
            frame = frames[body]
            centre = frame.p_world_B + frame.R_world_B @ ca.DM(model.body_ipos[body])
            energy += float(model.body_gravcomp[body] * model.body_mass[body]) * ca.dot(gravity, centre)
    return energy


def _newton_euler(model, frames, joints, gravity, inertials: Mapping[int, Inertial]):
    """Return generalised forces (n_q,), kinetic and potential energy of the moving bodies."""
    force = [ca.SX.zeros(3) for _ in frames]  # on the subtree, at the body frame's origin
    moment = [ca.SX.zeros(3) for _ in frames]
    kinetic, potential = ca.SX(0), ca.SX(0)
    for body in range(1, model.nbody):
        if model.body_weldid[body] == 0:
            continue
        frame, own = frames[body], inertials.get(body) or _inertial(model, body)
        mass, arm = own.mass, frame.R_world_B @ own.com
        inertia = frame.R_world_B @ own.inertia @ frame.R_world_B.T
        w, alpha = frame.w_world_B, frame.alpha_world_B
        force[body] = mass * (frame.acceleration_B + _rigid_acceleration(w, alpha, arm) - gravity)
        moment[body] = inertia @ alpha + ca.cross(w, inertia @ w) + ca.cross(arm, force[body])
        v_com = frame.v_world_B + ca.cross(w, arm)
        kinetic += 0.5 * mass * ca.dot(v_com, v_com) + 0.5 * ca.dot(w, inertia @ w)
        potential -= mass * ca.dot(gravity, frame.p_world_B + arm)

    tau = ca.SX.zeros(model.nv)
    for body in range(model.nbody - 1, 0, -1):
        p = frames[body].p_world_B
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            dof, kind = int(model.jnt_dofadr[joint]), int(model.jnt_type[joint])
            n_pushed = {SLIDE: 1, FREE: 3}.get(kind, 0)
            n_dofs = {BALL: 3, FREE: 6}.get(kind, 1)
            for k in range(n_dofs):
                axis, anchor = joints[dof + k]
                pushed = force[body] if k < n_pushed else moment[body] + ca.cross(p - anchor, force[body])
                tau[dof + k] = ca.dot(axis, pushed)
        parent = model.body_parentid[body]
        moment[parent] += moment[body] + ca.cross(p - frames[parent].p_world_B, force[body])
        force[parent] += force[body]
    return tau, kinetic, potential


def _inertial(model: mujoco.MjModel, body: int) -> Inertial:
    R_B_I = rotation_from_quaternion(model.body_iquat[body])
    inertia_B = R_B_I @ np.diag(model.body_inertia[body]) @ R_B_I.T
    return Inertial(mass=float(model.body_mass[body]), com=ca.DM(model.body_ipos[body]), inertia=ca.DM(_clean(inertia_B)))


def _clean(matrix: np.ndarray) -> np.ndarray:
    """Return `matrix` with entries of rounding size set to zero, which keeps planar expressions short."""
    return np.where(np.abs(matrix) > 1e-15 * np.abs(matrix).max(initial=0.0), matrix, 0.0)
