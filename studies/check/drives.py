"""The findings of `linkplan check` on drives, such as actuators that act in one direction only or are far too weak."""

import json

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.actuation.distribution import distribute
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.foreign.floating import floating_joints
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import RANGE_ROUNDING, needed_effort
from linkplan.models.poses.assembly import in_loops
from linkplan.models.poses.equilibrium import rests_on_stops, sprung_freedoms, stop_sentence
from linkplan.models.reduction.reduced import acceleration_at, linearised
from linkplan.models.tree.coordinates import joint_label
from linkplan.models.tree.joints import Joint
from linkplan.models.tree.passive import is_gas_spring


def drivable(mechanism: Mechanism) -> np.ndarray:
    """Return a mask (n_s,) of the degrees of freedom that a drive could move: all but the spins of rods in loops."""
    return ~np.isin(mechanism.independent, mechanism.passive_dofs) | ~in_loops(mechanism)


def joints_to_drive(mechanism: Mechanism) -> list[str]:
    """Return the names of joints whose motors would fix the pose: one per degree of freedom, except rods' spins and a base.

    The joints nearest to the ground whose positions fix the pose come first: drives are usually there. Joints that follow
    others by a coupling, such as the slides of a rolling knee, come last.
    """
    model = mechanism.model
    many = model.body_jntnum[model.jnt_bodyid] > 1  # a single slide may be a lift
    base = {joint_label(model, k) for k in floating_joints(model) if many[k]}
    moved = drivable(mechanism) & np.array([joint.name not in base for joint in mechanism.independent_joints], dtype=bool)
    if not moved.any():
        return []
    rates, chosen = np.array(mechanism.dynamics.velocity_map(mechanism.home))[:, moved], []
    coupled = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_obj2id >= 0)
    last = set(model.eq_obj1id[coupled].tolist())
    level = np.zeros(model.nbody, dtype=int)
    for body in range(1, model.nbody):
        level[body] = level[model.body_parentid[body]] + 1
    depth = {joint_label(model, k): (k in last, level[model.jnt_bodyid[k]]) for k in range(model.njnt)}
    joints = [k for k, joint in enumerate(mechanism.joints) if joint.name in depth.keys() - base and joint.chart is None]
    for k in sorted(joints, key=lambda k: depth[mechanism.joints[k].name]):
        values = np.linalg.svd(rates[[*chosen, k]], compute_uv=False)
        if values[-1] > 1e-3 * values[0]:
            chosen.append(k)
    return [mechanism.joints[k].name for k in chosen[: rates.shape[1]]]


def motors_hint(mechanism: Mechanism) -> str:
    """Return a phrase on how a mechanism without actuators gets motors."""
    if not drivable(mechanism).any():
        return "its loops lock all joints, except rods that spin about their own axes"
    names = json.dumps(joints_to_drive(mechanism), ensure_ascii=False)
    if names == "[]":
        return "none of its joints is a hinge or slide, and mechanism.drive puts motors only on these"
    return f"mechanism.drive = {names} puts motors on joints that fix its pose, within their effort limits"


def pushed_one_way(mechanism: Mechanism, column: int) -> str | None:
    """Return the sentence on a joint that actuators push in one direction only and that nothing returns, or None.

    A weight returns the joint if its effort is more than 1 % of the largest actuator effort.
    """
    index = int(mechanism.independent[column])
    joint, model = mechanism.joints[index], mechanism.model
    acting = [(a, ends) for a, ends in _efforts(mechanism, column) if ends.any()]
    ends = np.array([ends for _, ends in acting]).reshape(-1, 2)
    if not len(ends) or (np.any(ends[:, 0] < 0) and np.any(ends[:, 1] > 0)):
        return None
    weight = np.abs(np.array(mechanism.dynamics.gravity_effort(mechanism.home))[column]).item()
    gas = any(is_gas_spring(model, a) for a in range(model.nactuator))
    if gas or np.any(model.jnt_stiffness) or weight > 0.01 * np.abs(ends).max():
        return None
    unit, damped = joint.si_units[1], is_damped(mechanism, mechanism.home, column)
    moves = "turns" if joint.kind == "hinge" else "pushes"
    pushes = " and ".join(
        f"{a.name}, on {a.target}, {moves} it in one direction only, with {low + 0.0:.3g} to {high + 0.0:.3g} {unit} at home"
        for a, (low, high) in acting
    )
    return (
        f"joint {joint.name} moves freely: no actuator is on it{'' if damped else ', nothing damps it'}, no spring or"
        f" weight returns it; {pushes}"
        if all(a.joint != index for a, _ in acting)
        else f"joint {joint.name} moves freely: {pushes}, and no spring or weight returns it"
    )


