"""Several programs as one: each has its own unknowns and rows, and links tie the states at their ends.

A link is a function of ends of programs, of their durations, and of a few unknowns of its own, such as the pose of a
mechanism between two phases. Its rows are zero. The programs keep their functions, so that the time of an evaluation is the
sum of theirs, whatever their number.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.program import hessian_function, program_functions


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Link:
    """Rows and a cost of programs' ends.

    `ends` are (program, 0 for its first state or -1 for its last). `function` takes the scaled states of these ends, one
    after the other, the scaled durations (n_programs,) of all programs, and the link's own unknowns (n_own,); it returns the
    rows (n_rows,), which are zero, and a scaled cost. `own` are values to start from, with their `bounds` (n_own, 2).
    """

    ends: tuple[tuple[int, int], ...]
    function: ca.Function
    own: np.ndarray = field(default_factory=lambda: np.zeros(0))
    bounds: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def n_rows(self) -> int:
        """The number of its rows."""
        return self.function.numel_out(0)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LinkedProgram:
    """The functions of linked programs, as those of a `Program`, and its sizes."""

    functions: dict[str, ca.Function]
    hess_lag: Callable[[], ca.Function]
    n_rows: int
    n_s: int
    n_u: int
    n_intervals: int


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Linked:
    """Linked programs with their numbers; `weights` (n,) are the factors on their objectives.

    A solver reads it like a `Transcribed` program.
    """

    parts: tuple[Transcribed, ...]
    links: tuple[Link, ...]
    weights: np.ndarray
    objective_scale: float
    program: LinkedProgram
    start: np.ndarray

    @property
    def parameters(self) -> np.ndarray:
        """The parameters of all programs."""
        return np.concatenate([part.parameters for part in self.parts])

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the unknowns."""
        return np.concatenate([*(part.lower for part in self.parts), *(link.bounds[:, 0] for link in self.links)])

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the unknowns."""
        return np.concatenate([*(part.upper for part in self.parts), *(link.bounds[:, 1] for link in self.links)])

    @property
    def row_lower(self) -> np.ndarray:
        """Lower bounds of the rows."""
        return np.concatenate([*(part.row_lower for part in self.parts), *(np.zeros(link.n_rows) for link in self.links)])

    @property
    def row_upper(self) -> np.ndarray:
        """Upper bounds of the rows."""
        return np.concatenate([*(part.row_upper for part in self.parts), *(np.zeros(link.n_rows) for link in self.links)])

    def split(self, x: np.ndarray) -> list[np.ndarray]:
        """Return the unknowns of each program, then those of each link."""
        sizes = [len(part.lower) for part in self.parts] + [len(link.own) for link in self.links]
        return np.split(x, np.cumsum(sizes)[:-1])

    def split_rows(self, values: np.ndarray) -> list[np.ndarray]:
        """Return the values of each program's rows, then those of each link's."""
        sizes = [len(part.row_lower) for part in self.parts] + [link.n_rows for link in self.links]
        return np.split(values, np.cumsum(sizes)[:-1])


def link_programs(
    parts: Sequence[Transcribed], links: Sequence[Link], weights: np.ndarray, objective_scale: float
) -> Linked:
    """Return programs and links as one program, whose objective is the weighted sum of theirs and of the links' costs.

    Args:
        parts: the programs.
        links: between their ends.
        weights: factors (n,) on the programs' own scaled objectives.
        objective_scale: the ratio of the objective in SI units to the whole program's value.
    """
    start = np.concatenate([*(part.start for part in parts), *(link.own for link in links)])
    program = _linked(tuple(parts), tuple(links), weights)
    return Linked(
        parts=tuple(parts),
        links=tuple(links),
        weights=weights,
        objective_scale=objective_scale,
        program=program,
        start=start,
    )


def _linked(parts: tuple[Transcribed, ...], links: tuple[Link, ...], weights: np.ndarray) -> LinkedProgram:
    """Return the functions of linked programs."""
    programs = [part.program for part in parts]
    sizes, n_p = [one.layout.size for one in programs], [len(part.parameters) for part in parts]
    n = sum(sizes) + sum(len(link.own) for link in links)
    x, p = ca.MX.sym("x", n), ca.MX.sym("p", sum(n_p))
    unknowns, parameters = _split(x, [*sizes, n - sum(sizes)]), _split(p, n_p)
    local = [_Local(link, k, programs, links, n) for k, link in enumerate(links)]
    values = [one.functions["grad_f"](at, given) for one, at, given in zip(programs, unknowns, parameters, strict=False)]
    rows = [one.functions["jac_g"](at, given) for one, at, given in zip(programs, unknowns, parameters, strict=False)]
    at_links = [one.values(x) for one in local]
    f = sum((w * value for w, (value, _) in zip(weights, values, strict=True)), start=ca.MX(0))
    f += sum((one.cost for one in at_links), start=ca.MX(0))
    gradient = ca.vertcat(*(w * slope for w, (_, slope) in zip(weights, values, strict=True)), ca.MX(n - sum(sizes), 1))
    gradient = ca.densify(gradient) + sum((one.gradient for one in at_links), start=ca.MX(n, 1))
    g = ca.vertcat(*(value for value, _ in rows), *(one.rows for one in at_links))
    own = ca.diagcat(*(slope for _, slope in rows))
    own = ca.horzcat(own, ca.MX(own.shape[0], n - own.shape[1]))
    jacobian = ca.vertcat(own, *(one.jacobian for one in at_links))
    n_rows = g.numel()

    @functools.cache
    def hess_lag() -> ca.Function:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)
        lams = _split(lam_g, [*(len(part.row_lower) for part in parts), *(link.n_rows for link in links)])
        blocks = [
            one.hess_lag()(at, given, w * lam_f, lam)
            for one, at, given, w, lam in zip(programs, unknowns, parameters, weights, lams, strict=False)
        ]
        hessian = ca.diagcat(*blocks, ca.MX(n - sum(sizes), n - sum(sizes)))
        for one, lam in zip(local, lams[len(parts) :], strict=True):
            hessian += one.hessian(x, lam_f, lam)
        return hessian_function(x, p, lam_f, lam_g, hessian)

    return LinkedProgram(
        functions=program_functions(x, p, f, g, gradient, jacobian),
        hess_lag=hess_lag,
        n_rows=n_rows,
        n_s=max(one.layout.n_s for one in programs),
        n_u=max(one.layout.n_u for one in programs),
        n_intervals=sum(one.mesh.n_intervals for one in programs),
    )


def _split(column: ca.MX, sizes: Sequence[int]) -> list[ca.MX]:
    """Return consecutive parts of a column."""
    return ca.vertsplit(column, [0, *np.cumsum(sizes).tolist()])


@dataclass(frozen=True, eq=False, slots=True)
class _Values:
    """A link's rows and cost, with their derivatives by all unknowns."""

    rows: ca.MX
    cost: ca.MX
    jacobian: ca.MX
    gradient: ca.MX


