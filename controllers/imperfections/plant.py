"""The simulated machine: a mechanism's MuJoCo model with one machine's imperfections, and where it starts."""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.controllers.imperfections.closing import closed_pose, closed_rates
from linkplan.controllers.imperfections.imperfections import Imperfections, Machine
from linkplan.controllers.imperfections.servos import as_motors
from linkplan.controllers.reference import SampledReference, state_at
from linkplan.controllers.rollout import ControlLoop, admit, scaled_model
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
    model = scaled_model(mechanism, loop.mass_factor * machine.mass_factor)
    model.opt.timestep = clock.period_factor * reference.period_s / substeps
    # A blow-up stays visible: MuJoCo would start such a simulation anew from its reference pose.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    constants = np.broadcast_to(imperfect.drives.constant_factor, (mechanism.n_u,))
    for actuator, limit, factor in zip(mechanism.actuators, loop.effort_limit, constants, strict=True):
        admit(model, actuator, *(max(1.0, factor) * limit))
    as_motors(model, mechanism)
    model.dof_damping[:] += machine.viscous
    _rub(model, machine)
    _stiffen(model, machine)
    if machine.com_shift_m is not None or machine.length_factor:
        _build_otherwise(model, machine)
    position, velocity = reference.position[0], reference.velocity[0]
    if clock.phase_periods:
        position, velocity = state_at(reference, clock.phase_periods * reference.period_s * clock.period_factor)
    s = position + imperfect.start.position_error
    v = velocity + imperfect.start.velocity_error
    as_planned = not machine.length_factor and np.all(s == reference.position[0]) and np.all(v == reference.velocity[0])
    if as_planned:
        gamma = np.array(mechanism.dynamics.velocity_map(reference.pose[0]))
        return Plant(model=model, pose=reference.pose[0], rates=gamma @ reference.velocity[0])
    # Newton's method from the plan's own start leads anywhere where the machine's lies far from it: along the branch first.
    poses, arrived = continue_to(mechanism, reference.pose[0], s[None])
    pose, rates = np.array(poses[0] if arrived else reference.pose[0]), np.zeros(mechanism.n_q)
    pose[mechanism.independent], rates[mechanism.independent] = s, v
    pose = closed_pose(model, mechanism, pose)
    return Plant(model=model, pose=pose, rates=closed_rates(model, mechanism, pose, rates))


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


def _build_otherwise(model: mujoco.MjModel, machine: Machine) -> None:
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
    mujoco.mj_setConst(model, mujoco.MjData(model))
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
