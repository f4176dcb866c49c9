"""Symbolic dynamics of a kinematic tree, read from a compiled MuJoCo model.

    M(q) q'' + h(q, q') = tau_passive(q, q') + tau

The recursion of Newton and Euler (`newton_euler.py`) runs once over CasADi SX with symbolic accelerations; M is the
derivative of the result with respect to q''. Frames, inertias, anchors, axes and references come from the compiled
`mjModel`. The quantities therefore agree with MuJoCo's `qM`, `qfrc_bias` and `qfrc_passive` to rounding.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.errors import ModelError, nearest
from linkplan.models.kinematics import extent_m, gravity_of, joints_of, path_to
from linkplan.models.symbolic_model import axis_of, column, number, numeric, unit_of
from linkplan.models.tree.coordinates import (
    FREE,
    HINGE,
    SLIDE,
    Coordinates,
    product,
    read_coordinates,
    rotation_about,
    rotation_from_quaternion,
    rotation_of,
    turned_quaternion,
)
from linkplan.models.tree.friction import TRANSITION, dry_friction
from linkplan.models.tree.newton_euler import inertial_of, newton_euler
from linkplan.models.tree.passive import (
    compensates,
    gas_springs,
    joint_armature,
    joint_passive,
    load_forces,
    tendon_inertias,
    tendon_passive,
)
from linkplan.models.tree.tendons import site_point, tendon_length


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Frame:
    """A body's frame in the world, as expressions of q."""

    p_world_B: ca.SX  # (3,) [m] position of the body frame's origin
    R_world_B: ca.SX  # (3, 3)
    quaternion: ca.SX  # (4,) of R_world_B, continuous in q

    def point(self, p_B: np.ndarray | ca.SX | ca.DM) -> ca.SX:
        """Return the world position (3,) [m] of a point in the body's frame."""
        return self.p_world_B + self.R_world_B @ (p_B if isinstance(p_B, ca.SX) else ca.DM(p_B))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Tree:
    """Expressions of a tree's dynamics over its symbols `q`, `qd`, `qdd` (n_q each).

    `inverse_dynamics` is M q'' + h without passive forces. `passive` is the generalised force of springs and dampers and
    `friction` the generalised force of dry friction, both positive along +q, in [N.m] on a hinge and [N] on a slide.
    `tendon_lengths` [m] holds None for a tendon that wraps around a geom.
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
    displacement: ca.SX  # symbols (6 nbody,) of small displacements of all bodies; empty by default
    reaction: ca.SX  # `inverse_dynamics` less passive forces and friction, along the displacement

    def site(self, site: int) -> ca.SX:
        """Return the world position (3,) [m] of a site by its index."""
        return site_point(self.model, self.frames, site)


def common_ancestor(model: mujoco.MjModel, first: int, second: int) -> int:
    """Return the nearest common ancestor of two bodies, or the world (0) if that ancestor is fixed."""
    above = path_to(model, first)
    nearest_one = next((body for body in reversed(path_to(model, second)) if body in above), 0)
    return nearest_one if model.body_weldid[nearest_one] != 0 else 0


def frame_in(tree: Tree, ancestor: int, body: int) -> Frame:
    """Return a body's frame relative to its ancestor's frame, an expression of the joints between the two."""
    if ancestor == 0:
        return tree.frames[body]
    frame, path = _fixed_frame(), path_to(tree.model, body)
    for link in path[path.index(ancestor) + 1 :]:
        frame = _displaced(_child_frame(tree.model, tree.coordinates, link, frame, tree.q), tree.displacement, link)
    return frame


def build_tree(
    model: mujoco.MjModel,
    reference: np.ndarray | None = None,
    transition: float = TRANSITION,
    forces: Mapping[int, ca.SX] | None = None,
    displacement: ca.SX | None = None,
) -> Tree:
    """Return the symbolic dynamics of a model in its internal coordinates.

    On a hinge or slide q_i is MuJoCo's `qpos`, which includes the joint's `ref`; the rotation is qpos - qpos0. The charts of
    ball and free joints are centred at `reference` (nq,), a qpos (default `qpos0`). The
    numbers of a `SymbolicModel` stay symbols. `transition` is the transition speed of dry friction (`models.tree.friction`).
    `forces` are further forces (3,) [N] in the world on sites by index; they are passive, and without potential energy.
    With symbols `displacement` (6 nbody,) every body, the world too, moves against its parent by a small translation and
    rotation along its own axes, beside its joints. Frames and lengths depend on them, so that forces along them follow like
    those along q.
    """
    n_q, moved = model.nv, ca.SX(0, 1) if displacement is None else displacement
    coordinates = read_coordinates(numeric(model), model.qpos0 if reference is None else reference)
    q, qd, qdd = (ca.SX.sym(name, n_q) for name in ("q", "qd", "qdd"))
    T = coordinates.velocity_matrix(q)
    velocity, acceleration = qd, qdd  # MuJoCo's qvel and its derivative
    if not coordinates.trivial:
        velocity = T @ qd
        acceleration = T @ qdd + ca.jtimes(velocity, q, qd)
    frames = [_displaced(_fixed_frame(), moved, 0)]
    for body in range(1, model.nbody):
        parent = frames[model.body_parentid[body]]
        frames.append(_displaced(_child_frame(model, coordinates, body, parent, q), moved, body))
    still = ca.SX.zeros(moved.numel())
    x, rates, turning = ca.vertcat(q, moved), ca.vertcat(qd, still), ca.diagcat(T, ca.SX.eye(moved.numel()))
    lengths = tuple(tendon_length(model, frames, q, tendon) for tendon in range(model.ntendon))

    gravity = ca.DM(gravity_of(model))
    tau, loads = newton_euler(model, coordinates, q, velocity, acceleration, gravity)
    potential = _potential(model, frames, gravity)
    armature = joint_armature(model)
    weight = ca.substitute(tau, ca.vertcat(qd, qdd), ca.SX.zeros(2 * n_q))
    tau = tau + armature * acceleration
    if not coordinates.trivial:
        tau, weight = T.T @ tau, T.T @ weight
    tau = ca.vertcat(tau, loads[: moved.numel()])
    for inertia, length in tendon_inertias(model, lengths, q):
        arm = ca.jacobian(length, x)
        tau = tau + inertia * arm.T * (arm[:, :n_q] @ qdd + ca.jtimes(arm[:, :n_q] @ qd, q, qd))
    joint_force, spring_energy = joint_passive(model, q, velocity)
    if not coordinates.trivial:
        joint_force = T.T @ joint_force
    tendon_force, tendon_energy = tendon_passive(model, lengths, x, rates)
    gas_force, gas_energy = gas_springs(model, frames, lengths, x, rates)
    compensation_energy = _compensation_energy(model, frames, gravity)
    compensation = -ca.jacobian(compensation_energy, x).T
    passive = ca.vertcat(joint_force, still) + tendon_force + gas_force + compensation + load_forces(model, frames, x, rates)
    for site, force in (forces or {}).items():
        passive += ca.jacobian(site_point(model, frames, site), x).T @ force
    friction = dry_friction(
        model, lengths, x, rates, ca.vertcat(velocity, still), turning, transition, extent_m(numeric(model))
    )
    tau, reaction = tau[:n_q], (tau - passive - friction)[n_q:]
    mass_matrix = ca.jacobian(tau, qdd)
    return Tree(
        model=model,
        coordinates=coordinates,
        q=q,
        qd=qd,
        qdd=qdd,
        frames=tuple(frames),
        inverse_dynamics=tau,
        mass_matrix=mass_matrix,
        bias=ca.substitute(tau, qdd, ca.SX.zeros(n_q)),
        gravity=weight - compensation[:n_q],
        passive=passive[:n_q],
        friction=friction[:n_q],
        kinetic_energy=0.5 * ca.dot(qd, mass_matrix @ qd),
        potential_energy=potential + spring_energy + tendon_energy + gas_energy + compensation_energy,
        velocity_matrix=T,
        tendon_lengths=lengths,
        displacement=moved,
        reaction=reaction,
    )


def _fixed_frame() -> Frame:
    return Frame(p_world_B=ca.SX.zeros(3), R_world_B=ca.SX.eye(3), quaternion=ca.SX([1, 0, 0, 0]))


def _displaced(frame: Frame, displacement: ca.SX, body: int) -> Frame:
    """Return a body's frame after its small translation and rotation in `displacement`, exact to first order."""
    if not displacement.numel():
        return frame
    way, turn = ca.vertsplit(displacement[6 * body : 6 * body + 6], 3)
    return Frame(
        p_world_B=frame.point(way),
        R_world_B=frame.R_world_B + frame.R_world_B @ ca.skew(turn),
        quaternion=product(frame.quaternion, ca.vertcat(1, turn / 2)),
    )


