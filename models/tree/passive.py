"""Springs, dampers and armatures of joints and tendons, and of the actuators on them.

A spring's force is -(a x + b x^2 + c x^3) with x measured from its rest position. A damper's force is
-(a v + b v|v| + c v^3) (MuJoCo, Computation, "Polynomial forces"). An actuator's own coefficients are multiplied by gear^2.
An actuator without gain is a passive force: its bias, an affine function of length and speed, as for a gas spring, or a
constant force on a site along fixed axes.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.external_forces import loads_of
from linkplan.models.kinematics import clamped_joints, data_at, disabled
from linkplan.models.symbolic_model import is_zero, number, numeric
from linkplan.models.tree.coordinates import HINGE, SLIDE

JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
SITE_TRANSMISSION = int(mujoco.mjtTrn.mjTRN_SITE)


def compensates(model: mujoco.MjModel) -> bool:
    """Return True if the simulator compensates the gravity of any body.

    MuJoCo ignores negative `gravcomp` values if no body has a positive one. It skips all passive forces, including gravity
    compensation, if springs and dampers are both switched off.
    """
    no_springs = disabled(model, mujoco.mjtDisableBit.mjDSBL_SPRING)
    return model.ngravcomp > 0 and not (no_springs and disabled(model, mujoco.mjtDisableBit.mjDSBL_DAMPER))


def limits_off(model: mujoco.MjModel) -> bool:
    """Return True if the model's options switch off joint and tendon limits, or all constraints."""
    return disabled(model, mujoco.mjtDisableBit.mjDSBL_LIMIT, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)


def joint_armature(model: mujoco.MjModel) -> ca.SX | ca.DM:
    """Return the armature (n_q,) of joints and of the actuators that drive them directly (reflected by gear^2)."""
    armature = [number(model.dof_armature[dof]) for dof in range(model.nv)]
    for dof, gear, actuator in _joint_actuators(model):
        armature[dof] += gear**2 * number(model.actuator_armature[actuator])
    return ca.vertcat(*armature)


def _joint_actuators(model: mujoco.MjModel):
    """Yield dof, gear and index of the actuators on hinges and slides."""
    for actuator in range(model.nactuator):
        joint = int(model.actuator_trnid[actuator, 0])
        on_joint = int(model.actuator_trntype[actuator]) in JOINT_TRANSMISSIONS
        if on_joint and int(model.jnt_type[joint]) in (HINGE, SLIDE):
            yield int(model.jnt_dofadr[joint]), _gear(model, actuator), actuator


def _tendon_actuators(model: mujoco.MjModel):
    """Yield tendon, gear and index of the actuators on tendons."""
    for actuator in range(model.nactuator):
        if int(model.actuator_trntype[actuator]) == int(mujoco.mjtTrn.mjTRN_TENDON):
            yield int(model.actuator_trnid[actuator, 0]), _gear(model, actuator), actuator


def _gear(model: mujoco.MjModel, actuator: int) -> Any:
    return number(model.actuator_gear[model.actuator_outadr[actuator], 0])


def switched_off(model: mujoco.MjModel, actuator: int) -> bool:
    """Return True if the model's flags or groups disable an actuator. It then gives no force, not even its bias."""
    group = int(model.actuator_group[actuator])
    by_group = 0 <= group < 31 and bool(model.opt.disableactuator >> group & 1)
    return by_group or disabled(model, mujoco.mjtDisableBit.mjDSBL_ACTUATION)


def is_gas_spring(model: mujoco.MjModel, actuator: int) -> bool:
    """Return True if an actuator on a hinge, slide, tendon or site has a bias but no gain: no control changes its force.

    On a site, the force is constant and its axes are those of a site that stands still.
    """
    kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
    if kind == SITE_TRANSMISSION:
        if not _is_constant_in_world(model, actuator):
            return False
        clamped = clamped_joints(model, target)
    elif kind == int(mujoco.mjtTrn.mjTRN_TENDON):
        clamped = model.tendon_actfrclimited[target]
    elif kind in JOINT_TRANSMISSIONS and int(model.jnt_type[target]) in (HINGE, SLIDE):
        clamped = model.jnt_actfrclimited[target]
    else:
        return False
    kinds = model.actuator_dyntype[actuator], model.actuator_gaintype[actuator], model.actuator_biastype[actuator]
    affine = (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE)
    law = tuple(map(int, kinds)) == tuple(map(int, affine)) and not model.actuator_gainprm[actuator, 0]
    # A clamp of the joint or tendon limits the sum of all efforts on it.
    return law and int(model.actuator_plugin[actuator]) < 0 and not clamped and not switched_off(model, actuator)