def floating_columns(mechanism: Mechanism) -> set[int]:
    """Return the independent coordinates of a base that floats."""
    names = {joint_label(mechanism.model, j) for j in floating_joints(mechanism.model)}
    joints = enumerate(mechanism.independent_joints)
    return {column for column, joint in joints if joint.name in names or joint.chart in names}


def undriven(mechanism: Mechanism, column: int, *, steerable: bool) -> tuple[str, bool]:
    """Return the sentence on an independent joint without an actuator, and True if it is a fault."""
    joint = mechanism.independent_joints[column]
    coasts = mechanism.independent[column] in mechanism.coasting_dofs
    ends = "; without a goal in the motion, it coasts on its momentum" if coasts else ""
    if steerable:
        return f"joint {joint.name} has no actuator: only the other joints move it (underactuated){ends}", False
    if column in sprung_freedoms(mechanism):
        return f"joint {joint.name} has no actuator and the other joints do not move it: springs hold it", False
    said = "" if is_damped(mechanism, mechanism.home, column) else " and nothing damps it"
    return f"joint {joint.name} moves freely: no actuator drives it{said}{ends}", True


def is_damped(mechanism: Mechanism, pose: np.ndarray, column: int) -> bool:
    """Tell if damping or dry friction acts on an independent coordinate at a pose (n_q,)."""
    along, model = np.array(mechanism.dynamics.velocity_map(pose))[:, column], mechanism.model
    drag = [np.array(mechanism.dynamics.passive(pose, speed)).ravel() @ along for speed in (along, 0 * along)]
    rubs = model.dof_frictionloss @ np.abs(mechanism.qvel_of(pose, along)) > 0
    return bool(drag[0] != drag[1] or rubs or model.tendon_frictionloss.any())


def range_words(joint: Joint) -> str:
    """Return a joint's range as text."""
    return f"[{joint.shown(joint.lower):g}, {joint.shown(joint.upper):g}] {joint.unit}"


def outside_at_home(mechanism: Mechanism) -> list[str]:
    """Return a sentence on each joint that is outside its range at home."""
    return [
        f"joint {joint.name} is at {joint.text(x)} {joint.unit} at home, outside its range {range_words(joint)}"
        for joint, x in zip(mechanism.joints, mechanism.home, strict=True)
        if not joint.lower - RANGE_ROUNDING <= x <= joint.upper + RANGE_ROUNDING
    ]


def pressed_joints(mechanism: Mechanism) -> list[tuple[Joint, float]]:
    """Return the joints, with their positions [rad or m], that weight and springs press onto their stops at home.

    An example is the fingers of an adaptive gripper. Actuators hold the coordinates that they drive, within their limits.
    """
    dynamics, home, still = mechanism.dynamics, mechanism.home, np.zeros(mechanism.dof)
    limit, arms = mechanism.effort_limit, np.array(dynamics.effort_map(home))
    mobility = np.linalg.solve(np.array(dynamics.reduced_inertia(home)), arms)
    falling = acceleration_at(dynamics, home, still, np.zeros(mechanism.n_u))
    driven = np.abs(arms).max(axis=1, initial=0.0) > ROUNDING_SHARE * np.abs(arms).max(initial=0.0)
    hold = np.clip(distribute(-falling[None, driven], mobility[None, driven], limit)[0], limit[:, 0], limit[:, 1])
    gained = falling + mobility @ hold
    rates = np.array(dynamics.velocity_map(home)) @ gained
    least = ROUNDING_SHARE * np.abs(falling).max(initial=0.0)
    return [
        (joint, float(x))
        for joint, x, rate in zip(mechanism.joints, home, rates, strict=True)
        if (abs(x - joint.upper) <= RANGE_ROUNDING and rate > least)
        or (abs(x - joint.lower) <= RANGE_ROUNDING and rate < -least)
    ]


def sprung_stops(mechanism: Mechanism) -> list[tuple[Joint, float]]:
    """Return the joints that are off their stops at home but would come to rest on them, with the stops [rad or m].

    Their equilibrium of weight and springs, with the other joints at home, is outside their range.
    """
    sprung, home = sprung_freedoms(mechanism), mechanism.home[mechanism.independent]
    others = {column: float(x) for column, x in enumerate(home) if column not in sprung}
    stops = rests_on_stops(mechanism, others, sprung) if sprung else {}
    joints = mechanism.independent_joints
    return [(joints[k], x) for k, x in stops.items() if abs(x - home[k]) > RANGE_ROUNDING]


