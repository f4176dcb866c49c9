"""Limits on the forces in pins: those of closures, and those of the joints of the tree.

They are rows at nodes, or rows on the Bernstein coefficients of the force's square, which hold at every instant. With rows
at nodes alone, efforts that jump can exceed the limit between nodes, as for powers. For limits at every instant the force is
an algebraic unknown, a polynomial through the nodes, whose error between nodes decreases with the interval's width.
"""

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.joint_forces import closure_rows_along, loads_along, pins_of
from linkplan.planner.limits.bounds import Affine
from linkplan.planner.limits.limit import (
    Bounds,
    Claimed,
    Limit,
    LimitFacts,
    Measured,
    Rows,
    Tightened,
    squared_claim,
    with_limits,
)
from linkplan.planner.limits.samples import Samples
from linkplan.planner.problem.instant import Instant, Scales
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class _ForceLimit(Limit):
    """The force in one pin, as a share of its rating; `n_unknowns` is the number of its components that are unknowns."""

    what: ClassVar[str]
    item: int
    n_unknowns: int = 0

    @classmethod
    @abstractmethod
    def ratings(cls, problem: Problem) -> dict[int, tuple[str, float]]:
        """Return the names and the largest forces [N] of the limited pins, by their index among all."""

    @abstractmethod
    def components(self, at: Instant) -> ca.SX:
        """Return the force's components [N] at an instant."""

    @abstractmethod
    def enclosed(self, at: Any) -> list[Any]:
        """Return the force's components [N] as balls of a proof's kinetics."""

    @abstractmethod
    def along(self, mechanism: Mechanism, *motion: np.ndarray) -> np.ndarray:
        """Return the force's components (n, k) [N] along samples: q, v, a, u and the forces over time."""

    @property
    def facts(self) -> LimitFacts:
        return LimitFacts(
            kind=self.key,
            words=f"the {self.what} of {{}}",
            tightened=Tightened.SQUARED,
            enclosable=True,
            jumps_with_effort=True,
            followed_with=1,
        )

    @property
    def rows(self) -> Rows:
        def numbers(problem: Problem) -> tuple[float]:
            return (self.ratings(problem)[self.item][1],)

        def shares(at: Instant, rating: ca.SX) -> ca.SX:
            return ca.densify(self.components(at)) / rating

        if not self.n_unknowns:
            return Rows(node=lambda at, rating: ca.sumsqr(shares(at, rating)), n_numbers=1, numbers=numbers)
        return Rows(
            n_numbers=1,
            numbers=numbers,
            interval=lambda own: ("squared_sums", (self.key, own)),
            n_unknowns=self.n_unknowns,
            unknowns=lambda at, rating: ("bearing", ca.vertsplit(shares(at, rating))),
        )

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return -np.inf, 1.0

    def measured(self, at: Samples) -> Measured:
        name, rating = self.ratings(at.problem)[self.item]
        components = self.along(at.problem.mechanism, at.q, at.v, at.a, at.u, *at.forces)
        return Measured(name, np.linalg.norm(components, axis=1), (-np.inf, rating), "N")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        name, rating = self.ratings(problem)[self.item]

        def squared(at: Any) -> Any:
            return sum((x * x for x in self.enclosed(at)), 0 * at.state.q[0])

        yield squared_claim(f"{self.what} of {name}", "N2", rating, squared)

    def affine(self, problem: Problem) -> Affine | None:
        mechanism = problem.mechanism
        name, most = self.ratings(problem)[self.item]
        return Affine(lambda q, v, a, u: self.along(mechanism, q, v, a, u), (-np.inf, most), force_of=name)


@dataclass(frozen=True, slots=True)
class ClosureForceLimit(_ForceLimit):
    """The force of one closure."""

    key: ClassVar[str] = "closure_force"
    what: ClassVar[str] = "closure force"

    @classmethod
    def of(cls, problem: Problem, *, enclosed: bool = False, **_: bool) -> list[Self]:
        places = {c: problem.mechanism.closure_slice(c) for c in cls.ratings(problem)}
        return [cls(c, own.stop - own.start if enclosed else 0) for c, own in places.items()]

    @classmethod
    def ratings(cls, problem: Problem) -> dict[int, tuple[str, float]]:
        names, most = problem.mechanism.closure_names, problem.limits.closure_force
        return {c: (names[c], float(most[c])) for c in problem.limits.limited_closures}

    def components(self, at: Instant) -> ca.SX:
        return at.closure_force[at.mechanism.closure_slice(self.item)]

    def enclosed(self, at: Any) -> list[Any]:
        return at.closure_forces[at.state.blocks.mechanism.closure_slice(self.item)]

    def along(self, mechanism: Mechanism, *motion: np.ndarray) -> np.ndarray:
        return closure_rows_along(mechanism, *motion)[:, mechanism.closure_slice(self.item)]

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        return with_limits(problem, closure_force=problem.limits.closure_force * factor)


@dataclass(frozen=True, slots=True)
class PinForceLimit(_ForceLimit):
    """The force between a body of the tree and its parent, in a pin, in a ball joint, or across a slide."""

    key: ClassVar[str] = "pin_force"
    what: ClassVar[str] = "pin force"

    @classmethod
    def of(cls, problem: Problem, *, enclosed: bool = False, **_: bool) -> list[Self]:
        return [cls(item, 3 if enclosed else 0) for item in cls.ratings(problem)]

    @classmethod
    def ratings(cls, problem: Problem) -> dict[int, tuple[str, float]]:
        names = [pin.name for pin in pins_of(problem.mechanism)]
        return {names.index(name): (name, newton) for name, newton in problem.limits.pin_force.items()}

    def components(self, at: Instant) -> ca.SX:
        return at.joint_loads[:3, self.item + 1]

    def enclosed(self, at: Any) -> list[Any]:
        return at.joint_loads(self.item + 1)[:3]

    def along(self, mechanism: Mechanism, *motion: np.ndarray) -> np.ndarray:
        return loads_along(mechanism, *motion)[:, :3, self.item + 1]
