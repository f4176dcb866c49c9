"""The recursion of Newton and Euler over a kinematic tree, with each body's motion and forces in its own axes.

Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 5. In a body's own axes its inertia is constant, and each joint's
rotation multiplies velocities and forces only once. Second derivatives are therefore a third as long as with the world's
axes. Gravity is modelled as an upward acceleration of the world, which `FrameMotion.acceleration` includes.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.kinematics import joints_of
from linkplan.models.symbolic_model import axis_of, column, number
from linkplan.models.tree.coordinates import (
    FREE,
    HINGE,
    SLIDE,
    Coordinates,
    rotation_about,
    rotation_from_quaternion,
    rotation_of,
    turned_quaternion,
)

# A step from a parent's frame towards a body's frame. It maps the force and moment (3,) after the step to those before it,
# and returns the generalised forces of the step's degrees of freedom.
Carry = Callable[[ca.SX, ca.SX], tuple[ca.SX, ca.SX, dict[int, ca.SX]]]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Inertial:
    """A body's mass [kg], centre of mass (3,) [m] and inertia (3, 3) [kg m2] about it, in the body's frame."""

    mass: ca.SX | float
    com: ca.SX | ca.DM
    inertia: ca.SX | ca.DM


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FrameMotion:
    """A frame's motion, in its own axes: angular velocity and acceleration, and acceleration of the origin (3,)."""

    w: ca.SX
    alpha: ca.SX
    acceleration: ca.SX

    def at(self, arm: ca.SX | ca.DM) -> "FrameMotion":
        """Return the motion of the frame's point at `arm`."""
        carried = ca.cross(self.alpha, arm) + ca.cross(self.w, ca.cross(self.w, arm))
        return replace(self, acceleration=self.acceleration + carried)

    def seen_from(self, R: ca.SX | ca.DM) -> "FrameMotion":
        """Return the motion in the axes R (3, 3), which are fixed in the frame."""
        return FrameMotion(w=R.T @ self.w, alpha=R.T @ self.alpha, acceleration=R.T @ self.acceleration)

    def spun(self, rate: ca.SX, rate_of_rate: ca.SX) -> "FrameMotion":
        """Return the motion of a body that spins in the frame about its origin, in the frame's axes."""
        return replace(self, w=self.w + rate, alpha=self.alpha + ca.cross(self.w, rate) + rate_of_rate)


def newton_euler(
    model: mujoco.MjModel,
    coordinates: Coordinates,
    q: ca.SX,
    velocity: ca.SX,
    acceleration: ca.SX,
    gravity: ca.DM,
) -> tuple[ca.SX, ca.SX]:
    """Return the generalised forces (nv,) that a motion requires, gravity included, and the loads (6 nbody,) of all bodies.

    `velocity` is MuJoCo's qvel and `acceleration` its derivative, both expressions. Armature is not included. A body's load
    is the force and the moment about its origin, in its own axes, that it and all that it carries require.
    """
    zero = ca.SX.zeros(3)
    motions = [FrameMotion(w=zero, alpha=zero, acceleration=ca.SX(-gravity))]
    ways: list[list[Carry]] = [[]]
    force, moment = ([zero for _ in range(model.nbody)] for _ in range(2))
    for body in range(1, model.nbody):
        parent = motions[int(model.body_parentid[body])]
        motion, way = _to_body(model, coordinates, body, parent, q, velocity, acceleration)
        motions.append(motion)
        ways.append(way)
        if model.body_weldid[body] == 0:
            continue
        own = inertial_of(model, body)
        force[body] = own.mass * motion.at(own.com).acceleration
        spin = own.inertia @ motion.w
        moment[body] = own.inertia @ motion.alpha + ca.cross(motion.w, spin) + ca.cross(own.com, force[body])

    tau = ca.SX.zeros(model.nv)
    for body in range(model.nbody - 1, 0, -1):
        f, n, parent = force[body], moment[body], int(model.body_parentid[body])
        for carry in reversed(ways[body]):
            f, n, taken = carry(f, n)
            for dof, effort in taken.items():
                tau[dof] = effort
        force[parent], moment[parent] = force[parent] + f, moment[parent] + n
    return tau, ca.vertcat(*(part for pair in zip(force, moment, strict=True) for part in pair))


