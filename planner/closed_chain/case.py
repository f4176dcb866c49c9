"""A mechanism's planning problem as a case for refinement, and the plan of a certified or prescribed motion."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.certificate.certificate import INTEGRATION_M, Certificate, certify
from linkplan.planner.certificate.further_checks import objective_value, with_contacts
from linkplan.planner.closed_chain.formulate import SMOOTHING_WEIGHT
from linkplan.planner.closed_chain.guess import Guess, guess_from
from linkplan.planner.closed_chain.prescribed import (
    along_reference,
    at_rate,
    balanced_rates,
    highest_rate,
    holding_at,
    prescribe,
    rate_margins,
    reference_overrun,
    rounded_down,
    rounded_up,
    undriven_need,
    unheld,
)
from linkplan.planner.closed_chain.transcribe import trajectory_of, transcribe
from linkplan.planner.limits.joints import bounds_of_state
from linkplan.planner.limits.kinds import effort_bounds, limits_of, tightened_in
from linkplan.planner.limits.limit import Margin, Tightened
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.plan.plan import Plan, tracking_errors
from linkplan.planner.plan.verdict import Overrun, Verdict, failed, infeasible
from linkplan.planner.problem.extra import as_no_number
from linkplan.planner.problem.keys.kinds import INTEGRATION_DEG
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.reference import Sine
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.refinement.case import ErrorReport, RefinementTarget
from linkplan.planner.refinement.history import progress, recorded
from linkplan.planner.refinement.marking import Tightening, evened, tightenings_of
from linkplan.planner.solvers.newton import EQUATION_TOLERANCE
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh

# Corrections satisfy the equations of closed loops within a tolerance. A range of a dependent joint that moves by less than
# this has no effect on them.
_LEAST_TIGHTENING = 2.0 * EQUATION_TOLERANCE


@dataclass(frozen=True, eq=False, slots=True)
class MechanismCase:
    """A `planner.refinement.case.Case`: solves use `problem` with tightened limits, certificates the `asked` problem."""

    problem: Problem
    asked: Problem
    tightenings: tuple[Tightening, ...] = ()
    n_tightenings: int = 0
    kinks: bool = True  # whether to search kinks of continuous efforts
    smoothing: float = SMOOTHING_WEIGHT  # see `formulate`
    enclosed: bool = False  # whether enclosable limits are imposed at every instant
    ties: float = 0.0  # see `formulate`
    free_ends: np.ndarray | None = None  # see `formulate`
    sampled_at: tuple[float, ...] = ()  # shares of the duration of further samples: a proof refuted a motion there
    target: RefinementTarget = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "target", _target(self.asked, kinks=self.kinks, enclosed=self.enclosed))

    def transcribe(self, start: Guess, mesh: Mesh, durations: np.ndarray, **options: Any) -> Transcribed:
        """Return the program from a guess."""
        kept = {"tightenings": self.tightenings, "smoothing": self.smoothing, "enclosed": self.enclosed, "ties": self.ties}
        return transcribe(self.problem, start, mesh, durations, free_ends=self.free_ends, **kept, **options)

    def motion(self, solution: Solution) -> Trajectory | None:
        """Return a solution's trajectory; None if the solver moved to another assembly branch."""
        try:
            return trajectory_of(solution.transcribed, solution.x)
        except AssemblyError:
            return None

    def start_from(self, motion: Trajectory) -> Guess:
        """Return a trajectory as a guess."""
        return guess_from(motion)

    def certify(self, motion: Trajectory) -> Certificate | None:
        """Return a trajectory's certificate; None if it leaves its assembly branch or the deadline passes."""
        try:
            return certify(self.asked, motion, self.sampled_at)
        except (AssemblyError, OutOfTimeError):
            return None

    def error_report(self, certificate: Certificate) -> ErrorReport:
        """Return the certificate's findings that refinement needs."""
        margins = certificate.margins
        over = [margin.overrun for margin in margins if margin.of.facts.tightened is not None]
        return ErrorReport(
            passed=certificate.is_carried,
            exact=is_exact(self.asked, certificate),
            repairable=certificate.repairable,
            leaves_positions=any(
                margin.of.facts.tightened is Tightened.IN_PROBLEM and margin.left < 0 for margin in margins
            ),
            overruns=not all(margin.kept for margin in margins),
            overrun=np.max([np.zeros(len(certificate.growth)), *over], axis=0),
            growth=certificate.growth,
            residual_share=certificate.residual_share,
            effort_overrun=certificate.effort_overrun,
            integration_error_deg=certificate.integration_error_deg,
        )

    def tightened(self, certificate: Certificate, motion: Trajectory) -> "MechanismCase":
        """Return the case with limits tightened by the amounts that the motion overran."""
        further = tightenings_of(certificate.margins, motion.breaks_s)
        further = evened(further) if self.enclosed else further
        everywhere = self.n_tightenings >= 1  # after the first time overruns are small and move between intervals
        problem = self.problem
        for margin in certificate.margins:  # limits without tightenable rows, by 1.1 times the overrun
            by = margin.of.facts.tightened
            if by is Tightened.IN_PROBLEM or (everywhere and by is Tightened.LATER_IN_PROBLEM):
                problem = tightened_in(problem, margin, 1.1, _LEAST_TIGHTENING)
            elif by is None and not margin.kept and np.isfinite(margin.left):
                problem = margin.of.relaxed(problem, 1.0 + 1.1 * margin.share)
        return replace(self, problem=problem, tightenings=self.tightenings + further, n_tightenings=self.n_tightenings + 1)


