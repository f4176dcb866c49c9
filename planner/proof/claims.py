"""Claims on every instant of a motion: a quantity as a series, and the interval in which it lies."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.tree.joints import Joint
from linkplan.planner.certificate.certificate import DYNAMICS_SHARE, INVERSE_DYNAMICS_SHARE, RANGE_SLACK
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.motion import Kinetics, State
from linkplan.planner.proof.walk import Ball, walk_of
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Claim:
    """low - slack <= f(t) <= high + slack at every instant. All `values` of a state have to keep it.

    Numbers are SI; `per_unit` times them is in `unit`.
    """

    name: str
    unit: str
    low: float
    high: float
    slack: float
    values: Callable[[State], list[Ball]]
    per_unit: float = 1.0


def claims_of(problem: Problem, trajectory: Trajectory) -> list[Claim]:
    """Return the claims of a problem on a trajectory at every instant."""
    kinds = (_efforts, _residuals, _joints, _rates_of_effort, _drives, _forces, _margins, _corners, _sites)
    return [claim for kind in kinds for claim in kind(problem, trajectory)]


def _size(bounds: np.ndarray) -> float:
    """Return the larger finite end of [low, high]."""
    ends = np.abs(np.asarray(bounds, dtype=float))
    return float(ends[np.isfinite(ends)].max(initial=0.0))


def _of_kinetics(of: Callable[[Kinetics], Ball]) -> Callable[[State], list[Ball]]:
    return lambda state: [of(kinetics) for kinetics in state.kinetics]


def _efforts(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    for j, (actuator, bounds) in enumerate(zip(problem.mechanism.actuators, problem.limits.effort, strict=True)):
        size = _size(bounds)
        if not size and not np.isfinite(bounds).any():
            continue
        low, high = (float(x) for x in bounds)
        yield Claim(
            name=f"effort of {actuator.name} by inverse dynamics",
            unit=actuator.unit,
            low=low,
            high=high,
            slack=INVERSE_DYNAMICS_SHARE * size,
            values=_of_kinetics(lambda kinetics, j=j: kinetics.efforts()[j]),
        )
        yield Claim(
            name=f"planned effort of {actuator.name}",
            unit=actuator.unit,
            low=low,
            high=high,
            slack=ROUNDING_SHARE * size,
            values=lambda state, j=j: [state.u[j]],
        )


def _residuals(problem: Problem, trajectory: Trajectory) -> Iterator[Claim]:
    """Yield the claims that the planned efforts give the motion, with the certificate's allowance."""
    mechanism = problem.mechanism
    largest = np.abs(np.array(mechanism.dynamics.effort_map(trajectory.start_pose))) @ np.abs(trajectory.effort).max((0, 1))
    inertia = np.abs(np.array(mechanism.dynamics.reduced_inertia(trajectory.start_pose)))
    acceleration = np.abs(trajectory.acceleration_at(trajectory.dense_times(4))).max(axis=0)
    allowed = max(DYNAMICS_SHARE * float(largest.max(initial=0.0)), 1e-12, 1e-6 * float((inertia @ acceleration).max()))
    for i, joint in enumerate(mechanism.independent_joints):
        yield Claim(
            name=f"effort on {joint.name} that the planned effort lacks",
            unit="N.m" if joint.kind == "hinge" else "N",
            low=0.0,
            high=0.0,
            slack=allowed,
            values=_of_kinetics(lambda kinetics, i=i: kinetics.residual[i]),
        )