def inertial_of(model: mujoco.MjModel, body: int) -> Inertial:
    """Return the inertial properties that the model gives a body."""
    R_B_I = rotation_from_quaternion(model.body_iquat[body])
    moments = model.body_inertia[body]
    if isinstance(moments, ca.SX):
        inertia_B = ca.DM(R_B_I) @ ca.diag(moments) @ ca.DM(R_B_I).T
        return Inertial(mass=number(model.body_mass[body]), com=column(model.body_ipos[body]), inertia=inertia_B)
    inertia_B = R_B_I @ np.diag(moments) @ R_B_I.T
    # Without entries of rounding size the expressions of planar mechanisms stay short.
    inertia_B[np.abs(inertia_B) <= 1e-15 * np.abs(inertia_B).max()] = 0.0
    return Inertial(mass=number(model.body_mass[body]), com=column(model.body_ipos[body]), inertia=ca.DM(inertia_B))


def _to_body(
    model: mujoco.MjModel,
    coordinates: Coordinates,
    body: int,
    motion: FrameMotion,
    q: ca.SX,
    velocity: ca.SX,
    acceleration: ca.SX,
) -> tuple[FrameMotion, list[Carry]]:
    """Return a body's motion from its parent's, and the steps between their frames. Joints are applied in file order."""
    joints = joints_of(model, body)
    way: list[Carry] = []
    if not any(int(model.jnt_type[joint]) == FREE for joint in joints):  # a free body has no offset
        offset, R = column(model.body_pos[body]), ca.DM(rotation_from_quaternion(model.body_quat[body]))
        motion = motion.at(offset).seen_from(R)
        way.append(_turned(R, offset))
    for joint in joints:
        dof, kind = int(model.jnt_dofadr[joint]), int(model.jnt_type[joint])
        if kind == FREE:
            motion = replace(motion, acceleration=motion.acceleration + acceleration[dof : dof + 3])
            way.append(_pushed(ca.DM.eye(3), ca.DM.zeros(3), range(dof, dof + 3)))
            dof += 3
        if kind == SLIDE:
            axis = axis_of(model, joint)
            travel = axis * (q[dof] - model.qpos0[model.jnt_qposadr[joint]])
            coriolis = 2 * ca.cross(motion.w, axis * velocity[dof])
            moved = motion.at(travel)
            motion = replace(moved, acceleration=moved.acceleration + coriolis + axis * acceleration[dof])
            way.append(_pushed(axis, travel, [dof]))
            continue
        if kind == HINGE:
            axes = axis_of(model, joint)
            R = rotation_about(model.jnt_axis[joint], q[dof] - model.qpos0[model.jnt_qposadr[joint]])
        else:
            chart = coordinates.chart_of(joint)
            axes = ca.DM.eye(3)
            R = ca.DM(rotation_from_quaternion(chart.centre)) @ rotation_of(turned_quaternion(chart, q))
        dofs = range(dof, dof + axes.shape[1])
        anchor = column(model.jnt_pos[joint])
        rate, rate_of_rate = axes @ velocity[dof : dofs.stop], axes @ acceleration[dof : dofs.stop]
        motion = motion.at(anchor).seen_from(R).spun(rate, rate_of_rate).at(-anchor)
        way += [_turned(R, anchor), _held(axes, anchor, dofs)]
    return motion, way


def _turned(R: ca.SX | ca.DM, arm: ca.SX | ca.DM) -> Carry:
    """Return the step to axes R with their origin at `arm`."""

    def carry(f: ca.SX, n: ca.SX) -> tuple[ca.SX, ca.SX, dict[int, ca.SX]]:
        f = R @ f
        return f, R @ n + ca.cross(arm, f), {}

    return carry


def _held(axes: ca.SX | ca.DM, anchor: ca.SX | ca.DM, dofs: range) -> Carry:
    """Return the step to an origin with the joint's anchor at `anchor`. The generalised forces are moments about `axes`."""

    def carry(f: ca.SX, n: ca.SX) -> tuple[ca.SX, ca.SX, dict[int, ca.SX]]:
        n = n - ca.cross(anchor, f)
        return f, n, dict(zip(dofs, ca.vertsplit(axes.T @ n), strict=True))

    return carry


def _pushed(axes: ca.SX | ca.DM, travel: ca.SX | ca.DM, dofs: range | list[int]) -> Carry:
    """Return the step of a slide by `travel`. The generalised forces are the forces along `axes` (3, n)."""

    def carry(f: ca.SX, n: ca.SX) -> tuple[ca.SX, ca.SX, dict[int, ca.SX]]:
        return f, n + ca.cross(travel, f), dict(zip(dofs, ca.vertsplit(axes.T @ f), strict=True))

    return carry
