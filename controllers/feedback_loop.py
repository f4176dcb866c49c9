"""The feedback loop, the only one: a law asked at every control instant for machines that run side by side.

What moves the machines is a `Stepper`: MuJoCo (mujoco_plant.py) or the reduced dynamics (rigid_plant.py). Nothing of a
machine depends on what runs beside it. One that diverges, or whose tracker fails, is frozen there and harms no other. This
file's job is speed.
"""

import time
from typing import Protocol

import numpy as np

from linkplan.controllers.divergence import divergence_expected
from linkplan.controllers.imperfections.sensing import Sensing, measure
from linkplan.controllers.trackers.tracker import TrackerWithMemory
from linkplan.models.errors import LinkplanError, ProblemError, one_line
from linkplan.models.interrupts import check

# MuJoCo calls a position or speed beyond this bad (mjMAXVAL).
LARGEST_STATE = 1e10


class Stepper(Protocol):
    """Machines that are moved on by control periods. The only mutable state of a simulation.

    `rows` are those that still run, a slice where all n do; `independent` the columns of a pose that a law is given.
    """

    n: int
    n_q: int
    n_s: int
    n_u: int
    rows: np.ndarray | slice
    independent: np.ndarray | slice
    lost: str  # why a machine's state is no number

    def read(self, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Fill in the poses (r, n_q) and velocities (r, n_s) of the machines that run."""
        ...

    def hold(self, command: np.ndarray, applied: np.ndarray, speed: np.ndarray) -> None:
        """Move the machines on by a period under commands (r, n_u), and fill in mean efforts and actuators' speeds."""
        ...

    def keep(self, running: np.ndarray) -> None:
        """Freeze all but some of the machines that run, by a mask (r,)."""
        ...


class LoopLog:
    """The log of n machines at t instants, NaN where a machine was frozen. Filled by `run_loop`."""

    def __init__(self, instants: int, n: int, n_q: int, n_s: int, n_u: int) -> None:
        # States and commands of an instant lie together: one sum of squares finds what is no number among them.
        self.instants = np.full((instants, n, n_q + n_s + n_u), np.nan)
        self.pose, self.velocity, self.commanded = np.split(self.instants, [n_q, n_q + n_s], axis=2)
        self.applied, self.speed = np.full((instants, n, n_u), np.nan), np.full((instants, n, n_u), np.nan)
        self.asked_s = np.full(instants, np.nan)
        self.done = np.full(n, instants)
        self.failure: list[str | None] = [None] * n
        self.error: list[BaseException | None] = [None] * n


@divergence_expected()
def run_loop(stepper: Stepper, law: TrackerWithMemory, instants: int, sensors: Sensing | None = None) -> LoopLog:
    """Return the log of a law over control instants, from where the machines stand on.

    Args:
        stepper: the machines, which are moved.
        law: asked for the machines that run, at instants from 0.
        instants: how many.
        sensors: of the machines that run; None where all states are measured as they are.
    """
    log = LoopLog(instants, stepper.n, stepper.n_q, stepper.n_s, stepper.n_u)
    memory = law.start(stepper.n)
    memory = memory if isinstance(stepper.rows, slice) else memory[stepper.rows]
    independent, n_u, bound, clock = stepper.independent, stepper.n_u, LARGEST_STATE**2, time.perf_counter
    logs = (log.pose, log.velocity, log.commanded, log.applied, log.speed)
    for k, (row, *logged) in enumerate(zip(log.instants.reshape(instants, -1), *logs, strict=True)):
        check()
        # What is logged is filled in where it stands; where some machines are frozen, beside it first.
        rows = stepper.rows
        here = logged if isinstance(rows, slice) else [one[rows] for one in logged]
        q, v, command, applied, speed = here
        stepper.read(q, v)
        s, rate = q[:, independent], v
        if sensors is not None:
            s, rate = measure(sensors, k, s, rate)
        begin = clock()
        asked, memory, failed = _asked(law, k, s, rate, memory, n_u)
        log.asked_s[k] = clock() - begin
        command[...] = asked
        # A sum of squares that is small and finite leaves no state or command beyond.
        if here is not logged or not row.dot(row) < bound:
            sound = (np.abs(q) < LARGEST_STATE).all(axis=1) & (np.abs(v) < LARGEST_STATE).all(axis=1)
            running = sound & np.isfinite(command).all(axis=1)
            if not running.all():
                for i in np.flatnonzero(~running):
                    machine = np.arange(stepper.n)[rows][i]
                    error = failed.get(int(i))
                    said = _said(error) if error else "the tracker gave an effort that is no number"
                    log.failure[machine], log.error[machine] = (said, error) if sound[i] else (stepper.lost, None)
                    log.done[machine] = k
                stepper.keep(running)
                rows = stepper.rows
                here = q, v, command, applied, speed = [one[running] for one in here]
                log.instants[k] = np.nan
                memory = memory[running]
                sensors = None if sensors is None else sensors.kept(running)
                if not len(q):
                    break
        stepper.hold(command, applied, speed)
        if here is not logged:
            for whole, part in zip(logged, here, strict=True):
                whole[rows] = part
    return log


def states_of(stepper: Stepper) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses (r, n_q) and velocities (r, n_s) of the machines that run."""
    n = len(np.arange(stepper.n)[stepper.rows])
    pose, velocity = np.empty((n, stepper.n_q)), np.empty((n, stepper.n_s))
    stepper.read(pose, velocity)
    return pose, velocity


def _asked(
    law: TrackerWithMemory, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray, n_u: int
) -> tuple[np.ndarray, np.ndarray, dict[int, BaseException]]:
    """Return efforts (n, n_u) and memories of machines, and what the tracker raised for some, whose efforts are NaN.

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
                return np.full((1, n_u), np.nan), memory, {0: error}
    # One after another: the others of the batch are not to suffer from what went wrong for one.
    rows = [slice(i, i + 1) for i in range(n)]
    each = [_asked(law, k, position[row], velocity[row], memory[row], n_u) for row in rows]
    failed = {i: raised[0] for i, (_, _, raised) in enumerate(each) if raised}
    return np.concatenate([one[0] for one in each]), np.concatenate([one[1] for one in each]), failed


def _said(error: BaseException) -> str:
    """Return an error, or its cause, in a line: the kind of one that is not linkplan's own is half of what it says."""
    error = error.__cause__ or error
    kind, said = type(error).__name__, one_line(error)
    words = said if isinstance(error, LinkplanError) else f"{kind}: {said}" if said else kind
    return f"the tracker failed: {words}"
