"""The forces and moments in all joints, those that the joints transmit beside their own freedoms, and those on the frame.

Every body gets a small displacement against its parent beside its joints' (`build_tree`). By virtual work the load along it,

    F = needed - B_d u - (dphi / dd)^T lambda,

is what the parent exerts on the body through its joints: the force and moment by Newton and Euler that the body and all it
carries need, less what springs, tendons, actuators, closures and external forces exert on them. The displacement of the
world gives the load on the whole mechanism, without forces between its parts; the frame carries its opposite.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from linkplan.models.actuation.actuators import effort_matrix
from linkplan.models.closure.equations import read_closures
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.kinematics import joints_of
from linkplan.models.mechanism import Mechanism, parametric_tree
from linkplan.models.poses.along import accelerations, joint_rates, sampled
from linkplan.models.symbolic_model import axis_of, column
from linkplan.models.tree.coordinates import (
    HINGE,
    SLIDE,
    joint_label,
    rotation_about,
    rotation_from_quaternion,
    rotation_of,
    turned_quaternion,
)
from linkplan.models.tree.dynamics import Tree

# Axes count as parallel if the sine of their angle is smaller.
_PARALLEL_SINE = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Pin:
    """The joints between a body and its parent, which share their load; `name` lists the joints."""

    name: str
    joints: tuple[str, ...]
    body: int


def pins_of(mechanism: Mechanism) -> tuple[Pin, ...]:
    """Return the pins, slides and balls of the tree; a body with all six freedoms, such as a free base, has none."""
    model, found = mechanism.model, []
    for body in range(1, model.nbody):
        if 0 < model.body_dofnum[body] < 6:
            names = tuple(joint_label(model, joint) for joint in joints_of(model, body))
            name = ", ".join(names)
            found.append(Pin(name=f"joint {name}" if name in mechanism.closure_names else name, joints=names, body=body))
    return tuple(found)


@functools.lru_cache(maxsize=16)
def joint_loads(mechanism: Mechanism) -> ca.Function:
    """Return the function to the loads (6, 1 + n_pins): force [N] and moment [N.m] on the frame, and in every pin.

    Its inputs are q, q' and q'' (n_q,) of all joints, the closure forces lambda (n_rows,), the efforts u (n_u,), and one
    column of the mechanism's parameters and the forces over time. The first column is what the mechanism exerts on the
    frame, in the world's axes, the moment about the world's origin. The others are what the parent exerts on the body of
    each of `pins_of`, in the body's axes, the moment about the anchor of its last hinge or ball, else about its origin.
    Components along slides, and moments about the axes of hinges, are omitted.
    """
    model = mechanism.model
    moved = ca.SX.sym("displacement", 6 * model.nbody)
    tree, given = parametric_tree(mechanism, moved)
    n, rows = model.nv, mechanism.n_closure_rows
    longer = ca.diagcat(tree.velocity_matrix, ca.SX.eye(moved.numel()))
    arms = effort_matrix(tree.model, replace(tree, q=ca.vertcat(tree.q, moved), velocity_matrix=longer), mechanism.actuators)
    phi = ca.vertcat(ca.SX(0, 1), *(closure.residual for closure in read_closures(tree.model, tree)))
    q, qd, qdd = (ca.SX.sym(name, mechanism.n_q) for name in ("q", "qd", "qdd"))
    force, u = ca.SX.sym("lambda", rows), ca.SX.sym("u", mechanism.n_u)
    load = tree.reaction - arms[n:, :] @ u - ca.jacobian(phi, moved).T @ force[: phi.numel()]
    every = ca.reshape(ca.substitute(load, moved, ca.SX.zeros(moved.numel())), 6, -1)
    columns = [-every[:, 0], *(_transmitted(tree, pin.body, every[:, pin.body]) for pin in pins_of(mechanism))]
    # A path's parameter, the last coordinate of a guided mechanism, moves no body.
    own = [ca.vertcat(tree.q, tree.qd, tree.qdd), ca.vertcat(q[:n], qd[:n], qdd[:n])]
    found = ca.substitute(ca.horzcat(*columns), *own)
    return ca.Function("joint_loads", [q, qd, qdd, force, u, given], [ca.densify(found)], {"cse": True})


def _transmitted(tree: Tree, body: int, load: ca.SX) -> ca.SX:
    """Return a body's load (6,) without what acts along its own freedoms, the moment about its last anchor."""
    model, turn, anchor = tree.model, ca.SX.eye(3), None
    along: list[ca.SX] = []
    about: list[ca.SX] = []
    for joint in reversed(joints_of(model, body)):
        axis, kind = axis_of(model, joint), int(model.jnt_type[joint])
        if kind == SLIDE:
            along.append(turn.T @ axis)
            continue
        anchor = column(model.jnt_pos[joint]) if anchor is None else anchor
        if kind == HINGE:
            about.append(turn.T @ axis)
            angle = tree.q[int(model.jnt_dofadr[joint])] - model.qpos0[model.jnt_qposadr[joint]]
            turn = rotation_about(model.jnt_axis[joint], angle) @ turn
        else:
            about += ca.horzsplit(ca.SX.eye(3))
            chart = tree.coordinates.chart_of(joint)
            turned = rotation_of(turned_quaternion(chart, tree.q))
            turn = ca.DM(rotation_from_quaternion(chart.centre)) @ turned @ turn
    force, moment = ca.vertsplit(load, 3)
    moment -= ca.cross(ca.DM.zeros(3) if anchor is None else anchor, force)
    return ca.vertcat(_across(tree.q, along, force), _across(tree.q, about, moment))


