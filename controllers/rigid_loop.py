"""The feedback loop on rigid kinematic loops: the reduced dynamics, integrated tightly, in the simulator's place.

What MuJoCo adds to a run, soft closures and its integrator's step, is the difference between this loop and `run_ensemble`.
An effort is held from one command to the next; in between the reduced dynamics go on by Runge-Kutta steps of fourth order,
at least two to a step of the simulator, and a Newton step closes the loops again at the end. Nothing saturates here.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.controllers.divergence import divergence_expected
from linkplan.controllers.imperfections.imperfections import Clock
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.prediction import runge_kutta
from linkplan.controllers.trackers.stepping import steps_of
from linkplan.controllers.trackers.tracker import AnyTracker
from linkplan.models.interrupts import check
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated, mapped

# Steps of the integrator in one of the simulator's.
_FINER = 2
# A loop that is open by more than this [m] after a Newton step has been driven through a pose where it cannot close.
_CLOSED_M = 1e-6
LOST = "the rigid loop was driven to where it cannot be closed"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class RigidRuns:
    """The logs of n runs at their control instants, time first: (t, n, ...); NaN after a run was lost.

    `pose` (t, n, n_q) and `velocity` (t, n, n_s) [rad or m, and per second], `commanded` (t, n, n_u) [N.m or N]; `failure`
    says why a run was lost.
    """

    pose: np.ndarray
    velocity: np.ndarray
    commanded: np.ndarray
    failure: tuple[str | None, ...]


@divergence_expected()
def run_rigid(
    mechanism: Mechanism,
    reference: SampledReference,
    tracker: AnyTracker,
    clocks: Sequence[Clock],
    starts: tuple[np.ndarray, np.ndarray],
    delay_periods: float = 0.0,
) -> RigidRuns:
    """Return the logs of a tracker on the reduced dynamics, over the whole reference.

    Args:
        mechanism: as the tracker believes it to be.
        reference: the motion, sampled.
        tracker: the law.
        clocks: of each run: its period, and its own delay.
        starts: closed poses (n, n_q) and velocities (n, n_s) that the runs begin with.
        delay_periods: of computing, in all runs.
    """
    n, n_q, n_s, t = len(clocks), mechanism.n_q, mechanism.dof, reference.n
    delays = np.array([round(delay_periods + clock.delay_periods, 9) for clock in clocks])
    whole = np.floor(delays).astype(int)
    share = delays - whole  # of a period during which the command before still acts
    periods = reference.period_s * np.array([clock.period_factor for clock in clocks])
    steps = max(1, int(np.ceil(_FINER * periods.max() / float(mechanism.model.opt.timestep) - 1e-9)))
    onward = mapped(_onward(mechanism, steps), n)
    state = np.concatenate(starts, axis=1)
    pose, velocity = np.full((t, n, n_q), np.nan), np.full((t, n, n_s), np.nan)
    commanded = np.full((t, n, mechanism.n_u), np.nan)
    done = np.full(n, t)
    law, rows = steps_of(tracker), np.arange(n)
    memory = law.start(n)
    for k in range(t):
        check()
        q, v = state[:, :n_q], state[:, n_q:]
        asked, memory = law.step(k, q[:, mechanism.independent], v, memory)
        pose[k], velocity[k], commanded[k] = q, v, asked
        # Before the first command arrives, the first one acts: the feedback loop is taken to be running already.
        before, acts = (commanded[np.maximum(0, k - whole - late), rows] for late in (1, 0))
        gap = np.zeros(n)
        for effort, duration in ((before, share * periods), (acts, (1 - share) * periods)):
            if np.any(duration):
                after, opened = evaluated(onward, state.T, effort.T, duration)
                state, gap = after.T, np.maximum(gap, opened.ravel())
        done[~((gap <= _CLOSED_M) & np.isfinite(state).all(axis=1)) & (done == t)] = k + 1
        if np.all(done <= k + 1):
            break
        if np.any(done < t):  # what is lost is put where it harms no law; its log ends
            following = min(k + 1, t - 1)
            there = np.concatenate([reference.pose[following], reference.velocity[following]])
            state = np.where((done < t)[:, None], there, state)
    ended = np.arange(t)[:, None] >= done
    for log in (pose, velocity, commanded):
        log[ended] = np.nan
    return RigidRuns(pose=pose, velocity=velocity, commanded=commanded, failure=tuple(LOST if d < t else None for d in done))


def _onward(mechanism: Mechanism, steps: int) -> ca.Function:
    """Return ((q, v), efforts, duration [s]) -> (q, v) after it, and what the loops are open by then [m]."""
    dynamics, n_q = mechanism.dynamics, mechanism.n_q
    state, u = ca.MX.sym("state", n_q + mechanism.dof), ca.MX.sym("u", mechanism.n_u)
    duration = ca.MX.sym("duration")
    one = ca.Function("one", [state, u, duration], [runge_kutta(mechanism, state, u, duration / steps)])
    x = state
    for _ in range(steps):
        x = one(x, u, duration)
    q, gap = x[:n_q], ca.MX(0)
    dependent = mechanism.dependent.tolist()
    if dependent:
        q[dependent] += dynamics.closure_step(q)[1]
        gap = ca.norm_inf(dynamics.independent_closure(q))
    return ca.Function("onward", [state, u, duration], [ca.vertcat(q, x[n_q:]), gap])
