"""Optimal control of x' = f(x, u, t) straight from the transcription: a formulation, its program, its solution."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.planner.solvers.solve import Solution, solve
from linkplan.planner.transcription.collocation import Curves, Transcribed, collocate, curves_of
from linkplan.planner.transcription.formulation import Formulation, PhaseBoundary, Start, Units
from linkplan.planner.transcription.interval import IntervalRows
from linkplan.planner.transcription.mesh import uniform
from linkplan.planner.transcription.schemes import scheme
from linkplan.planner.transcription.system import Endpoint, System, node_symbols

INF, NAN = np.inf, np.nan
# Limits of one effort and of one state that are none.
FREE_EFFORT, FREE_STATE = [[-INF, INF]], [-INF, INF]
AtInstant = Callable[[ca.SX, ca.SX, ca.SX], Sequence]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FirstOrder:
    """The least `final_cost`(first, last, T) + int `running_cost`(x, u, t) dt of x' = `rate`(x, u, t).

    `start` and `goal` have NaN where a state is free, limits have [low, high] rows. `path`(x, u, t) and `ends`(first, last)
    are bounded, `returns` end where they began. A fixed `duration_s` is one number, a free one (low, guess, high). `way` are
    states (n, n_x) of the guess, by default straight from start to goal, and `effort` (n_u,) its efforts. `unit` are the
    states' units.
    """

    rate: AtInstant
    start: list
    goal: list
    effort_limit: list
    duration_s: float | tuple[float, float, float]
    running_cost: Callable = lambda *_: 0.0
    final_cost: Callable = lambda *_: 0.0
    path: AtInstant = lambda *_: []
    path_limit: Sequence = ()
    ends: Callable = lambda *_: []
    ends_limit: Sequence = ()
    state_limit: list | None = None
    returns: tuple[int, ...] = ()
    way: list | None = None
    effort: list | float = 0.0
    unit: list | float = 1.0

    @property
    def durations(self) -> np.ndarray:
        """The bounds and the guess of the duration [s]: low, guess, high."""
        return np.array([self.duration_s] * 3 if np.ndim(self.duration_s) == 0 else self.duration_s, dtype=float)

    def formulation(self) -> Formulation:
        """Return the problem for the transcription, in units of the guessed duration and of the states."""
        n, n_u = len(self.start), len(self.effort_limit)
        low, T, high = self.durations
        unit = np.broadcast_to(np.array(self.unit, dtype=float), n)
        limit = np.array(self.state_limit or [FREE_STATE] * n, dtype=float) / unit[:, None]
        limited = tuple(np.flatnonzero(np.isfinite(limit).any(axis=1)))
        path = np.reshape(np.array(self.path_limit, dtype=float), (-1, 2))
        ends = np.reshape(np.array(self.ends_limit, dtype=float), (-1, 2))
        X = ca.DM(unit)

        def system() -> System:
            node, t = node_symbols(0, n, 0, n_u), ca.SX.sym("t")
            at = (node.x * X, node.u, t)
            rates, running = ca.vertcat(*self.rate(*at)), self.running_cost(*at)
            column = ca.densify(ca.vertcat(node.r - rates * T / X, *self.path(*at), running * T))
            kinds = ("dynamics",) * n + ("path",) * len(path)
            return System(n_x=n, n_u=n_u, node=ca.Function("node", [node.stacked, t], [column]),
                          n_equations=n, n_path=len(path), kinds=kinds)  # fmt: skip

        first, last, duration, none = ca.SX.sym("first", n), ca.SX.sym("last", n), ca.SX.sym("T"), ca.SX.sym("p", 0)
        at_ends = (first * X, last * X)
        cost = self.final_cost(*at_ends, duration * T)
        column = ca.densify(ca.vertcat(*self.ends(*at_ends), cost))
        return Formulation(
            build_system=system, n_x=n, n_u=n_u, rows=IntervalRows(state_columns=limited),
            units=Units(time_s=T, state=unit, effort=np.ones(n_u), objective=1.0), state=limit,
            effort=np.array(self.effort_limit, dtype=float), path=path, own={"state": limit[list(limited)]},
            boundaries=(PhaseBoundary(state=self._end(self.start, unit), time=(0.0, 0.0)),
                        PhaseBoundary(state=self._end(self.goal, unit), time=(low / T, high / T))),
            returns=self.returns, theta=lambda times: times[..., None], endpoint_bounds=ends,
            endpoint=Endpoint(function=ca.Function("endpoint", [first, last, duration, none], [column]), n_rows=len(ends)),
        )  # fmt: skip

    def transcribed(self, n: int, name: str = "radau-3", shape: str = "polynomial", **options: bool) -> Transcribed:
        """Return the program on n even intervals, from the guess, with efforts of a shape over each."""
        T, unit = self.durations[1], np.broadcast_to(np.array(self.unit, dtype=float), len(self.start))
        ends = [np.where(np.isfinite(a), a, np.nan_to_num(b)) for a, b in ((self.start, self.goal), (self.goal, self.start))]
        way = np.array(ends if self.way is None else self.way, dtype=float) / unit
        at, slopes = np.linspace(0.0, T, len(way)), np.diff(way, axis=0)

        def nodes(times: np.ndarray) -> tuple[np.ndarray, ...]:
            rates = slopes[np.clip(np.searchsorted(at, times, side="right") - 1, 0, len(slopes) - 1)] * (len(way) - 1)
            none = np.zeros((len(times), 0))
            return none, rates, none, np.tile(np.broadcast_to(self.effort, len(self.effort_limit)), (len(times), 1))

        def states(times: np.ndarray) -> np.ndarray:
            return np.column_stack([np.interp(times, at, column) for column in way.T])

        start = Start(states=states, nodes=nodes)
        return collocate(
            self.formulation(), scheme(name, shape), uniform(n), np.array([T]), start, compile_mode="never", **options
        )  # fmt: skip

    def solved(self, n: int, *how: str) -> tuple[Solution, Curves]:
        """Return the solution on n even intervals and its motion."""
        found = solve(self.transcribed(n, *how))
        assert found.converged, found.status
        return found, curves_of(found.transcribed, found.x, np.array(self.effort_limit, dtype=float))

    @staticmethod
    def _end(values: list, unit: np.ndarray) -> np.ndarray:
        """Return the bounds (n, 2) of one end in units; a free state has none."""
        given = np.array(values, dtype=float) / unit
        return np.column_stack([np.where(np.isnan(given), -INF, given), np.where(np.isnan(given), INF, given)])
