"""A user's differential equation as a formulation: its system at a node, units, bounds, and its starts."""

import casadi as ca
import numpy as np

from linkplan.planner.limits.limit import Tightened
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.refinement.marking import TightenedRow, Tightening, tightening_over
from linkplan.planner.transcription.bernstein import PiecewisePolynomial
from linkplan.planner.transcription.collocation import Curves
from linkplan.planner.transcription.formulation import Formulation, PhaseBoundary, Start, Units
from linkplan.planner.transcription.interval import IntervalRows
from linkplan.planner.transcription.system import Endpoint, System, node_symbols

# The smallest unit: a smaller one would enlarge a state that does not matter.
_MIN_UNIT = 1e-8


def depends_on_time(problem: OdeProblem) -> bool:
    """True if f, L or c depends on t: time is then the last state of the program."""
    return any(problem.function(name).sparsity_jac(3, 0).nnz() for name in ("rate", "running_cost", "path"))


def units_of(problem: OdeProblem, guess: Curves) -> Units:
    """Return units of order one: sizes in the guess, at the ends, of finite limits; the objective's along the guess."""
    times, duration = guess.breaks_s, guess.duration_s
    x, u = guess.state_at(times), guess.effort_at(times)
    limit, guessed = finite_size(problem.effort_limit), finite_size(u.T)
    effort = _first_size(np.minimum(guessed, np.where(limit > 0, limit, np.inf)), limit)
    state = _first_size(
        finite_size(np.hstack([problem.start, problem.goal, x.T])), finite_size(np.diff(problem.state_limit, axis=1))
    )
    # The cost of a motion of these sizes: of the guess, with efforts of their unit where it has none.
    u = np.where(guessed > 0, u, effort)
    cost = duration * np.abs(problem.along("running_cost", x, u, times)).mean()
    cost += abs(problem.at_ends("final_cost", x[0], x[-1], duration)[0])
    return Units(
        time_s=duration,
        state=np.append(state, duration) if depends_on_time(problem) else state,
        effort=effort,
        objective=float(_first_size(finite_size(np.array([[cost]])))[0]),
    )


def finite_size(rows: np.ndarray) -> np.ndarray:
    """Return the largest finite size (n,) in each row (n, m), 0 without one."""
    return np.where(np.isfinite(rows), np.abs(rows), 0.0).max(axis=1, initial=0.0)


def _first_size(*candidates: np.ndarray) -> np.ndarray:
    """Return the first candidate (n,) that is no rounding, else 1."""
    return np.select([size > _MIN_UNIT for size in candidates], candidates, 1.0)


def formulate_ode(
    problem: OdeProblem, units: Units, *, state_rows: bool = False, tightenings: tuple[Tightening, ...] = ()
) -> Formulation:
    """Return a problem's formulation; with `state_rows`, limited states are kept between the nodes by constraint rows."""
    p, X = problem.parameters, units.state[:, None]
    timed = len(X) - problem.n_x  # 1 if time is the last state, else 0
    state = np.vstack([problem.state_limit, free_bounds(timed)]) / X
    start = np.vstack([problem.start, np.zeros((timed, 2))]) / X
    goal = np.vstack([problem.goal, free_bounds(timed)]) / X
    limited = tuple(int(i) for i in np.flatnonzero(np.isfinite(state).any(axis=1)))
    low, high = problem.duration
    endpoint = _endpoint(problem, units)
    rows = [TightenedRow("path", k, Tightened.BY_SHARE) for k in range(len(problem.path_limit))]
    return Formulation(
        build_system=lambda: _system(problem, units),
        n_x=len(units.state),
        n_u=problem.n_u,
        rows=IntervalRows(state_columns=limited if state_rows else (), open_end_path=_open_end_path(problem)),
        units=units,
        state=state,
        effort=problem.effort_limit,
        path=problem.path_limit,
        own={"state": state[list(limited)]},
        boundaries=(
            PhaseBoundary(state=start, time=(0.0, 0.0)),
            PhaseBoundary(state=goal, time=(low / units.time_s, high / units.time_s)),
        ),
        returns=tuple(problem.returns),
        theta=lambda times: np.broadcast_to(p, (*times.shape, len(p))),
        tightening=tightening_over(tightenings, rows, problem.path_limit) if tightenings else None,
        endpoint=endpoint,
        endpoint_bounds=problem.ends_limit,
        endpoint_parameters=p if endpoint is not None else np.zeros(0),
    )


