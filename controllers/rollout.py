"""The closed loop in MuJoCo: a tracker, sampled, delayed and saturated, on the real closed chain.

Beside batch.py the only file that holds simulator state. A run starts from an assembled pose with joint rates consistent
with the loop (q' = Gamma v). At every control instant the independent joints are read, the tracker is asked, its command is
delayed by whole periods, cut at the actuators' limits and held while MuJoCo steps. What is held is the effort: a servo's
ctrl is worked out anew whenever MuJoCo evaluates its force, so that gain times ctrl plus bias is that effort where the
mechanism stands then.
"""

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from linkplan.controllers.divergence import divergence_expected
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.stepping import steps_of
from linkplan.controllers.trackers.tracker import AnyTracker
from linkplan.models.actuation.actuators import Actuator, constant_arms
from linkplan.models.errors import LinkplanError
from linkplan.models.interrupts import check
from linkplan.models.mechanism import Mechanism
from linkplan.models.payload import BODY_NAME

# An effort that goes from one limit to the other within this many control periods, again and again, is a limit cycle of
# the sampled loop and not a motion; this share of all instants makes the verdict. A bang-bang plan swings once or twice.
_SWING_PERIODS = 10
_SWING_SHARE = 0.02
_FEWEST_SWINGS = 6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ControlLoop:
    """The feedback loop's properties between a tracker and the mechanism.

    `effort_limit` (n_u, 2) [N.m or N] saturates; `delay_periods` whole control periods pass before a command acts;
    `mass_factor` multiplies the payload's mass and inertia (all moving bodies' where there is no payload).
    """

    effort_limit: np.ndarray
    delay_periods: int = 0
    mass_factor: float = 1.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Rollout:
    """The log of a run at its control instants (n,), and the conditions of the simulation.

    Angles [rad or m]; `commanded` is the tracker's output, `applied` what acted, both (n, n_u) [N.m or N]; `gap_m` (n,) is
    the largest distance between two points that a closure ties, or gap of slides, `gap_rad` (n,) that of angles, empty where
    none are tied; `finite` is False when the simulation blew up, and the log
    ends there. `asked_s` (n,) [s] is how long the tracker took to answer, here and now; no other figure depends on it.
    """

    tracker: str
    time_s: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    reference: np.ndarray
    pose: np.ndarray
    commanded: np.ndarray
    applied: np.ndarray
    gap_m: np.ndarray
    contacts: int
    finite: bool
    effort_limit: np.ndarray
    conditions: dict
    asked_s: np.ndarray = field(default_factory=lambda: np.empty(0))
    gap_rad: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def error(self) -> np.ndarray:
        """The position error s_ref - s (n, n_s) [rad or m]."""
        return self.reference - self.position

    @property
    def largest_gaps(self) -> tuple[float, float]:
        """The largest closure gap of the run, [m] of points and slides, [rad] of angles."""
        return float(self.gap_m.max()), float(self.gap_rad.max(initial=0.0))

    @property
    def saturated_fraction(self) -> float:
        """The share of control instants at which a command went beyond a limit."""
        low, high = self.effort_limit.T
        return float(np.mean(np.any((self.commanded < low) | (self.commanded > high), axis=1)))

    @property
    def stable(self) -> bool:
        """Whether the run stayed finite and no effort swung between its limits over and over."""
        return self.finite and not any(self._swings(j) for j in range(self.applied.shape[1]))

    def _swings(self, j: int) -> bool:
        low, high = self.effort_limit[j]
        at = np.where(self.applied[:, j] >= high, 1, np.where(self.applied[:, j] <= low, -1, 0))
        touched = np.flatnonzero(at)
        near = np.diff(touched) <= _SWING_PERIODS
        count = int(np.sum(near & (at[touched[1:]] != at[touched[:-1]])))
        return count >= max(_FEWEST_SWINGS, _SWING_SHARE * len(at))