def case_of(problem: Problem, *, kinks: bool = True, enclosed: bool = False) -> MechanismCase:
    """Return the case of a problem; with `kinks`, refinement searches the kinks of continuous efforts.

    With several degrees of freedom, limits on power are imposed at every instant. With one, the phase plane's legs satisfy
    them. Jerks of dependent joints and of sites are also limited at every instant: where they jump inside an interval, no
    finer mesh removes their overrun. With `enclosed`, all enclosable limits are imposed at every instant.
    """
    several = problem.mesh.effort == "polynomial" and problem.mechanism.dof > 1
    enclosed = enclosed or any(
        (several and limit.facts.enclosed_with_several)
        or (limit.rows.jerk and limit.rows.node is not None and limit.facts.enclosable)
        for limit in limits_of(problem)
    )
    return MechanismCase(problem, problem, kinks=kinks, enclosed=enclosed)


def _target(problem: Problem, *, kinks: bool, enclosed: bool) -> RefinementTarget:
    """Return the expected structure of a problem's optimum, and the accuracy to reach.

    Efforts jump between their limits, zero and constrained arcs if time or work is minimised. Efforts are continuous with
    kinks at their limits if squared efforts are minimised. In least time they are at their limits wherever no other limit
    binds. The change of the objective is checked where limits on coefficients may cost something that the motion itself does
    not show. Switches are not searched if limits are imposed at every instant; jumps may then lie inside intervals.
    """
    objective = problem.objective
    continuous_efforts = objective.efforts("bend")
    bending = kinks and continuous_efforts and not objective.has("tracking")
    switches = not enclosed and (objective.efforts("jump") or bending) and not objective.efforts("smooth")
    switches = switches and problem.mechanism.forces is None  # the instants of these jumps are those of the mesh
    lines = any(motor is not None and motor.line is not None for motor in problem.motors)
    bent = continuous_efforts and bool(np.any(np.isfinite(bounds_of_state(problem)[1])))
    tolerance = 1e-7 if switches and (lines or bent) else None
    if enclosed or any(limit.rows.jerk for limit in limits_of(problem)):
        tolerance = 1e-6  # looser, because efforts or jerk may jump inside intervals
    if not enclosed and (objective.has("peak_effort") or objective.has("jerk")):
        tolerance = 1e-5  # still looser, because there efforts within their limits jump, or a limit on acceleration binds
    return RefinementTarget(
        effort_limit=effort_bounds(problem),
        switches=switches,
        bang_bang=list(objective.weights) == ["time"],
        continuous_efforts=continuous_efforts,
        strictness=_strictness(problem),
        tolerance_given=problem.mesh.tolerance_deg is not None,
        objective_tolerance=tolerance,
        kinks_at_limits=True,
        enclosed=enclosed,
        has_boundary_layers=any(frictions_of(problem.mechanism.model)),  # thin layers where dry friction changes its sign
    )


def _strictness(problem: Problem) -> float:
    """Return the ratio of the certificate's integration tolerance to the problem's, which is 1e-6 deg if it gives none."""
    return INTEGRATION_DEG / (problem.mesh.tolerance_deg or 1e-6)