class _Local:
    """A link in terms of its local unknowns e = S x: states at ends, durations of all programs, and its own unknowns."""

    def __init__(self, link: Link, number: int, programs: Sequence, links: Sequence[Link], n: int) -> None:
        begins = np.cumsum([0, *(one.layout.size for one in programs), *(len(one.own) for one in links)])
        places: list[np.ndarray] = []
        for k, end in link.ends:
            layout = programs[k].layout
            places += [np.array([begins[k] + i]) for i in layout.state(0 if end == 0 else layout.n_intervals)]
        places += [begins[k] + one.layout.durations() for k, one in enumerate(programs)]
        places += [np.array([begins[len(programs) + number] + i]) for i in range(len(link.own))]
        columns = np.concatenate(places)
        rows = np.repeat(np.arange(len(places)), [len(place) for place in places])
        self._S = ca.DM.triplet(rows.tolist(), columns.tolist(), ca.DM.ones(len(rows)), len(places), n)
        e, lam = ca.SX.sym("e", len(places)), ca.SX.sym("lam", 1 + link.n_rows)
        sizes = [programs[k].layout.n_state for k, _ in link.ends]
        states, durations, own = ca.vertsplit(e, np.cumsum([0, sum(sizes), len(programs), len(link.own)]).tolist())
        found, cost = link.function(states, durations, own)
        lagrangian = lam[0] * cost + ca.dot(lam[1:], found)
        self._function = ca.Function("link", [e], [found, cost, ca.jacobian(found, e), ca.densify(ca.gradient(cost, e))])
        self._hessian = ca.Function("link_hessian", [e, lam], [ca.hessian(lagrangian, e)[0]])

    def values(self, x: ca.MX) -> _Values:
        """Return the link at all unknowns."""
        rows, cost, jacobian, gradient = self._function(self._S @ x)
        return _Values(rows, cost, jacobian @ self._S, self._S.T @ gradient)

    def hessian(self, x: ca.MX, lam_f: ca.MX, lam: ca.MX) -> ca.MX:
        """Return the upper triangle of the Hessian of lam_f cost + lam . rows."""
        return ca.triu(self._S.T @ self._hessian(self._S @ x, ca.vertcat(lam_f, lam)) @ self._S)