def pressed_stops(mechanism: Mechanism) -> list[str]:
    """Return the sentences on joints that weight and springs press onto their stops, at home or starting from home."""
    pressed, sprung = pressed_joints(mechanism), sprung_stops(mechanism)
    sentences = [stop_sentence(pressed, "at home")] if pressed else []
    return [*sentences, *([stop_sentence(sprung, "at rest")] if sprung else [])]


def feeble_drives(mechanism: Mechanism) -> list[str]:
    """Return a sentence on each actuator whose largest effort on a coordinate is below 0.1 % of another's."""
    said = []
    for column, joint in enumerate(mechanism.independent_joints):
        largest = [(a, float(np.abs(ends).max())) for a, ends in _efforts(mechanism, column)]
        strongest, most = max(largest, key=lambda item: item[1], default=(None, 0.0))
        for actuator, own in largest:
            if strongest is not None and np.isfinite(most) and 0 < own < 1e-3 * most:
                said.append(
                    f"actuator {actuator.name} has almost no effect on joint {joint.name}: at home at most {own:.3g}"
                    f" {joint.si_units[1]}, compared with {most:.3g} of {strongest.name}"
                )
    return said


def _efforts(mechanism: Mechanism, column: int) -> list[tuple[Actuator, np.ndarray]]:
    """Return each actuator with its least and largest effort (2,) on an independent joint at home."""
    maps = np.array(mechanism.dynamics.effort_map(mechanism.home))
    found = []
    for actuator, arms in zip(mechanism.actuators, maps.T, strict=True):
        arm = arms[column]
        acts = abs(arm) > ROUNDING_SHARE * max(np.abs(arms).max(), np.abs(maps[column]).max())
        found.append((actuator, np.sort(arm * np.array([actuator.lower, actuator.upper])) if acts else np.zeros(2)))
    return found


def steerable_columns(mechanism: Mechanism) -> np.ndarray:
    """Return a mask (n_s,) of the independent coordinates that the actuators together control near home.

    These are the coordinates in the controllable subspace of the dynamics linearised at home under the effort nearest to the
    holding effort. The subspace is the range of [B, A B, A^2 B, ...], with time in units of the fastest mode (Kailath,
    Linear Systems, 1980, 2.3).
    """
    n_s, still = mechanism.dof, np.zeros(mechanism.dof)
    dynamics, pose = mechanism.dynamics, mechanism.home
    (effort,), _ = needed_effort(mechanism, pose[None], still[None], still[None])
    by_s, by_v, by_u = linearised(dynamics, pose, still, effort)
    A = np.block([[np.zeros((n_s, n_s)), np.eye(n_s)], [by_s, by_v]])
    rate = max(float(np.abs(np.linalg.eigvals(A)).max()), 1.0)
    scale = np.concatenate([np.ones(n_s), np.full(n_s, rate)])
    A = A * scale / (scale[:, None] * rate)
    B = np.vstack([np.zeros_like(by_u), by_u]) / max(float(np.abs(by_u).max()), np.finfo(float).tiny)
    rounding = 1e-9  # of the singular values, in units of the largest effect of an effort
    space, sizes = _krylov_space(A, B, rounding)
    shares = np.linalg.norm(space[:, sizes > rounding], axis=1).reshape(2, n_s)  # of positions and speeds
    return np.all(shares > 1 - 1e-6, axis=0)


def _krylov_space(A: np.ndarray, B: np.ndarray, rounding: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the left singular vectors (n, r) and singular values (r,) of [B, A B, ..., A^(n-1) B].

    The blocks end when they span everything, by singular values above `rounding`. At most n_u + 2 n columns of the matrix
    are in memory, because the factor L of its LQ factorisation has the same singular values and left singular vectors.
    """
    n, lower, block, reduced = len(A), np.empty((len(A), 0)), B, False
    for _ in range(n):
        lower, block = np.hstack([lower, block]), A @ block
        if lower.shape[1] < 2 * n:
            continue
        lower = np.linalg.qr(lower.T, mode="r").T
        if not reduced and np.linalg.svd(lower, compute_uv=False)[-1] > rounding:
            break
        reduced = True
    space, sizes, _ = np.linalg.svd(lower, full_matrices=False)
    return space, sizes
