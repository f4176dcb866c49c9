"""The claims of a problem at every instant of a motion: those of its limits, and those that hold for every motion.

A claim is a quantity as a series, the interval in which it lies, and the bounds on it.

For every motion, all rows of the closure are zero, the planned efforts produce the motion, and a reference is followed.
"""

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from flint import arb

from linkplan.planner.certificate.certificate import CLOSURE_M
from linkplan.planner.certificate.integration import BOUNDARY_SHARE
from linkplan.planner.limits.kinds import FURTHER_CLAIMS, limits_of
from linkplan.planner.limits.limit import Claimed, Limit, rounding_of
from linkplan.planner.limits.samples import samples_for_claims
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.reference import Sine
from linkplan.planner.proof.curve import enclosed
from linkplan.planner.proof.finding import Finding
from linkplan.planner.proof.motion import Kinetics, State
from linkplan.planner.proof.taylor import LOOSE_SHARE, TaylorForm, Verdict
from linkplan.planner.proof.walk import Ball, UnknownOperationError, walk_of
from linkplan.planner.trajectory import Trajectory

# Of functions of q, v, a and u; further ones take the jerk and the forces over time (`motion_symbols`).
_MOTION_INPUTS = 4
_NOT_ENCLOSED = "balls do not enclose one of its operations"


def _no_limit() -> tuple[str, str]:
    return "", ""


@dataclass(frozen=True, eq=False, slots=True)
class Claim:
    """low - slack[0] <= f(t) <= high + slack[1] at every instant. Every value of `values` at a state must satisfy it.

    Numbers are in SI; a number times `per_unit` is in `unit`. The default slack is the allowance for rounding.
    """

    name: str
    unit: str
    bounds: Sequence[float] | np.ndarray
    values: Callable[[State], list[Ball]]
    slack: tuple[float, float] | None = None
    per_unit: float = 1.0
    of: Callable[[], tuple[str, str]] = _no_limit  # gives the key and the part of its limit

    @property
    def allowed(self) -> tuple[float, float]:
        """The allowances on [low, high]; by default for rounding."""
        low, high = (rounding_of(float(x)) for x in self.bounds)
        return (low, high) if self.slack is None else self.slack

    @property
    def least_size(self) -> float:
        """The size up to which a value counts as zero: the allowance if the claim is an equation, 0 if it is a limit."""
        return max(self.allowed) if self.bounds[0] == self.bounds[1] else 0.0

    @property
    def marks(self) -> tuple[float, float]:
        """The limits [low, high], extended by their allowances."""
        return float(self.bounds[0]) - self.allowed[0], float(self.bounds[1]) + self.allowed[1]


def of_kinetics(of: Callable[[Kinetics], Ball]) -> Callable[[State], list[Ball]]:
    """Return the values of a quantity for the one or two `Kinetics` of a motion."""
    return lambda state: [of(kinetics) for kinetics in state.kinetics]


@dataclass(eq=False, slots=True, kw_only=True)
class Record:
    """The bounds found so far on the quantity of one claim. The sweep over the boxes extends them."""

    least: float = math.inf
    greatest: float = -math.inf
    least_at: float = 0.0
    greatest_at: float = 0.0
    boxes: int = 0
    refuted: Verdict | None = None
    refuted_at: float = 0.0
    undecided: list[tuple[float, float]] = field(default_factory=list)

    def loosened_by(self, verdict: Verdict, form: TaylorForm, claim: Claim) -> bool:
        """Return True if a bound would extend the known range and a large share of it is the Taylor form's remainder."""
        extends = verdict.least < self.least or verdict.greatest > self.greatest
        size = max(abs(verdict.least), abs(verdict.greatest), claim.least_size)
        return extends and not form.remainder <= LOOSE_SHARE * size

    def add(self, verdict: Verdict, time_s: float) -> None:
        """Extend the known range by the bounds on a box."""
        if verdict.least < self.least:
            self.least, self.least_at = verdict.least, time_s
        if verdict.greatest > self.greatest:
            self.greatest, self.greatest_at = verdict.greatest, time_s


