"""Machines in MuJoCo, stepped together with `mujoco.batch.Batch`. Written for speed.

A command is delayed, clipped to the actuators' limits and held while MuJoCo steps. Logs are identical to the last bit for
any number of machines and threads. Only this file and rigid_plant.py hold simulator state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from linkplan.controllers.imperfections.batch_effects import ClosureWatch, LoadForces, PushState, SiteForces, pushing, spread
from linkplan.controllers.imperfections.driving import DriveState, act, driving, stretches, take
from linkplan.controllers.imperfections.imperfections import Imperfections
from linkplan.controllers.imperfections.plant import ImperfectPlant, held_before, is_nominal, plant
from linkplan.controllers.imperfections.servos import servo_inversion, speed_gains
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.sampling import substeps_of
from linkplan.models.actuation.actuators import Actuator
from linkplan.models.actuation.distribution import distribute
from linkplan.models.errors import LinkplanError, one_line
from linkplan.models.external_forces import loads_of
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import is_redundant, sampled

DIVERGED = "the simulation diverged"
_STATE_KNOWN = int(mujoco.mjtStage.mjSTAGE_VEL)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MujocoPlant:
    """A mechanism in MuJoCo with the effort limits, delay and masses of a feedback loop, shared by all machines.

    `built` caches the machines of the last ensemble, so that several trackers can run on them.
    """

    mechanism: Mechanism
    loop: ControlLoop
    threads: int = 0  # of the simulator; 0 for one for each core
    built: dict[tuple[SampledReference, Imperfections], ImperfectPlant | str] = field(default_factory=dict)

    def begin(
        self, reference: SampledReference, machines: Sequence[Imperfections]
    ) -> tuple["MujocoStepper", list[str | None]]:
        """Return the machines at the start of a reference, and the reason for each that cannot be built, else None.

        The modelled plant replaces a machine that cannot be built.
        """
        mechanism, loop, substeps = self.mechanism, self.loop, substeps_of(self.mechanism, reference.period_s)
        neutral = next((one for one in machines if is_nominal(one)), Imperfections())
        keys = [(reference, neutral if is_nominal(one) else one) for one in machines]
        base = self._build(reference, neutral, substeps)
        if isinstance(base, str):
            raise LinkplanError(base)
        found = {key: self._build(*key, substeps) for key in keys}
        self.built.clear()
        self.built.update(found | {(reference, neutral): base})
        failure = [one if isinstance(one := found[key], str) else None for key in keys]
        plants = [base if isinstance(one := found[key], str) else one for key in keys]
        drives = driving(
            [one.drives for one in machines],
            [loop.delay_periods + one.clock.delay_periods for one in machines],
            [float(one.model.opt.timestep) for one in plants],
            substeps,
            loop.effort_limit,
            held_before(mechanism, reference, loop),
            line=loop.motor_line,
            slowest=loop.rate_limit,
        )
        stepper = MujocoStepper(
            mechanism, plants, drives, substeps, base=base, pushes=pushing(machines, plants, mechanism, substeps),
            gains=speed_gains(mechanism, reference, substeps), threads=self.threads, watched=True,
            begun=np.array([one.clock.phase_periods for one in machines]) * substeps,
        )  # fmt: skip
        return stepper, failure

    def _build(self, reference: SampledReference, one: Imperfections, substeps: int) -> ImperfectPlant | str:
        if (reference, one) in self.built:
            return self.built[reference, one]
        try:
            return plant(self.mechanism, reference, self.loop, one, substeps)
        except LinkplanError as error:
            return one_line(error)


class MujocoStepper:
    """Machines in MuJoCo that are advanced by control periods; see `Stepper`.

    Args:
        mechanism: the mechanism of all machines.
        plants: each machine's model and start.
        drives: the machines' drives.
        substeps: simulator steps per control period.
        base: the plant of all unmodified machines; default: the first plant.
        pushes: external forces on the machines, or None.
        gains: what the actuators' speeds (p, n_u) gain in a simulator step of each period, by the reference; default: 0.
        threads: simulator threads; 0 for one per core.
        watched: record closure gaps and contacts.
        begun: simulator steps (n,) since the motion's start, for forces over time; without it they do not act.
    """

    lost = DIVERGED

    def __init__(
        self,
        mechanism: Mechanism,
        plants: Sequence[ImperfectPlant],
        drives: DriveState,
        substeps: int,
        *,
        base: ImperfectPlant | None = None,
        pushes: PushState | None = None,
        gains: np.ndarray | None = None,
        threads: int = 0,
        watched: bool = False,
        begun: np.ndarray | None = None,
    ) -> None:
        models = [one.model for one in plants]
        model = models[0] if base is None else base.model
        self.n, self.n_u = len(plants), mechanism.n_u
        self.running = np.ones(self.n, dtype=bool)
        self.n_q, self.n_s, self.independent = mechanism.n_q, mechanism.dof, _columns(mechanism.independent)
        self.model, self.timestep_s = model, np.array([one.opt.timestep for one in models])
        self._mechanism, self._substeps, self._pushes, self._drives = mechanism, substeps, pushes, drives
        self._servos = servo_inversion(mechanism)
        self._gains = np.zeros((1, self.n_u)) if gains is None else gains
        self._redundant = is_redundant(mechanism)
        # A servo's ctrl and a motor's line need the actuators' speeds at the beginning of every step.
        by_speed = self._servos is not None or drives.line is not None
        timed, loaded = begun if mechanism.forces is not None else None, bool(loads_of(model))
        by_speed |= timed is not None or loaded  # which need the sites' places
        self._batch = Batch(model, nsim=self.n, nthread=threads, persistent=by_speed)
        spread(self._batch, model, models)
        bind = self._batch.bind
        self._qpos, self._qvel, self._ctrl, self._speeds = map(bind, ("qpos", "qvel", "ctrl", "actuator_velocity"))
        self._lengths = None if self._servos is None else bind("actuator_length")
        self._site_forces = None if timed is None else SiteForces(self._batch, mechanism, self.timestep_s, timed)
        self._loads = LoadForces(self._batch, model) if loaded else None
        if pushes is not None or timed is not None or loaded:
            self._forces, self._efforts = bind("xfrc_applied"), bind("qfrc_applied")
        self._watch = ClosureWatch(self._batch, models) if watched else None
        self._map_actuators(mechanism.actuators)
        self._ids: np.ndarray | None = None  # of the running machines; None for all
        # One by one: the rounding of ball joints' rotations must not depend on the other machines.
        self._first_qpos = np.array([mechanism.qpos_of(one.pose) for one in plants])
        self._first_qvel = np.array([mechanism.qvel_of(one.pose, one.rates) for one in plants])
        self._first = np.array([one.pose for one in plants])
        self._near, self._qpos[:], self._qvel[:] = self._first.copy(), self._first_qpos, self._first_qvel
        changing = pushes is not None or by_speed
        self._stretches = [(j, 1) for j in range(substeps)] if changing else stretches(drives, substeps)
        self._stage = 0
        if by_speed:
            self._stage = _STATE_KNOWN
            self._batch.forward(stage=_STATE_KNOWN)
        self.k = 0

    def _map_actuators(self, driven: Sequence[Actuator]) -> None:
        """Set the columns of the driven actuators, and ctrl = (effort - bias) scale with scale 1 and bias 0 for servos."""
        self._channels = _columns(np.array([actuator.channel for actuator in driven], dtype=int))
        self._outputs = _columns(np.array([actuator.output for actuator in driven], dtype=int))
        is_servo = [actuator.is_servo for actuator in driven]
        self._scale = 1.0 / np.where(is_servo, 1.0, [actuator.gain for actuator in driven])
        self._bias = np.where(is_servo, 0.0, [actuator.biases[0] for actuator in driven])
        self._direct = bool(np.all(self._scale == 1.0) and np.all(self._bias == 0.0)) and self._servos is None

    def under_way(self, commands: np.ndarray) -> None:
        """Set the commands (p, n, n_u) of the p periods before the start."""
        for command in commands:
            take(self._drives, self.k, command)
            self.k += 1

    def read(self, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Write the machines' poses and velocities."""
        mechanism = self._mechanism
        if mechanism.coordinates.trivial:
            pose[...], velocity[...] = self._qpos, self._qvel[:, self.independent]
            return
        for i, (qpos, qvel) in enumerate(zip(self._qpos, self._qvel, strict=True)):
            pose[i] = mechanism.q_of(qpos, self._near[i])
            velocity[i] = mechanism.rates_of(pose[i], qvel)[self.independent]
        self._near[:] = pose

    def share(self, pose: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Return the commands (n, n_u) within limits that produce the generalised efforts of commands beyond them.

        Only more actuators than freedoms can; other commands stay.
        """
        low, high = self._drives.low, self._drives.high
        beyond = np.flatnonzero(np.any((command < low) | (command > high), axis=1)) if self._redundant else ()
        if not len(beyond):
            return command
        maps, shared = sampled(self._mechanism.dynamics.effort_map, pose[beyond]), command.copy()
        tau, limit = np.einsum("ksu,ku->ks", maps, command[beyond]), np.stack([low, high], axis=1)
        shared[beyond] = distribute(tau, maps, limit, command[beyond])
        return shared

    def hold(self, command: np.ndarray, applied: np.ndarray, speed: np.ndarray) -> None:
        """Advance the machines by a period under commands; `speed` receives the actuators' speeds at its start."""
        drives, k, servos = self._drives, self.k, self._servos
        take(drives, k, command)
        beyond: np.ndarray | float = 0.0
        for j, count in self._stretches:
            rate = self._speeds[:, self._outputs] if self._stage else None
            effort = ctrl = act(drives, k, j, rate)
            if self._stage and j == 0:  # a later step overwrites them
                speed[...] = rate
            if servos is not None:
                length = self._lengths[:, self._outputs]
                at_the_end = rate + self._gains[min(k, len(self._gains) - 1)]
                ctrl, effort = servos.controls(effort, length, at_the_end)
                effort = np.minimum(np.maximum(effort, drives.clamp[..., 0]), drives.clamp[..., 1])
            elif not self._direct:
                ctrl = (effort - self._bias) * self._scale
            self._ctrl[:, self._channels] = ctrl
            if self._pushes is not None:
                self._forces[:], self._efforts[:] = self._pushes.over(k * self._substeps + j)
            elif self._site_forces is not None or self._loads is not None:
                self._forces[:], self._efforts[:] = 0.0, 0.0
            if self._site_forces is not None:
                self._site_forces.add(k * self._substeps + j, self._forces)
            if self._loads is not None:
                self._loads.add(self._forces, self._efforts)
            self._batch.step(self._ids, count, self._stage)
            self.note_step()
            if j:
                beyond = beyond + count * (effort - applied)
                continue
            applied[...] = effort
            if not self._stage:
                speed[...] = self._speeds[:, self._outputs]
        if len(self._stretches) > 1:  # a constant effort stays exact
            applied += beyond / self._substeps
        self.k += 1
        if self._watch is not None:
            self._watch.note()

    def note_step(self) -> None:
        """Note what is lost between control instants, after every stretch of simulator steps: nothing here."""

    def freeze(self, lost: np.ndarray) -> None:
        """Put the machines of a mask (n,) back to their starts, where they stay."""
        self.running = self.running & ~lost
        self._ids = None if self.running.all() else np.flatnonzero(self.running)
        self._qpos[lost], self._qvel[lost], self._near[lost] = (
            first[lost] for first in (self._first_qpos, self._first_qvel, self._first)
        )

    def gap_and_contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Return each machine's largest gap [m] of tied points and largest number of contacts so far, (n,) each."""
        assert self._watch is not None
        return self._watch.largest()


def simulation_conditions(model: mujoco.MjModel) -> dict[str, Any]:
    """Return the simulator settings: version, step, integrator and the loop constraints' softness."""
    active = [index for index in range(model.neq) if model.eq_active0[index]]
    return {
        "mujoco": mujoco.__version__,
        "timestep_s": float(model.opt.timestep),
        "integrator": mujoco.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_"),
        "solref": [model.eq_solref[index].tolist() for index in active],
        "solimp": [model.eq_solimp[index].tolist() for index in active],
    }


def _columns(index: np.ndarray) -> np.ndarray | slice:
    """Return consecutive indices as a slice, which avoids copies, and others unchanged."""
    first = int(index[0])
    return slice(first, first + len(index)) if np.array_equal(index, first + np.arange(len(index))) else index
