"""The linear map of errors from the end of a phase to the start of the next, and feedback through all phases.

The state x = (s, v) of a phase becomes R(x) of the next: the positions of its own independent joints, and the speeds that
keep the momentum along its freedoms. If a touch-down ends the phase when g(s) = 0, an error also changes the time of the
event, and

    e+ = S e-,   S = DR + (f+ - DR f-) Dg / (Dg f-),

the saltation matrix, with the flows f- and f+ before and after the event (Leine and Nijmeijer, Dynamics and Bifurcations of
Non-Smooth Mechanical Systems, 2004, 7.2). At a planned time S = DR.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.controllers.linearisation import discretise, linearise
from linkplan.controllers.trackers.lqr import Regulator, regulated, regulator
from linkplan.controllers.trackers.tracker import Design, StateFeedback
from linkplan.models.errors import GainError
from linkplan.models.mechanism import Mechanism
from linkplan.models.reduction.closing import closed_near

# The cost of a gait's errors has settled when it changes by less than this share, in at most so many repetitions.
_SETTLED_SHARE, _MOST_REPETITIONS = 1e-9, 500


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class End:
    """The nominal state at one end of a phase: pose (n_q,), independent rates (n_s,), efforts (n_u,)."""

    mechanism: Mechanism
    pose: np.ndarray
    rates: np.ndarray
    effort: np.ndarray

    @property
    def flow(self) -> np.ndarray:
        """The state's rate f (2 n_s,)."""
        acceleration = np.array(self.mechanism.dynamics.acceleration(self.pose, self.rates, self.effort)).ravel()
        return np.concatenate([self.rates, acceleration])


def jump(before: End, after: End, order: np.ndarray, moved: np.ndarray, event: tuple[int, np.ndarray] | None) -> np.ndarray:
    """Return the map S (2 n_2, 2 n_1) of errors through a junction.

    Args:
        before: the end of the phase.
        after: the start of the next.
        order: (n_q,) coordinate i afterwards is coordinate order[i] before.
        moved: (n_q,) how far the origin moves.
        event: the site that touches the ground, by its number in the next phase, and the ground's normal (3,); None at a
            planned time.
    """
    first, second = before.mechanism.dynamics, after.mechanism.dynamics
    n = before.mechanism.dof
    near, x = ca.MX.sym("near", before.mechanism.n_q), ca.MX.sym("x", 2 * n)
    q, _ = closed_near(first, near, x[:n])
    q_2 = q[order.tolist()] - ca.DM(moved)
    gamma, M = second.velocity_map(q_2), second.mass_matrix(q_2)
    rates = (first.velocity_map(q) @ x[n:])[order.tolist()]
    v_2 = ca.solve(gamma.T @ M @ gamma, gamma.T @ M @ rates)
    state = ca.vertcat(q_2[after.mechanism.independent.tolist()], v_2)
    height = ca.MX(0) if event is None else ca.dot(ca.DM(event[1]), second.site_places(q_2)[:, event[0]])
    maps = ca.Function("jump", [near, x], [ca.jacobian(state, x), ca.jacobian(height, x)])
    at = np.concatenate([before.pose[before.mechanism.independent], before.rates])
    D, slope = (np.array(one) for one in maps(before.pose, at))
    if event is None:
        return D
    return D + np.outer(after.flow - D @ before.flow, slope[0]) / float(slope[0] @ before.flow)


def through_phases(designs: Sequence[Design], jumps: Sequence[np.ndarray]) -> list[StateFeedback]:
    """Return the LQR of each phase with the cost of the errors that reach the next; a gait has a jump after each phase.

    Raises:
        GainError: if the errors of a gait grow in spite of feedback.
    """
    repeats, n = len(jumps) == len(designs), len(designs)
    end, before = _last_cost(designs[-1], moving=repeats), None
    for _ in range(_MOST_REPETITIONS if repeats else 1):
        found: list[Regulator] = []
        for k in range(n - 1, -1, -1):
            found.insert(0, regulator(designs[k].mechanism, designs[k].reference, designs[k].errors(), end)[0])
            start = _whole(found[0].cost[0], designs[k])
            end = jumps[k - 1].T @ start @ jumps[k - 1] if k or repeats else start
        if before is not None and np.abs(end - before).max() <= _SETTLED_SHARE * np.abs(end).max():
            break
        before = end
    else:
        if repeats:
            raise GainError("LQR has no gain that keeps the errors of this gait bounded from one repetition to the next")
    return [regulated(design, one) for design, one in zip(designs, found, strict=True)]


def cycle_map(
    designs: Sequence[Design], laws: Sequence[StateFeedback], jumps: Sequence[np.ndarray], durations_s: Sequence[float]
) -> np.ndarray:
    """Return the linear Poincare map (2 n_s, 2 n_s) of a tracked gait's errors at the start of its first phase.

    Args:
        designs: of each phase's law.
        laws: the laws.
        jumps: the map of errors after each phase.
        durations_s: from the first control instant of each phase to its end [s]; the last period is shorter than the others.
    """
    total = np.eye(2 * designs[0].mechanism.dof)
    for design, law, S, duration in zip(designs, laws, jumps, durations_s, strict=True):
        reference, T = design.reference, design.reference.period_s
        A, B = linearise(design.mechanism, *reference.states)
        A_last, B_last = discretise(A[-1:], B[-1:], duration - T * (reference.n - 1))
        A, B = discretise(A, B, T)
        for A_k, B_k, K in zip([*A[:-1], *A_last], [*B[:-1], *B_last], law.gains, strict=True):
            total = (A_k - B_k @ K) @ total
        total = S @ total
    return total


def _last_cost(design: Design, *, moving: bool) -> np.ndarray:
    """Return the cost (2 n_s, 2 n_s) of errors at the end: for ever, or that of the instant if nothing can hold them."""
    last = design.reference.part(slice(-1, None))
    try:
        found = None if moving else regulator(design.mechanism, last, design.errors())[0]
    except GainError:
        found = None
    if found is None:
        zero = np.zeros((2 * design.mechanism.dof,) * 2)
        return _whole(regulator(design.mechanism, last, design.errors(), zero)[0].Q, design)
    return _whole(found.cost[-1], design)


def _whole(matrix: np.ndarray, design: Design) -> np.ndarray:
    """Return a matrix of all states from one of the controllable states."""
    kept = np.flatnonzero(np.tile(design.mechanism.actuated, 2))
    full = np.zeros((2 * design.mechanism.dof,) * 2)
    full[np.ix_(kept, kept)] = matrix
    return full
