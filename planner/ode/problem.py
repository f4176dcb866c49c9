"""Optimal control of any ordinary differential equation: a user's own dynamics for the same transcription as mechanisms'.

x' = f(x, u, p, t),   J = phi(x_0, x_T, T, p) + int L(x, u, p, t) dt,   c(x, u, p, t) and psi(x_0, x_T, T, p) within limits
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import casadi as ca
import numpy as np
from msgspec import Meta

from linkplan.models.errors import ProblemError, one_line
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.problem.settings import DERIVED, MeshSettings, SolverSettings, frozen, number, to_toml_types

# (x, u, p, t) -> a column; x (n_x,), u (n_u,), p (n_p,) and t are CasADi SX.
AtInstant = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], object]
# (x at the start, x at the end, duration, p) -> a column.
AtEnds = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], object]
_AT_ENDS = ("final_cost", "ends")


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

    def __post_init__(self) -> None:
        self._freeze_arrays()
        self._check_lists()
        self._check_settings()
        for name in ("rate", "running_cost", "path", *_AT_ENDS):  # functions with a wrong number of values
            n = {"rate": self.n_x, "path": len(self.path_limit), "ends": len(self.ends_limit)}.get(name, 1)
            got = self.function(name).numel_out(0)
            if got != n:
                of = "x at the start, x at the end, duration, p" if name in _AT_ENDS else "x, u, p, t"
                raise ProblemError(f"{name} gives {n} values of ({of}), got {got}")

    def _freeze_arrays(self) -> None:
        """Store start, goal, limits and parameters as arrays that cannot be changed, and refuse other shapes."""
        ends = {name: _rows(name, getattr(self, name), values=True) for name in ("start", "goal")}
        n_x = len(ends["start"])
        if len(ends["goal"]) != n_x or n_x == 0:
            raise ProblemError(f"start and goal have one value a state, got {n_x} and {len(ends['goal'])}")
        limits = {name: _rows(name, getattr(self, name)) for name in ("effort_limit", "path_limit", "ends_limit")}
        limits["state_limit"] = free_bounds(n_x) if self.state_limit is None else _rows("state_limit", self.state_limit)
        parameters = np.ravel(_array("parameters", self.parameters))
        for name, value in (ends | limits | {"parameters": parameters}).items():
            object.__setattr__(self, name, frozen(value))
        if len(self.state_limit) != n_x:
            raise ProblemError(f"state_limit has one [low, high] for each of {n_x} states, got {len(self.state_limit)}")
        if self.n_u == 0:
            raise ProblemError("effort_limit has one [low, high] for each effort; a problem has at least one")
        if not np.all(np.isfinite(parameters)):
            raise ProblemError(f"parameters must be finite numbers, got {parameters}")

    def _check_lists(self) -> None:
        """Refuse names, indices and guesses of other numbers of states; number states and efforts without names."""
        n_x, n_u = self.n_x, self.n_u
        for name, n in (("states", n_x), ("efforts", n_u)):
            labels = tuple(getattr(self, name)) or tuple(f"{name[:-1]}{i}" for i in range(n))
            if len(labels) != n:
                raise ProblemError(f"{name} has {n} names, got {len(labels)}")
            object.__setattr__(self, name, labels)
        object.__setattr__(self, "returns", tuple(self.returns))
        object.__setattr__(self, "guesses", tuple(self.guesses))
        if any(not isinstance(i, int | np.integer) or not 0 <= i < n_x for i in self.returns):
            raise ProblemError(f"returns must be states from 0 to {n_x - 1}, got {list(self.returns)}")
        for guess in self.guesses:
            if not isinstance(guess, StateGuess):
                raise ProblemError(f"guesses must be {StateGuess.__module__}.StateGuess objects, got {guess!r}")
            if guess.state.shape[1] != n_x or (guess.effort is not None and guess.effort.shape[1] != n_u):
                raise ProblemError(f"a guess has {n_x} states and {n_u} efforts, got {guess.state.shape[1]} states")
        for what, rows in (("start", self.start), ("goal", self.goal)):
            for name, (low, high), (least, most) in zip(self.states, rows, self.state_limit, strict=True):
                if low > most or high < least:
                    asked = low if low > most else high
                    raise ProblemError(f"{what} asks for {name} = {asked:g}, beyond its limits {least:g} to {most:g}")

    def _check_settings(self) -> None:
        """Refuse meaningless durations, tolerances and settings, and a problem without a rate or a cost."""
        low, high = self.duration
        if not (0 <= low <= high and high > 0 and np.isfinite(low)):
            raise ProblemError(
                f"duration_s must be a positive number, or (low, high) with 0 <= low < high, got {self.duration_s!r}"
            )
        for name, kind in (("mesh", MeshSettings), ("solver", SolverSettings)):
            if not isinstance(getattr(self, name), kind):
                raise ProblemError(f"{name} must be a {kind.__module__}.{kind.__name__}, got {getattr(self, name)!r}")
        if self.solver.starts != 1:
            got = f"got {self.solver.starts}: give `guesses`"
            raise ProblemError(f"solver.starts must be 1 for a differential equation, {got}")
        share: Any = Annotated[float, Meta(gt=0, le=1)]
        read(share, to_toml_types(self.tolerance), "tolerance")
        if self.objective_tolerance is not None:
            read(share, to_toml_types(self.objective_tolerance), "objective_tolerance")
        if self.rate is None:
            raise ProblemError("rate must be a function of (x, u, p, t), got None")
        if self.running_cost is None and self.final_cost is None:
            raise ProblemError("a problem needs running_cost, final_cost or both: otherwise no motion is the best")

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
        given = _array("duration_s", self.duration_s).ravel()
        if len(given) not in (1, 2):
            legal = "a positive number, or (low, high) where it is free"
            raise ProblemError(f"duration_s must be {legal}, got {self.duration_s!r}")
        return float(given[0]), float(given[-1])

    def function(self, name: str) -> ca.Function:
        """Return `rate`, `running_cost` or `path` of (x, u, p, t), or `final_cost` or `ends` of (x_0, x_T, T, p).

        The result is a CasADi function. A missing cost is zero; a missing path, or missing ends, have no values.
        """
        sizes = {"x": self.n_x, "u": self.n_u, "p": len(self.parameters), "t": 1}
        if name in _AT_ENDS:
            sizes = {"x0": self.n_x, "xT": self.n_x, "T": 1, "p": len(self.parameters)}
        symbols = [ca.SX.sym(symbol, n) for symbol, n in sizes.items()]
        given = getattr(self, name)
        try:
            value = ca.SX.zeros(name.endswith("cost"), 1) if given is None else given(*symbols)
            column = ca.vec(ca.vertcat(*value) if isinstance(value, list | tuple) else ca.SX(value))
            return ca.Function(name, symbols, [ca.densify(column)])
        except Exception as error:  # any error of a user's function is reported with the function's name
            raise ProblemError(
                f"{name} of '{self.name}' cannot be written in CasADi's SX: {type(error).__name__}: {one_line(error)}"
            ) from error

    def along(self, name: str, x: np.ndarray, u: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return `rate`, `running_cost` or `path` (n, n_values) at states (n, n_x), efforts (n, n_u) and times (n,)."""
        return np.array(self.function(name)(x.T, u.T, self.parameters, time[None])).reshape(-1, len(time)).T

    def at_ends(self, name: str, first: np.ndarray, last: np.ndarray, duration_s: float) -> np.ndarray:
        """Return `final_cost` or `ends` (n_values,) of the first and the last state (n_x,) and the duration [s]."""
        return np.array(self.function(name)(first, last, duration_s, self.parameters)).ravel()


def _rows(name: str, given: object, *, values: bool = False) -> np.ndarray:
    """Return [low, high] rows (n, 2); with `values` a value may stand for its row, NaN where it is free."""
    array = _array(name, given)
    if values and array.ndim == 1:
        free = np.isnan(array)
        array = np.column_stack([np.where(free, -np.inf, array), np.where(free, np.inf, array)])
    if array.size == 0:
        return np.zeros((0, 2))
    if array.ndim != 2 or array.shape[1] != 2:
        one = "one value, or [low, high], a state" if values else "one [low, high] a row"
        raise ProblemError(f"{name} has {one}, got shape {array.shape}")
    low, high = array.T
    if not np.all((low <= high) & (low < np.inf) & (high > -np.inf)):
        raise ProblemError(f"{name} has rows [low, high] with low <= high, got {array.tolist()}")
    return array


def _array(name: str, value: object) -> np.ndarray:
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ProblemError(f"{name} must be numbers, got {value!r}") from error