def _child_frame(model: mujoco.MjModel, coordinates: Coordinates, body: int, parent: Frame, q: ca.SX) -> Frame:
    """Return a body's frame. Its joints are applied in file order."""
    p = parent.p_world_B + parent.R_world_B @ column(model.body_pos[body])
    R = parent.R_world_B @ ca.DM(rotation_from_quaternion(model.body_quat[body]))
    quaternion = product(parent.quaternion, ca.SX(ca.DM(model.body_quat[body])))
    for joint in joints_of(model, body):
        dof, kind = int(model.jnt_dofadr[joint]), int(model.jnt_type[joint])
        if kind == FREE:  # MuJoCo ignores the body's own position here
            p, R, quaternion = q[dof : dof + 3], ca.SX.eye(3), ca.SX([1, 0, 0, 0])
        if kind == SLIDE:
            p = p + R @ axis_of(model, joint) * (q[dof] - model.qpos0[model.jnt_qposadr[joint]])
            continue
        anchor = p + R @ column(model.jnt_pos[joint])
        if kind == HINGE:
            angle = q[dof] - model.qpos0[model.jnt_qposadr[joint]]
            R = R @ rotation_about(model.jnt_axis[joint], angle)
            turn = ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) * column(unit_of(model.jnt_axis[joint])))
        else:
            chart = coordinates.chart_of(joint)
            turned = turned_quaternion(chart, q)
            turn = product(ca.SX(ca.DM(chart.centre)), turned)
            R = R @ ca.DM(rotation_from_quaternion(chart.centre)) @ rotation_of(turned)
        quaternion = product(quaternion, turn)
        p = anchor - R @ column(model.jnt_pos[joint])
    return Frame(p_world_B=p, R_world_B=R, quaternion=quaternion)