def is_exact(problem: Problem, certificate: Certificate) -> bool:
    """Check a motion's integration error against the problem's tolerance or the default one."""
    strict = _strictness(problem)
    return certificate.integration_error_deg * strict <= INTEGRATION_DEG and (
        certificate.integration_error_m * strict <= INTEGRATION_M
    )


def slow_share(mechanism: Mechanism, trajectory: Trajectory) -> tuple[float, str] | None:
    """Return the largest share of a motion during which a joint moves too slowly for its dry friction, and the joint's name.

    Too slow means that f tanh(v / v_0) is below 0.9 f. None if no joint has dry friction.
    """
    joints = [one for one in frictions_of(mechanism.model) if one.dof is not None]
    if not joints:
        return None
    time = np.linspace(trajectory.breaks_s[0], trajectory.breaks_s[-1], 400)
    poses = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    qvel = mechanism.qvel_of(poses, joint_rates(mechanism, poses, trajectory.velocity_at(time)))
    found = []
    for one in joints:
        speed = np.abs(qvel[:, one.dof])
        fast = np.arctanh(0.9) * mechanism.friction_transition * (1.0 if one.turns else mechanism.extent_m)
        found.append((float(np.mean(speed < fast)) if speed.max() > 1e-9 else 0.0, one.name))  # the loops may hold the joint
    return max(found)


def finished(
    problem: Problem,
    trajectory: Trajectory,
    certificate: Certificate,
    objective: float,
    words: str | None,
    *,
    optimal: bool = True,
    further: Sequence[str] = (),
) -> Plan:
    """Return the plan of a certified motion; every search and every prescribed motion ends here.

    The plan passes if its certificate, including contacts along the motion, passes and the tolerance is met. Its status is
    then "optimal" if the motion is locally optimal as far as known, else "feasible". `words` are those of a motion that was
    not found by a solver, `further` are phrases after them.
    """
    certificate = with_contacts(problem, trajectory, certificate)
    verdict = Verdict(
        kind="optimal" if optimal else "feasible",
        words=words or f"motion of {trajectory.duration_s:.6g} s",
        objective="" if words else problem.objective.name,
        further=tuple(further),
    )
    plan = Plan(
        problem=problem,
        verdict=verdict,
        objective=objective,
        trajectory=trajectory,
        certificate=certificate,
        history=recorded(),
    )
    failure = _failure(plan)
    details: dict[str, float] = {}
    errors = tracking_errors(plan)
    if errors is not None and words is None and problem.objective.has("tracking"):
        joint = problem.mechanism.independent_joints[0]
        details |= {
            f"tracking_rms_{joint.unit}": joint.shown(errors[0]),
            f"tracking_max_{joint.unit}": joint.shown(errors[1]),
        }
        nearest = (
            f"nearest motion to the reference: {joint.shown(errors[0]):.4g} {joint.unit} rms,"
            f" {joint.shown(errors[1]):.4g} {joint.unit} at most away from it"
        )
        verdict = verdict.replace(words=nearest, objective="")
        timeless = problem.varied(solver=SolverSettings())
        over = reference_overrun(samples_of(timeless, prescribe(timeless, trajectory.start_pose)))
        if over is not None:
            verdict = verdict.adding(f"on the reference itself {over.sentence()}")
            details |= {"reference_needs": over.value, "reference_needs_at_s": over.time_s}
    slow = None if failure is not None else slow_share(problem.mechanism, trajectory)
    if slow is not None and slow[0] > 0.1:  # smaller shares are its start, end and turning points
        share, joint = slow
        details["slow_friction_share"] = share
        verdict = verdict.adding(
            f"{joint} moves slowly for {share:.0%} of the time, in which the plan has less than 90 % of its dry friction"
            " (a lower mechanism.friction_transition_deg_s plans more)"
        )
    if failure is not None:
        return replace(plan, verdict=failure, objective=None, details=details)
    return replace(plan, verdict=verdict, details=details)


def _failure(plan: Plan) -> Verdict | None:
    """Return the verdict on a motion whose certificate fails or whose tolerance is missed; else None."""
    certificate, tolerance = plan.certificate, plan.problem.mesh.tolerance_deg
    assert certificate is not None  # of a motion
    if not certificate.passed:
        overruns = tuple(Overrun.of(margin) for margin in certificate.margins if not margin.kept)
        words = f"the solver converged, but the certificate does not pass: {'; '.join(certificate.failures)}"
        late = plan.problem.solver.certificate_deadline.passed
        return failed(words, "certificate", known_by="certificate", overruns=overruns, out_of_time=late)
    if plan.objective is not None and not np.isfinite(plan.objective):
        return failed(f"the objective ({plan.problem.objective.name}) is {as_no_number(plan.objective)}", "numbers")
    if tolerance is None or is_exact(plan.problem, certificate):
        return None
    words = (
        f"the state integrated under the planned effort ends {certificate.integration_error_deg:.3g} deg from the"
        f" planned state on {plan.intervals} intervals,"
        f" more than mesh.tolerance_deg = {tolerance:g}"
    )
    return failed(words, "certificate", known_by="certificate")


