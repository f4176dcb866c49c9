"""The links between phases of a motion: two mechanisms of the same bodies, with other closures, in the pose of one instant.

The pose q (n_q,) of the instant is an unknown of the link. With the closures C of the next phase, momentum is conserved
along its freedoms,

    Gamma_2^T (M_2 Gamma_2 v_2 - M Gamma_1 v_1) = 0,

which is the plastic impact q'+ = q'- - M^-1 C^T (C M^-1 C^T)^-1 C q'- where a closure is added. Where none is, the speeds of
all joints are continuous. What is picked up was at rest before; what is put down keeps its speed. M is therefore the mass
matrix of what moves both before and after, and M_2 that of what moves afterwards.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import RANK_TOLERANCE, independent_rows
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
    """The coordinates of the next phase from those of the last: those in `order` (n_q,), less the way of its origin.

    A gait mirrors its legs: coordinate i of the next phase is coordinate order[i] of the last. `slides` are the coordinates
    of the base along the ground, along which the next phase begins anywhere.
    """

    order: np.ndarray
    slides: tuple[int, ...] = ()


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
    order = exchange.order.tolist()
    q_2 = q[order] - moved
    rates = first.dynamics.velocity_map(q) @ _speeds(one, before)
    v_2 = _speeds(two, after)
    gamma, M = second.dynamics.velocity_map(q_2), inertia.dynamics.mass_matrix(q_2)
    momentum = gamma.T @ (second.dynamics.mass_matrix(q_2) @ (gamma @ v_2) - M @ rates[order])
    rate = after.scales.position / after.scales.time_s
    of_units = np.abs(np.array(second.dynamics.reduced_inertia(pose[order]))) @ rate
    position, after_position = ca.DM(before.scales.position), ca.DM(after.scales.position)
    start = np.concatenate([pose / unit, np.zeros(len(exchange.slides))])
    held, closing = first.dynamics.independent_closure(q), second.dynamics.independent_closure(q_2)
    rows = ca.vertcat(
        q[first.independent.tolist()] / position - one[: first.dof],
        held / first.extent_m,
        q_2[second.independent.tolist()] / after_position - two[: second.dof],
        closing[_further_rows(held, closing, own, start)] / second.extent_m,
        momentum / ca.DM(of_units),
    )
    function = ca.Function("junction", [ca.vertcat(one, two), durations, own], [ca.densify(rows), ca.SX(0)])
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


def _further_rows(held: ca.SX, closing: ca.SX, own: ca.SX, at: np.ndarray) -> list[int]:
    """Return the indices of the next phase's closure rows that do not follow from those of the last, by their rank.

    Args:
        held: the rows of the phase before, expressions of a link's unknowns.
        closing: likewise of the next phase.
        own: these unknowns.
        at: guess of their values.
    """
    both = ca.vertcat(held, closing)
    jacobian = np.array(ca.Function("J", [own], [ca.densify(ca.jacobian(both, own))])(at)).reshape(both.numel(), own.numel())
    before, after = jacobian[: held.numel()], jacobian[held.numel() :]
    basis = np.linalg.qr(before.T)[0]
    left = after - (after @ basis) @ basis.T
    rank = int(np.sum(np.linalg.svd(left, compute_uv=False) > RANK_TOLERANCE * np.abs(jacobian).max(initial=0.0)))
    return independent_rows([left], rank).tolist()
