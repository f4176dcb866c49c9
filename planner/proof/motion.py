"""The motion on a box of time as power series: poses, rates and the efforts of the model, each computed at first use."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import comb

import numpy as np
from flint import arb, arb_poly, arb_series

from linkplan.models.actuation.distribution import actuator_sizes
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.poses.joint_forces import joint_loads
from linkplan.planner.limits.samples import Leverage
from linkplan.planner.problem.instant import Corner
from linkplan.planner.proof.branch import pose_of
from linkplan.planner.proof.curve import forces_over
from linkplan.planner.proof.taylor import Matrix, NotSeparatedError, product, solve_enclosed, transposed
from linkplan.planner.proof.walk import Ball, Blocks, dense, larger, loaded_tree, pose_walk, walk_of
from linkplan.planner.trajectory import JOIN_SHARE, Trajectory
from linkplan.planner.transcription.bernstein import PiecewisePolynomial


def power_form(bernstein: np.ndarray) -> list[arb]:
    """Return coefficients of powers of tau in [0, 1] as balls that enclose those of Bernstein coefficients (degree + 1,)."""
    degree, found = len(bernstein) - 1, []
    b = [arb(float(x)) for x in bernstein]
    for j in range(degree + 1):
        inner = sum(((-1) ** (j - i) * comb(j, i) * b[i] for i in range(j + 1)), arb(0))
        found.append(comb(degree, j) * inner)
    return found


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Piece:
    """Interval `index` of a trajectory: polynomials in tau in [0, 1], one for each coordinate or actuator."""

    index: int
    begin_s: float
    since: arb  # the time from the start of the motion to that of the interval [s]
    width: arb  # [s]
    position: tuple[arb_poly, ...]
    velocity: tuple[arb_poly, ...]
    effort: tuple[arb_poly, ...]
    along: tuple[arb_poly, ...]
    kinetics: tuple[str, ...]  # the names of the motion's kinetics in `State`

    @classmethod
    def of(cls, trajectory: Trajectory, k: int) -> "Piece":
        """Return interval k of a trajectory."""
        begin, end = (float(x) for x in trajectory.breaks_s[k : k + 2])
        named = {
            name: tuple(arb_poly(power_form(column)) for column in getattr(trajectory, name)[:, k].T)
            for name in ("position", "velocity", "effort", "along")
        }
        since = arb(begin) - arb(float(trajectory.breaks_s[0]))
        return cls(
            index=k, begin_s=begin, since=since, width=arb(end) - arb(begin), kinetics=_kinetics(trajectory, k), **named
        )


# Rounding below this share of the largest value is far below every claim's allowance.
_SMALL_SHARE = 0.1 * ROUNDING_SHARE


def _kinetics(trajectory: Trajectory, k: int) -> tuple[str, ...]:
    """Return the names of the kinetics on interval k: one of them if velocity and acceleration are those of the position.

    Positions suffice unless a short interval amplifies their rounding; planned velocities do not amplify it.
    """
    slope = PiecewisePolynomial(trajectory.position, trajectory.breaks_s).derivative()
    velocity = PiecewisePolynomial(trajectory.velocity, trajectory.breaks_s)
    if slope.coefficients.shape != velocity.coefficients.shape:
        return "of_position", "of_velocity"
    of_slope = trajectory.slope_rounding()[k]
    of_bend = 2 * (len(trajectory.position) - 2) * of_slope / (trajectory.breaks_s[k + 1] - trajectory.breaks_s[k])
    pairs = ((slope, velocity, of_slope), (slope.derivative(), velocity.derivative(), of_bend))
    alike = rounded = True
    for one, other, rounding in pairs:
        apart, share = np.abs(one.coefficients[:, k] - other.coefficients[:, k]), np.abs(other.coefficients).max()
        alike = alike and bool(apart.max() <= JOIN_SHARE * share and rounding.max() <= _SMALL_SHARE * share)
        rounded = rounded and bool((apart - rounding).max() <= JOIN_SHARE * share)
    return ("of_position",) if alike else ("of_velocity",) if rounded else ("of_position", "of_velocity")


@dataclass(frozen=True, eq=False, kw_only=True)
class Kinetics:
    """Velocities and accelerations (n_q,) of all joints, and the generalised forces that the motion needs."""

    state: "State"
    rates: list[Ball]
    accelerations: list[Ball]
    _trees: dict[tuple[float, ...], list[Ball]] = field(default_factory=dict)
    _efforts: dict[Corner | None, list[Ball]] = field(default_factory=dict)
    _loads: dict[tuple[int, int], Ball] = field(default_factory=dict)

    @cached_property
    def jerks(self) -> list[Ball]:
        """The jerks (n_q,) of all joints.

        With `State.of_velocity` they follow from the velocity: a third derivative amplifies rounding.
        """
        return [self.state.rate * x.derivative() for x in self.accelerations]

    def needed(self, corner: Corner | None = None) -> tuple[list[Ball], list[Ball]]:
        """Return the reduced efforts tau (n_s,) and the multipliers J_z^-T (...)_z of the nominal model or of a corner."""
        state, mechanism = self.state, self.state.blocks.mechanism
        values: tuple[float, ...] = ()
        if corner is not None and corner.changes_parameters:
            values = tuple(corner.parameters(mechanism, mechanism.parameter_values.tolist()))
        walk = loaded_tree(mechanism, values) if values else state.blocks.tree
        if values not in self._trees:
            self._trees[values] = dense(walk(state.q, self.rates, self.accelerations, *state.forces)[0], len(state.q))
        forces = list(self._trees[values])
        for name, viscous, coulomb in () if corner is None else corner.friction:
            joint = state.blocks.mechanism.joint_index(name)
            forces[joint] = forces[joint] + viscous * self.rates[joint] + coulomb
        return state.reduced(forces)

    @cached_property
    def tau(self) -> tuple[list[Ball], list[Ball]]:
        """The reduced efforts tau (n_s,) and the multipliers of the nominal model."""
        return self.needed()

    def efforts(self, corner: Corner | None = None, leverage: Leverage | None = None) -> list[Ball]:
        """Return the efforts (n_u,) of the actuators by inverse dynamics.

        If the numbers of actuators and of degrees of freedom differ, they are the planned efforts plus the least efforts
        that compensate the difference, for a corner in units of the limits S: u + S (P S)^+ (tau - P u). At a dead
        centre (see `Leverage`) they are the planned efforts.

        Raises:
            NotSeparatedError: if a box is partly at a dead centre.
        """
        if leverage is not None and self.state.at_dead_centre(leverage):
            return list(self.state.u)
        if corner not in self._efforts:
            self._efforts[corner] = self._by_inverse_dynamics(corner)
        return self._efforts[corner]

    def _by_inverse_dynamics(self, corner: Corner | None) -> list[Ball]:
        state = self.state
        tau = (self.tau if corner is None else self.needed(corner))[0]
        factor = 1.0 if corner is None else corner.torque_factor
        P, n_s, n_u = state.effort_map, len(tau), len(state.u)
        rows, columns = (sorted({place[axis] for place in P}) for axis in (0, 1))  # the others are zero everywhere
        if n_s == n_u == len(rows) == len(columns):
            (found,) = solve_enclosed(P, [tau])
            return [x / factor for x in found]
        left, size = (
            self._left(corner),
            np.ones(n_u) if corner is None else actuator_sizes(state.blocks.mechanism.effort_limit),
        )
        P = {(rows.index(i), columns.index(k)): x * float(size[k]) for (i, k), x in P.items()}
        added = dict(zip(columns, _least(P, [left[i] for i in rows], len(columns)), strict=True))
        return [u + added[k] * float(size[k]) if k in added else u for k, u in enumerate(state.u)]

    @cached_property
    def residual(self) -> list[Ball]:
        """The reduced efforts (n_s,) that the planned efforts do not provide, tau - P u."""
        return self._left(None)

    def lacking(self, corner: Corner, leverage: Leverage) -> list[Ball]:
        """Return the reduced efforts (n_s,) that planned efforts do not provide at a corner; zero except at a dead centre.

        Raises:
            NotSeparatedError: if a box is partly at a dead centre.
        """
        return self._left(corner) if self.state.at_dead_centre(leverage) else [arb(0)] * len(self.state.s)

    def _left(self, corner: Corner | None) -> list[Ball]:
        tau, factor = (self.tau[0], 1.0) if corner is None else (self.needed(corner)[0], corner.torque_factor)
        return [t / factor - c for t, c in zip(tau, product(self.state.effort_map, self.state.u, len(tau)), strict=True)]

    @cached_property
    def multipliers(self) -> list[Ball]:
        """The multipliers (rank,) of the closures under the planned efforts."""
        found: list[Ball] = list(self.tau[1])
        for u, of in zip(self.state.u, self.state.arm_multipliers, strict=True):
            found = [x - y * u for x, y in zip(found, of, strict=True)]
        return found

    @cached_property
    def closure_forces(self) -> list[Ball]:
        """The forces (n_rows,) on all closure rows [N], of least norm."""
        state, blocks = self.state, self.state.blocks
        return product(blocks.force_map(state.q)[0], self.multipliers, blocks.n_rows)

    def joint_loads(self, column: int) -> list[Ball]:
        """Return a column (6,) of the loads on the frame and in the pins of the tree, by the function `joint_loads`."""
        state, mechanism = self.state, self.state.blocks.mechanism
        if not self._loads:
            values = mechanism.parameter_values
            given = [*(arb(float(x)) for x in values), *(x for of in state.forces for x in of)]
            motion = state.q, self.rates, self.accelerations, self.closure_forces, state.u, given
            self._loads.update(walk_of(joint_loads(mechanism))(*motion)[0])
        return dense(self._loads, 6, column)

    @cached_property
    def actuator_speeds(self) -> list[Ball]:
        """The actuators' speeds (n_u,), B^T q'."""
        return product(transposed(self.state.arms), self.rates, len(self.state.u))


def _least(P: Matrix, of: Sequence[Ball], n_columns: int) -> list[Ball]:
    """Return P^+ b (n_columns,) with the pseudoinverse of a matrix P of full rank."""
    PT, n_rows = transposed(P), len(of)
    if n_columns >= n_rows:
        (inner,) = solve_enclosed(_squared(P, n_rows), [of])
        return product(PT, inner, n_columns)
    (found,) = solve_enclosed(_squared(PT, n_columns), [product(PT, of, n_columns)])
    return found


def _squared(A: Matrix, n_rows: int) -> Matrix:
    """Return A A^T (n_rows, n_rows)."""
    found: Matrix = {}
    for (i, k), x in A.items():
        for (j, other), y in A.items():
            if other == k and i < n_rows:
                found[i, j] = found[i, j] + x * y if (i, j) in found else x * y
    return found


@dataclass(frozen=True, eq=False, kw_only=True)
class State:
    """A motion as series of x over a box: positions s (n_s,), pose q (n_q,), planned velocity v and efforts u.

    `along` (1,) is the parameter of the path that a site follows, empty without a path.
    `rate` is dx/dt [1/s], `time` is the time since the start of the motion [s]. `middle` is the state at the middle
    of the box, None for a state at one instant.
    """

    blocks: Blocks
    piece: Piece
    s: Sequence[arb_series]
    z: Sequence[arb_series]
    v: Sequence[arb_series]
    u: Sequence[arb_series]
    rate: arb
    time: arb_series
    along: Sequence[arb_series] = ()
    middle: "State | None" = None
    _kept: dict[str, list[Ball]] = field(default_factory=dict)

    def at_dead_centre(self, leverage: Leverage) -> bool:
        """Return True if the actuators are at a dead centre on the whole box, False if they are nowhere.

        A transmission between the least one and twice that may count as either, so every small enough box is decided.

        Raises:
            NotSeparatedError: if the box must be halved.
        """
        if self.middle is not None:
            return self.middle.at_dead_centre(leverage)
        maps = np.zeros((3, len(self.s), len(self.u)))
        for (i, k), entry in self.effort_map.items():
            of = entry.coeffs() if isinstance(entry, arb_series) else [entry]
            numbers = [float(x.mid()) for x in of] or [0.0]  # the series of zero has no coefficient
            maps[:, i, k] = np.polynomial.polynomial.polyval([-1.0, 0.0, 1.0], numbers)
        if not np.isfinite(maps).all():
            raise NotSeparatedError("a transmission is not enclosed")
        least = leverage.transmission(maps)
        if least.min() < leverage.least < 0.5 * least.max():
            raise NotSeparatedError("a box is partly at a dead centre")
        return bool(least.min() < leverage.least)

    def of_pose(self, name: str) -> list[Ball]:
        """Return the value of a column of the reduced dynamics that depends only on the pose."""
        if name not in self._kept:
            walk, n_rows = pose_walk(self.blocks.mechanism, name)
            self._kept[name] = dense(walk(self.q)[0], n_rows)
        return self._kept[name]

    @staticmethod
    def larger(number: float, other: Ball) -> Ball:
        """Return the larger of two numbers at every point."""
        return larger(arb(number), other)

    @cached_property
    def q(self) -> list[Ball]:
        """The pose (n_q,)."""
        return pose_of(self.blocks, self.s, self.z)

    @cached_property
    def forces(self) -> list[list[Ball]]:
        """The external forces over time (3 n_sites,), the last input of the `forced` dynamics; empty if there are none."""
        mechanism = self.blocks.mechanism
        return [] if mechanism.forces is None else forces_over(mechanism.forces, self.time)

    @cached_property
    def tangent(self) -> Matrix:
        """dphi/dq of the independent closure."""
        return self.blocks.tangent(self.q)[0]

    @cached_property
    def tangent_z(self) -> Matrix:
        """J_z, the dependent columns of the tangent."""
        at = {column: j for j, column in enumerate(self.blocks.dependent)}
        return {(row, at[column]): x for (row, column), x in self.tangent.items() if column in at}

    @cached_property
    def tangent_s(self) -> Matrix:
        """J_s, the independent columns of the tangent."""
        at = {column: j for j, column in enumerate(self.blocks.independent)}
        return {(row, at[column]): x for (row, column), x in self.tangent.items() if column in at}

    @cached_property
    def arms(self) -> Matrix:
        """B (n_q, n_u)."""
        return self.blocks.arms(self.q)[0]

    @cached_property
    def _reduced_arms(self) -> tuple[Matrix, list[list[Ball]]]:
        columns = [[self.arms.get((i, k), arb(0)) for i in range(len(self.q))] for k in range(len(self.u))]
        P, multipliers = {}, []
        for k, column in enumerate(columns):
            tau, of = self.reduced(column)
            P |= {(i, k): x for i, x in enumerate(tau) if not (isinstance(x, arb) and x.is_zero())}
            multipliers.append(of)
        return P, multipliers

    @property
    def effort_map(self) -> Matrix:
        """P = Gamma^T B (n_s, n_u)."""
        return self._reduced_arms[0]

    @property
    def arm_multipliers(self) -> list[list[Ball]]:
        """J_z^-T B_z for each actuator."""
        return self._reduced_arms[1]

    def reduced(self, forces: Sequence[Ball]) -> tuple[list[Ball], list[Ball]]:
        """Return Gamma^T f (n_s,) and J_z^-T f_z (rank,) of generalised forces f (n_q,)."""
        of_s = [forces[i] for i in self.blocks.independent]
        of_z = [forces[i] for i in self.blocks.dependent]
        if all(isinstance(x, arb) and x.is_zero() for x in of_z):
            return of_s, of_z
        (found,) = solve_enclosed(transposed(self.tangent_z), [of_z])
        return [x - y for x, y in zip(of_s, product(transposed(self.tangent_s), found, len(of_s)), strict=True)], found

    @cached_property
    def of_position(self) -> Kinetics:
        """Velocities and accelerations as derivatives of the planned positions."""
        rates = [self.rate * x.derivative() for x in self.q]
        return Kinetics(state=self, rates=rates, accelerations=[self.rate * x.derivative() for x in rates])

    @cached_property
    def of_velocity(self) -> Kinetics:
        """Rates Gamma v and accelerations of the planned velocity v."""
        a = [self.rate * x.derivative() for x in self.v]
        rates = pose_of(self.blocks, self.v, self._dependent(self.v, None))
        return Kinetics(state=self, rates=rates, accelerations=pose_of(self.blocks, a, self._dependent(a, rates)))

    def _dependent(self, of_s: Sequence[Ball], rates: list[Ball] | None) -> list[Ball]:
        """Return -J_z^-1 (J_s x + J' q'), or -J_z^-1 J_s x if `rates` are not given."""
        n = self.blocks.rank
        if n == 0:
            return []
        right = product(self.tangent_s, of_s, n)
        if rates is not None:
            right = [x + y for x, y in zip(right, dense(self.blocks.convective(self.q, rates)[0], n), strict=True)]
        (found,) = solve_enclosed(self.tangent_z, [[-x for x in right]])
        return found

    @property
    def kinetics(self) -> list[Kinetics]:
        """The kinetics of the motion: one, or two if the planned velocity is not the derivative of the planned position."""
        return [getattr(self, name) for name in self.piece.kinetics]
