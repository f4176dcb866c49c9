"""Many closed loops at once in MuJoCo: one law each, stepped together on `mujoco.batch.Batch`. This file's job is speed.

Every simulation is the same mechanism about its own pose, with its own gain, reference and feedforward:

    u_k = u_ff + K (x_ref - x_k),   x = (s, v),

delayed, cut at the actuators' limits and held, as `rollout.run` does for one. Beside rollout.py the only file that holds
simulator state.
"""

import copy
import os

import mujoco
import numpy as np
from mujoco.batch import Batch

from linkplan.controllers.divergence import divergence_expected
from linkplan.controllers.imperfections.servos import as_motors, refuse_unfit, servo_bias, servo_ranges
from linkplan.controllers.rollout import admit
from linkplan.controllers.sampling import Sampling
from linkplan.models.errors import ModelError
from linkplan.models.interrupts import check
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates


class BatchControlLoop:
    """Closed loops in MuJoCo. Mutable: every `run` advances the simulations named by some control periods.

    Args:
        mechanism: the mechanism of all simulations.
        pose: closed poses (n, n_q) to start from.
        velocity: independent rates (n, n_s) to start with.
        gain: K (n, n_u, 2 n_s).
        first_effort: commands (n, n_u) taken to be under way at the start, where the loop has a delay.
        timing: period, simulator steps, delay.
        effort_limit: (n_u, 2) [N.m or N].
        threads: of the simulator; 0 for one for each core.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        *,
        pose: np.ndarray,
        velocity: np.ndarray,
        gain: np.ndarray,
        first_effort: np.ndarray,
        timing: Sampling,
        effort_limit: np.ndarray,
        threads: int = 0,
    ) -> None:
        if not mechanism.coordinates.trivial:
            raise ModelError(
                f"mechanism '{mechanism.name}': batches of simulations run on hinges and slides only; it has ball or free"
                " joints"
            )
        refuse_unfit(mechanism)
        self._servo = servo_bias(mechanism)
        self._ranges = servo_ranges(mechanism)
        model = copy.deepcopy(mechanism.model)
        model.opt.timestep = timing.timestep_s
        # A blow-up stays visible: MuJoCo would start such a simulation anew from its reference pose.
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        for actuator, (low, high) in zip(mechanism.actuators, effort_limit, strict=True):
            admit(model, actuator, low, high)
        if self._servo is None:  # a motor's step is then a servo's
            as_motors(model, mechanism)
        self.n, self.timing, self.k = len(pose), timing, 0
        self.gain = np.array(gain)
        self.limit = np.array(effort_limit)
        self._model = model
        self._independent = mechanism.independent
        self._channels = np.array([actuator.channel for actuator in mechanism.actuators], dtype=int)
        motors = [actuator.is_servo and self._servo is None for actuator in mechanism.actuators]
        self._bias = np.where(motors, 0.0, [actuator.biases[0] for actuator in mechanism.actuators])
        self._per_ctrl = np.where(motors, 1.0, [actuator.gain for actuator in mechanism.actuators])
        self._batch = Batch(model, nsim=self.n, nthread=threads or min(self.n, os.cpu_count() or 1))
        self._qpos, self._qvel, self._ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self._qpos[:] = pose
        self._qvel[:] = joint_rates(mechanism, np.asarray(pose), np.asarray(velocity))
        self.queue = np.repeat(np.asarray(first_effort, dtype=float)[:, None], timing.memory, axis=1)  # oldest overwritten

    def state(self, ids: np.ndarray) -> np.ndarray:
        """Return x = (s, v) (len(ids), 2 n_s) of simulations now."""
        columns = self._independent
        return np.concatenate([self._qpos[np.ix_(ids, columns)], self._qvel[np.ix_(ids, columns)]], axis=1)

    def poses(self) -> np.ndarray:
        """Return every joint's position (n, n_q) now."""
        return np.array(self._qpos)

    def conditions(self) -> dict:
        """Return what a result depends on: version, step, integrator and the loop constraints' softness."""
        model = self._model
        active = [index for index in range(model.neq) if model.eq_active0[index]]
        return {
            "mujoco": mujoco.__version__,
            "timestep_s": self.timing.timestep_s,
            "integrator": mujoco.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_"),
            "solref": [model.eq_solref[index].tolist() for index in active],
            "solimp": [model.eq_solimp[index].tolist() for index in active],
            "control_period_s": self.timing.period_s,
            "delay_s": self.timing.delay_s,
        }

    @divergence_expected()
    def run(
        self, ids: np.ndarray, reference: np.ndarray, feedforward: np.ndarray, gain: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Advance simulations by t control periods; one once left out stays out.

        Args:
            ids: which simulations (r,).
            reference: x_ref (t, r, 2 n_s) at these instants.
            feedforward: u_ff (t, r, n_u) for their holds.
            gain: K (t, n_u, 2 n_s) of all simulations at these instants, in place of their own.

        Returns:
            The measured states (t, r, 2 n_s) and the commands (t, r, n_u), before delay and limits.
        """
        timing, n_u = self.timing, len(self._channels)
        gains = np.broadcast_to(self.gain[ids], (len(reference), len(ids), n_u, reference.shape[2]))
        if gain is not None:
            gains = np.broadcast_to(gain[:, None], gains.shape)
        drive = feedforward + np.matmul(gains, reference[:, :, :, None])[:, :, :, 0]
        at_joints = np.ix_(ids, self._independent)
        qpos, qvel, queue, n_s = self._qpos, self._qvel, self.queue, len(self._independent)
        states, commands = np.empty((len(drive), len(ids), 2 * n_s)), np.empty((len(drive), len(ids), n_u))
        p, d, late = timing.memory, timing.whole, timing.late
        for t in range(len(drive)):
            check()
            x = states[t]
            x[:, :n_s], x[:, n_s:] = qpos[at_joints], qvel[at_joints]
            command = np.subtract(drive[t], np.matmul(gains[t], x[:, :, None])[:, :, 0], out=commands[t])
            acting, before = command, None
            if p:
                # Slot k mod memory holds u_{k-memory} until u_k takes its place.
                if d:
                    acting = queue[ids, (self.k - d) % p]
                if late:
                    before = queue[ids, (self.k - d - 1) % p]
                queue[ids, self.k % p] = command
            if before is not None:
                self._step(ids, before, late)
            self._step(ids, acting, timing.substeps - late)
            self.k += 1
        return states, commands

    def _step(self, ids: np.ndarray, effort: np.ndarray, steps: int) -> None:
        """Step simulations under held efforts (r, n_u), within their limits."""
        at_ctrl, everyone = np.ix_(ids, self._channels), None if len(ids) == self.n else ids
        effort = np.clip(effort, *self.limit.T)
        if self._servo is None and self._ranges is None:
            self._ctrl[at_ctrl] = (effort - self._bias) / self._per_ctrl
            self._batch.step(ids=everyone, nstep=steps)
            return
        for _ in range(steps):
            qpos, qvel = self._qpos[ids], self._qvel[ids]
            within = effort if self._ranges is None else self._ranges.within(effort, qpos, qvel)
            moved = 0.0 if self._servo is None else qpos @ self._servo[0].T + qvel @ self._servo[1].T
            self._ctrl[at_ctrl] = (within - moved - self._bias) / self._per_ctrl
            self._batch.step(ids=everyone, nstep=1)