def undecided_reason(boxes: list[tuple[float, float]]) -> str:
    """Return the reason that lists the undecided boxes (begin, end) [s]."""
    begin, end = boxes[0]
    more = f" and in {len(boxes) - 1} more boxes" if len(boxes) > 1 else ""
    return f"not decided between t = {begin:.9g} s and {end:.9g} s{more}"


def finding_of_claim(claim: Claim, record: Record) -> Finding:
    """Return the finding on a claim from the bounds in its record."""
    k, (low, high) = claim.per_unit, claim.marks
    if record.refuted is not None:
        upper = record.refuted.least > high
        value, mark = (record.refuted.least, high) if upper else (record.refuted.greatest, low)
        reason = f"{value * k:.9g} {claim.unit} at t = {record.refuted_at:.9g} s, beyond {mark * k:.9g}"
        answer, margin, when, (limit, part) = "refuted", -abs(value - mark) * k, record.refuted_at, claim.of()
    else:
        upper = high - record.greatest <= record.least - low
        value, mark = (record.greatest, high) if upper else (record.least, low)
        margin, when = min(high - record.greatest, record.least - low) * k, record.greatest_at if upper else record.least_at
        reason = undecided_reason(record.undecided) if record.undecided else ""
        answer, limit, part = "undecided" if record.undecided else "proved", "", ""
    return Finding(
        name=claim.name, answer=answer, unit=claim.unit, bound=value * k, mark=mark * k, margin=margin,
        boxes=record.boxes, time_s=when, reason=reason, limit=limit, part=part,
    )  # fmt: skip


def claims_of(problem: Problem, trajectory: Trajectory) -> tuple[list[Claim], list[Finding]]:
    """Return the claims of a problem on a trajectory at every instant, and the findings on limits without a claim.

    A limit without a claim, or with a value that cannot be enclosed, is undecided.
    """
    claims, open_limits = [], []
    for limit in limits_of(problem):
        claimed = list(limit.claims(problem, trajectory))
        if not claimed:
            title = limit.facts.words.format(f"number {limit.item + 1}")
            open_limits.append(_undecided(f"limit on {limit.key}: {title}", "the limit has no claim"))
        for one in claimed:
            _sort_in(one, problem, claims, open_limits, functools.partial(_part_of, limit, problem, trajectory))
    for one in (one for claimed in FURTHER_CLAIMS for one in claimed(problem, trajectory)):
        _sort_in(one, problem, claims, open_limits)
    further = (loop_claims, _residuals, reference_claims)
    claims += [claim for kind in further for claim in kind(problem, trajectory)]
    return claims, open_limits


def _part_of(limit: Limit, problem: Problem, trajectory: Trajectory) -> tuple[str, str]:
    """Return the key of a limit and the name of its part."""
    return limit.key, limit.measured(samples_for_claims(problem, trajectory)).name


def _sort_in(
    one: Claimed,
    problem: Problem,
    claims: list[Claim],
    open_limits: list[Finding],
    of: Callable[[], tuple[str, str]] = _no_limit,
) -> None:
    """Add the claim of a limit to the claims. If its value cannot be enclosed, add an undecided finding instead."""
    if one.unknown:
        open_limits.append(_undecided(one.name, one.unknown))
        return
    try:
        values = _values(one, problem)
    except UnknownOperationError:
        open_limits.append(_undecided(one.name, _NOT_ENCLOSED))
        return
    claims.append(Claim(one.name, one.unit, one.bounds, values, one.slack, one.per_unit, of))