# Factors on a reference's speed that are tried if the problem has no bounds on a free duration.
_LOWEST_RATE, _HIGHEST_RATE = 1e-3, 1e3


def plan_prescribed(problem: Problem, start_pose: np.ndarray) -> Plan:
    """Return the plan of a reference that is followed exactly; if the duration is free, in the least feasible time."""
    if problem.motion.duration_s is None:
        return _plan_fastest(problem, start_pose)
    progress("following the reference")
    trajectory = prescribe(problem, start_pose)
    along = samples_of(problem, trajectory)
    need = undriven_need(along, along.lacking_allowed)
    over = None if need else reference_overrun(along)
    if over is not None:
        return _too_fast(problem, start_pose, over)
    certificate = certify(problem, trajectory)
    if not certificate.passed:
        need = need or undriven_need(along, along.lacking_rounding)
    if need is not None:
        return Plan(problem=problem, verdict=_undriven(need))
    return finished(problem, trajectory, certificate, 0.0, "the reference satisfies every limit and is followed exactly")


def _undriven(need: Overrun, durations: str = "") -> Verdict:
    """Return the verdict on a reference that needs an effort that no actuator can give."""
    words = f"on the reference no actuator can give the {need.value:.4g} {need.unit} needed on joint {need.name}"
    return infeasible(f"{words} at t = {need.time_s:.4g} s{durations}", known_by="reference", overruns=(need,))


def _too_fast(problem: Problem, start_pose: np.ndarray, over: Margin) -> Plan:
    """Return the plan that says that a reference violates a limit, with the highest rate at which it violates none."""
    sentence = f"on the reference {over.sentence()}"
    details = {"needed": over.value, "limit": over.limit, "time_s": over.time_s}
    nearest = 'motion.kind = "{}" plans the nearest motion that does'
    if problem.mechanism.forces is not None:  # forces over time would not scale with the rate
        kind = "periodic" if problem.reference.periodic else "reach"
        verdict = _beyond_on_reference(sentence, over).adding(f"{nearest.format(kind)} not break it")
        return Plan(problem=problem, verdict=verdict, details=details)
    progress("searching for the highest feasible rate")
    rate, reference = None, problem.reference
    at = "at this amplitude" if isinstance(reference, Sine) else "along these positions"
    remedy, would_do = "no slower one satisfies the limits", {}
    if balanced_rates(problem, start_pose) is None:
        rate = highest_rate(problem, start_pose, _LOWEST_RATE, 1.0)
    else:
        remedy = "no slower one is possible, because a joint has no actuator"
    if rate is not None:
        details["least_duration_s"] = reference.period_s / rate
        would_do = {"motion.duration_s": rounded_up(reference.period_s / rate)}
        remedy = f"in {would_do['motion.duration_s']:g} s or more it satisfies every limit"
    if rate is not None and isinstance(reference, Sine):
        details["highest_frequency_hz"] = rate * reference.frequency_hz
        would_do = {"reference.frequency_hz": rounded_down(rate * reference.frequency_hz)}
        remedy = f"up to {would_do['reference.frequency_hz']:g} Hz it satisfies every limit"
    kind = "periodic" if reference.periodic else "reach"
    verdict = _beyond_on_reference(sentence, over, remedy=would_do).adding(f"{at} {remedy}", nearest.format(kind))
    return Plan(problem=problem, verdict=verdict, details=details)


def _beyond_on_reference(words: str, over: Margin, **more: Any) -> Verdict:
    """Return the verdict on a reference that violates a limit."""
    return infeasible(words, known_by="reference", overruns=(Overrun.of(over),), **more)