def _joints(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    limits = problem.limits
    for index, joint in enumerate(problem.mechanism.joints):
        for what, per, bounds in (("position", "", limits.position[index]), ("speed", "/s", limits.speed[index])):
            if not np.isfinite(bounds).any():
                continue
            values = (
                (lambda state, i=index: [state.q[i]])
                if what == "position"
                else _of_kinetics(lambda kinetics, i=index: kinetics.rates[i])
            )
            yield Claim(
                name=f"{what} of {joint.name}",
                unit=f"{joint.unit}{per}",
                low=float(bounds[0]),
                high=float(bounds[1]),
                slack=RANGE_SLACK,
                values=values,
                per_unit=_per_unit(joint),
            )


def _per_unit(joint: Joint) -> float:
    return 180.0 / np.pi if joint.kind == "hinge" else 1.0


def _rates_of_effort(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    for j, actuator in enumerate(problem.mechanism.actuators):
        bounds = problem.limits.effort_rate[j]
        if np.isfinite(bounds).any():
            yield Claim(
                name=f"effort rate of {actuator.name}",
                unit=f"{actuator.unit}/s",
                low=float(bounds[0]),
                high=float(bounds[1]),
                slack=ROUNDING_SHARE * max(1.0, _size(bounds)),
                values=lambda state, j=j: [state.rate * state.u[j].derivative()],
            )


def _drives(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claims on actuators' powers and motors' torque-speed lines."""
    for j, (actuator, motor) in enumerate(zip(problem.mechanism.actuators, problem.motors, strict=True)):
        power = problem.limits.power[j]
        if np.isfinite(power).any():
            yield Claim(
                name=f"power of {actuator.name}",
                unit="W",
                low=float(power[0]),
                high=float(power[1]),
                slack=ROUNDING_SHARE * max(1.0, _size(power)),
                values=_of_kinetics(lambda kinetics, j=j: kinetics.state.u[j] * kinetics.actuator_speeds[j]),
            )
        if motor is not None and motor.line is not None:
            stall, no_load = motor.line

            def line(kinetics: Kinetics, j: int = j, stall: float = stall, no_load: float = no_load) -> Ball:
                return kinetics.state.u[j] / stall + kinetics.actuator_speeds[j] / no_load

            yield Claim(
                name=f"torque-speed line of {actuator.name}",
                unit="1",
                low=-1.0,
                high=1.0,
                slack=ROUNDING_SHARE,
                values=_of_kinetics(line),
            )


def _forces(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    mechanism = problem.mechanism
    for c in problem.limits.limited_closures:
        rows, rating = mechanism.closure_slice(c), float(problem.limits.closure_force[c])

        def squared(kinetics: Kinetics, rows: slice = rows) -> Ball:
            return sum((x * x for x in kinetics.closure_forces[rows]), 0 * kinetics.state.q[0])

        yield Claim(
            name=f"squared closure force of {mechanism.closure_names[c]}",
            unit="N2",
            low=-np.inf,
            high=rating**2,
            slack=2 * ROUNDING_SHARE * max(1.0, rating) * rating,
            values=_of_kinetics(squared),
        )


def _margins(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claims on J_z's determinants relative to home, on tendons' lengths and on ball joints' angles."""
    mechanism, margin = problem.mechanism, problem.limits.singular_margin
    q = ca.SX.sym("q", mechanism.n_q)
    if margin > 0:
        at_home = np.array(mechanism.dynamics.block_singularity(mechanism.home)).ravel()
        walk = walk_of(ca.Function("blocks", [q], [mechanism.dynamics.block_singularity(q) / ca.DM(at_home)]))
        for block in range(len(at_home)):
            yield Claim(
                name=f"distance from a singular pose, block {block + 1}",
                unit="1",
                low=float(margin),
                high=np.inf,
                slack=ROUNDING_SHARE,
                values=lambda state, walk=walk, b=block: [walk(state.q)[0][b, 0]],
            )
    if mechanism.tendons:
        lengths = walk_of(ca.Function("tendons", [q], [ca.densify(mechanism.dynamics.tendon_length(q))]))
        for k, tendon in enumerate(mechanism.tendons):
            yield Claim(
                name=f"length of tendon {tendon.name}",
                unit=tendon.unit,
                low=float(tendon.low),
                high=float(tendon.high),
                slack=ROUNDING_SHARE * max(1.0, _size(np.array([tendon.low, tendon.high]))),
                values=lambda state, walk=lengths, k=k: [walk(state.q)[0][k, 0]],
            )
    if mechanism.balls:
        turns = walk_of(ca.Function("balls", [q], [ca.densify(mechanism.dynamics.ball_turns(q))]))
        for k, ball in enumerate(mechanism.balls):
            yield Claim(
                name=f"sin^2 of half the angle of ball joint {ball.name}",
                unit="1",
                low=-np.inf,
                high=float(np.sin(ball.largest / 2) ** 2),
                slack=ROUNDING_SHARE,
                values=lambda state, walk=turns, k=k: [walk(state.q)[0][k, 0]],
            )


def _corners(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    mechanism = problem.mechanism
    joints = tuple(joint.name for joint in mechanism.joints)
    for corner in problem.robust.corners:
        for j, actuator in enumerate(mechanism.actuators):
            bounds = problem.robust.room * problem.limits.effort[j]
            if np.isfinite(bounds).any():
                yield Claim(
                    name=f"effort of {actuator.name} with {corner.description(joints)}",
                    unit=actuator.unit,
                    low=float(bounds[0]),
                    high=float(bounds[1]),
                    slack=INVERSE_DYNAMICS_SHARE * _size(bounds),
                    values=_of_kinetics(lambda kinetics, j=j, corner=corner: kinetics.efforts(corner)[j]),
                )


def _sites(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claims on sites' coordinates and distances from walls."""
    mechanism = problem.mechanism
    q = ca.SX.sym("q", mechanism.n_q)
    for limit in problem.limits.site:
        if limit.normal is None:  # a tube
            continue
        place = mechanism.dynamics.site_places(q)[:, limit.index]
        value = ca.densify(ca.dot(ca.DM(limit.normal), place) - limit.origin)
        walk = walk_of(ca.Function("site", [q], [value]))
        yield Claim(
            name=f"{limit.what} of site {limit.site}",
            unit="m",
            low=float(limit.low),
            high=float(limit.high),
            slack=ROUNDING_SHARE * max(1.0, _size(np.array([limit.low, limit.high]))),
            values=lambda state, walk=walk: [walk(state.q)[0][0, 0]],
        )
