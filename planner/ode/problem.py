"""Optimal control of any ordinary differential equation: a user's own dynamics for the same transcription as mechanisms'.

x' = f(x, u, p, t),   J = phi(x_0, x_T, T, p) + int L(x, u, p, t) dt,   c(x, u, p, t) and psi(x_0, x_T, T, p) within limits
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeGuard

import casadi as ca
import numpy as np

from linkplan.models.errors import ProblemError, one_line
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.problem.settings import DERIVED, MeshSettings, SolverSettings, frozen

# (x, u, p, t) -> a column; x (n_x,), u (n_u,), p (n_p,) and t are CasADi SX.
AtInstant = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], object]
# (x at the start, x at the end, duration, p) -> a column.
AtEnds = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], object]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class StateGuess:
    """A motion to start from: states (n, n_x) and, where given, efforts (n, n_u) at equal times, and a duration [s]."""

    state: np.ndarray
    effort: np.ndarray | None = None
    duration_s: float | None = None

    def __post_init__(self) -> None:
        if self.duration_s is not None and not (_is_number(self.duration_s) and self.duration_s > 0):
            raise ProblemError(f"a guess's duration_s is a positive number, got {self.duration_s!r}")
        for name in ("state", "effort"):
            value = getattr(self, name)
            if value is None:
                continue
            array = frozen(_array(f"a guess's {name}", value))
            if array.ndim != 2 or len(array) < 2 or not np.all(np.isfinite(array)):
                raise ProblemError(f"a guess's {name} is two or more finite rows, got shape {array.shape}")
            object.__setattr__(self, name, array)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class CompletedGuess(StateGuess):
    """A guess with efforts (n, n_u) and a duration [s]."""

    effort: np.ndarray = DERIVED
    duration_s: float = DERIVED


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OdeProblem:
    """An optimal-control problem over a differential equation.

    `rate` is f, and the cost L and the path c go with it: callables, or CasADi functions, of (x, u, p, t). `final_cost`
    phi and
    `ends` psi are of (x_0, x_T, T, p). `start` and `goal` have a value for each state, NaN where it is free, or [low,
    high] rows. `duration_s` is a number, or (low, high) where it is free. `effort_limit` (n_u, 2), `state_limit` (n_x, 2),
    `path_limit` and
    `ends_limit` have [low, high] rows, infinite where there is none. `returns` are states that end as they began. `guesses`
    are motions to start from; then comes a straight line between the given values of start and goal. `tolerance` is on the
    state after integration, relative to each state's size; `objective_tolerance` on the objective's change from one mesh to
    the next, relative: None asks for 1e-6 where that is cheap. Mesh and solver settings mean what they do for mechanisms,
    tolerance_deg and breaks apart.

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
        self._name_states_and_efforts()
        self._check_duration_and_guesses()
        self._check_settings()
        self._check_functions()

    def _freeze_arrays(self) -> None:
        """Store start, goal, limits and parameters as arrays that cannot be changed, and refuse other shapes."""
        start, goal = _rows("start", self.start), _rows("goal", self.goal)
        if start.shape != goal.shape or len(start) == 0:
            raise ProblemError(f"start and goal have one value a state, got {len(start)} and {len(goal)}")
        n_x = len(start)
        limit = free_bounds(n_x) if self.state_limit is None else _limits("state_limit", self.state_limit)
        if len(limit) != n_x:
            raise ProblemError(f"state_limit has one [low, high] for each of {n_x} states, got {len(limit)}")
        parameters = np.ravel(_array("parameters", self.parameters))
        values = {"start": start, "goal": goal, "state_limit": limit, "parameters": parameters}
        values |= {name: _limits(name, getattr(self, name)) for name in ("effort_limit", "path_limit", "ends_limit")}
        for name, value in values.items():
            object.__setattr__(self, name, frozen(value))
        if len(self.effort_limit) == 0:
            raise ProblemError("effort_limit has one [low, high] for each effort; a problem has at least one")
        if not np.all(np.isfinite(self.parameters)):
            raise ProblemError(f"parameters are finite numbers, got {self.parameters}")

    def _name_states_and_efforts(self) -> None:
        """Give states and efforts that have no names their numbers as names."""
        for name, n in (("states", self.n_x), ("efforts", self.n_u)):
            labels = tuple(getattr(self, name)) or tuple(f"{name[:-1]}{i}" for i in range(n))
            if len(labels) != n:
                raise ProblemError(f"{name} has {n} names, got {len(labels)}")
            object.__setattr__(self, name, labels)

    def _check_duration_and_guesses(self) -> None:
        """Refuse a duration, indices of states and guesses that mean nothing."""
        low, high = _duration(self.duration_s)
        if not (0 <= low <= high and high > 0 and np.isfinite(low)):
            raise ProblemError(
                f"duration_s is a positive number, or (low, high) with 0 <= low < high, got {self.duration_s!r}"
            )
        n_x = self.n_x
        object.__setattr__(self, "returns", tuple(self.returns))
        object.__setattr__(self, "guesses", tuple(self.guesses))
        if any(not isinstance(i, int | np.integer) or not 0 <= i < n_x for i in self.returns):
            raise ProblemError(f"returns are states from 0 to {n_x - 1}, got {list(self.returns)}")
        for guess in self.guesses:
            if not isinstance(guess, StateGuess):
                raise ProblemError(f"guesses are {StateGuess.__module__}.StateGuess objects, got {guess!r}")
            wrong = guess.state.shape[1] != n_x or (guess.effort is not None and guess.effort.shape[1] != self.n_u)
            if wrong:
                raise ProblemError(f"a guess has {n_x} states and {self.n_u} efforts, got {guess.state.shape[1]} states")

    def _check_settings(self) -> None:
        """Refuse tolerances and settings that mean nothing, and a problem without a cost."""
        for name, kind in (("mesh", MeshSettings), ("solver", SolverSettings)):
            if not isinstance(getattr(self, name), kind):
                raise ProblemError(f"{name} is a {kind.__module__}.{kind.__name__}, got {getattr(self, name)!r}")
        for name in ("tolerance", "objective_tolerance"):
            value = getattr(self, name)
            if (value is not None or name == "tolerance") and not (_is_number(value) and 0 < value <= 1):
                raise ProblemError(f"{name} is above 0 and at most 1, got {value!r}")
        if self.running_cost is None and self.final_cost is None:
            raise ProblemError("a problem needs running_cost, final_cost or both: otherwise no motion is the best")

    def _check_functions(self) -> None:
        """Refuse functions that give a wrong number of values."""
        if self.rate is None:
            raise ProblemError("rate is a function of (x, u, p, t), got None")
        expected = {"rate": self.n_x, "running_cost": 1, "path": len(self.path_limit)}
        for name, n in expected.items():
            got = self.at_instant(name).numel_out(0)
            if got != (n if getattr(self, name) is not None or name == "path" else 0):
                raise ProblemError(f"{name} gives {n} values of (x, u, p, t), got {got}")
        for name, n in {"final_cost": 1, "ends": len(self.ends_limit)}.items():
            got = self.at_ends(name).numel_out(0)
            if got != (n if getattr(self, name) is not None or name == "ends" else 0):
                raise ProblemError(f"{name} gives {n} values of (x at the start, x at the end, duration, p), got {got}")

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
        """The bounds on the duration [s]."""
        return _duration(self.duration_s)

    def at_instant(self, name: str) -> ca.Function:
        """Return `rate`, `running_cost` or `path` as a function of (x, u, p, t); empty where there is none."""
        x, u, p, t = (ca.SX.sym(n, k) for n, k in (("x", self.n_x), ("u", self.n_u), ("p", len(self.parameters)), ("t", 1)))
        return self._function(name, (x, u, p, t))

    def at_ends(self, name: str) -> ca.Function:
        """Return `final_cost` or `ends` as a function of (x_0, x_T, T, p); empty where there is none."""
        sizes = (("x0", self.n_x), ("xT", self.n_x), ("T", 1), ("p", len(self.parameters)))
        return self._function(name, tuple(ca.SX.sym(n, k) for n, k in sizes))

    def _function(self, name: str, symbols: tuple[ca.SX, ...]) -> ca.Function:
        given = getattr(self, name)
        try:
            value = ca.SX(0, 1) if given is None else given(*symbols)
            column = ca.vec(ca.vertcat(*value) if isinstance(value, list | tuple) else ca.SX(value))
            return ca.Function(name, list(symbols), [ca.densify(column)])
        except Exception as error:  # whatever a user's function raises is said, with its name
            raise ProblemError(
                f"{name} of '{self.name}' cannot be written in CasADi's SX: {type(error).__name__}: {one_line(error)}"
            ) from error


