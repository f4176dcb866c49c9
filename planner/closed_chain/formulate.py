"""A mechanism's planning problem as a formulation: its functions and the numbers of its limits and objective.

Where waypoints and goals leave the pose free, sites and bodies are prescribed at the phase boundaries of the program.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from linkplan.planner.closed_chain.mechanics import (
    NodeTerms,
    in_order,
    mechanism_system,
    n_algebraic,
    node_numbers,
)
from linkplan.planner.limits.efforts import end_efforts, hold_a_free_goal, holds_at_rest
from linkplan.planner.limits.joints import bounds_of_state
from linkplan.planner.limits.kinds import effort_bounds, limits_of
from linkplan.planner.limits.limit import Limit, WhichJoints
from linkplan.planner.limits.rates import smooth_columns
from linkplan.planner.limits.site import expression_of, scaled_coordinate, unit_of
from linkplan.planner.problem.extra import jerk_of
from linkplan.planner.problem.instant import Scales
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import coordinates_of
from linkplan.planner.refinement.marking import Tightening, tightening_over
from linkplan.planner.transcription.formulation import Formulation, PhaseBoundary, Units
from linkplan.planner.transcription.interval import COSTS, IntervalRows
from linkplan.planner.transcription.system import Endpoint

# Weight of the squared effort rate for objectives that leave efforts non-smooth (tracking, work), in scaled units. Without
# it the nearest motion chatters at the ends of its bang arcs where limits are active (Fuller's phenomenon). With it, a
# change of the effort over its whole range in a tenth of the motion costs as much as an rms error of 3e-4 of the motion's
# span.
SMOOTHING_WEIGHT = 2.5e-9
# Weights of the mean squared effort, in shares of the limits, that break ties of several motors in least time: one joint
# determines the time, and the others have slack. With the first weight, first solves take a half to a third of the
# iterations, and the time is 5e-4 longer. With the second it is 4e-6 longer in the median of 52 problems, and more than 3e-5
# longer in one of ten.
FIRST_TIE_WEIGHT, TIE_WEIGHT = 1e-2, 5e-4


def free_goal_endpoint(problem: Problem, scales: Scales, n_z: int) -> tuple[Endpoint | None, np.ndarray]:
    """Return the endpoint rows of a motion with a free goal pose, and their parameters: the coordinates [m or rad].

    Efforts with a limited rate hold the pose. If the goal pose is prescribed, there is no endpoint and no parameter.

    Args:
        problem: the problem.
        scales: units of its unknowns.
        n_z: the number of algebraic unknowns; the dependent joints come first.
    """
    mechanism, motion = problem.mechanism, problem.motion
    if not motion.goal_is_free:
        return None, np.zeros(0)
    n_s, n_dependent = mechanism.dof, len(mechanism.dependent)
    first, last, duration = (ca.SX.sym(*of) for of in (("first", 2 * n_s), ("last", 2 * n_s), ("duration", 1)))
    asked = ca.SX.sym("asked", len(motion.goal_rows))
    z = ca.SX.sym("z", n_z)
    q = in_order(mechanism, last[:n_s] * ca.DM(scales.position), z[:n_dependent])
    every = coordinates_of(motion.goal_at)
    ends = [every[row] for row in motion.goal_rows]
    at = ca.vertcat(*[expression_of(mechanism, index, axis, q) for index, axis, _ in ends])
    units = ca.DM([unit_of(mechanism, axis) for _, axis, _ in ends])
    held, u, holding = hold_a_free_goal(problem), ca.SX.sym("u", mechanism.n_u), ca.SX(0, 1)
    if held:
        still = ca.SX.zeros(n_s)
        forces = () if mechanism.forces is None else mechanism.forces_at(np.array([motion.duration_s]))
        demand = (mechanism.forced if forces else mechanism.dynamics).inverse_dynamics(
            q, still, still, *(w.T for w in forces)
        )
        holding = u[held] - (ca.solve(mechanism.dynamics.effort_map(q), demand) / scales.effort)[held]
    column = ca.vertcat((at - asked) / units, holding, 0.0)
    inputs = [first, last, duration, asked, *([z] if n_dependent else []), *([u] if held else [])]
    function = ca.Function("goal_end", inputs, [column])
    n_rows = len(ends) + len(held)
    endpoint = Endpoint(function=function, n_rows=n_rows, algebraic=bool(n_dependent), effort=bool(held))
    return endpoint, np.array([value for _, _, value in ends])


def formulate(
    problem: Problem,
    scales: Scales,
    *,
    position_rows: WhichJoints = False,
    enclosed: bool = False,
    least_limit: bool = False,
    tightenings: tuple[Tightening, ...] = (),
    smoothing: float = SMOOTHING_WEIGHT,
    ties: float = 0.0,
    free_ends: np.ndarray | None = None,
) -> Formulation:
    """Return a problem's formulation.

    Args:
        problem: what to plan.
        scales: units of its unknowns.
        position_rows: impose the ranges of independent joints between the nodes too, of all or of some by their index.
        enclosed: impose enclosable limits (power, pin force, accelerations, jerk) between the nodes too.
        least_limit: omit the objective, because only a feasible motion is needed.
        tightenings: amounts by which limits are tightened along the motion, because it overran them between nodes.
        smoothing: the weight of the squared effort rate if the objective leaves efforts non-smooth, in scaled units.
        ties: the weight of the mean squared effort, see `tie_weights`.
        free_ends: a mask (2, 2 n_s) of states at start and goal that a link to another phase determines.
    """
    mechanism, objective, motion = problem.mechanism, problem.objective, problem.motion
    n_s, n_u = mechanism.dof, mechanism.n_u
    limits = limits_of(problem, enclosed=enclosed, position_rows=position_rows)
    asked = _node_terms(problem, limits, least_limit=least_limit)
    n_z = n_algebraic(mechanism, asked)
    value = sum(objective.weight(name) * term.scale(scales, problem.motors) for name, term in objective.terms.items())
    smoothing_weight = smoothing if objective.is_smoothed else None
    costs = {} if least_limit else _exact_costs(problem, scales, smoothing_weight, value, ties)
    eta = [np.zeros(0), *costs.values(), *(limit.rows.interval_numbers(problem, scales) for limit in limits)]
    rows, own, own_tightening = _interval_rows(problem, scales, limits, n_z - asked.n_unknowns, tuple(costs), tightenings)
    n_works = n_u if asked.works else 0
    (position, speed, dependent), rate = bounds_of_state(problem), scales.position / scales.time_s
    positive = np.tile([0.0, np.inf], (n_works, 1))
    bounds = np.array([limit.bounds(problem, scales) for limit in asked.rows]).reshape(-1, 2)
    path = np.vstack([bounds, free_bounds(len(asked.passed)), positive])
    endpoint, places = free_goal_endpoint(problem, scales, n_z)
    free_at_end = tuple(np.flatnonzero(problem.free_spins).tolist())
    returns = tuple(i for i in range(2 * n_s) if i not in free_at_end)
    return Formulation(
        build_system=lambda: mechanism_system(mechanism, asked),
        n_s=n_s,
        n_x=0,
        n_z=n_z,
        n_u=n_u,
        rows=rows,
        units=Units(
            time_s=scales.time_s,
            state=np.concatenate([scales.position, rate]),
            effort=scales.effort,
            objective=value,
        ),
        state=np.vstack([position / scales.position[:, None], speed / rate[:, None]]),
        algebraic=np.vstack([dependent, positive, free_bounds(asked.n_unknowns)]),
        effort=effort_bounds(problem),
        path=path,
        own=own,
        boundaries=_freed(phase_boundaries_of(problem, scales), free_ends),
        returns=returns if motion.kind == "periodic" else (),
        free_at_end=free_at_end if motion.kind == "periodic" else (),
        advance=_advance(problem, scales, returns),
        smooth=tuple(range(n_u)) if objective.is_smoothed or objective.efforts("smooth") else rows.rate_columns,
        holds_at_rest=tuple(sums * scales.position for sums in holds_at_rest(problem)),
        end_accelerations=motion.end_accelerations(n_s) * scales.time_s**2 / scales.position,
        end_efforts=end_efforts(problem) if motion.kind == "reach" else None,
        eta=np.concatenate(eta),
        theta=_theta(problem, asked, scales, value),
        tightening=tightening_over(tightenings, asked.rows, path) if tightenings else None,
        own_tightening=own_tightening,
        position_path=tuple(k for k, limit in enumerate(asked.rows) if _is_given_with_pose(limit)),
        passed=_passed_rows(problem, asked),
        peak=None if least_limit or not objective.has("peak_effort") else objective.weight("peak_effort") / value,
        endpoint=endpoint,
        endpoint_bounds=np.zeros((endpoint.n_rows if endpoint else 0, 2)),
        endpoint_parameters=places,
    )


def _node_terms(problem: Problem, limits: tuple[Limit, ...], *, least_limit: bool) -> NodeTerms:
    """Return the terms that are evaluated at a node."""
    passed = {(index, axis) for waypoint in problem.motion.waypoints for index, axis, _ in waypoint.open_coordinates}
    at_nodes = tuple(limit for limit in limits if limit.rows.node is not None or limit.rows.n_unknowns)
    costs = () if least_limit else problem.objective.extra
    return NodeTerms(
        running=() if least_limit else tuple(term for term in problem.objective.terms.values() if term.exact is None),
        limits=at_nodes,
        passed=tuple(sorted(passed)),
        has_jerk=any(limit.rows.jerk for limit in at_nodes) or any(jerk_of(cost, problem.mechanism) for cost in costs),
    )


def _passed_rows(problem: Problem, asked: NodeTerms) -> tuple[tuple[int, int, float], ...]:
    """Return (phase boundary, path quantity, value) for each coordinate that a waypoint prescribes."""
    first = len(asked.rows)
    return tuple(
        (k + 1, first + asked.passed.index((index, axis)), scaled_coordinate(problem.mechanism, index, axis, at))
        for k, waypoint in enumerate(problem.motion.waypoints)
        for index, axis, at in waypoint.open_coordinates
    )


def _is_given_with_pose(limit: Limit) -> bool:
    return limit.facts.of_position and not limit.facts.at_given_poses


def _interval_rows(
    problem: Problem,
    scales: Scales,
    limits: tuple[Limit, ...],
    first_unknown: int,
    costs: tuple[str, ...],
    tightenings: tuple[Tightening, ...],
) -> tuple[IntervalRows, dict[str, np.ndarray], dict[str, Callable[[np.ndarray], np.ndarray]]]:
    """Return an interval's own rows, their bounds by kind, and by kind the tightening of the enclosed ones."""
    fields: dict[str, list] = {}
    bounds: dict[str, list] = {}
    enclosed: dict[str, list[Limit]] = {}
    for limit in limits:
        rows = limit.rows
        unknowns = tuple(range(first_unknown, first_unknown + rows.n_unknowns))
        first_unknown += rows.n_unknowns
        if rows.interval is not None:
            name, entry = rows.interval(unknowns)
            fields.setdefault(name, []).append(entry)
            bounds.setdefault(limit.key, []).append(limit.bounds(problem, scales))
            if limit.facts.enclosable:
                enclosed.setdefault(limit.key, []).append(limit)
    at_nodes = [limit for limit in limits if limit.rows.node is not None]
    own_rows = IntervalRows(
        costs=costs,
        jerk_path=tuple(k for k, limit in enumerate(at_nodes) if limit.rows.jerk),
        smooth_columns=smooth_columns(problem),
        open_end_path=tuple(k for k, limit in enumerate(at_nodes) if limit.facts.jumps_with_effort),
        **{field: tuple(entries) for field, entries in fields.items()},
    )
    own = {kind: np.array(of_kind).reshape(-1, 2) for kind, of_kind in bounds.items()}
    tightened = enclosed if tightenings else {}
    return own_rows, own, {kind: tightening_over(tightenings, rows, own[kind]) for kind, rows in tightened.items()}


