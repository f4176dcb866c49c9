"""The simulated machine: a mechanism's MuJoCo model with one machine's imperfections, and its initial state.

The closed pose and rates of a plant that differs from its mechanism follow by Newton's method on MuJoCo's constraint
residuals.
"""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.controllers.imperfections.imperfections import Imperfections, Machine
from linkplan.controllers.imperfections.servos import as_motors
from linkplan.controllers.integrator import simulates_servos
from linkplan.controllers.reference import SampledReference, state_at
from linkplan.controllers.rollout import ControlLoop
from linkplan.models.actuation.actuators import Actuator, constant_arms
from linkplan.models.closure.newton import root_by_newton
from linkplan.models.errors import AssemblyError, LinkplanError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.models.parameters import chosen_parameters, derive, link_size, write_values
from linkplan.models.payload import BODY_NAME
from linkplan.models.poses.along import equality_jacobian, needed_effort
from linkplan.models.poses.assembly import continue_to
from linkplan.models.tree.joints import where

# MuJoCo raises a loop constraint's time constant to at least this many timesteps.
_MIN_TIME_CONSTANT_STEPS = 2.0


def closed_pose(model: mujoco.MjModel, data: mujoco.MjData, mechanism: Mechanism, pose: np.ndarray) -> np.ndarray:
    """Return the closed pose (n_q,) near a pose with the same independent coordinates; `data` is overwritten.

    A gap that no joint changes stays, such as the offset of a planar loop's pins along their axes, or a gap of pins with
    several constraints. It takes no part in the motion.

    Raises:
        AssemblyError: if the loop does not close there.
    """
    q, r = root_by_newton(lambda q: _equalities(model, data, mechanism, q), pose, mechanism.dependent.tolist())
    changed = np.linalg.svd(_equalities(model, data, mechanism, q)[1])[0][:, : len(mechanism.dependent)]
    residual = float(np.abs(changed.T @ r).max(initial=0.0))
    if residual > mechanism.closed_m:
        at = where(mechanism.independent_joints, q[mechanism.independent])
        raise AssemblyError(
            f"the loop does not close at the start, {at}, with this machine's lengths:"
            f" a gap of {1e3 * residual:.3g} mm remains"
        )
    return q


def closed_rates(
    model: mujoco.MjModel, data: mujoco.MjData, mechanism: Mechanism, pose: np.ndarray, rates: np.ndarray
) -> np.ndarray:
    """Return rates (n_q,) with dependent rates that keep the loop closed, J q' = 0; `data` is overwritten."""
    _, J = _equalities(model, data, mechanism, pose)
    found, dependent = np.array(rates, dtype=float), mechanism.dependent
    found[dependent] = 0.0
    found[dependent] = -np.linalg.lstsq(J[:, dependent], J @ found, rcond=None)[0]
    return found


