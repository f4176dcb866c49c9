"""The simulated machine: a mechanism's MuJoCo model with one machine's imperfections, and where it starts."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.controllers.imperfections.closing import closed_pose, closed_rates
from linkplan.controllers.imperfections.imperfections import Imperfections, Machine
from linkplan.controllers.imperfections.servos import as_motors, stay_servos
from linkplan.controllers.reference import SampledReference, state_at
from linkplan.controllers.rollout import ControlLoop
from linkplan.models.actuation.actuators import Actuator, constant_arms
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.payload import BODY_NAME
from linkplan.models.poses.assembly import continue_to
from linkplan.models.stiffness import make_dry

# MuJoCo answers a loop constraint's time constant below this many steps by taking this many.
_LEAST_STEPS = 2.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Plant:
    """A model of its own, and the closed pose (n_q,) and consistent rates (n_q,) it starts with."""

    model: mujoco.MjModel
    pose: np.ndarray
    rates: np.ndarray


def as_modelled(one: Imperfections) -> bool:
    """Return whether a machine is built, starts and is clocked as modelled: its plant is that of all such machines."""
    machine, start, clock = one.machine, one.start, one.clock
    numbers = (machine.viscous, machine.coulomb, start.position_error, start.velocity_error, clock.phase_periods)
    factors = (machine.mass_factor, clock.period_factor, one.drives.constant_factor)
    otherwise = machine.com_shift_m is not None or machine.length_factor or machine.loop_solref is not None
    if otherwise or any(bool(x) if isinstance(x, int | float) else np.any(x) for x in numbers):
        return False
    return all(f == 1.0 if isinstance(f, int | float) else np.all(np.equal(f, 1.0)) for f in factors)


def plant(
    mechanism: Mechanism, reference: SampledReference, loop: ControlLoop, imperfect: Imperfections, substeps: int
) -> Plant:
    """Return the plant of one machine.

    Raises:
        LinkplanError: for a body that is not there, no payload where one is shifted, or a loop that does not close.
    """
    machine, clock = imperfect.machine, imperfect.clock
    model = copy.deepcopy(mechanism.model)
    data = mujoco.MjData(model)  # for all that follows: to make one takes longer than to work something out in it
    scale_masses(model, data, loop.mass_factor * machine.mass_factor)
    timestep_s = clock.period_factor * reference.period_s / substeps
    constants = np.broadcast_to(imperfect.drives.constant_factor, (mechanism.n_u,))
    prepare(model, mechanism, timestep_s, np.maximum(1.0, constants)[:, None] * loop.effort_limit)
    model.dof_damping[:] += machine.viscous
    _rub(model, machine)
    _stiffen(model, machine)
    if machine.com_shift_m is not None or machine.length_factor:
        _build_otherwise(model, data, machine)
    pose, rates = start_of(model, data, mechanism, reference, imperfect)
    return Plant(model=model, pose=pose, rates=rates)


def prepare(model: mujoco.MjModel, mechanism: Mechanism, timestep_s: float, effort_limit: np.ndarray) -> None:
    """Make a mechanism's model, which is changed, one that is stepped by a timestep [s] under efforts (n_u, 2)."""
    model.opt.timestep = timestep_s
    # A blow-up stays visible: MuJoCo would start such a simulation anew from its reference pose.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for actuator, (low, high) in zip(mechanism.actuators, effort_limit, strict=True):
        admit(model, actuator, low, high)
    if not stay_servos(mechanism):
        as_motors(model, mechanism)


def start_of(
    model: mujoco.MjModel, data: mujoco.MjData, mechanism: Mechanism, reference: SampledReference, imperfect: Imperfections
) -> tuple[np.ndarray, np.ndarray]:
    """Return the closed pose (n_q,) and consistent rates (n_q,) that a machine starts with.

    Raises:
        AssemblyError: for a loop that does not close there.
    """
    machine, clock = imperfect.machine, imperfect.clock
    position, velocity = reference.position[0], reference.velocity[0]
    if clock.phase_periods:
        position, velocity = state_at(reference, clock.phase_periods * reference.period_s * clock.period_factor)
    s = position + imperfect.start.position_error
    v = velocity + imperfect.start.velocity_error
    as_planned = not machine.length_factor and np.all(s == reference.position[0]) and np.all(v == reference.velocity[0])
    if as_planned:
        gamma = np.array(mechanism.dynamics.velocity_map(reference.pose[0]))
        return reference.pose[0], gamma @ reference.velocity[0]
    # Newton's method from the plan's own start leads anywhere where the machine's lies far from it: along the branch first.
    poses, arrived = continue_to(mechanism, reference.pose[0], s[None])
    pose, rates = np.array(poses[0] if arrived else reference.pose[0]), np.zeros(mechanism.n_q)
    pose[mechanism.independent], rates[mechanism.independent] = s, v
    pose = closed_pose(model, data, mechanism, pose)
    return pose, closed_rates(model, data, mechanism, pose, rates)


def scale_masses(model: mujoco.MjModel, data: mujoco.MjData, factor: float) -> None:
    """Multiply mass and inertia in a model: the payload's, or all moving bodies'; `data` is overwritten."""
    if factor == 1.0:
        return
    bodies = [body for body in range(1, model.nbody) if model.body_weldid[body] != 0]
    payload = [body for body in bodies if model.body(body).name == BODY_NAME]
    for body in payload or bodies:
        model.body_mass[body] *= factor
        model.body_inertia[body] *= factor
    mujoco.mj_setConst(model, data)


