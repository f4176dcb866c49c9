"""The links between phases of a motion: two mechanisms of the same bodies, with other closures, in the pose of one instant.

The pose q (n_q,) of the instant is an unknown of the link. With the closures C of the next phase, momentum is conserved
along its freedoms,

    Gamma_2^T (M_2 Gamma_2 v_2 - M Gamma_1 v_1) = 0,

which is the plastic impact q'+ = q'- - M^-1 C^T (C M^-1 C^T)^-1 C q'- where a closure is added. Where none is, the speeds of
all joints are continuous. What is picked up was at rest before; what is put down keeps its speed. M is therefore the mass
matrix of what moves both before and after, and M_2 that of what moves afterwards.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import independent_rows
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.problem.instant import Scales
from linkplan.planner.transcription.linked import Link


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Side:
    """One side of a junction: the number of its program, its mechanism and its units."""

    program: int
    mechanism: Mechanism
    scales: Scales


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Exchange:
    """The coordinates of the next phase from those of the last: q_2 = S q_1 + shift of the ground along `slides`.

    `order` (n_q,) and `signs` (n_q,) mirror a gait: coordinate i of the next phase is signs[i] times coordinate order[i].
    `slides` are the coordinates of the base along the ground, along which the next phase begins anywhere.
    """

    order: np.ndarray
    signs: np.ndarray
    slides: tuple[int, ...] = ()

    @classmethod
    def none(cls, n_q: int, slides: Sequence[int] = ()) -> "Exchange":
        """Return the exchange of equal coordinates."""
        return cls(order=np.arange(n_q), signs=np.ones(n_q), slides=tuple(slides))

    @property
    def matrix(self) -> np.ndarray:
        """The matrix S (n_q, n_q)."""
        found = np.zeros((len(self.order), len(self.order)))
        found[np.arange(len(self.order)), self.order] = self.signs
        return found


def junction(before: Side, after: Side, exchange: Exchange, inertia: Mechanism, n_programs: int, pose: np.ndarray) -> Link:
    """Return the link between the end of a phase and the start of the next.

    Args:
        before: the phase that ends.
        after: the phase that begins; the same for a gait of one phase.
        exchange: of coordinates.
        inertia: the mechanism of what moves on both sides.
        n_programs: the number of all programs.
        pose: guess (n_q,) of the pose, in the coordinates of the phase before.
    """
    first, second = before.mechanism, after.mechanism
    unit = unit_steps(first.joints, first.extent_m)
    one, two = ca.SX.sym("one", 2 * first.dof), ca.SX.sym("two", 2 * second.dof)
    durations, own = ca.SX.sym("durations", n_programs), ca.SX.sym("own", first.n_q + len(exchange.slides))
    q, moved = own[: first.n_q] * ca.DM(unit), ca.SX.zeros(first.n_q)
    for k, slide in enumerate(exchange.slides):
        moved[slide] = own[first.n_q + k] * float(unit[slide])
    S = ca.DM(exchange.matrix)
    q_2 = S @ q - moved
    rates = first.dynamics.velocity_map(q) @ _speeds(one, before)
    v_2 = _speeds(two, after)
    gamma, M = second.dynamics.velocity_map(q_2), inertia.dynamics.mass_matrix(q_2)
    momentum = gamma.T @ (second.dynamics.mass_matrix(q_2) @ (gamma @ v_2) - M @ (S @ rates))
    rate = after.scales.position / after.scales.time_s
    of_units = np.abs(np.array(second.dynamics.reduced_inertia(exchange.matrix @ pose))) @ rate
    position, after_position = ca.DM(before.scales.position), ca.DM(after.scales.position)
    rows = ca.vertcat(
        q[first.independent.tolist()] / position - one[: first.dof],
        first.dynamics.independent_closure(q) / first.extent_m,
        q_2[second.independent.tolist()] / after_position - two[: second.dof],
        _further_closure(first, second, exchange, pose)(own) / second.extent_m,
        momentum / ca.DM(of_units),
    )
    function = ca.Function("junction", [ca.vertcat(one, two), durations, own], [ca.densify(rows), ca.SX(0)])
    start = np.concatenate([pose / unit, np.zeros(len(exchange.slides))])
    ends = (before.program, -1), (after.program, 0)
    return Link(ends=ends, function=function, own=start, bounds=np.tile([-np.inf, np.inf], (len(start), 1)))


def end_link(
    side: Side,
    n_programs: int,
    pose: np.ndarray,
    *,
    end: int = -1,
    positions: Mapping[int, float] = MappingProxyType({}),
    speeds: Mapping[int, float] = MappingProxyType({}),
    further: Callable[[ca.SX, ca.SX], tuple[ca.SX, list[ca.SX]]] | None = None,
) -> Link:
    """Return the link of one end of a phase with given values of any joints, and a cost and rows of its pose and rates.

    Args:
        side: the phase.
        n_programs: the number of all programs.
        pose: guess (n_q,) of the pose.
        end: 0 for its start, -1 for its end.
        positions: by the number of the joint [rad or m].
        speeds: likewise, per second.
        further: a function of the pose q and the rates q' (n_q,) to a scaled cost and further scaled rows.
    """
    mechanism, scales = side.mechanism, side.scales
    unit = unit_steps(mechanism.joints, mechanism.extent_m)
    state, own = ca.SX.sym("state", 2 * mechanism.dof), ca.SX.sym("own", mechanism.n_q)
    durations, q = ca.SX.sym("durations", n_programs), own * ca.DM(unit)
    rates = mechanism.dynamics.velocity_map(q) @ _speeds(state, side)
    cost, more = (ca.SX(0), []) if further is None else further(q, rates)
    rows = ca.vertcat(
        q[mechanism.independent.tolist()] / ca.DM(scales.position) - state[: mechanism.dof],
        mechanism.dynamics.independent_closure(q) / mechanism.extent_m,
        *((q[i] - value) / float(unit[i]) for i, value in positions.items()),
        *((rates[i] - value) * scales.time_s / float(unit[i]) for i, value in speeds.items()),
        *more,
    )
    function = ca.Function("end", [state, durations, own], [ca.densify(rows), ca.densify(cost)])
    start = pose / unit
    bounds = np.tile([-np.inf, np.inf], (len(start), 1))
    return Link(ends=((side.program, end),), function=function, own=start, bounds=bounds)


def _speeds(state: ca.SX, side: Side) -> ca.SX:
    """Return the independent speeds [SI] of a scaled state."""
    n_s = side.mechanism.dof
    return state[n_s:] * ca.DM(side.scales.position / side.scales.time_s)


def _further_closure(first: Mechanism, second: Mechanism, exchange: Exchange, pose: np.ndarray) -> ca.Function:
    """Return the closure equations of the next phase [m] that do not follow from those of the last, of the link's unknowns.

    Which these are is read from the Jacobian's rank in the guessed pose.
    """
    unit = unit_steps(first.joints, first.extent_m)
    own = ca.SX.sym("own", first.n_q + len(exchange.slides))
    moved = ca.SX.zeros(first.n_q)
    for k, slide in enumerate(exchange.slides):
        moved[slide] = own[first.n_q + k] * float(unit[slide])
    q = own[: first.n_q] * ca.DM(unit)
    held = first.dynamics.independent_closure(q)
    new = second.dynamics.independent_closure(ca.DM(exchange.matrix) @ q - moved)
    both = ca.vertcat(held, new)
    at = np.concatenate([pose / unit, np.zeros(len(exchange.slides))])
    jacobian = np.array(ca.Function("J", [own], [ca.densify(ca.jacobian(both, own))])(at)).reshape(both.numel(), own.numel())
    kept = _independent_after(jacobian, held.numel())
    return ca.Function("further", [own], [ca.densify(ca.vertcat(ca.SX(0, 1), *(new[k] for k in kept)))])


def _independent_after(jacobian: np.ndarray, n_held: int) -> list[int]:
    """Return the indices of the rows after the first `n_held` that are independent of these and of each other."""
    held, new = jacobian[:n_held], jacobian[n_held:]
    if n_held:
        basis = np.linalg.qr(held.T)[0]
        left = new - (new @ basis) @ basis.T
    else:
        left = new
    left = np.where(np.abs(left) > 1e-9 * max(np.abs(jacobian).max(initial=0.0), 1e-300), left, 0.0)
    rank = int(np.linalg.matrix_rank(left, tol=1e-6 * max(np.abs(jacobian).max(initial=0.0), 1e-300))) if left.size else 0
    return [int(k) for k in independent_rows([left], rank)] if rank else []
