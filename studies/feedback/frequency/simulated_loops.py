"""Feedback loops simulated in MuJoCo side by side. Each has its own pose, gain and signals; `run` advances them in steps.

In a trial of stability, disturbed loops run until the disturbance has decayed or grown.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.feedback_loop import run_loop, states_of
from linkplan.controllers.imperfections.driving import driving
from linkplan.controllers.imperfections.imperfections import Drives
from linkplan.controllers.imperfections.plant import ImperfectPlant, prepare
from linkplan.controllers.imperfections.servos import speed_gains
from linkplan.controllers.mujoco_plant import MujocoStepper, simulation_conditions
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.sampling import Sampling
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.tree.joints import unit_steps
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SimulatedFeedback:
    """The law u_k = u_ff + K (x_ref - x_k), x = (s, v). Its memory (n, 1) is the number of each simulation.

    `drive` u_ff + K x_ref (t, n, n_u) [N.m or N] and `gain` K (t, n, n_u, 2 n_s).
    """

    drive: np.ndarray
    gain: np.ndarray
    name: str = "state feedback"

    def start(self, n: int) -> np.ndarray:
        """Return the numbers (n, 1) of the simulations."""
        return np.arange(n)[:, None]

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) of simulations at states (n, n_s)."""
        x, of = np.concatenate([position_rad, velocity_rad_s], axis=1), memory[:, 0]
        return self.drive[k, of] - np.matmul(self.gain[k, of], x[:, :, None])[:, :, 0], memory