def admit(model: mujoco.MjModel, actuator: Actuator, low: float, high: float) -> None:
    """Let MuJoCo's own clamps admit the loop's limits: the problem's limits stand in for the file's.

    A servo keeps the range of its ctrl, which is one of positions or speeds.
    """
    index, on = actuator.index, int(model.actuator_trnid[actuator.index, 0])
    if not actuator.is_servo:
        ends = sorted((end - actuator.biases[0]) / actuator.gain for end in (low, high))
        if np.all(np.isfinite(ends)):
            model.actuator_ctrlrange[actuator.channel] = ends
        else:
            model.actuator_ctrllimited[actuator.channel] = False
    if model.actuator_forcelimited[index] or actuator.is_servo:
        model.actuator_forcelimited[index] = True
        model.actuator_forcerange[index] = (low, high) if np.all(np.isfinite((low, high))) else (-1e30, 1e30)
    kind = int(model.actuator_trntype[index])
    if actuator.joint is not None and model.jnt_actfrclimited[on]:
        forces = sorted((low * actuator.gear, high * actuator.gear))
        model.jnt_actfrcrange[on] = forces if np.all(np.isfinite(forces)) else (-1e30, 1e30)
    if kind == int(mujoco.mjtTrn.mjTRN_TENDON):
        if model.tendon_actfrclimited[on]:
            model.tendon_actfrcrange[on] = (low, high) if np.all(np.isfinite((low, high))) else (-1e30, 1e30)
        for dof, arm in constant_arms(model, index).items():
            joint = int(model.dof_jntid[dof])
            if model.jnt_actfrclimited[joint] and arm:
                # The joint's clamp is what narrowed this actuator's limit, which is held already.
                model.jnt_actfrclimited[joint] = False


def _rub(model: mujoco.MjModel, machine: Machine) -> None:
    """Add dry friction, hard enough to be dry."""
    rubs = np.broadcast_to(machine.coulomb, (model.nv,)) > 0
    model.dof_frictionloss[:] += machine.coulomb
    make_dry(model, rubs)


def _stiffen(model: mujoco.MjModel, machine: Machine) -> None:
    if machine.loop_solref is None:
        return
    least = _LEAST_STEPS * float(model.opt.timestep)
    if machine.loop_solref[0] < least * (1 - 1e-9):
        raise LinkplanError(
            f"a loop constraint's time constant is at least {_LEAST_STEPS:g} simulator steps ({least:g} s),"
            f" got {machine.loop_solref[0]:g} s"
        )
    model.eq_solref[:] = machine.loop_solref


def _build_otherwise(model: mujoco.MjModel, data: mujoco.MjData, machine: Machine) -> None:
    """Scale links and move the payload's centre of mass; then MuJoCo's derived constants, the closures' points kept."""
    for name, factor in machine.length_factor.items():
        body = body_index(model, name)
        joints = np.flatnonzero(model.jnt_bodyid == body)
        about = model.jnt_pos[joints[0]].copy() if len(joints) else np.zeros(3)
        for points in _points_of(model, body):
            points[:] = about + factor * (points - about)
        _frames_apart(model, body)
    if machine.com_shift_m is not None:
        body = body_index(model, BODY_NAME)
        model.body_ipos[body] += machine.com_shift_m
        _frames_apart(model, body)
    kept = model.eq_data.copy()
    mujoco.mj_setConst(model, data)
    model.eq_data[:] = kept


def _frames_apart(model: mujoco.MjModel, body: int) -> None:
    """Let MuJoCo work out frames that its compiler found to be the same, and that are no longer."""
    model.body_sameframe[body] = 0
    model.site_sameframe[model.site_bodyid == body] = 0
    model.geom_sameframe[model.geom_bodyid == body] = 0


def _points_of(model: mujoco.MjModel, body: int) -> list[np.ndarray]:
    """Return views (3,) of all points that are fixed to a body: children, sites, geoms, closures' anchors, its centre."""
    places = [model.body_ipos[body]]
    places += [model.body_pos[i] for i in np.flatnonzero(model.body_parentid == body)]
    places += [model.site_pos[i] for i in np.flatnonzero(model.site_bodyid == body)]
    places += [model.geom_pos[i] for i in np.flatnonzero(model.geom_bodyid == body)]
    for i in range(model.neq):
        if model.eq_objtype[i] != int(mujoco.mjtObj.mjOBJ_BODY):
            continue  # between sites, which have moved already
        if model.eq_type[i] == int(mujoco.mjtEq.mjEQ_CONNECT):
            ends = {int(model.eq_obj1id[i]): slice(0, 3), int(model.eq_obj2id[i]): slice(3, 6)}
        elif model.eq_type[i] == int(mujoco.mjtEq.mjEQ_WELD):
            # MuJoCo holds the weld's point in the second body's frame, and the second body's place in the first one's.
            ends = {int(model.eq_obj2id[i]): slice(0, 3), int(model.eq_obj1id[i]): slice(3, 6)}
        else:
            continue
        if body in ends:
            places.append(model.eq_data[i][ends[body]])
    return places


def body_index(model: mujoco.MjModel, name: str) -> int:
    """Return the index of a body.

    Raises:
        LinkplanError: when there is none of that name, or no payload.
    """
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if index > 0:
        return index
    if name == BODY_NAME:
        raise LinkplanError("the payload's centre of mass cannot be moved: the mechanism has no payload")
    names = ", ".join(model.body(i).name for i in range(1, model.nbody))
    raise LinkplanError(f"body '{name}' is not in the model; bodies are {names}")
