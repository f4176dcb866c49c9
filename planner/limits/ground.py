"""Limits on the forces of the ground on what stands on it: they push, and stay within the friction cone.

A contact is a closure between a site and a point of the world, the z axis of whose site is the ground's normal. In a planar
mechanism its force has one tangential component, and the cone is two linear rows. In space it is the square of the
tangential force; that row alone has no slope where the force vanishes, so the normal force has a row of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.ground import ground_normal
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.joint_forces import closure_rows_along
from linkplan.models.poses.whole_body import total_mass, unit_acceleration
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.limits.bounds import Affine
from linkplan.planner.limits.limit import Bounds, Claimed, Limit, LimitFacts, Measured, Rows, Tightened
from linkplan.planner.limits.samples import Samples
from linkplan.planner.problem.instant import Instant, Scales
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class GroundForceLimit(Limit):
    """One row on the force of one contact, at least zero: what friction has left, or the normal force alone.

    `item` is the number of the closure, `normal` (3,) the direction of the ground's push. Friction leaves its coefficient
    times the push plus the force along `tangent` (3,), which is zero for the normal force alone. `conic` rows are the
    squares, (coefficient x push)^2 less the tangential force squared, over the weight.
    """

    key: ClassVar[str] = "friction"
    item: int
    normal: tuple[float, ...]
    tangent: tuple[float, ...] = (0.0, 0.0, 0.0)
    conic: bool = False

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        mechanism = problem.mechanism
        names = mechanism.closure_names
        return [
            row
            for name, share in problem.limits.friction.items()
            for row in cls._rows_of(mechanism, names.index(name), bool(np.isfinite(share)))
        ]

    @classmethod
    def _rows_of(cls, mechanism: Mechanism, item: int, slips: bool) -> Iterator[Self]:
        """Yield the rows of one contact, which `slips` if its friction is finite."""
        normal = ground_normal(mechanism.model, mechanism.equalities[item])
        assert normal is not None  # of a closure with friction
        up = tuple(normal.tolist())
        yield cls(item, up)
        ways = _tangents(mechanism, item, normal) if slips else []
        if len(ways) > 1:
            yield cls(item, up, conic=True)
        for way in ways if len(ways) == 1 else ():
            yield cls(item, up, tuple(way.tolist()))
            yield cls(item, up, tuple((-way).tolist()))

    @property
    def facts(self) -> LimitFacts:
        words = "the friction that {} has left" if self.conic or any(self.tangent) else "the ground's push on {}"
        return LimitFacts(
            kind="friction",
            words=words,
            beyond="below",
            tightened=Tightened.IN_UNITS,
            jumps_with_effort=True,
            by_size=True,
        )

    def _left(self, force: Any, friction: Any, weight_n: Any) -> Any:
        """Return the row of a force (3,) [N]: zero at the limit."""
        push = sum(n * f for n, f in zip(self.normal, force, strict=True) if n)
        if self.conic:
            square = sum(f * f for f in force)
            return (push * push * (1.0 + friction * friction) - square) / weight_n
        along = [t * f for t, f in zip(self.tangent, force, strict=True) if t]
        return push * friction + sum(along[1:], along[0]) if along else push

    @property
    def rows(self) -> Rows:
        def node(at: Instant, numbers: ca.SX) -> ca.SX:
            force = ca.vertsplit(ca.densify(at.closure_force[at.mechanism.closure_slice(self.item)]))
            return self._left(force, numbers[0], numbers[1]) / numbers[1]

        def numbers(problem: Problem) -> tuple[float, float]:
            friction = self._friction(problem)
            return (friction if self.conic or any(self.tangent) else 0.0), weight(problem.mechanism)

        return Rows(node=node, n_numbers=2, numbers=numbers)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return 0.0, np.inf

    def measured(self, at: Samples) -> Measured:
        mechanism = at.problem.mechanism
        rows = closure_rows_along(mechanism, at.q, at.v, at.a, at.u, *at.forces)[:, mechanism.closure_slice(self.item)]
        size = weight(mechanism)
        left = self._left(rows.T, self._friction(at.problem), size)
        return Measured(mechanism.closure_names[self.item], left, (0.0, np.inf), "N", size, slack=ROUNDING_SHARE * size)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        own, friction, size = problem.mechanism.closure_slice(self.item), self._friction(problem), weight(problem.mechanism)
        name = self.facts.words.format(problem.mechanism.closure_names[self.item])

        def left(at: Any) -> Any:
            return self._left(at.closure_forces[own], friction, size) + 0 * at.state.q[0]

        yield Claimed(name=name, unit="N", bounds=(0.0, np.inf), value=left, slack=(ROUNDING_SHARE * size, 0.0))

    def affine(self, problem: Problem) -> Affine | None:
        mechanism, friction, size = problem.mechanism, self._friction(problem), weight(problem.mechanism)
        own = mechanism.closure_slice(self.item)
        if self.conic:
            return None  # no affine function of the efforts

        def along(q: np.ndarray, v: np.ndarray, a: np.ndarray, u: np.ndarray) -> np.ndarray:
            return self._left(closure_rows_along(mechanism, q, v, a, u)[:, own].T, friction, size)

        return Affine(along, (0.0, np.inf))

    def _friction(self, problem: Problem) -> float:
        return float(problem.limits.friction[problem.mechanism.closure_names[self.item]])


def weight(mechanism: Mechanism) -> float:
    """Return the weight [N] of the moving bodies, the unit of the ground's forces; without gravity, their mass."""
    return unit_acceleration(mechanism) * total_mass(mechanism)


def _tangents(mechanism: Mechanism, item: int, normal: np.ndarray) -> np.ndarray:
    """Return the tangential directions (n, 3) in which the ground can push on a contact: one if the motion is planar."""
    own = mechanism.closure_slice(item)
    jacobian = mechanism.dynamics.closure_jacobian
    near = np.random.default_rng(0).uniform(-1.0, 1.0, (3, mechanism.n_q)) * unit_steps(mechanism.joints, mechanism.extent_m)
    moved = np.hstack([np.array(jacobian(mechanism.home + 0.1 * step))[own] for step in near])
    along = moved - np.outer(normal, normal @ moved)
    ways, sizes, _ = np.linalg.svd(along, full_matrices=False)
    return ways.T[sizes > 1e-9 * max(float(np.abs(moved).max(initial=0.0)), 1e-300)]
