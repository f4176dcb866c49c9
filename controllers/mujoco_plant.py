"""Machines in MuJoCo, moved on together on `mujoco.batch.Batch`. This file's job is speed.

A command is delayed, cut at the actuators' limits and held while MuJoCo steps; logs are the same to the last bit at any
number of machines and threads. Beside rigid_plant.py the only file that holds simulator state.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from linkplan.controllers.imperfections.driving import Driving, act, driving, stretches, take
from linkplan.controllers.imperfections.gaping import ClosureWatch
from linkplan.controllers.imperfections.imperfections import Imperfections
from linkplan.controllers.imperfections.plant import Plant, as_modelled, plant
from linkplan.controllers.imperfections.pushing import Pushing, pushing
from linkplan.controllers.imperfections.servos import servo_inversion
from linkplan.controllers.imperfections.spreading import spread
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop
from linkplan.models.errors import LinkplanError, one_line
from linkplan.models.mechanism import Mechanism

DIVERGED = "the simulation diverged"
_STATE_KNOWN = int(mujoco.mjtStage.mjSTAGE_VEL)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MujocoPlant:
    """A mechanism in MuJoCo with a feedback loop's limits, delay and masses, which all its machines share.

    `built` keeps the machines of the last ensemble: the trackers that run on them one after another share them.
    """

    mechanism: Mechanism
    loop: ControlLoop
    threads: int = 0  # of the simulator; 0 for one for each core
    built: dict[tuple[SampledReference, Imperfections], Plant | str] = field(default_factory=dict)

    @property
    def measured(self) -> np.ndarray:
        """The columns of a pose that a law is given."""
        return self.mechanism.independent

    def begin(
        self, reference: SampledReference, machines: Sequence[Imperfections]
    ) -> tuple["MujocoStepper", list[str | None]]:
        """Return the machines at the start of a reference, and why some cannot be built, which stand in for themselves."""
        mechanism, loop, substeps = self.mechanism, self.loop, substeps_of(self.mechanism, reference.period_s)
        neutral = next((one for one in machines if as_modelled(one)), Imperfections())
        keys = [(reference, neutral if as_modelled(one) else one) for one in machines]
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
        )
        stepper = MujocoStepper(
            mechanism, plants, drives, substeps, base=base, pushes=pushing(machines, plants, mechanism, substeps),
            threads=self.threads, watched=True,
        )  # fmt: skip
        return stepper, failure

    def _build(self, reference: SampledReference, one: Imperfections, substeps: int) -> Plant | str:
        if (reference, one) in self.built:
            return self.built[reference, one]
        try:
            return plant(self.mechanism, reference, self.loop, one, substeps)
        except LinkplanError as error:
            return one_line(error)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PlantAsItStands:
    """A model as its file stands: from its own reference pose, open loops, contacts and all, at its own step.

    `mechanism` is for the model, its joints and its first actuator, which drives a joint; its assembly is not used.
    `idle_ctrl` holds constant controls of other actuators, by MuJoCo's index of the control.
    """

    mechanism: Mechanism
    idle_ctrl: Mapping[int, float]

    @property
    def loop(self) -> ControlLoop:
        """The first actuator's own limits, without delay."""
        return ControlLoop(effort_limit=self.mechanism.effort_limit[:1])

    @property
    def measured(self) -> np.ndarray:
        """The column of a pose that a law is given, that of the first actuator's joint."""
        return np.array([self.mechanism.actuators[0].joint])

    def begin(
        self, reference: SampledReference, machines: Sequence[Imperfections]
    ) -> tuple["MujocoStepper", list[str | None]]:
        """Return the model as many times as there are machines, whose imperfections it does not know.

        Raises:
            LinkplanError: when the first actuator drives no joint.
        """
        mechanism, n = self.mechanism, len(machines)
        actuator, model, data = mechanism.actuators[0], mechanism.model, mujoco.MjData(mechanism.model)
        if actuator.joint is None:
            raise LinkplanError(f"the first actuator, {actuator.name}, is to drive a joint; it acts on {actuator.target}")
        pose = mechanism.q_of(data.qpos)
        one = Plant(model=model, pose=pose, rates=np.zeros(mechanism.n_q))
        periods = [reference.period_s] * n
        drives = driving([machine.drives for machine in machines], [0.0] * n, periods, 1, self.loop.effort_limit)
        stepper = MujocoStepper(mechanism, [one] * n, drives, 1, watched=True, actuators=1, independent=self.measured)
        for index, value in self.idle_ctrl.items():
            stepper.ctrl[:, index] = value
        return stepper, [None] * n


