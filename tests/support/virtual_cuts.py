"""The force or moment in every pin of a mechanism along a motion by virtual cuts in MuJoCo, independent of the product's.

In a copy of the model every jointed body gets three slides (for moments, three hinges) that never move. The efforts on them
by inverse dynamics are the force or moment through the body's joints, including that of closures, tendons and actuators.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from linkplan.models.closure.rank import RANK_TOLERANCE
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import accelerations, equality_jacobian, joint_rates, sampled
from linkplan.models.selected_model import whole_spec
from linkplan.models.tree.coordinates import BALL, HINGE, SLIDE, joint_label
from linkplan.models.tree.passive import simulated_gas_springs

# The step [s] of the central difference for the accelerations of ball joints, for which MuJoCo uses other coordinates.
_DIFFERENCE_STEP_S = 1e-6


def virtual_cuts(
    mechanism: Mechanism,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    u: np.ndarray,
    *forces: np.ndarray,
    kind: mujoco.mjtJoint = SLIDE,
) -> dict[str, np.ndarray]:
    """Return the size (n,) of the force [N] or moment [N.m] in the pins of the tree, by the names of the joints of a pin.

    Forces along slides and moments about hinges, which do not load a pin, are omitted. The moment is about the joint's
    anchor. Bodies with more than three degrees of freedom of their own are left out.

    Args:
        mechanism: the mechanism.
        q: poses (n, n_q) of all joints.
        v: speeds (n, n_s) of the independent joints.
        a: accelerations (n, n_s) of the independent joints.
        u: efforts (n, n_u) of the actuators.
        forces: those of `Mechanism.forces_at`; without them, forces over time are omitted.
        kind: of the joints added to every body: slides for forces, hinges for moments.
    """
    model, pins = _with_joints(mechanism, kind)
    first = np.array([model.body_dofadr[body] + model.body_dofnum[body] - 3 for body in pins], dtype=int)
    added = first[:, None] + np.arange(3)
    kept = np.setdiff1d(np.arange(model.nv), added)
    places = np.setdiff1d(np.arange(model.nq), model.jnt_qposadr[model.dof_jntid[added]])
    rates, second = joint_rates(mechanism, q, v), accelerations(mechanism, q, v, a)
    of = mechanism.forced if forces else mechanism.dynamics
    needed = sampled(of.tree_effort, q, rates, second, *forces)[:, :, 0]
    pushed = () if mechanism.forces is None else mechanism.forces.sites
    maps = sampled(mechanism.dynamics.effort_matrix, q)
    qpos, qvel, qacc = mechanism.qpos_of(q), mechanism.qvel_of(q, rates), _qacc(mechanism, q, rates, second)
    data = mujoco.MjData(model)

    def terms(k: int) -> tuple[np.ndarray, ...]:
        data.qpos[places], data.qvel[kept], data.qacc[kept] = qpos[k], qvel[k], qacc[k]
        given = [(name, w[k, 3 * i : 3 * i + 3]) for w in forces for i, name in enumerate(pushed)]
        return (*_terms(model, data, given), np.array(data.xmat[list(pins)]), np.array(data.xaxis))

    required, loops, moments, turns, axes = (np.array(of) for of in zip(*map(terms, range(len(q))), strict=True))
    units = np.broadcast_to(np.eye(len(kept)), (len(q), len(kept), len(kept)))
    T = mechanism.qvel_of(np.broadcast_to(q[:, None], units.shape), units).transpose(0, 2, 1)  # qvel = T q'
    held = np.einsum("nrk,nkj->njr", loops[:, :, kept], T)
    multipliers = np.einsum(
        "nrj,nj->nr", np.linalg.pinv(held, rcond=RANK_TOLERANCE), needed - np.einsum("nju,nu->nj", maps, u)
    )
    outputs = [actuator.output for actuator in mechanism.actuators]
    left = required - np.einsum("nrk,nr->nk", loops, multipliers) - np.einsum("nuk,nu->nk", moments[:, outputs], u)
    force = np.einsum("npij,npj->pni", turns.reshape(len(q), len(pins), 3, 3), left[:, added])
    return {
        name: np.linalg.norm(_across(model, body, axes, force[pin], kind), axis=1)
        for pin, (body, name) in enumerate(pins.items())
    }


def _with_joints(mechanism: Mechanism, kind: mujoco.mjtJoint) -> tuple[mujoco.MjModel, dict[int, str]]:
    """Return the model with three joints at the end of every jointed body, and the names of its pins by body."""
    names: dict[int, list[str]] = {}
    for joint, body in enumerate(mechanism.model.jnt_bodyid.tolist()):
        ball = kind == HINGE and int(mechanism.model.jnt_type[joint]) == BALL  # which no hinge may follow
        if mechanism.model.body_dofnum[body] <= 3 and not ball:  # MuJoCo allows at most six degrees of freedom per body
            names.setdefault(body, []).append(joint_label(mechanism.model, joint))
    spec = whole_spec(mechanism)
    for key in list(spec.keys):  # keyframes, whose qpos would be too short
        spec.delete(key)
    bodies = list(spec.bodies)
    for body in names:
        last = int(mechanism.model.body_jntadr[body] + mechanism.model.body_jntnum[body] - 1)
        for axis in np.eye(3):
            slide = bodies[body].add_joint(type=kind, axis=axis, pos=mechanism.model.jnt_pos[last], limited=False)
            # Armature [kg] has no effect without acceleration; without it a second slide along an axis has no inertia.
            slide.armature, slide.frictionloss = 1.0, 0.0
            slide.stiffness, slide.damping = np.zeros(3), np.zeros(3)
    model = spec.compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    return model, {body: ", ".join(own) for body, own in names.items()}


def _qacc(mechanism: Mechanism, q: np.ndarray, rates: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the derivative (n, nv) of MuJoCo's qvel."""
    h = _DIFFERENCE_STEP_S
    later, earlier = (mechanism.qvel_of(q + step * rates, rates + step * second) for step in (h, -h))
    return (later - earlier) / (2 * h)


def _terms(
    model: mujoco.MjModel, data: mujoco.MjData, pushes: Sequence[tuple[str, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return M qacc + bias - passive (nv,), the Jacobian of equality constraints (rows, nv), moment arms (outputs, nv).

    The forces (3,) [N] that push sites by name are passive, too.
    """
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    required, moments = np.zeros(model.nv), np.zeros((len(data.moment_rownnz), model.nv))
    mujoco.mj_mulM(model, data, required, data.qacc)
    mujoco.mju_sparse2dense(moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    springs = data.qfrc_passive + simulated_gas_springs(model, data)
    for name, force in pushes:
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, model.site(name).id)
        springs += jacobian.T @ force
    return required + data.qfrc_bias - springs, equality_jacobian(model, data), moments


def _across(model: mujoco.MjModel, body: int, axes: np.ndarray, load: np.ndarray, kind: mujoco.mjtJoint) -> np.ndarray:
    """Return loads (n, 3) without components along own joints of a kind; `axes` (n, n_joints, 3) are in the world."""
    joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body] - 3)
    along = axes[:, [joint for joint in joints if int(model.jnt_type[joint]) == kind]].transpose(0, 2, 1)
    return load - np.einsum("nij,nj->ni", along @ np.linalg.pinv(along, rcond=RANK_TOLERANCE), load)
