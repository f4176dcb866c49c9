"""Many machines under one tracker in MuJoCo, each with imperfections of its own. This file's job is speed.

The loop is that of `rollout.run`, stepped for all simulations together on `mujoco.batch.Batch`. Nothing of a simulation
depends on what runs beside it: the logs are the same to the last bit at any batch size and number of threads. One that
diverges, or whose tracker fails, is frozen there and harms no other. Beside rollout.py and batch.py the only file that holds
simulator state.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from linkplan.controllers.divergence import divergence_expected
from linkplan.controllers.imperfections.driving import act, driving, take
from linkplan.controllers.imperfections.gaping import gaps
from linkplan.controllers.imperfections.imperfections import Imperfections
from linkplan.controllers.imperfections.plant import Plant, as_modelled, plant
from linkplan.controllers.imperfections.pushing import pushing
from linkplan.controllers.imperfections.sensing import measure, sensing
from linkplan.controllers.imperfections.servos import refuse_unfit, servo_ranges
from linkplan.controllers.imperfections.spreading import spread
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.trackers.linear import added
from linkplan.controllers.trackers.stepping import steps_of
from linkplan.controllers.trackers.tracker import AnyTracker, TrackerWithMemory
from linkplan.models.errors import LinkplanError, ProblemError, one_line
from linkplan.models.interrupts import check
from linkplan.models.mechanism import Mechanism

# MuJoCo calls a position or speed beyond this bad (mjMAXVAL).
_BAD = 1e10
DIVERGED = "the simulation diverged"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Ensemble:
    """The logs of n simulations at their control instants, time first: (t, n, ...); NaN after a simulation was frozen.

    `time_s` (t, n) is each one's true time; `pose` (t, n, n_q) and `velocity` (t, n, n_s) [rad or m, and per second] are its
    true states; `commanded` is the tracker's output, `applied` the mean of what acted in the period, both (t, n, n_u)
    [N.m or N]; `power` (t, n) [W] the actuators' mechanical power, each one's size taken; `gap_m` (n,) the largest distance
    that ever was between two points that a closure ties. `done` (n,) counts the logged instants; `failure` says why one was
    frozen.
    """

    tracker: str
    time_s: np.ndarray
    pose: np.ndarray
    velocity: np.ndarray
    commanded: np.ndarray
    applied: np.ndarray
    power: np.ndarray
    gap_m: np.ndarray
    done: np.ndarray
    failure: tuple[str | None, ...]
    timestep_s: np.ndarray


def bytes_each(mechanism: Mechanism, instants: int) -> int:
    """Return the memory that the log of one simulation takes."""
    return 8 * instants * (2 + mechanism.n_q + mechanism.dof + 2 * mechanism.n_u)


@divergence_expected()
def run_ensemble(
    mechanism: Mechanism,
    reference: SampledReference,
    tracker: AnyTracker,
    loop: ControlLoop,
    machines: Sequence[Imperfections],
    threads: int = 0,
) -> Ensemble:
    """Return the logs of a tracker on many machines over the whole reference.

    Args:
        mechanism: as the tracker believes the machine to be.
        reference: the motion, sampled.
        tracker: the law; one that knows single states only is asked for each.
        loop: limits, whole periods of delay and a factor on masses that all machines share.
        machines: what is wrong with each.
        threads: of the simulator; 0 for one for each core.

    A machine that cannot be built is one that failed before its first instant.

    Raises:
        ModelError: for a mechanism that batches cannot simulate.
    """
    refuse_unfit(mechanism)
    substeps = max(1, int(np.ceil(reference.period_s / float(mechanism.model.opt.timestep) - 1e-9)))
    base = plant(mechanism, reference, loop, Imperfections(), substeps)
    log = _Log(mechanism, reference.n, len(machines))
    plants = []
    for i, one in enumerate(machines):
        try:
            plants.append(base if as_modelled(one) else plant(mechanism, reference, loop, one, substeps))
        except LinkplanError as error:
            log.failure[i], log.done[i] = one_line(error), 0
            plants.append(base)
    _simulate(log, mechanism, reference, steps_of(tracker), loop, machines, base.model, plants, substeps, threads)
    clocks = [one.clock for one in machines]
    start = np.array([clock.phase_periods for clock in clocks])
    period = np.array([clock.period_factor for clock in clocks]) * reference.period_s
    return Ensemble(
        tracker=tracker.name,
        time_s=(np.arange(reference.n)[:, None] + start) * period,
        pose=log.pose,
        velocity=log.velocity,
        commanded=log.commanded,
        applied=log.applied,
        power=log.power,
        gap_m=np.sqrt(log.gap_squared),
        done=log.done,
        failure=tuple(log.failure),
        timestep_s=np.array([one.model.opt.timestep for one in plants]),
    )


class _Log:
    """The arrays that a simulation fills. Mutable, and gone when it ends."""

    def __init__(self, mechanism: Mechanism, t: int, n: int) -> None:
        self.pose = np.full((t, n, mechanism.n_q), np.nan)
        self.velocity = np.full((t, n, mechanism.dof), np.nan)
        self.commanded, self.applied = (np.full((t, n, mechanism.n_u), np.nan) for _ in range(2))
        self.power = np.full((t, n), np.nan)
        self.gap_squared = np.zeros(n)
        self.done = np.full(n, t)
        self.failure: list[str | None] = [None] * n


def _simulate(
    log: _Log,
    mechanism: Mechanism,
    reference: SampledReference,
    law: TrackerWithMemory,
    loop: ControlLoop,
    machines: Sequence[Imperfections],
    base: mujoco.MjModel,
    plants: Sequence[Plant],
    substeps: int,
    threads: int,
) -> None:
    n, independent = len(plants), _columns(mechanism.independent)
    actuators = mechanism.actuators
    channels = _columns(np.array([actuator.channel for actuator in actuators], dtype=int))
    outputs = _columns(np.array([actuator.output for actuator in actuators], dtype=int))
    scale = 1.0 / np.array([1.0 if actuator.is_servo else actuator.gain for actuator in actuators])
    bias = np.array([0.0 if actuator.is_servo else actuator.biases[0] for actuator in actuators])
    ranges = servo_ranges(mechanism)
    batch = Batch(base, nsim=n, nthread=threads or min(n, os.cpu_count() or 1))
    spread(batch, base, [one.model for one in plants])
    qpos, qvel, ctrl, speeds = (batch.bind(name) for name in ("qpos", "qvel", "ctrl", "actuator_velocity"))
    gap_now = gaps(batch, [one.model for one in plants])
    pushes = pushing(machines, plants, mechanism, substeps)
    forces, efforts = (None, None) if pushes is None else (batch.bind("xfrc_applied"), batch.bind("qfrc_applied"))
    read = _reader(mechanism, independent)
    qpos[:] = [mechanism.qpos_of(one.pose) for one in plants]
    qvel[:] = [mechanism.qvel_of(one.pose, one.rates) for one in plants]

    timesteps = [float(one.model.opt.timestep) for one in plants]
    delays = [loop.delay_periods + one.clock.delay_periods for one in machines]
    drives = driving([one.drives for one in machines], delays, timesteps, substeps, loop.effort_limit)
    q, v = read(qpos, qvel, np.array([one.pose for one in plants]))
    sensors = sensing([one.sensors for one in machines], q[:, independent], v, reference.period_s)
    memory = law.start(n)
    ids: np.ndarray | None = None  # of the simulations that run; None for all
    rows: np.ndarray | slice = slice(None)
    built = np.array([failure is None for failure in log.failure])
    if not built.all():
        ids = rows = np.flatnonzero(built)
        memory, sensors, drives, q = memory[built], sensors.kept(built), drives.kept(built), q[built]
        pushes = None if pushes is None else pushes.kept(built)
        if not len(ids):
            return
    for k in range(reference.n):
        check()
        q, v = read(qpos[rows], qvel[rows], q)
        x = q[:, independent]
        s, s_rate, sensors = measure(sensors, k, x, v)
        command, memory, failed = _asked(law, k, s, s_rate, memory, len(actuators))
        if not (np.abs(x).max() < _BAD and np.abs(v).max() < _BAD and np.isfinite(command.sum())):
            sound = (np.abs(x) < _BAD).all(axis=1) & (np.abs(v) < _BAD).all(axis=1)
            fine = sound & np.isfinite(command).all(axis=1)
            here = np.arange(n) if ids is None else ids
            for i in np.flatnonzero(~fine):
                said = failed.get(int(i), "the tracker gave an effort that is no number")
                log.failure[here[i]] = said if sound[i] else DIVERGED
                log.done[here[i]] = k
            ids = rows = here[fine]
            if not len(ids):
                return
            q, v, command, memory = q[fine], v[fine], command[fine], memory[fine]
            sensors, drives = sensors.kept(fine), drives.kept(fine)
            pushes = None if pushes is None else pushes.kept(fine)
        log.pose[k, rows], log.velocity[k, rows], log.commanded[k, rows] = q, v, command
        drives = take(drives, k, command)
        acted, speed = 0.0, v
        for j in range(substeps):
            effort, drives = act(drives, k, j)
            if ranges is not None:
                effort = ranges.within(effort, qpos[rows], qvel[rows])
            _put(ctrl, rows, channels, (effort - bias) * scale)
            if pushes is not None:
                forces[rows], efforts[rows] = pushes.over(k * substeps + j)
            batch.step(ids=ids)
            acted = effort if j == 0 else acted + effort
            if j == 0:
                speed = speeds[rows][:, outputs].copy()
        mean = acted / substeps if substeps > 1 else acted
        log.applied[k, rows] = mean
        log.power[k, rows] = added(np.abs(mean * speed))
        log.gap_squared[rows] = np.fmax(log.gap_squared[rows], gap_now(rows))


def _reader(
    mechanism: Mechanism, independent: np.ndarray | slice
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return the function of qpos (n, nq), qvel (n, nv) and poses before (n, n_q) to poses and rates (n, n_s)."""
    if mechanism.coordinates.trivial:
        return lambda qpos, qvel, _: (qpos.copy(), qvel[:, independent].copy())

    def read(qpos: np.ndarray, qvel: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # One after another: rounding of ball joints' rotations must not depend on what stands beside them.
        q = np.array([mechanism.q_of(one, near) for one, near in zip(qpos, before, strict=True)])
        return q, np.array([mechanism.rates_of(*one) for one in zip(q, qvel, strict=True)])[:, independent]

    return read


def _asked(
    law: TrackerWithMemory, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray, n_u: int
) -> tuple[np.ndarray, np.ndarray, dict[int, str]]:
    """Return efforts (n, n_u) and memories of simulations, and why the tracker failed for some, whose efforts are NaN.

    A law that says `batched = False` is asked for one state after the other, and never twice for one instant: what it
    keeps in itself, where it does, goes on by one instant each time.
    """
    n = len(position)
    if n == 1 or getattr(law, "batched", True):
        try:
            effort, after = law.step(k, position, velocity, memory)
            effort = np.asarray(effort, dtype=float)
            if effort.shape != (n, n_u):
                raise ProblemError(f"it gave efforts of shape {effort.shape[1:]}, not one for each of {n_u} actuators")
            if len(after) != n:
                raise ProblemError(f"it gave a memory of {len(after)} rows for {n} simulations")
            return effort, after, {}
        except (Exception, SystemExit) as error:  # a user's law may raise anything
            if n == 1:
                return np.full((1, n_u), np.nan), memory, {0: f"the tracker failed: {_words(error)}"}
    # One after another: the others of the batch are not to suffer from what went wrong for one.
    rows = [slice(i, i + 1) for i in range(n)]
    each = [_asked(law, k, position[row], velocity[row], memory[row], n_u) for row in rows]
    failed = {i: said[0] for i, (_, _, said) in enumerate(each) if said}
    return np.concatenate([one[0] for one in each]), np.concatenate([one[1] for one in each]), failed


def _words(error: BaseException) -> str:
    """Return an error, or its cause, in a line: the kind of one that is not linkplan's own is half of what it says."""
    error = error.__cause__ or error
    kind, said = type(error).__name__, one_line(error)
    return said if isinstance(error, LinkplanError) else f"{kind}: {said}" if said else kind


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