def _across(q: ca.SX, axes: Sequence[ca.SX], vector: ca.SX) -> ca.SX:
    """Return a vector (3,) without its components in the span of unit axes, expressions of q."""
    kept: list[ca.SX] = []  # orthogonal axes
    pose = np.random.default_rng(0).uniform(-1.0, 1.0, q.numel())
    for axis in axes:
        left = axis - sum((one @ ca.dot(one, axis) for one in kept), ca.SX.zeros(3))
        if np.linalg.norm(np.array(ca.Function("left", [q], [left])(pose))) > _PARALLEL_SINE:
            kept.append(left / ca.norm_2(left))
    if len(kept) == 3:
        return ca.SX.zeros(3)
    return vector - sum((one @ ca.dot(one, vector) for one in kept), ca.SX.zeros(3))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class JointForces:
    """Loads along n samples.

    `force` (n,) [N] and `moment` (n,) [N.m] are sizes by the names of closures and pins; moments that are always zero
    are omitted. `on_frame` (n, 6) are the shaking force [N] and moment [N.m], in the world's axes about its origin.
    """

    force: Mapping[str, np.ndarray]
    moment: Mapping[str, np.ndarray]
    on_frame: np.ndarray


def joint_forces(
    mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray, u: np.ndarray, *forces: np.ndarray
) -> JointForces:
    """Return the forces and moments in all closures and pins, and on the frame.

    The closure forces of overconstrained loops are those of least norm.

    Args:
        mechanism: the mechanism.
        q: poses (n, n_q) of all joints.
        v: speeds (n, n_s) of the independent joints.
        a: accelerations (n, n_s) of the independent joints.
        u: efforts (n, n_u) of the actuators.
        forces: those of `Mechanism.forces_at`; without them, forces over time are omitted.
    """
    loads, sizes = loads_along(mechanism, q, v, a, u, *forces), functools.partial(np.linalg.norm, axis=1)
    cut = closure_rows_along(mechanism, q, v, a, u, *forces)
    force = {name: sizes(cut[:, mechanism.closure_slice(c)]) for c, name in enumerate(mechanism.closure_names)}
    welds = [gap for gap in mechanism.closures if gap.kind == "orientation"]
    moment = {gap.name: sizes(cut[:, gap.rows]) * gap.per_unit for gap in welds}
    for k, pin in enumerate(pins_of(mechanism), 1):
        force[pin.name], moment[pin.name] = sizes(loads[:, :3, k]), sizes(loads[:, 3:, k])
    rounding = ROUNDING_SHARE * mechanism.extent_m * max((float(of.max(initial=0.0)) for of in force.values()), default=0.0)
    moment = {name: of for name, of in moment.items() if of.max(initial=0.0) > rounding}
    return JointForces(force=force, moment=moment, on_frame=loads[:, :, 0])


def loads_along(mechanism: Mechanism, q, v, a, u, *forces: np.ndarray) -> np.ndarray:
    """Return the values (n, 6, 1 + n_pins) of `joint_loads` along samples, which are those of `joint_forces`."""
    values = mechanism.parameter_values
    n_forces = 0 if mechanism.forces is None else 3 * len(mechanism.forces.sites)
    given = np.hstack([np.tile(values, (len(q), 1)), forces[0] if forces else np.zeros((len(q), n_forces))])
    motion = q, joint_rates(mechanism, q, v), accelerations(mechanism, q, v, a)
    return sampled(joint_loads(mechanism), *motion, closure_rows_along(mechanism, q, v, a, u, *forces), u, given)


def closure_rows_along(mechanism: Mechanism, q, v, a, u, *forces: np.ndarray) -> np.ndarray:
    """Return the forces (n, n_rows) [N] on all closure rows along samples."""
    of = mechanism.forced if forces else mechanism.dynamics
    return sampled(of.closure_force, q, v, a, u, *forces)[:, :, 0]