def tie_weights(problem: Problem, ties: float) -> np.ndarray:
    """Return the weights (n_u,) of the squared efforts' integrals [SI] that break ties, each by its limit and 1 / n_u.

    They are zero for actuators without a limit, for one degree of freedom, which has no ties, and for objectives without
    time or with a term of squared efforts.
    """
    largest = np.abs(effort_bounds(problem)).max(axis=1)
    limited = np.isfinite(largest) & (largest > 0)
    if (
        not ties
        or problem.mechanism.dof == 1
        or not problem.objective.has("time")
        or problem.objective.efforts("bend", "smooth")
    ):
        return np.zeros(len(largest))
    weight = ties * problem.objective.weight("time") / len(largest)
    return np.where(limited, weight / np.where(limited, largest, 1.0) ** 2, 0.0)


def _exact_costs(
    problem: Problem, scales: Scales, smoothing: float | None, value: float, ties: float
) -> dict[str, np.ndarray]:
    """Return the exactly integrated costs of an interval, with their weights on the scaled unknowns."""
    found: dict[str, Any] = {}  # a value, or one for each actuator
    for name, term in problem.objective.terms.items():
        if term.exact is not None:
            weights = problem.objective.weight(name) * term.size(scales, problem.motors) / value
            found[term.exact] = found.get(term.exact, 0.0) + weights
    weights = tie_weights(problem, ties)
    if np.any(weights):
        found["effort"] = weights * scales.time_s * scales.effort**2 / value
    if smoothing is not None:
        found["effort_rate"] = found.get("effort_rate", 0.0) + np.full(problem.mechanism.n_u, smoothing)
    return {cost: found[cost] for cost in COSTS if cost in found}


