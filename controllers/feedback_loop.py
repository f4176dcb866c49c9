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
    n_u: int
    rows: np.ndarray | slice
    independent: np.ndarray | slice
    lost: str  # why a machine's state is no number

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of the poses (r, n_q) and velocities (r, n_s) of the machines that run."""
        ...

    def hold(self, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Move the machines on by a period under commands (r, n_u); return mean efforts and actuator speeds (r, n_u)."""
        ...

    def keep(self, running: np.ndarray) -> None:
        """Freeze all but some of the machines that run, by a mask (r,)."""
        ...


class LoopLog:
    """The log of n machines at t instants, NaN where a machine was frozen. Filled by `run_loop`."""

    def __init__(self, instants: int, n: int, n_q: int, n_s: int, n_u: int) -> None:
        self.pose, self.velocity = np.full((instants, n, n_q), np.nan), np.full((instants, n, n_s), np.nan)
        self.commanded, self.applied, self.speed = (np.full((instants, n, n_u), np.nan) for _ in range(3))
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
    rows, memory = stepper.rows, law.start(stepper.n)
    memory = memory if isinstance(rows, slice) else memory[rows]
    q, v = stepper.read()
    log = LoopLog(instants, stepper.n, q.shape[1], v.shape[1], stepper.n_u)
    asked_s, independent, n_u = log.asked_s, stepper.independent, stepper.n_u
    bound = LARGEST_STATE**2
    for k in range(instants):
        if not len(q):
            break
        check()
        s, rate = q[:, independent], v
        if sensors is not None:
            s, rate = measure(sensors, k, s, rate)
        begin = time.perf_counter()
        command, memory, failed = _asked(law, k, s, rate, memory, n_u)
        asked_s[k] = time.perf_counter() - begin
        # Sums of squares that are small and finite leave no state or command beyond.
        if not (np.vdot(q, q) < bound and np.vdot(v, v) < bound and np.vdot(command, command) < bound):
            sound = (np.abs(q) < LARGEST_STATE).all(axis=1) & (np.abs(v) < LARGEST_STATE).all(axis=1)
            running = sound & np.isfinite(command).all(axis=1)
            if not running.all():
                here = np.arange(stepper.n)[rows]
                for i in np.flatnonzero(~running):
                    error = failed.get(int(i))
                    said = _said(error) if error else "the tracker gave an effort that is no number"
                    log.failure[here[i]], log.error[here[i]] = (said, error) if sound[i] else (stepper.lost, None)
                    log.done[here[i]] = k
                stepper.keep(running)
                rows = stepper.rows
                q, v, command, memory = q[running], v[running], command[running], memory[running]
                sensors = None if sensors is None else sensors.kept(running)
                if not len(q):
                    break
        log.pose[k, rows], log.velocity[k, rows], log.commanded[k, rows] = q, v, command
        log.applied[k, rows], log.speed[k, rows] = stepper.hold(command)
        q, v = stepper.read()
    return log


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
