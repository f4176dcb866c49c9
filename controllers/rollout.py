"""The closed loop in MuJoCo: a tracker, sampled, delayed and saturated, on the real closed chain.

Beside batch.py the only file that holds simulator state. A run starts from an assembled pose with joint rates consistent
with the loop (q' = Gamma v). At every control instant the independent joints are read, the tracker is asked, its command is
delayed by whole periods, cut at the actuators' limits and held while MuJoCo steps.
"""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from controllers.reference import SampledReference
from controllers.tracker import Tracker
from models.along import sampled
from models.mechanism import Mechanism
from models.payload import BODY_NAME

# An effort that goes from one limit to the other within this many control periods, again and again, is a limit cycle of
# the sampled loop and not a motion; this share of all instants makes the verdict. A bang-bang plan swings once or twice.
_SWING_PERIODS = 10
_SWING_SHARE = 0.02
_FEWEST_SWINGS = 6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Loop:
    """What stands between a tracker and the mechanism.

    `effort_limit` (n_u, 2) [N.m or N] saturates; `delay_periods` whole control periods pass before a command acts;
    `mass_factor` multiplies the payload's mass and inertia (all moving bodies' where there is no payload).
    """

    effort_limit: np.ndarray
    delay_periods: int = 0
    mass_factor: float = 1.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Rollout:
    """The log of a run at its control instants (n,), and the conditions of the simulation.

    Angles [rad or m]; `commanded` is the tracker's wish, `applied` what acted, both (n, n_u) [N.m or N]; `gap_m` (n,) is
    the largest distance between two points that a closure ties; `finite` is False when the simulation blew up, and the log
    ends there.
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

    @property
    def error(self) -> np.ndarray:
        """The position error s_ref - s (n, n_s) [rad or m]."""
        return self.reference - self.position

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


def run(mechanism: Mechanism, reference: SampledReference, tracker: Tracker, loop: Loop) -> Rollout:
    """Return the log of a tracker run in MuJoCo over the whole reference."""
    model = scaled_model(mechanism, loop.mass_factor)
    substeps = max(1, int(np.ceil(reference.period_s / model.opt.timestep - 1e-9)))
    model.opt.timestep = reference.period_s / substeps
    limit = loop.effort_limit
    actuators = mechanism.actuators
    channels = np.array([actuator.index for actuator in actuators], dtype=int)
    gains = np.array([actuator.gain for actuator in actuators])
    for actuator, (low, high) in zip(actuators, limit, strict=True):
        admit(model, actuator, low, high)

    data = mujoco.MjData(model)
    data.qpos[:] = reference.pose[0]
    data.qvel[:] = np.array(mechanism.dynamics.velocity_map(reference.pose[0])) @ reference.velocity[0]
    independent = mechanism.independent
    n = reference.n
    poses, velocities = np.empty((n, mechanism.n_q)), np.empty((n, mechanism.dof))
    commanded, applied = np.empty((n, len(actuators))), np.empty((n, len(actuators)))
    contacts, done, finite = 0, n, True
    mujoco.set_mju_user_warning(_ignore)  # a blow-up is this function's answer, not a line in a log file
    try:
        for k in range(n):
            poses[k], velocities[k] = data.qpos, data.qvel[independent]
            commanded[k] = tracker.effort(k, poses[k][independent], velocities[k])
            # Before the first command arrives, the first one acts: the loop is taken to have been at work already.
            applied[k] = np.clip(commanded[max(0, k - loop.delay_periods)], limit[:, 0], limit[:, 1])
            if not np.all(np.isfinite(applied[k])):  # MuJoCo would take it for zero and go on
                done, finite = k + 1, False
                break
            data.ctrl[channels] = applied[k] / gains
            mujoco.mj_step(model, data, substeps)
            contacts = max(contacts, data.ncon)
            if _blew_up(data):
                done, finite = k + 1, False
                break
    finally:
        mujoco.set_mju_user_warning(None)
    kept = slice(0, done)
    phi = sampled(mechanism.dynamics.closure, poses[kept]).reshape(done, -1, 3)
    return Rollout(
        tracker=tracker.name,
        time_s=reference.time_s[kept],
        position=poses[kept][:, independent],
        velocity=velocities[kept],
        reference=reference.position[kept],
        pose=poses[kept],
        commanded=commanded[kept],
        applied=applied[kept],
        gap_m=np.linalg.norm(phi, axis=2).max(axis=1, initial=0.0),
        contacts=contacts,
        finite=finite,
        effort_limit=np.array(limit),
        conditions=conditions(mechanism, model, reference, loop),
    )


def run_as_it_stands(
    mechanism: Mechanism,
    law: Callable[[float, float, float], float],
    reference: Callable[[np.ndarray], np.ndarray],
    duration_s: float,
    idle_ctrl: Mapping[int, float],
) -> Rollout:
    """Return the log of a model run as its file stands: from its own reference pose, open loops, contacts and all.

    Args:
        mechanism: for its model, joints and first actuator; its assembly is not used.
        law: (time, position, velocity) of the first actuator's joint to a command, every step.
        reference: desired positions (n,) of that joint at times (n,).
        duration_s: how long [s].
        idle_ctrl: constant controls of other actuators, by MuJoCo's index.
    """
    model = copy.deepcopy(mechanism.model)
    actuator = mechanism.actuators[0]
    data = mujoco.MjData(model)
    step = float(model.opt.timestep)
    n, joint = round(duration_s / step), actuator.joint
    poses, velocities = np.empty((n, mechanism.n_q)), np.empty((n, 1))
    commanded, contacts = np.empty((n, 1)), np.zeros(n, dtype=int)
    for index, value in idle_ctrl.items():
        data.ctrl[index] = value
    for k in range(n):
        poses[k], velocities[k] = data.qpos, data.qvel[joint]
        commanded[k] = law(data.time, float(data.qpos[joint]), float(data.qvel[joint]))
        data.ctrl[actuator.index] = commanded[k, 0] / actuator.gain
        mujoco.mj_step(model, data)
        contacts[k] = data.ncon
    time = step * np.arange(n)
    phi = sampled(mechanism.dynamics.closure, poses).reshape(n, -1, 3)
    limit = mechanism.effort_limit[:1]
    return Rollout(
        tracker="pd",
        time_s=time,
        position=poses[:, [joint]],
        velocity=velocities,
        reference=reference(time)[:, None],
        pose=poses,
        commanded=commanded,
        applied=np.clip(commanded, limit[:, 0], limit[:, 1]),
        gap_m=np.linalg.norm(phi, axis=2).max(axis=1, initial=0.0),
        contacts=int(contacts.max()),
        finite=bool(np.all(np.isfinite(poses))),
        effort_limit=limit,
        conditions={"mechanism": mechanism.name, "mujoco": mujoco.__version__, "timestep_s": step},
    )


def conditions(mechanism: Mechanism, model: mujoco.MjModel, reference: SampledReference, loop: Loop) -> dict:
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


def admit(model: mujoco.MjModel, actuator, low: float, high: float) -> None:
    """Let MuJoCo's own clamps admit the loop's limits: the problem's limits stand in for the file's."""
    index, joint = actuator.index, int(model.actuator_trnid[actuator.index, 0])
    ends = sorted((low / actuator.gain, high / actuator.gain))
    if np.all(np.isfinite(ends)):
        model.actuator_ctrlrange[index] = ends
    else:
        model.actuator_ctrllimited[index] = False
    if model.actuator_forcelimited[index]:
        model.actuator_forcerange[index] = (low, high) if np.all(np.isfinite((low, high))) else (-1e30, 1e30)
    if model.jnt_actfrclimited[joint]:
        forces = sorted((low * actuator.gear, high * actuator.gear))
        model.jnt_actfrcrange[joint] = forces if np.all(np.isfinite(forces)) else (-1e30, 1e30)


def _blew_up(data: mujoco.MjData) -> bool:
    bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
    return any(data.warning[int(kind)].number > 0 for kind in bad) or not np.all(np.isfinite(data.qpos))


def _ignore(message: str) -> None:
    del message