def _theta(problem: Problem, asked: NodeTerms, scales: Scales, value: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function from times (n, m) [s] to node parameters (n, m, n_theta)."""
    before, after = node_numbers(problem, asked, scales, value)

    def theta(times: np.ndarray) -> np.ndarray:
        n, m = times.shape
        parts = [np.broadcast_to(before, (n, m, len(before)))]
        if asked.tracked:
            parts.append(problem.reference.derivative(times.ravel()).reshape(n, m, -1) / scales.position)
        parts.append(np.broadcast_to(after, (n, m, len(after))))
        parts += [forces.reshape(n, m, -1) for forces in problem.mechanism.forces_at(times.ravel())]
        return np.concatenate(parts, axis=2)

    return theta


def _advance(problem: Problem, scales: Scales, returns: tuple[int, ...]) -> np.ndarray | float:
    """Return the scaled difference between end and start of the periodic states `returns`."""
    if problem.motion.turns is None:
        return 0.0
    return np.concatenate([problem.motion.advance / scales.position, np.zeros(problem.mechanism.dof)])[list(returns)]


def phase_boundaries_of(problem: Problem, scales: Scales) -> tuple[PhaseBoundary, ...]:
    """Return the phase boundaries, scaled: start, the middle of a periodic motion between two poses, waypoints, goal."""
    motion, n_s = problem.motion, problem.mechanism.dof
    unit = np.concatenate([scales.position, scales.position / scales.time_s])

    def boundary(s, v, time: tuple[float, float], share: float | None = None, free_at_end=False) -> PhaseBoundary:
        state = np.full((2 * n_s, 2), [-np.inf, np.inf])
        for value, place in ((s, slice(0, n_s)), (v, slice(n_s, None))):
            if value is not None:
                asked = np.asarray(value, dtype=float) / unit[place]
                given = ~np.isnan(asked) & ~(problem.free_at_end & free_at_end)
                state[place][given] = asked[given, None]
        return PhaseBoundary(state=state, time=(time[0] / scales.time_s, time[1] / scales.time_s), share=share)

    if motion.duration_s is not None:
        last = (motion.duration_s, motion.duration_s)
    else:
        last = (motion.min_duration_s or 0.0, motion.max_duration_s or np.inf)
    via = []
    for waypoint in motion.waypoints:
        time = (0.0, np.inf) if waypoint.time_s is None else (waypoint.time_s, waypoint.time_s)
        via.append(boundary(waypoint.position, waypoint.speed, time))
    if motion.ends_at_goal:
        rest = np.zeros(n_s)
        start = boundary(motion.start, rest if motion.start_speed is None else motion.start_speed, (0.0, 0.0))
        position, speed = (None if motion.goal_is_free else motion.goal), motion.goal_speed
        goal = boundary(position, rest if speed is None else speed, last, free_at_end=True)
        return (start, *via, goal)
    start, goal = boundary(_first_position(problem), None, (0.0, 0.0)), boundary(None, None, last)
    if motion.goal is not None and not via:
        via = [boundary(motion.goal, None, (0.0, np.inf), share=0.5, free_at_end=True)]
    return (start, *via, goal)


def _freed(boundaries: tuple[PhaseBoundary, ...], free_ends: np.ndarray | None) -> tuple[PhaseBoundary, ...]:
    """Return phase boundaries with free states (2, 2 n_s) at start and goal."""
    if free_ends is None:
        return boundaries
    changed = list(boundaries)
    for at, free in zip((0, -1), free_ends, strict=True):
        state = np.where(free[:, None], [-np.inf, np.inf], changed[at].state)
        changed[at] = replace(changed[at], state=state)
    return tuple(changed)


def _first_position(problem: Problem) -> np.ndarray | None:
    """Return the start positions (n_s,) of a periodic motion, NaN where they are free; None if all are free.

    A joint that turns continuously passes every angle, so its motion may begin at any angle; it begins at home. The same
    holds for a spin that affects nothing else.
    """
    motion = problem.motion
    home = problem.mechanism.home[problem.mechanism.independent]
    if motion.start is not None or not (np.any(problem.free_spins) or (motion.turns is not None and not motion.waypoints)):
        return motion.start
    first = np.where(problem.free_spins, home, np.nan)
    if motion.turns is not None and not motion.waypoints:
        column = int(np.flatnonzero(motion.turns)[0])
        first[column] = home[column]
    return first
