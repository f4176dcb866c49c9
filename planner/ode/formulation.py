"""A user's differential equation as a formulation: its system at a node, units, bounds, and a start."""

import casadi as ca
import numpy as np
from scipy.interpolate import PchipInterpolator

from linkplan.planner.limits.limit import Tightened
from linkplan.planner.ode.problem import CompletedGuess, OdeProblem, StateGuess
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.refinement.marking import TightenedRow, Tightening, tightening_over
from linkplan.planner.transcription.formulation import Formulation, PhaseBoundary, Start, Units
from linkplan.planner.transcription.interval import IntervalRows
from linkplan.planner.transcription.system import Endpoint, System, node_symbols

# The smallest unit of a state as a share of the largest number seen: a smaller one would enlarge a state that does not
# matter.
_MIN_UNIT_SHARE = 1e-8


def depends_on_time(problem: OdeProblem) -> bool:
    """True if f, L or c depends on t: time is then a state of its own."""
    for name in ("rate", "running_cost", "path"):
        function = problem.at_instant(name)
        if function.numel_out(0) and function.sparsity_jac(3, 0).nnz():
            return True
    return False


def units_of(problem: OdeProblem, guess: CompletedGuess) -> Units:
    """Return units of order one: sizes in the guess, at the ends, of finite limits; the objective's along the guess."""
    with np.errstate(invalid="ignore"):
        ends = np.abs(np.hstack([problem.start, problem.goal]))
        size = np.where(np.isfinite(ends), ends, 0.0).max(axis=1)
        size = np.maximum(size, np.abs(guess.state).max(axis=0))
        span = problem.state_limit[:, 1] - problem.state_limit[:, 0]
    size = np.where(size > _MIN_UNIT_SHARE, size, np.where(np.isfinite(span) & (span > 0), span, 1.0))
    effort = np.where(np.isfinite(problem.effort_limit), np.abs(problem.effort_limit), 0.0).max(axis=1)
    guessed = np.abs(guess.effort).max(axis=0)
    effort = np.where(guessed > _MIN_UNIT_SHARE, np.where(effort > 0, np.minimum(effort, guessed), guessed), effort)
    effort = np.where(effort > 0, effort, 1.0)
    T = guess.duration_s
    if depends_on_time(problem):
        size = np.append(size, T)
    # The cost of a motion of these sizes: of the guess, with efforts of their unit where it has none.
    times = np.linspace(0.0, T, len(guess.state))
    of = np.linspace(0.0, T, len(guess.effort))
    u = np.column_stack([np.interp(times, of, column) for column in guess.effort.T])
    u = np.where(np.abs(u).max(axis=0) > 0, u, effort)
    cost = 0.0
    if problem.running_cost is not None:
        running = problem.at_instant("running_cost")(guess.state.T, u.T, problem.parameters, times[None])
        cost += T * float(np.mean(np.abs(np.array(running))))
    if problem.final_cost is not None:
        cost += abs(float(problem.at_ends("final_cost")(guess.state[0], guess.state[-1], T, problem.parameters)))
    cost = cost if np.isfinite(cost) and cost > _MIN_UNIT_SHARE else 1.0
    return Units(time_s=T, state=size, effort=effort, objective=cost)


def formulate_ode(
    problem: OdeProblem,
    units: Units,
    *,
    state_rows: bool = False,
    least_limit: bool = False,
    tightenings: tuple[Tightening, ...] = (),
) -> Formulation:
    """Return a problem's formulation.

    Args:
        problem: what to solve.
        units: of its unknowns.
        state_rows: whether limited states are kept between the nodes by constraint rows.
        least_limit: leave the objective out: only a motion is sought.
        tightenings: how far path limits are tightened over the motion, where it overran them between nodes.
    """
    timed = depends_on_time(problem)
    n_x, X = problem.n_x + timed, units.state
    state = np.vstack([problem.state_limit, free_bounds(int(timed))])
    start = np.vstack([problem.start, np.zeros((int(timed), 2))])
    goal = np.vstack([problem.goal, free_bounds(int(timed))])
    limited = tuple(int(i) for i in np.flatnonzero(np.isfinite(state).any(axis=1)))
    low, high = problem.duration
    p = problem.parameters
    endpoint = _endpoint(problem, units, timed, least_limit)
    rows = [TightenedRow("path", k, Tightened.BY_SHARE) for k in range(len(problem.path_limit))]
    tightening = tightening_over(tightenings, rows, problem.path_limit)

    def theta(times: np.ndarray) -> np.ndarray:
        return np.broadcast_to(p, (*times.shape, len(p)))

    return Formulation(
        build_system=lambda: _system(problem, units, timed, least_limit),
        n_s=0,
        n_x=n_x,
        n_z=0,
        n_u=problem.n_u,
        rows=IntervalRows(state_columns=limited if state_rows else (), open_end_path=_open_end_path(problem)),
        units=units,
        state=state / X[:, None],
        algebraic=np.zeros((0, 2)),
        effort=problem.effort_limit,
        path=problem.path_limit,
        own={"state": (state / X[:, None])[list(limited)]},
        boundaries=(
            PhaseBoundary(state=start / X[:, None], time=(0.0, 0.0)),
            PhaseBoundary(state=goal / X[:, None], time=(low / units.time_s, high / units.time_s)),
        ),
        returns=tuple(problem.returns),
        smooth=False,
        eta=np.zeros(0),
        theta=theta,
        tightening=tightening,
        endpoint=endpoint,
        endpoint_bounds=np.array(problem.ends_limit),
        endpoint_parameters=p if endpoint is not None else np.zeros(0),
    )


