"""The claims of a problem on every instant of a motion: on efforts, rates, drives and forces, and on its poses.

Those on poses are all rows of the loops, singular poses, tendons, ball joints, sites, and a reference.
"""

import functools
from collections.abc import Callable, Iterator, Sequence

import casadi as ca
import numpy as np
from flint import arb

from linkplan.models.actuation.actuators import Actuator, ranged_control
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.poses.along import missed_rounding
from linkplan.planner.certificate.certificate import CLOSURE_M, DYNAMICS_SHARE, INVERSE_DYNAMICS_SHARE, RANGE_SLACK
from linkplan.planner.certificate.integration import BOUNDARY_SHARE
from linkplan.planner.limits.actuators import clamped_allowance
from linkplan.planner.limits.kinds import squared_distances
from linkplan.planner.problem.extra import ExtraLimit, expressed
from linkplan.planner.problem.instant import free_instant
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.claim import Claim, claim_of, of_kinetics, rounding_of, share_of
from linkplan.planner.proof.finding import Finding
from linkplan.planner.proof.motion import Kinetics, State
from linkplan.planner.proof.walk import Ball, UnknownOperationError, Walk, larger, walk_of
from linkplan.planner.trajectory import Trajectory


def loop_claims(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claim on rows of the loops that the branch does not solve: redundant ones, and those of normal equations.

    Out of a plane, a planar loop has rows that are constant.
    """
    mechanism = problem.mechanism
    solved = {int(row) for row in mechanism.closure_rows} - {row for loop in mechanism.projected for row in loop.rows}
    q, mark = ca.SX.sym("q", mechanism.n_q), max(CLOSURE_M, mechanism.closed_m)
    phi = ca.vertsplit(mechanism.dynamics.closure(q))
    rows = [
        phi[row]
        for row in range(mechanism.n_closure_rows)
        if row not in solved and not (phi[row].is_constant() and abs(float(phi[row])) <= mark)
    ]
    if rows:
        walk = walk_of(ca.Function("redundant", [q], [ca.densify(ca.vertcat(*rows))]))
        name = "the redundant equations of the loops hold"
        yield claim_of(name, "m", (0.0, 0.0), lambda state: list(walk(state.q)[0].values()), (mark, mark))


def singularity_claims(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claims on the determinants of J_z's blocks relative to home."""
    mechanism, margin = problem.mechanism, problem.limits.singular_margin
    if margin <= 0:
        return
    q = ca.SX.sym("q", mechanism.n_q)
    at_home = np.array(mechanism.dynamics.block_singularity(mechanism.home)).ravel()
    walk = walk_of(ca.Function("blocks", [q], [mechanism.dynamics.block_singularity(q) / ca.DM(at_home)]))
    for block in range(len(at_home)):
        yield claim_of(f"distance from a singular pose, block {block + 1}", "1", (margin, np.inf), _entry(walk, block))


def part_claims(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claims on tendons' lengths and on ball joints' angles."""
    mechanism = problem.mechanism
    q = ca.SX.sym("q", mechanism.n_q)
    if mechanism.tendons:
        lengths = walk_of(ca.Function("tendons", [q], [ca.densify(mechanism.dynamics.tendon_length(q))]))
        for k, tendon in enumerate(mechanism.tendons):
            bounds = (tendon.low, tendon.high)
            yield claim_of(f"length of tendon {tendon.name}", tendon.unit, bounds, _entry(lengths, k))
    if mechanism.balls:
        turns = walk_of(ca.Function("balls", [q], [ca.densify(mechanism.dynamics.ball_turns(q))]))
        for k, ball in enumerate(mechanism.balls):
            bounds = (-np.inf, np.sin(ball.largest / 2) ** 2)
            yield claim_of(f"sin^2 of half the angle of ball joint {ball.name}", "1", bounds, _entry(turns, k))


def site_claims(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claims on sites' coordinates and distances from walls, and on squared distances from polylines."""
    mechanism = problem.mechanism
    q = ca.SX.sym("q", mechanism.n_q)
    for limit in problem.limits.site:
        place = mechanism.dynamics.site_places(q)[:, limit.index]
        bounds, slack = (limit.low, limit.high), None
        if limit.is_tube:
            distances = squared_distances(place, np.asarray(limit.along))
            value, squared = functools.reduce(ca.fmin, distances), limit.high**2
            slack = (0.0, (limit.high + rounding_of(bounds)[1]) ** 2 - squared)
            name, unit, bounds = f"squared distance from the tube of site {limit.site}", "m2", (-np.inf, squared)
        else:
            value = ca.dot(ca.DM(np.asarray(limit.normal)), place) - limit.origin
            name, unit = f"{limit.what} of site {limit.site}", "m"
        walk = walk_of(ca.Function("site", [q], [ca.densify(value)]))
        yield claim_of(name, unit, bounds, _entry(walk, 0), slack)


def reference_claims(problem: Problem, trajectory: Trajectory) -> Iterator[Claim]:
    """Yield the claims that a motion follows its sinusoids exactly."""
    reference = problem.reference
    if problem.motion.kind != "track" or reference is None:
        return
    allowed = BOUNDARY_SHARE * max(float(np.ptp(trajectory.position)), 1e-9)
    for i, joint in enumerate(problem.mechanism.independent_joints):
        amplitude, bias, phase = (float(x[i]) for x in (reference.amplitude, reference.bias, reference.phase))

        def off(
            state: State, i: int = i, amplitude: float = amplitude, bias: float = bias, phase: float = phase
        ) -> list[Ball]:
            turned = 2 * arb.pi() * reference.frequency_hz * state.time + phase
            return [state.s[i] - bias - amplitude * turned.sin()]

        name = f"distance of {joint.name} from its reference"
        yield claim_of(name, joint.unit, (0.0, 0.0), off, (allowed, allowed), joint.shown(1.0))


def _entry(walk: Walk, k: int) -> Callable[[State], list[Ball]]:
    """Return the values of entry k of a function of the pose."""
    return lambda state: [walk(state.q)[0][k, 0]]


def claims_of(problem: Problem, trajectory: Trajectory) -> list[Claim]:
    """Return the claims of a problem on a trajectory at every instant."""
    of_poses = (loop_claims, singularity_claims, part_claims, site_claims, reference_claims)
    kinds = (_efforts, _residuals, _joints, _rates_of_effort, _drives, _servos, _forces, _corners, *of_poses, _extras)
    return [claim for kind in kinds for claim in kind(problem, trajectory)]


def _efforts(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    for j, (actuator, bounds) in enumerate(zip(problem.mechanism.actuators, problem.limits.effort, strict=True)):
        if not np.isfinite(bounds).any():
            continue
        needed = of_kinetics(lambda kinetics, j=j: kinetics.efforts()[j])
        allowed = share_of(bounds, INVERSE_DYNAMICS_SHARE)
        yield claim_of(f"effort of {actuator.name} by inverse dynamics", actuator.unit, bounds, needed, allowed)
        allowed = share_of(bounds, ROUNDING_SHARE)
        yield claim_of(f"planned effort of {actuator.name}", actuator.unit, bounds, lambda state, j=j: [state.u[j]], allowed)


def _residuals(problem: Problem, trajectory: Trajectory) -> Iterator[Claim]:
    """Yield the claims that the planned efforts give the motion, with the certificate's allowance."""
    mechanism = problem.mechanism
    largest = np.abs(np.array(mechanism.dynamics.effort_map(trajectory.start_pose))) @ np.abs(trajectory.effort).max((0, 1))
    inertia = np.abs(np.array(mechanism.dynamics.reduced_inertia(trajectory.start_pose)))
    acceleration = np.abs(trajectory.acceleration_at(trajectory.dense_times(4))).max(axis=0)
    rounding = missed_rounding(problem.limits.effort)
    allowed = max(DYNAMICS_SHARE * float(largest.max(initial=0.0)), rounding, 1e-6 * float((inertia @ acceleration).max()))
    for i, joint in enumerate(mechanism.independent_joints):
        name, unit = f"effort on {joint.name} that the planned effort lacks", joint.si_units[1]
        lacking = of_kinetics(lambda kinetics, i=i: kinetics.residual[i])
        yield claim_of(name, unit, (0.0, 0.0), lacking, (allowed, allowed))


def _joints(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    limits = problem.limits
    for index, joint in enumerate(problem.mechanism.joints):
        for what, per, bounds in (("position", "", limits.position[index]), ("speed", "/s", limits.speed[index])):
            if not np.isfinite(bounds).any():
                continue
            values = (
                (lambda state, i=index: [state.q[i]])
                if what == "position"
                else of_kinetics(lambda kinetics, i=index: kinetics.rates[i])
            )
            slack = (RANGE_SLACK, RANGE_SLACK)
            yield claim_of(f"{what} of {joint.name}", f"{joint.unit}{per}", bounds, values, slack, joint.shown(1.0))


def _rates_of_effort(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    for j, actuator in enumerate(problem.mechanism.actuators):
        bounds = problem.limits.effort_rate[j]
        if np.isfinite(bounds).any():
            yield claim_of(
                f"effort rate of {actuator.name}",
                f"{actuator.unit}/s",
                bounds,
                lambda state, j=j: [state.rate * state.u[j].derivative()],
            )


def _drives(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claims on actuators' powers and motors' torque-speed lines."""
    for j, (actuator, motor) in enumerate(zip(problem.mechanism.actuators, problem.motors, strict=True)):
        power = problem.limits.power[j]
        if np.isfinite(power).any():
            spent = of_kinetics(lambda kinetics, j=j: kinetics.state.u[j] * kinetics.actuator_speeds[j])
            yield claim_of(f"power of {actuator.name}", "W", power, spent)
        if motor is not None and motor.line is not None:
            stall, no_load = motor.line

            def line(kinetics: Kinetics, j: int = j, stall: float = stall, no_load: float = no_load) -> Ball:
                return kinetics.state.u[j] / stall + kinetics.actuator_speeds[j] / no_load

            yield claim_of(f"torque-speed line of {actuator.name}", "1", (-1.0, 1.0), of_kinetics(line))


def _servos(problem: Problem, trajectory: Trajectory) -> Iterator[Claim]:
    """Yield the claims that a ctrl in its range gives a servo's planned effort, unless its force is clamped anyway."""
    mechanism = problem.mechanism
    for j, actuator in enumerate(mechanism.actuators):
        bounds = (actuator.control_lower, actuator.control_upper)
        if not (actuator.is_servo and actuator.has_length and np.isfinite(bounds).any()):
            continue
        q = ca.SX.sym("q", mechanism.n_q)
        length = walk_of(ca.Function("length", [q], [ca.densify(mechanism.dynamics.actuator_length(q)[j])]))

        def ctrl(kinetics: Kinetics, j: int = j, actuator: Actuator = actuator, length: Walk = length) -> Ball:
            state = kinetics.state
            on = (arb(1), length(state.q)[0][0, 0], kinetics.actuator_speeds[j])
            gain, bias = (
                sum((arb(c) * x for c, x in zip(of, on, strict=True) if c), arb(0))
                for of in (actuator.gains, actuator.biases)
            )
            return ranged_control(actuator, (state.u[j] - bias) / gain, state.u[j], gain, lambda a, b: larger(arb(a), b))

        more = clamped_allowance(problem, trajectory, j)
        yield claim_of(f"ctrl of {actuator.name}", "", bounds, of_kinetics(ctrl), (more, more) if more else None)


def _forces(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    mechanism = problem.mechanism
    for c in problem.limits.limited_closures:
        rows, rating = mechanism.closure_slice(c), float(problem.limits.closure_force[c])

        def squared(kinetics: Kinetics, rows: slice = rows) -> Ball:
            return sum((x * x for x in kinetics.closure_forces[rows]), 0 * kinetics.state.q[0])

        name, slack = (
            f"squared closure force of {mechanism.closure_names[c]}",
            2 * ROUNDING_SHARE * max(1.0, rating) * rating,
        )
        yield claim_of(name, "N2", (-np.inf, rating**2), of_kinetics(squared), (0.0, slack))


def _corners(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    mechanism = problem.mechanism
    joints = tuple(joint.name for joint in mechanism.joints)
    for corner in problem.robust.corners:
        for j, actuator in enumerate(mechanism.actuators):
            bounds = problem.robust.room * problem.limits.effort[j]
            if np.isfinite(bounds).any():
                name = f"effort of {actuator.name} with {corner.description(joints)}"
                needed = of_kinetics(lambda kinetics, j=j, corner=corner: kinetics.efforts(corner)[j])
                yield claim_of(name, actuator.unit, bounds, needed, share_of(bounds, INVERSE_DYNAMICS_SHARE))


def enclosed(problem: Problem, limit: ExtraLimit) -> Walk | None:
    """Return the walk of (q, v, a, u) -> a user's expression; None if balls do not enclose one of its operations."""
    at, symbols = free_instant(problem.mechanism)
    try:
        return walk_of(ca.Function("extra", symbols[:4], [ca.densify(expressed(limit, at))]))
    except UnknownOperationError:
        return None


def _extras(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claims on users' own expressions."""
    of_s = list(problem.mechanism.independent)
    for limit in problem.extra_limits:
        walk = enclosed(problem, limit)
        if walk is None:
            continue

        def value(kinetics: Kinetics, walk: Walk = walk) -> Ball:
            v, a = ([of[i] for i in of_s] for of in (kinetics.rates, kinetics.accelerations))
            return walk(kinetics.state.q, v, a, kinetics.state.u)[0][0, 0]

        yield claim_of(f"extra limit '{limit.name}'", limit.unit, (limit.lower, limit.upper), of_kinetics(value))


def sampled_findings(problem: Problem, failures: Sequence[str]) -> list[Finding]:
    """Return the findings that only a certificate has: what is not enclosed, with the reason, and its `failures`.

    A limit among them is not proved.
    """
    mechanism = problem.mechanism
    lines = [
        (f"ctrl of {actuator.name}", "only MuJoCo knows its length")
        for actuator in mechanism.actuators
        if actuator.is_servo
        and not actuator.has_length
        and np.isfinite([actuator.control_lower, actuator.control_upper]).any()
    ]
    lines += [
        (f"extra limit '{limit.name}'", "balls do not enclose one of its operations")
        for limit in problem.extra_limits
        if enclosed(problem, limit) is None
    ]
    lines += [
        (f"extra limit '{one.name}'", "its expression is Python, which files do not hold; linkplan.read_plan takes it again")
        for one in problem.unread_extras
        if one.kind == "limit"
    ]
    contacts = "distances between geoms are compared at samples"
    return [
        Finding(name="contacts between geoms", answer="sampled", reason=contacts),
        *(Finding(name=name, answer="undecided", reason=f"not proved: {reason}") for name, reason in lines),
        *(Finding(name="certificate at samples", answer="refuted", reason=sentence) for sentence in failures),
    ]