def closure_gaps(mechanism: Mechanism, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest gaps at poses (n, n_q): (n,) [m] of points and slides, (n,) [rad] of angles or (0,) without any."""
    gaps = mechanism.gaps_by_unit(poses)
    return gaps.get("m", np.zeros(len(poses))), gaps.get("rad", np.empty(0))


def scaled_model(mechanism: Mechanism, factor: float) -> mujoco.MjModel:
    """Return a copy of the mechanism's model with mass and inertia multiplied: the payload's, or all moving bodies'."""
    model = copy.deepcopy(mechanism.model)
    if factor == 1.0:
        return model
    bodies = [body for body in range(1, model.nbody) if model.body_weldid[body] != 0]
    payload = [body for body in bodies if model.body(body).name == BODY_NAME]
    for body in payload or bodies:
        model.body_mass[body] *= factor
        model.body_inertia[body] *= factor
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


@divergence_expected()
def run(mechanism: Mechanism, reference: SampledReference, tracker: AnyTracker, loop: ControlLoop) -> Rollout:
    """Return the log of a tracker run in MuJoCo over the whole reference."""
    model = scaled_model(mechanism, loop.mass_factor)
    substeps = max(1, int(np.ceil(reference.period_s / model.opt.timestep - 1e-9)))
    model.opt.timestep = reference.period_s / substeps
    limit = loop.effort_limit
    actuators = mechanism.actuators
    for actuator, (low, high) in zip(actuators, limit, strict=True):
        admit(model, actuator, low, high)

    data = mujoco.MjData(model)
    rates = np.array(mechanism.dynamics.velocity_map(reference.pose[0])) @ reference.velocity[0]
    data.qpos[:] = mechanism.qpos_of(reference.pose[0])
    data.qvel[:] = mechanism.qvel_of(reference.pose[0], rates)
    independent = mechanism.independent
    n = reference.n
    poses, velocities = np.empty((n, mechanism.n_q)), np.empty((n, mechanism.dof))
    commanded, applied = np.empty((n, len(actuators))), np.empty((n, len(actuators)))
    contacts, done, finite, asked_s = 0, n, True, np.empty(n)
    law = steps_of(tracker)
    memory = law.start(1)
    for k in range(n):
        check()
        poses[k] = mechanism.q_of(data.qpos, reference.pose[k])
        velocities[k] = mechanism.rates_of(poses[k], data.qvel)[independent]
        begin = time.perf_counter()
        asked, memory = law.step(k, poses[k : k + 1, independent], velocities[k : k + 1], memory)
        asked_s[k] = time.perf_counter() - begin
        commanded[k] = asked[0]
        # Before the first command arrives, the first one acts: the feedback loop is taken to be running already.
        applied[k] = np.clip(commanded[max(0, k - loop.delay_periods)], limit[:, 0], limit[:, 1])
        if not np.all(np.isfinite(applied[k])):  # MuJoCo would take it for zero and go on
            done, finite = k + 1, False
            break
        applied[k] = _step(model, data, actuators, applied[k], substeps)
        contacts = max(contacts, data.ncon)
        if _blew_up(data):
            done, finite = k + 1, False
            break
    kept = slice(0, done)
    gap_m, gap_rad = closure_gaps(mechanism, poses[kept])
    return Rollout(
        tracker=tracker.name,
        time_s=reference.time_s[kept],
        position=poses[kept][:, independent],
        velocity=velocities[kept],
        reference=reference.position[kept],
        pose=poses[kept],
        commanded=commanded[kept],
        applied=applied[kept],
        gap_m=gap_m,
        gap_rad=gap_rad,
        contacts=contacts,
        finite=finite,
        effort_limit=np.array(limit),
        conditions=conditions(mechanism, model, reference, loop),
        asked_s=asked_s[kept],
    )


@divergence_expected()
def run_as_it_stands(
    mechanism: Mechanism,
    law: Callable[[float, float, float], float],
    reference: Callable[[np.ndarray], np.ndarray],
    duration_s: float,
    idle_ctrl: Mapping[int, float],
) -> Rollout:
    """Return the log of a model run as its file stands: from its own reference pose, open loops, contacts and all.

    Raises:
        LinkplanError: when the first actuator drives no joint.

    Args:
        mechanism: for its model, joints and first actuator; its assembly is not used.
        law: (time, position, velocity) of the first actuator's joint to a command, every step.
        reference: desired positions (n,) of that joint at times (n,).
        duration_s: how long [s].
        idle_ctrl: constant controls of other actuators, by MuJoCo's index of the control.
    """
    model = copy.deepcopy(mechanism.model)
    actuator = mechanism.actuators[0]
    data = mujoco.MjData(model)
    step = float(model.opt.timestep)
    n, joint = round(duration_s / step), actuator.joint
    if joint is None:
        raise LinkplanError(f"the first actuator, {actuator.name}, is to drive a joint; it acts on {actuator.target}")
    poses, velocities = np.empty((n, mechanism.n_q)), np.empty((n, 1))
    commanded, contacts = np.empty((n, 1)), np.zeros(n, dtype=int)
    for index, value in idle_ctrl.items():
        data.ctrl[index] = value
    for k in range(n):
        check()
        poses[k], velocities[k] = mechanism.q_of(data.qpos), data.qvel[joint]
        commanded[k] = law(data.time, float(poses[k, joint]), float(data.qvel[joint]))
        data.ctrl[actuator.channel] = commanded[k, 0] / actuator.gain
        mujoco.mj_step(model, data)
        contacts[k] = data.ncon
    time_s = step * np.arange(n)
    limit = mechanism.effort_limit[:1]
    gap_m, gap_rad = closure_gaps(mechanism, poses)
    return Rollout(
        tracker="pd",
        time_s=time_s,
        position=poses[:, [joint]],
        velocity=velocities,
        reference=reference(time_s)[:, None],
        pose=poses,
        commanded=commanded,
        applied=np.clip(commanded, limit[:, 0], limit[:, 1]),
        gap_m=gap_m,
        gap_rad=gap_rad,
        contacts=int(contacts.max()),
        finite=bool(np.all(np.isfinite(poses))),
        effort_limit=limit,
        conditions={"mechanism": mechanism.name, "mujoco": mujoco.__version__, "timestep_s": step},
    )


def conditions(mechanism: Mechanism, model: mujoco.MjModel, reference: SampledReference, loop: ControlLoop) -> dict:
    """Return what a result depends on beside the tracker: versions, steps, integrator, softness, delay, masses."""
    active = [index for index in range(model.neq) if model.eq_active0[index]]
    return {
        "mechanism": mechanism.name,
        "mujoco": mujoco.__version__,
        "timestep_s": float(model.opt.timestep),
        "integrator": mujoco.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_"),
        "solref": [model.eq_solref[index].tolist() for index in active],
        "control_period_s": reference.period_s,
        "delay_periods": loop.delay_periods,
        "mass_factor": loop.mass_factor,
        "duration_s": reference.period_s * reference.n,
    }


def _step(model, data: mujoco.MjData, actuators: tuple[Actuator, ...], effort: np.ndarray, substeps: int) -> np.ndarray:
    """Step MuJoCo under held efforts (n_u,), and return the efforts that acted in the first step.

    They are the same but where a servo's ctrl meets the end of its range, or its gain vanishes. MuJoCo's implicit
    integrators add a servo's own damping to the inertia of a step whatever its ctrl: the motion then differs a little from
    a motor's.
    """
    if not any(actuator.is_servo for actuator in actuators):
        for actuator, u in zip(actuators, effort, strict=True):
            data.ctrl[actuator.channel] = (u - actuator.biases[0]) / actuator.gain
        mujoco.mj_step(model, data, substeps)
        return effort
    acted: list[float] = []

    def invert(_: mujoco.MjModel, now: mujoco.MjData) -> None:
        """Set every ctrl where MuJoCo asks for it: at each evaluation, with lengths and velocities worked out."""
        for actuator, u in zip(actuators, effort, strict=True):
            length, velocity = (float(x[actuator.output]) for x in (now.actuator_length, now.actuator_velocity))
            now.ctrl[actuator.channel] = ctrl = actuator.control(float(u), length, velocity)
            if len(acted) < len(actuators):
                limited = bool(model.actuator_forcelimited[actuator.index])
                low, high = model.actuator_forcerange[actuator.index] if limited else (-np.inf, np.inf)
                acted.append(float(np.clip(actuator.effort(ctrl, length, velocity), low, high)))

    mujoco.set_mjcb_control(invert)
    try:
        mujoco.mj_step(model, data, substeps)
    finally:
        mujoco.set_mjcb_control(None)
    return np.array(acted)


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


def _blew_up(data: mujoco.MjData) -> bool:
    bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
    return any(data.warning[int(kind)].number > 0 for kind in bad) or not np.all(np.isfinite(data.qpos))
