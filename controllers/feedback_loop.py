"""The feedback loop: a law is evaluated at every control instant for machines that run side by side. Written for speed.

A `Stepper` advances the machines: MuJoCo (mujoco_plant.py) or the reduced dynamics (rigid_plant.py). Results of a machine
do not depend on the other machines. A machine that diverges, or whose tracker fails, is frozen: its log ends, and it is put
back to its start.
"""

import time
from typing import Protocol

import numpy as np

from linkplan.controllers.imperfections.sensing import SensorState, measure
from linkplan.controllers.rollout import divergence_expected
from linkplan.controllers.trackers.tracker import TrackerWithMemory
from linkplan.models.deadline import check
from linkplan.models.errors import LinkplanError, ProblemError, one_line

# Largest position or velocity that MuJoCo accepts (mjMAXVAL).
LARGEST_STATE = 1e10


class Stepper(Protocol):
    """Machines, advanced one control period at a time: the only mutable state of a simulation.

    `running` (n,) marks the machines that are not frozen. `independent` are the columns of a pose that the law measures.
    """

    n: int
    n_q: int
    n_s: int
    n_u: int
    running: np.ndarray
    independent: np.ndarray | slice
    lost: str  # the reason given for a machine with an invalid state

    def read(self, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Write the machines' poses (n, n_q) and velocities (n, n_s)."""
        ...

    def share(self, pose: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Return commands (n, n_u) within limits at poses (n, n_q), as far as other actuators can take over."""
        ...

    def hold(self, command: np.ndarray, applied: np.ndarray, speed: np.ndarray) -> None:
        """Advance the machines by a period under commands (n, n_u), and write mean efforts and actuators' speeds."""
        ...

    def freeze(self, lost: np.ndarray) -> None:
        """Put the machines of a mask (n,) back to their starts, where they stay."""
        ...


class LoopLog:
    """The log of n machines at t instants, NaN after a machine was frozen. `run_loop` fills it."""

    def __init__(self, instants: int, n: int, n_q: int, n_s: int, n_u: int) -> None:
        # States and commands of an instant are contiguous, so that one sum of squares detects invalid numbers.
        self.instants = np.full((instants, n, n_q + n_s + n_u), np.nan)
        self.pose, self.velocity, self.commanded = np.split(self.instants, [n_q, n_q + n_s], axis=2)
        self.applied, self.speed = np.full((instants, n, n_u), np.nan), np.full((instants, n, n_u), np.nan)
        self.asked_s = np.full(instants, np.nan)
        self.done = np.full(n, instants)
        self.failure: list[str | None] = [None] * n
        self.error: list[BaseException | None] = [None] * n


@divergence_expected()
def run_loop(stepper: Stepper, law: TrackerWithMemory, instants: int, sensors: SensorState | None = None) -> LoopLog:
    """Return the log of a law over control instants, from the machines' present states.

    Args:
        stepper: the machines, which are advanced.
        law: evaluated at instants from 0.
        instants: their number.
        sensors: of the machines; None for exact measurements.
    """
    log = LoopLog(instants, stepper.n, stepper.n_q, stepper.n_s, stepper.n_u)
    log.done[~stepper.running] = 0
    memory = law.start(stepper.n)
    independent, n_u, bound, clock = stepper.independent, stepper.n_u, LARGEST_STATE**2, time.perf_counter
    logs = (log.pose, log.velocity, log.commanded, log.applied, log.speed)
    running = int(np.count_nonzero(stepper.running))
    for k, (row, q, v, command, applied, speed) in enumerate(zip(log.instants.reshape(instants, -1), *logs, strict=True)):
        check()
        if not running:
            break
        stepper.read(q, v)
        s, rate = q[:, independent], v
        if sensors is not None:
            s, rate = measure(sensors, k, s, rate)
        begin = clock()
        if running == stepper.n:
            command[...], memory, failed = _efforts(law, k, s, rate, memory, n_u)
        else:  # the law is not evaluated for frozen machines
            run, memory, command[...] = np.flatnonzero(stepper.running), memory.copy(), 0.0
            command[run], memory[run], raised = _efforts(law, k, s[run], rate[run], memory[run], n_u)
            failed = {int(run[i]): error for i, error in raised.items()}
        log.asked_s[k] = clock() - begin
        command[...] = stepper.share(q, command)
        # If the sum of squares is finite and small, all states and commands are valid.
        if not row.dot(row) < bound:
            _freeze_failures(log, stepper, k, failed)
            running = int(np.count_nonzero(stepper.running))
        stepper.hold(command, applied, speed)
    for machine in np.flatnonzero(log.done < instants):
        for whole in (log.instants, log.applied, log.speed):
            whole[log.done[machine] :, machine] = np.nan
    return log


def _freeze_failures(log: LoopLog, stepper: Stepper, k: int, failed: dict[int, BaseException]) -> None:
    """Freeze the machines with an invalid state or command at instant k, and log why."""
    valid_state = (np.abs(log.pose[k]) < LARGEST_STATE).all(axis=1) & (np.abs(log.velocity[k]) < LARGEST_STATE).all(axis=1)
    lost = stepper.running & ~(valid_state & np.isfinite(log.commanded[k]).all(axis=1))
    for machine in np.flatnonzero(lost).tolist():
        error, reason = failed.get(machine), "the tracker gave an effort that is not a number"
        if error:  # in one line, with its type if it is of another library
            cause = error.__cause__ or error
            kind, text = type(cause).__name__, one_line(cause)
            reason = text if isinstance(cause, LinkplanError) else f"{kind}: {text}" if text else kind
            reason = f"the tracker failed: {reason}"
        log.failure[machine], log.error[machine] = (reason, error) if valid_state[machine] else (stepper.lost, None)
        log.done[machine] = k
    stepper.freeze(lost)
    log.commanded[k, ~stepper.running] = 0.0


def states_of(stepper: Stepper) -> tuple[np.ndarray, np.ndarray]:
    """Return the machines' poses (n, n_q) and velocities (n, n_s)."""
    pose, velocity = np.empty((stepper.n, stepper.n_q)), np.empty((stepper.n, stepper.n_s))
    stepper.read(pose, velocity)
    return pose, velocity


def _efforts(
    law: TrackerWithMemory, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray, n_u: int
) -> tuple[np.ndarray, np.ndarray, dict[int, BaseException]]:
    """Return efforts (n, n_u), the next memory, and the tracker's exceptions by machine, whose efforts are NaN.

    A law with `batched = False` is evaluated for one state at a time, and once per instant, because it may have internal
    state.
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
    # One by one, so that the failure of one machine does not affect the others.
    rows = [slice(i, i + 1) for i in range(n)]
    each = [_efforts(law, k, position[row], velocity[row], memory[row], n_u) for row in rows]
    failed = {i: raised[0] for i, (_, _, raised) in enumerate(each) if raised}
    return np.concatenate([one[0] for one in each]), np.concatenate([one[1] for one in each]), failed