def _values(one: Claimed, problem: Problem) -> Callable[[State], list[Ball]]:
    """Return the function from a state to an enclosure of the quantity that a limit bounds."""
    value = one.value
    if isinstance(value, Sequence):
        walks = [walk_of(function) for function in value]
        return lambda state: [walks[state.piece.index](state.q, state.along)[0][0, 0]]
    if not isinstance(value, ca.Function):
        return (lambda state: [value(state)]) if one.of_planned else of_kinetics(value)
    walk, of_s = walk_of(value), list(problem.mechanism.independent)
    if one.of_planned:
        return lambda state: [walk(state.q)[0][0, 0]]

    def at(kinetics: Kinetics) -> Ball:
        of_time = [kinetics.rates, kinetics.accelerations]
        of_time += [kinetics.jerks] if value.n_in() > _MOTION_INPUTS else []
        v, a, *jerk = ([of[i] for i in of_s] for of in of_time)
        forces = kinetics.state.forces if jerk else ()
        return walk(kinetics.state.q, v, a, kinetics.state.u, *jerk, *forces)[0][0, 0]

    if value.n_in() > _MOTION_INPUTS and value.jac_sparsity(0, _MOTION_INPUTS).nnz():
        return lambda state: [at(state.of_velocity)]
    return of_kinetics(at)


def _undecided(name: str, reason: str) -> Finding:
    return Finding(name=name, answer="undecided", reason=f"not proved: {reason}")


def loop_claims(problem: Problem, _: Trajectory) -> Iterator[Claim]:
    """Yield the claim on closure rows for which the branch does not solve: redundant rows, and those of normal equations.

    Constant rows, such as those of a planar loop normal to its plane, are left out if they are zero.
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
        yield Claim(name, "m", (0.0, 0.0), lambda state: list(walk(state.q)[0].values()), (mark, mark))


def reference_claims(problem: Problem, trajectory: Trajectory) -> Iterator[Claim]:
    """Yield the claims that a motion equals its reference, with an allowance relative to its span."""
    reference = problem.reference_over(trajectory.duration_s)
    if problem.motion.kind != "track" or reference is None:
        return
    allowed = BOUNDARY_SHARE * max(float(np.ptp(trajectory.position)), 1e-9)
    for i, joint in enumerate(problem.mechanism.independent_joints):
        over = _enclosed_sine if isinstance(reference, Sine) else enclosed

        def off(state: State, i: int = i, over: Callable = over) -> list[Ball]:
            return [state.s[i] - over(reference, i, state.time)]

        name = f"distance of {joint.name} from its reference"
        yield Claim(name, joint.unit, (0.0, 0.0), off, (allowed, allowed), joint.shown(1.0))


def _enclosed_sine(sine: Sine, i: int, time: Ball) -> Ball:
    """Return a ball around a joint's sinusoid in a ball of times."""
    amplitude, bias, phase = (float(x[i]) for x in (sine.amplitude, sine.bias, sine.phase))
    return bias + amplitude * (2 * arb.pi() * sine.frequency_hz * time + phase).sin()


def _residuals(problem: Problem, trajectory: Trajectory) -> Iterator[Claim]:
    """Yield the claims that the planned efforts produce the motion, with the certificate's allowance."""
    allowed = samples_for_claims(problem, trajectory).lacking_allowed
    for i, joint in enumerate(problem.mechanism.independent_joints):
        name, unit = f"effort on {joint.name} that the planned effort lacks", joint.si_units[1]
        lacking = of_kinetics(lambda kinetics, i=i: kinetics.residual[i])
        yield Claim(name, unit, (0.0, 0.0), lacking, (allowed, allowed))


def sampled_findings(problem: Problem, failures: Sequence[str]) -> list[Finding]:
    """Return the findings that only a certificate gives: contacts, limits missing in a saved plan, and `failures`."""
    unread = "its expression is Python, which files do not hold; linkplan.read_plan takes it again"
    contacts = "distances between geoms are compared at samples"
    return [
        Finding(name="contacts between geoms", answer="sampled", reason=contacts),
        *(_undecided(f"extra limit '{one.name}'", unread) for one in problem.unread_extras if one.kind == "limit"),
        *(Finding(name="certificate at samples", answer="refuted", reason=sentence) for sentence in failures),
    ]