def _rows(name: str, value: object) -> np.ndarray:
    """Return boundary values as [low, high] rows (n, 2), infinite where they are free."""
    array = _array(name, value)
    if np.any(np.isinf(array)) and array.ndim == 1:
        raise ProblemError(f"{name} has finite values, NaN where a state is free, got {array.tolist()}")
    if array.ndim == 1:
        array = np.column_stack([np.where(np.isnan(array), -np.inf, array), np.where(np.isnan(array), np.inf, array)])
    if array.ndim != 2 or array.shape[1] != 2:
        raise ProblemError(f"{name} has one value, or [low, high], a state, got shape {array.shape}")
    return _ordered(name, array)


def _limits(name: str, value: object) -> np.ndarray:
    array = _array(name, value)
    if array.size == 0:
        return np.zeros((0, 2))
    if array.ndim != 2 or array.shape[1] != 2:
        raise ProblemError(f"{name} has one [low, high] a row, got shape {array.shape}")
    return _ordered(name, array)


def _ordered(name: str, rows: np.ndarray) -> np.ndarray:
    """Return rows of [low, high], refused where they are not."""
    if (
        np.any(np.isnan(rows))
        or np.any(rows[:, 0] > rows[:, 1])
        or np.any(rows[:, 0] == np.inf)
        or np.any(rows[:, 1] == -np.inf)
    ):
        raise ProblemError(f"{name} has rows [low, high] with low <= high, got {rows.tolist()}")
    return rows


def _array(name: str, value: object) -> np.ndarray:
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ProblemError(f"{name} is numbers, got {value!r}") from error


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _duration(value: object) -> tuple[float, float]:
    """Return the bounds on a duration: twice the same where it is given."""
    if _is_number(value):
        return float(value), float(value)
    ends = _array("duration_s", value).ravel()
    if len(ends) != 2:
        raise ProblemError(f"duration_s is a positive number, or (low, high) where it is free, got {value!r}")
    return float(ends[0]), float(ends[1])