def _compensation_energy(model: mujoco.MjModel, frames: list[Frame], gravity: ca.DM) -> ca.SX:
    """Return the potential energy [J] of gravity compensation: the sum of gravcomp m g . p over the bodies."""
    energy = ca.SX(0)
    if not compensates(model):
        return energy
    for body in range(1, model.nbody):
        if model.body_gravcomp[body]:
            mass = float(model.body_gravcomp[body]) * number(model.body_mass[body])
            energy += mass * ca.dot(gravity, frames[body].point(model.body_ipos[body]))
    return energy


def _potential(model: mujoco.MjModel, frames: list[Frame], gravity: ca.DM) -> ca.SX:
    """Return the potential energy [J] of the moving bodies in gravity."""
    energy = ca.SX(0)
    for body in range(1, model.nbody):
        if model.body_weldid[body] != 0:
            own = inertial_of(model, body)
            energy -= own.mass * ca.dot(gravity, frames[body].point(own.com))
    return energy


def site_places(tree: Tree) -> ca.SX:
    """Return the world positions (3, n_sites) [m] of a model's sites as expressions of q."""
    return ca.horzcat(ca.SX(3, 0), *(tree.site(site) for site in range(tree.model.nsite)))


def site_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of a model's named sites in file order."""
    return tuple(name for name in (model.site(site).name for site in range(model.nsite)) if name)


def site_index(model: mujoco.MjModel, name: str, what: str, error: type[Exception] = ModelError) -> int:
    """Return a site's index by name.

    Raises:
        error: if there is no such site; the message contains `what` and lists the sites.
    """
    names = site_names(model)
    if name in names:
        return int(model.site(name).id)
    known = (
        f"sites are {', '.join(names)}" if names else "the model names none; a point of a body is <site name=... pos=.../>"
    )
    raise error(f"unknown site '{name}' in {what}{nearest(name, names)}; {known}")