def _open_end_path(problem: OdeProblem) -> tuple[int, ...]:
    """Return the path quantities with effort in them, but for equalities: of those the nodes bear as many as they can."""
    path, limit = problem.at_instant("path"), problem.path_limit
    if not len(limit):
        return ()
    jumping = np.unique(np.array(path.sparsity_jac(1, 0).get_triplet()[0], dtype=int))
    return tuple(int(i) for i in jumping if limit[i, 0] < limit[i, 1])


def _system(problem: OdeProblem, units: Units, timed: bool, least_limit: bool) -> System:
    n = problem.n_x
    node = node_symbols(0, n + timed, 0, problem.n_u)
    p = ca.SX.sym("p", len(problem.parameters))
    X, T = ca.DM(units.state), units.time_s
    x, u = node.x * X, node.u * ca.DM(units.effort)
    at = (x[:n], u, p, x[n] if timed else ca.SX(0))
    rate = problem.at_instant("rate")(*at)
    rate = ca.vertcat(rate, 1.0) if timed else rate
    path = problem.at_instant("path")(*at)
    running = ca.SX(0)
    if problem.running_cost is not None and not least_limit:
        # The program multiplies by an interval's scaled width, and the objective by its unit.
        running = problem.at_instant("running_cost")(*at) * T / units.objective
    column = ca.densify(ca.vertcat(node.r - rate * T / X, path, running))
    return System(
        n_s=0,
        n_x=n + timed,
        n_z=0,
        n_u=problem.n_u,
        node=ca.Function("node", [node.stacked, p], [column]),
        n_equations=n + timed,
        n_path=path.numel(),
        kinds=("dynamics",) * (n + timed) + ("path",) * path.numel(),
    )


def _endpoint(problem: OdeProblem, units: Units, timed: bool, least_limit: bool) -> Endpoint | None:
    if problem.ends is None and (problem.final_cost is None or least_limit):
        return None
    n = problem.n_x
    first, last, T = (ca.SX.sym(name, k) for name, k in (("first", n + timed), ("last", n + timed), ("T", 1)))
    p, X = ca.SX.sym("p", len(problem.parameters)), ca.DM(units.state)
    at = ((first * X)[:n], (last * X)[:n], T * units.time_s, p)
    rows, cost = problem.at_ends("ends")(*at), ca.SX(0)
    if problem.final_cost is not None and not least_limit:
        cost = problem.at_ends("final_cost")(*at) / units.objective
    function = ca.Function("endpoint", [first, last, T, p], [ca.densify(ca.vertcat(rows, cost))])
    return Endpoint(function=function, n_rows=rows.numel())


def straight_guess(problem: OdeProblem) -> CompletedGuess:
    """Return the straight line between the given values of start and goal, with efforts in the middle of their limits."""
    ends = []
    for rows, other in ((problem.start, problem.goal), (problem.goal, problem.start)):
        ends.append([_middle(row, _middle(over, 0.0)) for row, over in zip(rows, other, strict=True)])
    limit = np.array(problem.state_limit)
    state = np.clip(np.linspace(ends[0], ends[1], 21), limit[:, 0], limit[:, 1])
    return completed(problem, StateGuess(state=state))


def _middle(row: np.ndarray, otherwise: float) -> float:
    """Return the middle of [low, high], its finite end, or something else where it has none."""
    low, high = row
    if np.isfinite(low) and np.isfinite(high):
        return 0.5 * (low + high)
    return float(low if np.isfinite(low) else high if np.isfinite(high) else otherwise)


def completed(problem: OdeProblem, guess: StateGuess) -> CompletedGuess:
    """Return a guess with efforts and a duration, where it lacks them."""
    low, high = problem.duration
    duration = guess.duration_s
    if duration is None:
        duration = 0.5 * (low + high) if high < 100 * low else 1.0
    duration = float(np.clip(duration, low, high))
    effort = guess.effort
    if effort is None:
        effort = np.tile([_middle(row, 0.0) for row in problem.effort_limit], (len(guess.state), 1))
    return CompletedGuess(state=guess.state, effort=effort, duration_s=duration)


def start_of(guess: CompletedGuess, units: Units) -> Start:
    """Return a completed guess as a scaled start: monotone cubics through its rows."""
    times = [np.linspace(0.0, guess.duration_s, len(rows)) for rows in (guess.state, guess.effort)]
    state, effort = PchipInterpolator(times[0], guess.state), PchipInterpolator(times[1], guess.effort)
    timed = len(units.state) > guess.state.shape[1]

    def carried(values: np.ndarray, clock: np.ndarray) -> np.ndarray:
        return np.column_stack([values, clock]) if timed else values

    def nodes(at: np.ndarray):
        at = np.clip(at, 0.0, guess.duration_s)
        rates = carried(state.derivative()(at), np.ones_like(at)) * units.time_s / units.state
        return np.zeros((len(at), 0)), rates, np.zeros((len(at), 0)), effort(at)

    return Start(states=lambda at: carried(state(np.clip(at, 0.0, guess.duration_s)), at) / units.state, nodes=nodes)


def start_from(curves: OdeTrajectory, units: Units) -> Start:
    """Return a solution's polynomials as a scaled start on another mesh."""

    def nodes(at: np.ndarray):
        rates = curves.rate_at(at) * units.time_s / units.state
        return np.zeros((len(at), 0)), rates, np.zeros((len(at), 0)), curves.effort_at(at)

    return Start(states=lambda at: curves.full_state_at(at) / units.state, nodes=nodes)