def _equalities(
    model: mujoco.MjModel, data: mujoco.MjData, mechanism: Mechanism, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the equality constraints' residual (n_r,) and Jacobian (n_r, n_q) at a pose (n_q,)."""
    data.qpos[:] = mechanism.qpos_of(q)
    mujoco.mj_fwdPosition(model, data)
    J = equality_jacobian(model, data)
    if not mechanism.coordinates.trivial:
        J = J @ mechanism.qvel_of(np.tile(q, (model.nv, 1)), np.eye(model.nv)).T
    return data.efc_pos[: data.ne].copy(), J


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ImperfectPlant:
    """A machine's own model, and its initial closed pose (n_q,) and consistent rates (n_q,)."""

    model: mujoco.MjModel
    pose: np.ndarray
    rates: np.ndarray


def is_nominal(one: Imperfections) -> bool:
    """Return True if all but a machine's sensors and pushes are nominal, so that such machines can share one plant."""
    parts = [getattr(one, name) for name in one.__slots__ if name not in ("sensors", "pushes")]
    values = [(getattr(part, name), getattr(type(part)(), name)) for part in parts for name in part.__slots__]
    return all(np.all(np.equal(value, neutral)) for value, neutral in values)


def plant(
    mechanism: Mechanism, reference: SampledReference, loop: ControlLoop, imperfect: Imperfections, substeps: int
) -> ImperfectPlant:
    """Return the plant of one machine.

    Raises:
        LinkplanError: for an unknown body, a shifted payload without a payload, or a loop that does not close.
    """
    machine, clock = imperfect.machine, imperfect.clock
    model = copy.deepcopy(mechanism.model)
    data = mujoco.MjData(model)  # shared by all computations below, because its creation is slow
    timestep_s = clock.period_factor * reference.period_s / substeps
    constants = np.broadcast_to(imperfect.drives.constant_factor, (mechanism.n_u,))
    prepare(model, mechanism, timestep_s, np.maximum(1.0, constants)[:, None] * loop.effort_limit)
    change_numbers(model, machine, loop.mass_factor * machine.mass_factor)
    if machine.loop_solref is not None:
        least = _MIN_TIME_CONSTANT_STEPS * float(model.opt.timestep)
        if machine.loop_solref[0] < least * (1 - 1e-9):
            raise LinkplanError(
                f"a loop constraint's time constant is at least {_MIN_TIME_CONSTANT_STEPS:g} simulator steps ({least:g} s),"
                f" got {machine.loop_solref[0]:g} s"
            )
        model.eq_solref[:] = machine.loop_solref
    pose, rates = start_of(model, data, mechanism, reference, imperfect)
    return ImperfectPlant(model=model, pose=pose, rates=rates)


def prepare(model: mujoco.MjModel, mechanism: Mechanism, timestep_s: float, effort_limit: np.ndarray) -> None:
    """Prepare a model for simulation with a timestep [s] and effort limits (n_u, 2); the model is modified."""
    model.opt.timestep = timestep_s
    # By default MuJoCo resets a diverged simulation to its reference pose, which would hide the divergence.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for actuator, (low, high) in zip(mechanism.actuators, effort_limit, strict=True):
        admit(model, actuator, low, high)
    if not simulates_servos(mechanism):
        as_motors(model, mechanism)


def start_of(
    model: mujoco.MjModel, data: mujoco.MjData, mechanism: Mechanism, reference: SampledReference, imperfect: Imperfections
) -> tuple[np.ndarray, np.ndarray]:
    """Return a machine's initial closed pose (n_q,) and consistent rates (n_q,).

    Raises:
        AssemblyError: for a loop that does not close there.
    """
    machine, clock = imperfect.machine, imperfect.clock
    position, velocity = reference.position_rad[0], reference.velocity_rad_s[0]
    if clock.phase_periods:
        position, velocity = state_at(reference, clock.phase_periods * reference.period_s * clock.period_factor)
    s = position + imperfect.start.position_error
    v = velocity + imperfect.start.velocity_error
    as_planned = (
        not (machine.length_factor or machine.parameters)
        and np.all(s == reference.position_rad[0])
        and np.all(v == reference.velocity_rad_s[0])
    )
    if as_planned:
        gamma = np.array(mechanism.dynamics.velocity_map(reference.pose_rad[0]))
        return reference.pose_rad[0], gamma @ reference.velocity_rad_s[0]
    # Newton's method may diverge if the machine starts far from the plan's start: follow the assembly branch first.
    poses, arrived = continue_to(mechanism, reference.pose_rad[0], s[None])
    pose, rates = np.array(poses[0] if arrived else reference.pose_rad[0]), np.zeros(mechanism.n_q)
    pose[mechanism.independent], rates[mechanism.independent] = s, v
    pose = closed_pose(model, data, mechanism, pose)
    return pose, closed_rates(model, data, mechanism, pose, rates)


def held_before(mechanism: Mechanism, reference: SampledReference, loop: ControlLoop) -> np.ndarray:
    """Return the efforts (n_u,) before the first command: those that hold a start at rest, else the reference's own.

    More actuators than freedoms hold it by the efforts within their limits that are nearest to the reference's first, which
    those with a limited rate have. The loop's initial efforts, where they are finite, replace them.
    """
    held, limit, given = reference.effort[0], loop.effort_limit, loop.initial_effort
    if loop.rate_limit is not None:
        limit = np.where(np.isfinite(loop.rate_limit)[:, None], held[:, None], limit)
    if not np.any(reference.velocity_rad_s[0]):
        still = np.zeros((1, mechanism.dof))
        pose = reference.pose_rad[:1]
        held = needed_effort(mechanism, pose, still, still, np.zeros(1), limit=limit, wanted=held)[0][0]
    return held if given is None else np.where(np.isfinite(given), given, held)


def change_numbers(model: mujoco.MjModel, machine: Machine, mass_factor: float = 1.0) -> None:
    """Write into a model the numbers in which a machine differs from it: named ones first, then factors and additions.

    The factor multiplies mass and inertia of the payload, or of all moving bodies without one.

    Raises:
        LinkplanError: for numbers that no machine has, or an unknown body.
    """
    if machine.parameters:
        write_values(model, chosen_parameters(model, machine.parameters), list(machine.parameters.values()))
    if machine.length_factor:
        sizes = [link_size(model, body_index(model, name)) for name in machine.length_factor]
        write_values(model, sizes, list(machine.length_factor.values()))
    moving = [body for body in range(1, model.nbody) if model.body_weldid[body] != 0]
    bodies = [body for body in moving if model.body(body).name == BODY_NAME] or moving
    model.body_mass[bodies] *= mass_factor
    model.body_inertia[bodies] *= mass_factor
    if machine.com_shift_m is not None:
        model.body_ipos[body_index(model, BODY_NAME)] += machine.com_shift_m
    model.dof_damping[:] += machine.viscous
    model.dof_frictionloss[:] += machine.coulomb
    if mass_factor != 1.0 or machine.com_shift_m is not None or np.any(machine.coulomb):
        derive(model)


def admit(model: mujoco.MjModel, actuator: Actuator, low: float, high: float) -> None:
    """Replace the model's effort limits of an actuator by the feedback loop's limits.

    A servo keeps its ctrl range, which limits positions or speeds.
    """
    force_range = np.nan_to_num((low, high))  # MuJoCo has no infinite ranges
    index, on = actuator.index, int(model.actuator_trnid[actuator.index, 0])
    if not actuator.is_servo:
        ends = sorted((end - actuator.biases[0]) / actuator.gain for end in (low, high))
        if np.all(np.isfinite(ends)):
            model.actuator_ctrlrange[actuator.channel] = ends
        else:
            model.actuator_ctrllimited[actuator.channel] = False
    if model.actuator_forcelimited[index] or actuator.is_servo:
        model.actuator_forcelimited[index] = True
        model.actuator_forcerange[index] = force_range
    kind = int(model.actuator_trntype[index])
    if actuator.joint is not None and model.jnt_actfrclimited[on]:
        model.jnt_actfrcrange[on] = np.nan_to_num(sorted((low * actuator.gear, high * actuator.gear)))
    if kind == int(mujoco.mjtTrn.mjTRN_TENDON):
        if model.tendon_actfrclimited[on]:
            model.tendon_actfrcrange[on] = force_range
        for dof, arm in constant_arms(model, index).items():
            joint = int(model.dof_jntid[dof])
            if model.jnt_actfrclimited[joint] and arm:
                # The actuator's limit already accounts for the joint's limit.
                model.jnt_actfrclimited[joint] = False


def body_index(model: mujoco.MjModel, name: str) -> int:
    """Return the index of a body.

    Raises:
        LinkplanError: if no body has this name, or if there is no payload.
    """
    names = [model.body(i).name for i in range(1, model.nbody)]
    if name == BODY_NAME and name not in names:
        raise LinkplanError("the payload's centre of mass cannot be moved: the mechanism has no payload")
    return 1 + names.index(choose("body", name, names, LinkplanError))
