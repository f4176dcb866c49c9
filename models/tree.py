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

HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Frame:
    """A body's frame in the world, as expressions of q, with the motion of its origin."""

    p_world_B: ca.SX  # (3,) [m] position of the body frame's origin
    R_world_B: ca.SX  # (3, 3)
    v_world_B: ca.SX  # (3,) [m/s] velocity of the origin
    w_world_B: ca.SX  # (3,) [rad/s] angular velocity
    acceleration_B: ca.SX  # (3,) [m/s2] of the origin, gravity not included
    alpha_world_B: ca.SX  # (3,) [rad/s2] angular acceleration


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Tree:
    """Expressions of a tree's dynamics over its symbols `q`, `qd`, `qdd` (n_q each).

    `inverse_dynamics` is M q'' + h without passive forces; `passive` is the generalised force of springs and dampers,
    positive along +q. [N.m] on a hinge, [N] on a slide.
    """

    q: ca.SX
    qd: ca.SX
    qdd: ca.SX
    frames: tuple[Frame, ...]
    inverse_dynamics: ca.SX
    mass_matrix: ca.SX
    bias: ca.SX
    gravity: ca.SX
    passive: ca.SX
    kinetic_energy: ca.SX
    potential_energy: ca.SX

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


def build_tree(model: mujoco.MjModel, inertials: Mapping[int, Inertial] | None = None) -> Tree:
    """Return the symbolic dynamics of a model whose joints are hinges and slides.

    q_i here is MuJoCo's `qpos[i]`, the joint's `ref` included; the rotation applied is qpos - qpos0. Bodies in
    `inertials` have those in place of the model's own.
    """
    n_q = model.nv
    q, qd, qdd = (ca.SX.sym(name, n_q) for name in ("q", "qd", "qdd"))
    zero = ca.SX.zeros(3)
    world = Frame(
        p_world_B=zero,
        R_world_B=ca.SX.eye(3),
        v_world_B=zero,
        w_world_B=zero,
        acceleration_B=zero,
        alpha_world_B=zero,
    )
    frames = [world]
    joints: dict[int, tuple[ca.SX, ca.SX]] = {}  # dof -> (axis, anchor) in the world
    for body in range(1, model.nbody):
        frames.append(_child_frame(model, body, frames[model.body_parentid[body]], q, qd, qdd, joints))

    gravity = ca.DM(model.opt.gravity) if not _disabled(model, mujoco.mjtDisableBit.mjDSBL_GRAVITY) else ca.DM.zeros(3)
    tau, kinetic, potential = _newton_euler(model, frames, joints, gravity, inertials or {})
    at_rest = ca.SX.zeros(n_q)
    mass = ca.jacobian(tau, qdd) + ca.diag(ca.DM(_armature(model)))
    passive, spring_energy = _passive(model, q, qd)
    return Tree(
        q=q,
        qd=qd,
        qdd=qdd,
        frames=tuple(frames),
        inverse_dynamics=tau + ca.DM(_armature(model)) * qdd,
        mass_matrix=mass,
        bias=ca.substitute(tau, qdd, at_rest),
        gravity=ca.substitute(tau, ca.vertcat(qd, qdd), ca.SX.zeros(2 * n_q)),
        passive=passive,
        kinetic_energy=kinetic + 0.5 * ca.dot(ca.DM(_armature(model)), qd**2),
        potential_energy=potential + spring_energy,
    )


def _disabled(model: mujoco.MjModel, bit: mujoco.mjtDisableBit) -> bool:
    return bool(model.opt.disableflags & int(bit))


def _armature(model: mujoco.MjModel) -> np.ndarray:
    """Return the armature (n_q,) of joints and of the actuators that drive them directly (reflected by gear^2)."""
    armature = np.array(model.dof_armature, dtype=float)
    for dof, gear, actuator in _joint_actuators(model):
        armature[dof] += gear**2 * model.actuator_armature[actuator]
    return armature


def _joint_actuators(model: mujoco.MjModel):
    for actuator in range(model.nu):
        if int(model.actuator_trntype[actuator]) in JOINT_TRANSMISSIONS:
            joint = model.actuator_trnid[actuator, 0]
            yield int(model.jnt_dofadr[joint]), float(model.actuator_gear[actuator, 0]), actuator