class MujocoStepper:
    """Machines in MuJoCo that are moved on by control periods; see `Stepper`.

    Args:
        mechanism: of all machines.
        plants: each machine's model and start.
        drives: of the machines.
        substeps: simulator steps of a control period.
        base: the plant that all machines without differences share; the first by default.
        pushes: on the machines, or None.
        threads: of the simulator; 0 for one for each core.
        watched: whether closure gaps and contacts are wanted.
        actuators: how many of the mechanism's first actuators are driven; all by default.
        independent: the columns of a pose that a law is given; the independent coordinates by default.
    """

    lost = DIVERGED

    def __init__(
        self,
        mechanism: Mechanism,
        plants: Sequence[Plant],
        drives: Driving,
        substeps: int,
        *,
        base: Plant | None = None,
        pushes: Pushing | None = None,
        threads: int = 0,
        watched: bool = False,
        actuators: int | None = None,
        independent: np.ndarray | None = None,
    ) -> None:
        models = [one.model for one in plants]
        model = models[0] if base is None else base.model
        driven = mechanism.actuators[:actuators]
        self.n, self.n_u, self.rows = len(plants), len(driven), slice(None)
        self.n_q, self.n_s = mechanism.n_q, len(mechanism.independent if independent is None else independent)
        self.independent = _columns(mechanism.independent if independent is None else independent)
        self.model, self.timestep_s = model, np.array([one.opt.timestep for one in models])
        self._mechanism, self._substeps, self._pushes, self._drives = mechanism, substeps, pushes, drives
        self._servos = servo_inversion(mechanism) if actuators is None else None
        self._batch = Batch(
            model, nsim=self.n, nthread=threads or min(self.n, os.cpu_count() or 1), persistent=self._servos is not None
        )
        spread(self._batch, model, models)
        bind = self._batch.bind
        self._qpos, self._qvel, self.ctrl, self._speeds = (
            bind(name) for name in ("qpos", "qvel", "ctrl", "actuator_velocity")
        )
        self._lengths = None if self._servos is None else bind("actuator_length")
        if pushes is not None:
            self._forces, self._efforts = bind("xfrc_applied"), bind("qfrc_applied")
        self._watch = ClosureWatch(self._batch, models) if watched else None
        self._channels = _columns(np.array([actuator.channel for actuator in driven], dtype=int))
        self._outputs = _columns(np.array([actuator.output for actuator in driven], dtype=int))
        as_servo = [actuator.is_servo for actuator in driven]
        self._scale = 1.0 / np.where(as_servo, 1.0, [actuator.gain for actuator in driven])
        self._bias = np.where(as_servo, 0.0, [actuator.biases[0] for actuator in driven])
        self._direct = bool(np.all(self._scale == 1.0) and np.all(self._bias == 0.0)) and self._servos is None
        self._ids: np.ndarray | None = None  # of those that run; None for all
        self._near = np.array([one.pose for one in plants])
        self._qpos[:] = [mechanism.qpos_of(one.pose) for one in plants]
        self._qvel[:] = [mechanism.qvel_of(one.pose, one.rates) for one in plants]
        self._stage = 0
        if self._servos is not None:
            self._stage = _STATE_KNOWN
            self._batch.forward(stage=_STATE_KNOWN)
        changing = pushes is not None or self._servos is not None
        self._stretches = [(j, 1) for j in range(substeps)] if changing else stretches(drives, substeps)
        self.k = 0

    def under_way(self, commands: np.ndarray) -> None:
        """Let commands (p, n, n_u) have been given in the p periods before the start."""
        for command in commands:
            take(self._drives, self.k, command)
            self.k += 1

    def read(self, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Fill in poses and velocities of the machines that run."""
        mechanism, rows = self._mechanism, self.rows
        if mechanism.coordinates.trivial:
            pose[...], velocity[...] = self._qpos[rows], self._qvel[rows][:, self.independent]
            return
        # One after another: rounding of ball joints' rotations must not depend on what stands beside them.
        for i, (qpos, qvel) in enumerate(zip(self._qpos[rows], self._qvel[rows], strict=True)):
            pose[i] = mechanism.q_of(qpos, self._near[i])
            velocity[i] = mechanism.rates_of(pose[i], qvel)[self.independent]
        self._near = pose.copy()

    def hold(self, command: np.ndarray, applied: np.ndarray, speed: np.ndarray) -> None:
        """Move the machines on by a period under commands; speeds are those at its start."""
        drives, k, rows, servos = self._drives, self.k, self.rows, self._servos
        take(drives, k, command)
        beyond: np.ndarray | float = 0.0
        for j, count in self._stretches:
            effort = ctrl = act(drives, k, j)
            if servos is not None:
                length, rate = self._lengths[rows][:, self._outputs], self._speeds[rows][:, self._outputs]
                ctrl, effort = servos.controls(effort, length, rate)
                effort = np.minimum(np.maximum(effort, drives.clamp[..., 0]), drives.clamp[..., 1])
                if j == 0:  # MuJoCo works them out anew after a step
                    speed[...] = rate
            elif not self._direct:
                ctrl = (effort - self._bias) * self._scale
            _put(self.ctrl, rows, self._channels, ctrl)
            if self._pushes is not None:
                self._forces[rows], self._efforts[rows] = self._pushes.over(k * self._substeps + j)
            self._batch.step(self._ids, count, self._stage)
            if j:
                beyond = beyond + count * (effort - applied)
                continue
            applied[...] = effort
            if servos is None:
                speed[...] = self._speeds[rows][:, self._outputs]
        if len(self._stretches) > 1:  # a held effort is its own mean, to the last bit
            applied += beyond / self._substeps
        self.k += 1
        if self._watch is not None:
            self._watch.note()

    def keep(self, running: np.ndarray) -> None:
        """Freeze all but some of the machines that run."""
        self.rows = self._ids = np.arange(self.n)[self.rows][running]
        self._near = self._near[running]
        self._drives = self._drives.kept(running)
        self._pushes = None if self._pushes is None else self._pushes.kept(running)

    def gap_and_contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest gap [m] of tied points and the most contacts (n,) of each machine so far."""
        assert self._watch is not None
        return self._watch.largest()


def substeps_of(mechanism: Mechanism, period_s: float) -> int:
    """Return the fewest simulator steps of a control period [s] that the model's own step allows."""
    return max(1, int(np.ceil(period_s / float(mechanism.model.opt.timestep) - 1e-9)))


def simulation_conditions(model: mujoco.MjModel) -> dict[str, Any]:
    """Return what a result depends on beside the loop: version, step, integrator and the loop constraints' softness."""
    active = [index for index in range(model.neq) if model.eq_active0[index]]
    return {
        "mujoco": mujoco.__version__,
        "timestep_s": float(model.opt.timestep),
        "integrator": mujoco.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_"),
        "solref": [model.eq_solref[index].tolist() for index in active],
        "solimp": [model.eq_solimp[index].tolist() for index in active],
    }


def _columns(index: np.ndarray) -> np.ndarray | slice:
    """Return indices as a slice where they follow one another, which needs no copy."""
    first = int(index[0])
    return slice(first, first + len(index)) if np.array_equal(index, first + np.arange(len(index))) else index


def _put(array: np.ndarray, rows: np.ndarray | slice, columns: np.ndarray | slice, values: np.ndarray) -> None:
    """Write values (r, c) into an array's rows and columns."""
    if isinstance(rows, slice) or isinstance(columns, slice):
        array[rows, columns] = values
    else:
        array[np.ix_(rows, columns)] = values