class SimulatedLoops:
    """Closed loops in MuJoCo. Mutable: every `run` advances the given simulations by some control periods.

    Args:
        mechanism: the mechanism of all simulations.
        pose: closed poses (n, n_q) to start from.
        velocity: independent rates (n, n_s) to start with.
        gain: K (n, n_u, 2 n_s).
        under_way: commands (p, n, n_u) of the last p = `timing.memory` periods before the start, or one (n, n_u) for all.
        timing: period, simulator steps, delay.
        effort_limit: (n_u, 2) [N.m or N].
        motion: the reference of every `run`, from which servos under implicit integrators take what their speeds gain in a
            step; default: constant states.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        *,
        pose: np.ndarray,
        velocity: np.ndarray,
        gain: np.ndarray,
        under_way: np.ndarray,
        timing: Sampling,
        effort_limit: np.ndarray,
        motion: SampledReference | None = None,
    ) -> None:
        model = copy.copy(mechanism.model)
        prepare(model, mechanism, timing.timestep_s, np.array(effort_limit))
        rates = joint_rates(mechanism, np.asarray(pose), np.asarray(velocity))
        starts = [ImperfectPlant(model=model, pose=q, rates=v) for q, v in zip(pose, rates, strict=True)]
        n, self.gain, self.timing, self.periods = len(pose), np.array(gain), timing, 0
        delays = [timing.delay_steps / timing.substeps] * n
        drives = driving([Drives()] * n, delays, [timing.timestep_s] * n, timing.substeps, effort_limit)
        gains = None if motion is None else speed_gains(mechanism, motion, timing.substeps)
        # Along a motion, the commands under way before its start take the steps before zero.
        begun = None if motion is None else np.full(n, -float(timing.memory * timing.substeps))
        self._stepper = MujocoStepper(mechanism, starts, drives, timing.substeps, gains=gains, begun=begun)
        self._stepper.under_way(np.broadcast_to(under_way, (timing.memory, n, mechanism.n_u)))

    def state(self) -> np.ndarray:
        """Return the current x = (s, v) (n, 2 n_s); NaN for simulations that have ended."""
        stepper = self._stepper
        q, v = states_of(stepper)
        x = np.concatenate([q[:, stepper.independent], v], axis=1)
        return np.where(stepper.running[:, None], x, np.nan)

    def conditions(self) -> dict:
        """Return the simulation settings that results depend on."""
        timing = self.timing
        return {**simulation_conditions(self._stepper.model), "control_period_s": timing.period_s, "delay_s": timing.delay_s}

    def run(
        self, ids: Sequence[int] | np.ndarray, reference: np.ndarray, feedforward: np.ndarray, gain: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Advance simulations by t control periods. A simulation that is left out once cannot be resumed.

        Args:
            ids: indices (r,) of the simulations.
            reference: x_ref (t, r, 2 n_s) at these instants.
            feedforward: u_ff (t, r, n_u) of the control periods.
            gain: K (t, n_u, 2 n_s) for all simulations; default: their own gains.

        Returns:
            The measured states (t, r, 2 n_s) and the commands (t, r, n_u) before delay and limits; NaN after divergence.
        """
        pose, velocity, commands = self.run_poses(ids, reference, feedforward, gain)
        return np.concatenate([pose[:, :, self._stepper.independent], velocity], axis=2), commands

    def run_poses(
        self, ids: Sequence[int] | np.ndarray, reference: np.ndarray, feedforward: np.ndarray, gain: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Advance simulations as `run` does; return poses q (t, r, n_q), independent rates (t, r, n_s) and commands."""
        stepper, ids = self._stepper, np.asarray(ids)
        stepper.freeze(stepper.running & ~np.isin(np.arange(stepper.n), ids))
        t = len(reference)
        gains = np.broadcast_to(self.gain if gain is None else gain[:, None], (t, *self.gain.shape))
        drive = np.zeros((t, *self.gain.shape[:2]))
        of = self.gain[ids] if gain is None else gain[:, None]
        drive[:, ids] = feedforward + np.matmul(of, reference[:, :, :, None])[:, :, :, 0]
        log = run_loop(stepper, SimulatedFeedback(drive=drive, gain=gains), t)
        self.periods += t
        return log.pose[:, ids], log.velocity[:, ids], log.commanded[:, ids]


def simulated(loops: Sequence[FeedbackLoop], effort_limit: np.ndarray, velocity: np.ndarray | None = None) -> SimulatedLoops:
    """Return simulations of loops of one mechanism and one timing, held at their operating points.

    They start with independent rates `velocity` (n, n_s); default: those of their points.
    """
    points = [loop.point for loop in loops]
    return SimulatedLoops(
        points[0].mechanism,
        pose=np.array([point.pose for point in points]),
        velocity=np.array([point.velocity for point in points]) if velocity is None else velocity,
        gain=np.array([loop.gain for loop in loops]),
        under_way=np.array([point.hold for point in points]),
        timing=loops[0].timing,
        effort_limit=effort_limit,
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Excitation:
    """A test signal of a loop: efforts `push` (n_u,) times the signal, or the reference of a joint, its coordinate.

    `read` (n_u,) gives the excited effort of commands.
    """

    loop: FeedbackLoop
    push: np.ndarray
    read: np.ndarray
    coordinate: int | None = None


class ExcitedLoops:
    """Simulations (n,) of loops of one mechanism and one timing: every row of excitations `repeats` times.

    `measured` gives outputs (m, n_y) at poses (m, n_q) with commands (m, n_u) [N.m or N], these relative to the holding
    efforts `hold` (n, n_u). `read` (n, n_u) are those of the rows, `rest` (n, n_y) the outputs at the operating points.
    """

    def __init__(
        self,
        rows: Sequence[Excitation],
        measured: Callable[[np.ndarray, np.ndarray], np.ndarray],
        effort_limit: np.ndarray,
        repeats: int,
    ) -> None:
        every = [row for row in rows for _ in range(repeats)]
        points = [row.loop.point for row in every]
        self.rows, self._measured = tuple(rows), measured
        self.hold, self.read = np.array([point.hold for point in points]), np.array([row.read for row in every])
        self._push, self._state = np.array([row.push for row in every]), np.array([point.state for point in points])
        n_s = points[0].mechanism.dof
        self._excited = np.array([np.arange(n_s) == (-1 if row.coordinate is None else row.coordinate) for row in every])
        self.rest = measured(np.array([point.pose for point in points]), np.zeros_like(self.hold))
        self.simulations = simulated([row.loop for row in every], effort_limit)

    def run(
        self, active: np.ndarray, signal: np.ndarray, rate: np.ndarray, forward: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Apply test signals for t control periods.

        Args:
            active: indices (r,) of the simulations.
            signal: test signal (t, r) [rad, m, N.m or N].
            rate: derivative (t, r) of a reference signal [per second]; effort signals ignore it.
            forward: feedforward efforts (t, r, n_u) in addition to the holding efforts [N.m or N].

        Returns:
            The excited effort of the commands (t, r) and the outputs (t, r, n_y), relative to the operating point, and all
            commands (t, r, n_u).
        """
        added = [x[:, :, None] * self._excited[active] for x in (signal, rate)]
        reference = self._state[active] + np.concatenate(added, axis=2)
        feedforward = self.hold[active] + forward + signal[:, :, None] * self._push[active]
        pose, _, commands = self.simulations.run_poses(active, reference, feedforward)
        relative = commands - self.hold[active]
        outputs = self._measured(*(x.reshape(-1, x.shape[2]) for x in (pose, relative))).reshape(*signal.shape, -1)
        return np.sum(relative * self.read[active], axis=2), outputs - self.rest[active], commands


# Initial velocity [rad/s or m/s], far above the simulator's rounding of 1e-11.
_KICK_VELOCITY = 1e-3
# Share of the distance to the effort limits that the kick's command may use, so that growth is visible before saturation.
_KICK_EFFORT_SHARE = 1e-3
# A loop is decided when its speed has grown or decayed by this factor. At the end of the time the trend decides.
_DECISIVE_FACTOR = 300.0
# A speed of this many kicks is growth; the command is then still well inside the limits.
_GROWTH_FACTOR = 100.0
# A loop at rest this far [rad; on a slide, share of the extent] from its pose has fallen; soft loops sink by a third of it.
_FALL_DISTANCE = 0.1
MAX_TRIAL_PERIODS = 40_000


def settle_trials(
    loops: Sequence[FeedbackLoop], effort_limit: np.ndarray, most_periods: int = MAX_TRIAL_PERIODS
) -> np.ndarray:
    """Return a mask (n,) of the loops, all of one timing, that settle in MuJoCo after a small kick to their joints."""
    mechanism, n = loops[0].point.mechanism, len(loops)
    n_s = mechanism.dof
    state = np.array([loop.point.state for loop in loops])
    hold = np.array([loop.point.hold for loop in loops])
    room = np.abs(effort_limit[None] - hold[:, :, None]).min(axis=2)
    pushes = np.abs(np.array([loop.gain for loop in loops])[:, :, n_s:]).sum(axis=2)
    with np.errstate(divide="ignore"):
        kick = np.minimum(_KICK_VELOCITY, (_KICK_EFFORT_SHARE * room / pushes).min(axis=1))
    batch = simulated(loops, effort_limit, kick[:, None] * mechanism.actuated)
    settles = np.zeros(n, dtype=bool)
    unit = unit_steps(mechanism.joints, mechanism.extent_m)[mechanism.independent][mechanism.actuated]
    active, history = np.arange(n), []
    while active.size:
        reference, push = (np.repeat(value[None, active], 100, axis=0) for value in (state, hold))
        x, _ = batch.run(active, reference, push)
        speed = np.full(n, np.inf)
        with np.errstate(invalid="ignore"):
            now = np.abs(x[:, :, n_s:][:, :, mechanism.actuated]).max(axis=(0, 2))
        speed[active] = np.where(np.isfinite(now), now, np.inf)
        history.append(speed)
        log_speed = np.log(np.maximum(np.array(history)[:, active], 1e-300))
        half = len(history) // 2
        with np.errstate(invalid="ignore"):  # infinity minus infinity after divergence
            late_change, change = log_speed[-1] - log_speed[half], log_speed[-1] - log_speed[0]
        decisive = (np.abs(change) > np.log(_DECISIVE_FACTOR)) | ~np.isfinite(change)
        # A loop may decay or grow within the first check interval: compare with the kick itself.
        decayed = speed[active] < kick[active] / _DECISIVE_FACTOR
        # Soft loops initially sink under the weight, faster than the kick. A speed that does not fall again has grown.
        falls = np.min(history[-5:], axis=0) < np.min(history[:-5], axis=0, initial=np.inf)
        grown = ~(speed[active] < _GROWTH_FACTOR * kick[active]) & ~falls[active]
        finished = decisive | decayed | grown | (batch.periods >= most_periods)
        trend = np.where(decisive, change, late_change)
        off = np.abs(x[-1, :, :n_s] - state[active, :n_s])[:, mechanism.actuated] / unit
        near = off.max(axis=1) < _FALL_DISTANCE
        settles[active[finished]] = (near & (decayed | (~grown & (trend < 0))))[finished]
        active = active[~finished]
    return settles