def _is_constant_in_world(model: mujoco.MjModel, actuator: int) -> bool:
    """Return True if an actuator on a site gives a constant force, and no torque, along the axes of a site at rest."""
    axes = int(model.actuator_trnid[actuator, 1])
    at_rest = axes >= 0 and model.body_weldid[model.site_bodyid[axes]] == 0
    turning = model.actuator_gear[model.actuator_outadr[actuator], 3:]
    return bool(at_rest and not np.any(turning) and not np.any(model.actuator_biasprm[actuator, 1:3]))


def gas_springs(model: mujoco.MjModel, frames: Sequence[Any], lengths: Sequence, q: ca.SX, qd: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the generalised force (n_q,) of actuators without gain, within their forceranges, and their energy [J] at rest.

    The force along a length l is F = clip(b0 + b1 l + b2 l'). At rest, with l1 the length inside the range that has the same
    force, the energy is -(b0 l1 + b1 l1^2 / 2 + F (l - l1)). That of a constant force on a site at p is -F . p. `frames` are
    the bodies', of `models.tree.dynamics`.
    """
    force, energy = ca.SX.zeros(q.numel()), ca.SX(0)
    on_tendons = [(a, gear * lengths[t]) for t, gear, a in _tendon_actuators(model) if lengths[t] is not None]
    on_joints = [(a, gear * q[dof]) for dof, gear, a in _joint_actuators(model)]
    for actuator, length in (*on_tendons, *on_joints):
        if not is_gas_spring(model, actuator):
            continue
        arm, (b0, b1, b2) = ca.jacobian(length, q), (float(b) for b in model.actuator_biasprm[actuator, :3])
        still, push = b0 + b1 * length, b0 + b1 * length + b2 * (arm @ qd)
        if model.actuator_forcelimited[actuator]:
            low, high = (float(end) for end in model.actuator_forcerange[actuator])
            still, push = (ca.fmin(ca.fmax(one, low), high) for one in (still, push))
        inside = (still - b0) / b1 if b1 else length
        energy -= b0 * inside + b1 * inside**2 / 2 + still * (length - inside)
        force += arm.T * push
    for actuator in range(model.nactuator):  # constant forces on sites
        if int(model.actuator_trntype[actuator]) != SITE_TRANSMISSION or not is_gas_spring(model, actuator):
            continue
        site, axes = (int(i) for i in model.actuator_trnid[actuator])
        size = float(model.actuator_biasprm[actuator, 0])
        if model.actuator_forcelimited[actuator]:
            size = float(np.clip(size, *model.actuator_forcerange[actuator]))
        along = size * model.actuator_gear[model.actuator_outadr[actuator], :3]
        constant = ca.DM(data_at(numeric(model)).site_xmat[axes].reshape(3, 3) @ along)
        place = frames[int(model.site_bodyid[site])].point(model.site_pos[site])
        energy -= ca.dot(constant, place)
        force += ca.jacobian(place, q).T @ constant
    return force, energy


def simulated_gas_springs(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return MuJoCo's generalised force (nv,) of the actuators without gain, at data with known velocities."""
    outputs = [int(model.actuator_outadr[a]) for a in range(model.nactuator) if is_gas_spring(model, a)]
    if not outputs:
        return np.zeros(model.nv)
    mujoco.mj_fwdActuation(model, data)
    moments = np.zeros((len(data.moment_rownnz), model.nv))
    mujoco.mju_sparse2dense(moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    return moments[outputs].T @ data.actuator_force[outputs]


def tendon_inertias(model: mujoco.MjModel, lengths: Sequence, q: ca.SX) -> list[tuple[ca.SX | float, ca.SX]]:
    """Return the armature of each tendon, its actuators' included, with the tendon's length.

    Tendons that couple two branches of the tree are left out: MuJoCo's sparse mass matrix has no entries for them.
    """
    return [
        (inertia, lengths[tendon])
        for tendon, inertia in enumerate(tendon_armatures(model))
        if not is_zero(inertia) and lengths[tendon] is not None and not spans_branches(model, lengths[tendon], q)
    ]


def tendon_armatures(model: mujoco.MjModel) -> list:
    """Return each tendon's armature, its actuators' included (multiplied by gear^2)."""
    inertia = [number(model.tendon_armature[tendon]) for tendon in range(model.ntendon)]
    for tendon, gear, actuator in _tendon_actuators(model):
        inertia[tendon] += gear**2 * number(model.actuator_armature[actuator])
    return inertia


def spans_branches(model: mujoco.MjModel, length: ca.SX, q: ca.SX) -> bool:
    """Return True if a length depends on two coordinates of which neither carries the other."""
    reached = sorted(set(ca.jacobian(length, q).sparsity().get_triplet()[1]))
    for lower, upper in itertools.pairwise(reached):
        above = upper
        while above > lower:
            above = int(model.dof_parentid[above])
        if above != lower:
            return True
    return False


def load_forces(model: mujoco.MjModel, frames: Sequence[Any], q: ca.SX, qd: ca.SX) -> ca.SX:
    """Return the generalised force (n_q,) of loads over a place or a speed; `frames` are as of `gas_springs`."""
    force, numbers = ca.SX.zeros(q.numel()), numeric(model)
    for load in loads_of(numbers):
        joint = load.joint(numbers)
        place = None if joint is None else q[int(numbers.jnt_dofadr[joint])]
        if load.on == "site":
            site = int(numbers.site(load.name).id)
            length = ca.dot(ca.DM(load.axis), frames[int(model.site_bodyid[site])].point(model.site_pos[site]))
        else:
            length = q[int(numbers.jnt_dofadr[numbers.joint(load.name).id])]
        arm, place = ca.jacobian(length, q), length if place is None else place
        force += arm.T * load.expression(arm @ qd if load.over == "speed" else place)
    return force


def tendon_passive(model: mujoco.MjModel, lengths, q: ca.SX, qd: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the generalised force (n_q,) of tendons' springs and dampers, and the springs' energy [J].

    A tendon's spring is slack between its two rest lengths. The force laws are those of `joint_passive`.
    """
    force, energy = ca.SX.zeros(q.numel()), ca.SX(0)
    springs = not disabled(model, mujoco.mjtDisableBit.mjDSBL_SPRING)
    dampers = not disabled(model, mujoco.mjtDisableBit.mjDSBL_DAMPER)
    for tendon, length in enumerate(lengths):
        if length is None:
            continue
        pull, arm = ca.SX(0), ca.jacobian(length, q)
        a, (b, c) = number(model.tendon_stiffness[tendon]), model.tendon_stiffnesspoly[tendon]
        if springs and not all(map(is_zero, (a, b, c))):
            low, high = (float(x) for x in model.tendon_lengthspring[tendon])
            x = length - high if low == high else ca.fmax(length - high, 0) + ca.fmin(length - low, 0)
            pull -= a * x + b * x**2 + c * x**3
            energy += a * x**2 / 2 + b * x**3 / 3 + c * x**4 / 4
        if dampers:
            speed = arm @ qd
            pull -= _damper(speed, number(model.tendon_damping[tendon]), *model.tendon_dampingpoly[tendon])
            for driven, gear, actuator in _tendon_actuators(model):
                if driven == tendon:
                    coefficients = number(model.actuator_damping[actuator]), *model.actuator_dampingpoly[actuator]
                    pull -= gear**2 * _damper(speed, *coefficients)
        force += arm.T * pull
    return force, energy


def joint_passive(model: mujoco.MjModel, q: ca.SX, velocity: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the generalised force (nv,) of joint springs and dampers along MuJoCo's qvel, and the springs' energy [J].

    A spring's x is measured from `springref`. An actuator's own damping coefficients are multiplied by gear^2.
    """
    force, energy = ca.SX.zeros(model.nv), ca.SX(0)
    springs = not disabled(model, mujoco.mjtDisableBit.mjDSBL_SPRING)
    dampers = not disabled(model, mujoco.mjtDisableBit.mjDSBL_DAMPER)
    for joint in range(model.njnt):
        dof, address = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        if springs and int(model.jnt_type[joint]) in (HINGE, SLIDE):
            x = q[dof] - model.qpos_spring[address]
            a, (b, c) = number(model.jnt_stiffness[joint]), model.jnt_stiffnesspoly[joint]
            if not all(map(is_zero, (a, b, c))):
                force[dof] -= a * x + b * x**2 + c * x**3
                energy += a * x**2 / 2 + b * x**3 / 3 + c * x**4 / 4
    if dampers:
        for dof in range(model.nv):
            force[dof] -= _damper(velocity[dof], number(model.dof_damping[dof]), *model.dof_dampingpoly[dof])
        for dof, gear, actuator in _joint_actuators(model):
            coefficients = number(model.actuator_damping[actuator]), *model.actuator_dampingpoly[actuator]
            force[dof] -= gear**2 * _damper(velocity[dof], *coefficients)
    return force, energy


def _damper(v: ca.SX, a: ca.SX | float, b: float, c: float) -> ca.SX:
    """Return a v + b v|v| + c v^3, without the terms whose coefficient is zero."""
    total = a * v
    if b:
        total += b * v * ca.fabs(v)
    if c:
        total += c * v**3
    return total
