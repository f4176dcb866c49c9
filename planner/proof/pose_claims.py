"""Claims on a motion's poses: all rows of the loops, singular poses, tendons, ball joints, sites, a reference."""

import functools
import itertools
from collections.abc import Callable, Iterator

import casadi as ca
import numpy as np
from flint import arb

from linkplan.planner.certificate.boundary import BOUNDARY_SHARE
from linkplan.planner.certificate.certificate import CLOSURE_M
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import SiteLimit
from linkplan.planner.proof.claim import Claim, claim_of, rounding_of
from linkplan.planner.proof.motion import State
from linkplan.planner.proof.walk import Ball, Walk, walk_of
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
            value, squared = _squared_distance(limit, place), limit.high**2
            slack = (0.0, (limit.high + rounding_of(bounds)[1]) ** 2 - squared)
            name, unit, bounds = f"squared distance from the tube of site {limit.site}", "m2", (-np.inf, squared)
        else:
            value = ca.dot(ca.DM(np.asarray(limit.normal)), place) - limit.origin
            name, unit = f"{limit.what} of site {limit.site}", "m"
        walk = walk_of(ca.Function("site", [q], [ca.densify(value)]))
        yield claim_of(name, unit, bounds, _entry(walk, 0), slack)


def _squared_distance(limit: SiteLimit, place: ca.SX) -> ca.SX:
    """Return the squared distance of a place (3,) from the nearest segment of a tube's polyline."""

    def from_segment(a: np.ndarray, b: np.ndarray) -> ca.SX:
        way, off = b - a, place - ca.DM(a)
        share = ca.fmax(0.0, ca.fmin(1.0, ca.dot(off, ca.DM(way)) / float(way @ way)))
        return ca.sumsqr(off - share * ca.DM(way))

    corners = list(np.asarray(limit.along))
    return functools.reduce(ca.fmin, [from_segment(a, b) for a, b in itertools.pairwise(corners)])


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
