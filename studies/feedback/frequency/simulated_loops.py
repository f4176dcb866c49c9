"""Feedback loops simulated in MuJoCo side by side. Each has its own pose, gain and signals; `run` advances them in steps."""

import copy
from collections.abc import Sequence
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
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop, channel_effort, outputs_of


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
        """Return the present x = (s, v) (n, 2 n_s); NaN for simulations that have ended."""
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


def simulated(loops: Sequence[FeedbackLoop], effort_limit: np.ndarray, repeats: int) -> SimulatedLoops:
    """Return simulations of loops of one mechanism and one timing, each `repeats` times, held at its operating point."""

    def of_rows(values: list) -> np.ndarray:
        return np.repeat(values, repeats, axis=0)

    points = [loop.point for loop in loops]
    return SimulatedLoops(
        points[0].mechanism,
        pose=of_rows([point.pose for point in points]),
        velocity=of_rows([point.state[points[0].mechanism.dof :] for point in points]),
        gain=of_rows([loop.gain for loop in loops]),
        under_way=of_rows([point.hold for point in points]),
        timing=loops[0].timing,
        effort_limit=effort_limit,
    )


class ExcitedLoops:
    """Simulations (n,) of loops of one mechanism and one timing: every row (loop, excitation) `repeats` times.

    `hold` (n, n_u) [N.m or N] are the holding efforts; `read` (n, n_u) measures the effort where the loop is broken.
    `outputs` are the coordinates that are measured, first the channel.
    """

    def __init__(
        self,
        loops: Sequence[FeedbackLoop],
        excitations: Sequence[str],
        channel: int,
        effort_limit: np.ndarray,
        repeats: int = 1,
    ) -> None:
        def of_rows(values: list) -> np.ndarray:
            return np.repeat(values, repeats, axis=0)

        self.rows = tuple((loop, excitation) for loop in loops for excitation in excitations)
        points = [loop.point for loop, _ in self.rows]
        efforts = [channel_effort(point, channel) for point in points]
        self.outputs = outputs_of(loops[0].point.mechanism, channel)
        self._channel, self._state = channel, of_rows([point.state for point in points])
        self.hold, self.read = of_rows([point.hold for point in points]), of_rows([read for read, _ in efforts])
        self._push = of_rows([push for _, push in efforts])
        self._effort = of_rows([excitation == "effort" for _, excitation in self.rows])  # where the test signal is an effort
        self.simulations = simulated([loop for loop, _ in self.rows], effort_limit, repeats)

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
            The command (t, r) of the channel and the positions (t, r, n) of its outputs, relative to the operating point,
            and all commands (t, r, n_u).
        """
        n_s = self._state.shape[1] // 2
        effort = self._effort[active]
        reference = np.repeat(self._state[None, active], len(signal), axis=0)
        reference[:, :, self._channel] += np.where(effort, 0.0, signal)
        reference[:, :, n_s + self._channel] += np.where(effort, 0.0, rate)
        feedforward = self.hold[active] + forward
        feedforward += np.where(effort, signal, 0.0)[:, :, None] * self._push[active]
        x, commands = self.simulations.run(active, reference, feedforward)
        command = np.sum((commands - self.hold[active]) * self.read[active], axis=2)
        seen = list(self.outputs)
        return command, x[:, :, seen] - self._state[active][:, seen], commands
