"""Optimal control of any ordinary differential equation: a user's own dynamics for the same transcription as mechanisms'.

x' = f(x, u, p, t),   J = phi(x_0, x_T, T, p) + int L(x, u, p, t) dt,   c(x, u, p, t) and psi(x_0, x_T, T, p) within limits
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import casadi as ca
import numpy as np
from msgspec import Meta

from linkplan.models.errors import ProblemError, one_line
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.limits import exact_bounds, free_bounds
from linkplan.planner.problem.settings import DERIVED, MeshSettings, SolverSettings, frozen, number, to_toml_types

# (x, u, p, t) -> a column; x (n_x,), u (n_u,), p (n_p,) and t are CasADi SX.
AtInstant = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], object]
# (x at the start, x at the end, duration, p) -> a column.
AtEnds = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], object]
_AT_ENDS = ("final_cost", "ends")
_SHARE: Any = Annotated[float, Meta(gt=0, le=1)]
_ROWS = ("start", "goal", "effort_limit", "state_limit", "path_limit", "ends_limit")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class StateGuess:
    """A motion to start from: states (n, n_x) and, where given, efforts (n, n_u) at equal times, and a duration [s]."""

    state: np.ndarray
    effort: np.ndarray | None = None
    duration_s: float | None = None

    def __post_init__(self) -> None:
        if self.duration_s is not None:
            number(self.duration_s, "a guess's duration_s", positive=True)
        for name in ("state", "effort"):
            if getattr(self, name) is None:
                continue
            rows = frozen(_array(f"a guess's {name}", getattr(self, name)))
            if rows.ndim != 2 or len(rows) < 2 or not np.all(np.isfinite(rows)):
                raise ProblemError(f"a guess's {name} must be two or more finite rows, got shape {rows.shape}")
            object.__setattr__(self, name, rows)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OdeProblem:
    """An optimal-control problem over a differential equation.

    `rate` is f, and the cost L and the path c go with it: callables, or CasADi functions, of (x, u, p, t). `final_cost` phi
    and `ends` psi are functions of (x_0, x_T, T, p). `start` and `goal` have a value for each state, NaN where it is free,
    or [low, high] rows. `duration_s` is a number, or (low, high) where it is free. `effort_limit` (n_u, 2), `state_limit`
    (n_x, 2), `path_limit` and `ends_limit` have [low, high] rows, infinite where there is none. `returns` are states that
    end at their initial values. `guesses` are motions to start from; then comes a straight line between the given values of
    start and goal. `tolerance` is on the state after integration, relative to each state's size; `objective_tolerance` on
    the objective's change from one mesh to the next, relative: None asks for 1e-6 where that is cheap. Mesh and solver
    settings mean what they do for mechanisms, tolerance_deg apart; `solver.starts` must be 1, because there is no search
    beyond the guesses.

    Example::

        cart = linkplan.OdeProblem(
            name="cart",
            rate=lambda x, u, p, t: [x[1], u[0]],
            start=[0, 0],
            goal=[1, 0],
            effort_limit=[[-1, 1]],
            duration_s=(0.1, 9.0),
            final_cost=lambda x_0, x_T, T, p: T,
        )
        print(linkplan.solve_ocp(cart).duration_s)  # 2 s
    """

    name: str
    rate: AtInstant
    start: np.ndarray
    goal: np.ndarray
    effort_limit: np.ndarray
    duration_s: float | tuple[float, float]
    running_cost: AtInstant | None = None
    final_cost: AtEnds | None = None
    path: AtInstant | None = None
    path_limit: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    ends: AtEnds | None = None
    ends_limit: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    state_limit: np.ndarray = DERIVED
    returns: Sequence[int] = ()
    parameters: np.ndarray = field(default_factory=lambda: np.zeros(0))
    guesses: Sequence[StateGuess] = ()
    states: Sequence[str] = ()
    efforts: Sequence[str] = ()
    tolerance: float = 1e-8
    objective_tolerance: float | None = None
    mesh: MeshSettings = field(default_factory=MeshSettings)
    solver: SolverSettings = field(default_factory=SolverSettings)
    functions: dict[str, ca.Function] = field(init=False, repr=False)  # see `_function`

    def __post_init__(self) -> None:
        rows = {name: _rows(name, getattr(self, name)) for name in _ROWS if getattr(self, name) is not None}
        n_x, n_u = len(rows["start"]), len(rows["effort_limit"])
        limit, parameters = rows.setdefault("state_limit", free_bounds(n_x)), np.ravel(_array("parameters", self.parameters))
        duration = _array("duration_s", self.duration_s).ravel()
        _check(
            (n_x == len(rows["goal"]) > 0, f"start and goal have one value a state, got {n_x} and {len(rows['goal'])}"),
            (len(limit) == n_x, f"state_limit has one [low, high] for each of {n_x} states, got {len(limit)}"),
            (n_u > 0, "effort_limit has one [low, high] for each effort; a problem has at least one"),
            (np.all(np.isfinite(parameters)), f"parameters must be finite numbers, got {parameters}"),
            (
                len(duration) in (1, 2) and 0 <= duration[0] <= duration[-1] > 0 and np.isfinite(duration[0]),
                f"duration_s must be a positive number, or (low, high) with 0 <= low < high, got {self.duration_s!r}",
            ),
        )
        values: dict[str, Any] = {name: frozen(value) for name, value in (rows | {"parameters": parameters}).items()}
        values |= {"returns": tuple(self.returns), "guesses": tuple(self.guesses)}
        for name, n in (("states", n_x), ("efforts", n_u)):
            values[name] = tuple(getattr(self, name)) or tuple(f"{name[:-1]}{i}" for i in range(n))
            _check((len(values[name]) == n, f"{name} has {n} names, got {len(values[name])}"))
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._check_items()
        self._check_settings()
        functions = {name: self._function(name) for name in ("rate", "running_cost", "path", *_AT_ENDS)}
        object.__setattr__(self, "functions", functions)

    def varied(self, **values: Any) -> "OdeProblem":
        """Return the problem with other values."""
        return replace(self, **values)

    def _check_items(self) -> None:
        """Refuse unknown state indices, guesses of a wrong size, and boundary states beyond their limits."""
        n_x, n_u = self.n_x, self.n_u
        states = all(isinstance(i, int | np.integer) and 0 <= i < n_x for i in self.returns)
        _check((states, f"returns must be states from 0 to {n_x - 1}, got {list(self.returns)}"))
        for guess in self.guesses:
            _check((isinstance(guess, StateGuess), f"guesses must be {__name__}.StateGuess objects, got {guess!r}"))
            fits = guess.state.shape[1] == n_x and (guess.effort is None or guess.effort.shape[1] == n_u)
            _check((fits, f"a guess has {n_x} states and {n_u} efforts, got {guess.state.shape[1]} states"))
        for what, rows in (("start", self.start), ("goal", self.goal)):
            for name, (low, high), (least, most) in zip(self.states, rows, self.state_limit, strict=True):
                end = low if low > most else high
                legal = f"beyond its limits {least:g} to {most:g}"
                _check((least <= high and low <= most, f"{what} asks for {name} = {end:g}, {legal}"))

    def _check_settings(self) -> None:
        """Refuse meaningless tolerances and settings, and a problem without a rate or a cost."""
        for name, kind in (("mesh", MeshSettings), ("solver", SolverSettings)):
            given = getattr(self, name)
            _check((isinstance(given, kind), f"{name} must be a {kind.__module__}.{kind.__name__}, got {given!r}"))
        starts = self.solver.starts
        _check(
            (starts == 1, f"solver.starts must be 1 for a differential equation, got {starts}: give `guesses`"),
            (self.rate is not None, "rate must be a function of (x, u, p, t), got None"),
            (
                self.running_cost is not None or self.final_cost is not None,
                "a problem needs running_cost, final_cost or both: otherwise no motion is the best",
            ),
        )
        for name in ("tolerance", "objective_tolerance"):
            if name == "tolerance" or self.objective_tolerance is not None:
                read(_SHARE, to_toml_types(getattr(self, name)), name)

    def _function(self, name: str) -> ca.Function:
        """Return `rate`, `running_cost` or `path` of (x, u, p, t), or `final_cost` or `ends` of (x_0, x_T, T, p).

        A missing cost is zero; a missing path, or missing ends, have no values.
        """
        n_x, n_p, given = self.n_x, len(self.parameters), getattr(self, name)
        of, sizes = "x, u, p, t", (n_x, self.n_u, n_p, 1)
        if name in _AT_ENDS:
            of, sizes = "x at the start, x at the end, duration, p", (n_x, n_x, 1, n_p)
        symbols = [ca.SX.sym(f"a{i}", n) for i, n in enumerate(sizes)]
        try:
            value = ca.SX.zeros(name.endswith("cost"), 1) if given is None else given(*symbols)
            column = ca.vec(ca.vertcat(*value) if isinstance(value, list | tuple) else ca.SX(value))
            function = ca.Function(name, symbols, [ca.densify(column)])
        except Exception as error:  # any error of a user's function is reported with the function's name
            raise ProblemError(
                f"{name} of '{self.name}' cannot be written in CasADi's SX: {type(error).__name__}: {one_line(error)}"
            ) from error
        n = {"rate": n_x, "path": len(self.path_limit), "ends": len(self.ends_limit)}.get(name, 1)
        _check((column.numel() == n, f"{name} gives {n} values of ({of}), got {column.numel()}"))
        return function

    @property
    def n_x(self) -> int:
        """The number of states."""
        return len(self.start)

    @property
    def n_u(self) -> int:
        """The number of efforts."""
        return len(self.effort_limit)

    @property
    def duration(self) -> tuple[float, float]:
        """The bounds on the duration [s], equal if it is given."""
        bounds = np.ravel(self.duration_s)
        return float(bounds[0]), float(bounds[-1])

    def along(self, name: str, x: np.ndarray, u: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return `rate`, `running_cost` or `path` (n, n_values) at states (n, n_x), efforts (n, n_u) and times (n,)."""
        return np.array(self.functions[name](x.T, u.T, self.parameters, time[None])).reshape(-1, len(time)).T

    def at_ends(self, name: str, first: np.ndarray, last: np.ndarray, duration_s: float) -> np.ndarray:
        """Return `final_cost` or `ends` (n_values,) of the first and the last state (n_x,) and the duration [s]."""
        return np.array(self.functions[name](first, last, duration_s, self.parameters)).ravel()


def _check(*rules: tuple[Any, str]) -> None:
    """Refuse a problem with the sentence of the first rule that does not hold."""
    for holds, sentence in rules:
        if not holds:
            raise ProblemError(sentence)


def _rows(name: str, given: object) -> np.ndarray:
    """Return [low, high] rows (n, 2); a value may stand for a row of start and goal, NaN where it is free."""
    array, one = _array(name, given), "one [low, high] a row"
    if name in ("start", "goal"):
        one = "one value, or [low, high], a state"
        array = np.column_stack(exact_bounds(array)) if array.ndim == 1 else array
    array = array if array.size else free_bounds(0)
    _check((array.ndim == 2 and array.shape[1] == 2, f"{name} has {one}, got shape {array.shape}"))
    low, high = array.T
    legal = np.all((low <= high) & (low < np.inf) & (high > -np.inf))
    _check((legal, f"{name} has rows [low, high] with low <= high, got {array.tolist()}"))
    return array


def _array(name: str, value: object) -> np.ndarray:
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ProblemError(f"{name} must be numbers, got {value!r}") from error