def _open_end_path(problem: OdeProblem) -> tuple[int, ...]:
    """Return the path inequalities that depend on efforts; the nodes carry as many equalities as they can."""
    path, limit = problem.function("path"), problem.path_limit
    jumping = np.unique(np.array(path.sparsity_jac(1, 0).get_triplet()[0], dtype=int))
    return tuple(int(i) for i in jumping if limit[i, 0] < limit[i, 1])


def _system(problem: OdeProblem, units: Units) -> System:
    n, n_state, T = problem.n_x, len(units.state), units.time_s
    node = node_symbols(0, n_state, 0, problem.n_u)
    p = ca.SX.sym("p", len(problem.parameters))
    x, u = node.x * ca.DM(units.state), node.u * ca.DM(units.effort)
    at = (x[:n], u, p, x[n] if n_state > n else ca.SX(0))
    rate = ca.vertcat(problem.function("rate")(*at), ca.SX.ones(n_state - n))  # that of time is one
    path = problem.function("path")(*at)
    # The program multiplies by an interval's scaled width, and the objective by its unit.
    running = problem.function("running_cost")(*at) * T / units.objective
    column = ca.densify(ca.vertcat(node.r - rate * T / ca.DM(units.state), path, running))
    return System(
        n_x=n_state,
        n_u=problem.n_u,
        node=ca.Function("node", [node.stacked, p], [column]),
        n_equations=n_state,
        n_path=path.numel(),
        kinds=("dynamics",) * n_state + ("path",) * path.numel(),
    )


def _endpoint(problem: OdeProblem, units: Units) -> Endpoint | None:
    if problem.ends is None and problem.final_cost is None:
        return None
    sizes = {"first": len(units.state), "last": len(units.state), "T": 1, "p": len(problem.parameters)}
    first, last, T, p = symbols = [ca.SX.sym(name, n) for name, n in sizes.items()]
    X = ca.DM(units.state)
    at = ((first * X)[: problem.n_x], (last * X)[: problem.n_x], T * units.time_s, p)
    rows, cost = problem.function("ends")(*at), problem.function("final_cost")(*at) / units.objective
    return Endpoint(function=ca.Function("endpoint", symbols, [ca.vertcat(rows, cost)]), n_rows=rows.numel())


def guesses_of(problem: OdeProblem) -> list[Curves]:
    """Return the given guesses, then the straight line between the given values of start and goal.

    Each consists of straight lines through the guess's rows, completed by efforts and a duration where it has none.
    """
    ends = zip(problem.start, problem.goal, strict=True)
    line = np.array([[_middle(row, _middle(other, 0.0)) for row, other in (end, end[::-1])] for end in ends])
    line = np.clip(np.linspace(line[:, 0], line[:, 1], 21), *problem.state_limit.T)
    low, high = problem.duration
    usual_s = 0.5 * (low + high) if high < 100 * low else 1.0
    middles, found = [[_middle(row, 0.0) for row in problem.effort_limit]] * 2, []
    for guess in (*problem.guesses, StateGuess(state=line)):
        both = guess.state, np.array(middles) if guess.effort is None else guess.effort
        shares = np.linspace(0.0, 1.0, max(map(len, both)))
        lines = [PiecewisePolynomial(np.stack([y[:-1], y[1:]]), np.linspace(0.0, 1.0, len(y)))(shares) for y in both]
        state, effort = (np.stack([y[:-1], y[1:]]) for y in lines)
        duration = np.clip(usual_s if guess.duration_s is None else guess.duration_s, low, high)
        found.append(Curves(breaks_s=duration * shares, state=state, effort=effort))
    return found


def _middle(row: np.ndarray, otherwise: float) -> float:
    """Return the middle of [low, high], its finite end if only one is finite, or `otherwise` if none is."""
    finite = row[np.isfinite(row)]
    return float(finite.mean()) if len(finite) else otherwise


def start_from(motion: Curves, units: Units) -> Start:
    """Return a motion as a scaled start on any mesh."""
    timed = len(units.state) > motion.state.shape[2]

    def scaled(values: np.ndarray, clock: np.ndarray) -> np.ndarray:
        return (np.column_stack([values, clock]) if timed else values) / units.state

    def nodes(at: np.ndarray):
        rates = scaled(motion.rate_at(at), np.ones(len(at))) * units.time_s
        return np.zeros((len(at), 0)), rates, np.zeros((len(at), 0)), motion.effort_at(at)

    return Start(states=lambda at: scaled(motion.state_at(at), at), nodes=nodes)