def _passive(model: mujoco.MjModel, q: ca.SX, qd: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the generalised force (n_q,) of joint springs and dampers, and the springs' energy.

    A spring's force is -(a x + b x^2 + c x^3) from `springref`, a damper's -(a v + b v|v| + c v^3) (MuJoCo,
    "Polynomial forces"); an actuator's own damping is reflected to its joint by gear^2, each coefficient.
    """
    force, energy = ca.SX.zeros(model.nv), ca.SX(0)
    springs = not _disabled(model, mujoco.mjtDisableBit.mjDSBL_SPRING)
    dampers = not _disabled(model, mujoco.mjtDisableBit.mjDSBL_DAMPER)
    for joint in range(model.njnt):
        dof, address = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        x, v = q[dof] - model.qpos_spring[address], qd[dof]
        if springs:
            a, (b, c) = float(model.jnt_stiffness[joint]), model.jnt_stiffnesspoly[joint]
            if a or b or c:
                force[dof] -= a * x + b * x**2 + c * x**3
                energy += a * x**2 / 2 + b * x**3 / 3 + c * x**4 / 4
        if dampers:
            force[dof] -= _damper(v, float(model.dof_damping[dof]), *model.dof_dampingpoly[dof])
    if dampers:
        for dof, gear, actuator in _joint_actuators(model):
            coefficients = float(model.actuator_damping[actuator]), *model.actuator_dampingpoly[actuator]
            force[dof] -= gear**2 * _damper(qd[dof], *coefficients)
    return force, energy


def _damper(v: ca.SX, a: float, b: float, c: float) -> ca.SX:
    """Return a v + b v|v| + c v^3, without the terms whose coefficient is zero."""
    total = a * v
    if b:
        total += b * v * ca.fabs(v)
    if c:
        total += c * v**3
    return total


def _child_frame(model, body, parent: Frame, q, qd, qdd, joints) -> Frame:
    """Return a body's frame and motion, its joints applied in file order; records each joint's axis and anchor."""
    offset = parent.R_world_B @ ca.DM(model.body_pos[body])
    p = parent.p_world_B + offset
    R = parent.R_world_B @ ca.DM(rotation_from_quaternion(model.body_quat[body]))
    w, alpha = parent.w_world_B, parent.alpha_world_B
    v = parent.v_world_B + ca.cross(w, offset)
    acceleration = parent.acceleration_B + _rigid_acceleration(w, alpha, offset)
    start = model.body_jntadr[body]
    for joint in range(start, start + model.body_jntnum[body]):
        dof = int(model.jnt_dofadr[joint])
        axis = R @ ca.DM(model.jnt_axis[joint])
        travel = q[dof] - model.qpos0[model.jnt_qposadr[joint]]
        arm = R @ ca.DM(model.jnt_pos[joint])
        anchor = p + arm
        joints[dof] = (axis, anchor)
        if model.jnt_type[joint] == SLIDE:
            p = p + axis * travel
            acceleration = (
                acceleration
                + _rigid_acceleration(w, alpha, axis * travel)
                + 2 * ca.cross(w, axis * qd[dof])
                + axis * qdd[dof]
            )
            v = v + ca.cross(w, axis * travel) + axis * qd[dof]
            continue
        anchor_velocity = v + ca.cross(w, arm)
        anchor_acceleration = acceleration + _rigid_acceleration(w, alpha, arm)
        alpha = alpha + ca.cross(w, axis * qd[dof]) + axis * qdd[dof]
        w = w + axis * qd[dof]
        R = R @ _rotation(model.jnt_axis[joint], travel)
        arm = R @ ca.DM(model.jnt_pos[joint])
        p = anchor - arm
        v = anchor_velocity - ca.cross(w, arm)
        acceleration = anchor_acceleration + _rigid_acceleration(w, alpha, -arm)
    return Frame(p_world_B=p, R_world_B=R, v_world_B=v, w_world_B=w, acceleration_B=acceleration, alpha_world_B=alpha)


def _rigid_acceleration(w: ca.SX, alpha: ca.SX, arm: ca.SX) -> ca.SX:
    """Return the acceleration of a point relative to another of the same rigid body, `arm` away."""
    return ca.cross(alpha, arm) + ca.cross(w, ca.cross(w, arm))


def _rotation(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    """Return Rodrigues' rotation, written so that a coordinate axis leaves exact zeros and ones."""
    a = np.asarray(axis) / np.linalg.norm(axis)
    along = np.outer(a, a)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return ca.DM(along) + ca.cos(angle) * ca.DM(np.eye(3) - along) + ca.sin(angle) * ca.DM(cross)


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
            dof = int(model.jnt_dofadr[joint])
            axis, anchor = joints[dof]
            slide = model.jnt_type[joint] == SLIDE
            tau[dof] = ca.dot(axis, force[body] if slide else moment[body] + ca.cross(p - anchor, force[body]))
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