def _plan_fastest(problem: Problem, start_pose: np.ndarray) -> Plan:
    """Return the plan of a reference in the least duration at which every limit is satisfied."""
    progress("searching for the least duration of the reference")
    motion, own_s = problem.motion, problem.reference.period_s
    slowest = own_s / motion.max_duration_s if motion.max_duration_s else _LOWEST_RATE
    fastest = own_s / motion.min_duration_s if motion.min_duration_s else _HIGHEST_RATE
    balanced = balanced_rates(problem, start_pose)
    if balanced is not None:
        return _plan_balanced(problem, start_pose, *np.clip([1.0, *balanced], slowest, fastest).tolist())
    rate = highest_rate(problem, start_pose, slowest, fastest)
    if rate is None:
        margins = rate_margins(problem, start_pose, slowest)
        worst = min(margins, key=lambda margin: margin.share)
        words = f"even in {own_s / slowest:.4g} s, on the reference {worst.sentence()}"
        return Plan(problem=problem, verdict=_beyond_on_reference(words, worst))
    if rate == fastest and motion.min_duration_s is None:
        words = f"no limit is reached at {fastest:g} times the speed of the reference; set motion.min_duration_s"
        return Plan(problem=problem, verdict=failed(words, "duration"))
    binding = min(rate_margins(problem, start_pose, rate), key=lambda margin: margin.share)
    why = "the shortest that motion.min_duration_s allows" if rate == fastest else binding.bound + " allows no more"
    return _at_rate(problem, start_pose, rate, why)


def _at_rate(problem: Problem, start_pose: np.ndarray, rate: float, why: str) -> Plan:
    """Return the plan of the reference at a rate, the highest for a reason."""
    trajectory, own_s = prescribe(at_rate(problem, rate), start_pose), problem.reference.period_s
    said = f"the reference in {own_s / rate:.6g} s, {rate:.4g} times as fast as its own {own_s:.6g} s: {why}"
    plan = finished(problem, trajectory, certify(problem, trajectory), 0.0, said)
    return replace(plan, details={**plan.details, "rate": rate, "least_duration_s": own_s / rate})


def _plan_balanced(problem: Problem, start_pose: np.ndarray, nearest: float, *rates: float) -> Plan:
    """Return the plan at the highest of those rates at which joints without an actuator can follow the reference.

    If there is none, the verdict is on the rate `nearest` to the reference's own.
    """
    own_s, blocked = problem.reference.period_s, None
    for rate in sorted({nearest, *rates}, reverse=True):
        along = along_reference(at_rate(problem, rate), start_pose)
        if undriven_need(along, along.lacking_allowed) is not None:
            continue
        over = reference_overrun(along)
        if over is None:
            plan = _at_rate(problem, start_pose, rate, "joints without an actuator follow it in no shorter time")
        else:
            words = f"in {own_s / rate:.6g} s, in which all joints can follow the reference, {over.sentence()}"
            plan = Plan(problem=problem, verdict=_beyond_on_reference(words, over))
        if plan.passed:
            return plan
        if over is not None or undriven_need(along, along.lacking_rounding) is None:
            blocked = plan
    if blocked is not None:
        return blocked
    along = along_reference(at_rate(problem, nearest), start_pose)
    need = undriven_need(along, along.lacking_rounding)
    assert need is not None  # else this rate has a plan
    return Plan(problem=problem, verdict=_undriven(need, f" of {own_s / nearest:.4g} s, nor in another allowed duration"))


def plan_hold(problem: Problem) -> Plan:
    """Return the plan of a pose that is held from the start to the end by constant efforts."""
    progress("holding the start")
    motion = problem.motion
    assert motion.start is not None  # of a hold
    assert motion.duration_s is not None
    holding = holding_at(problem, motion.start)
    if not holding.holds:
        words, details = unheld(problem, holding)
        return Plan(problem=problem, verdict=infeasible(words, known_by="every motion"), details=details)
    rest = holding.lasting(motion.duration_s)
    certificate = certify(problem, rest)
    objective, _ = objective_value(problem, rest)
    said = f"rest of {rest.duration_s:.6g} s: constant efforts hold the start"
    plan = finished(problem, rest, certificate, objective, said, optimal=holding.best)
    over = [margin.sentence() for margin in certificate.margins if not margin.kept]
    if over and set(certificate.failures) <= set(over) and holding.unique:
        words = f"only these efforts hold the start, and {'; '.join(over)}"
        overruns = tuple(Overrun.of(margin) for margin in certificate.margins if not margin.kept)
        verdict = infeasible(words, known_by="every motion", overruns=overruns)
        return replace(plan, verdict=verdict, trajectory=None, certificate=None)
    return plan
