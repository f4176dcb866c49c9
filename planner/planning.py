"""From a planning problem to a certified plan: presolve, solve, find the switches, certify, refine, explain."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from models.assembly import follow
from models.errors import AssemblyError
from planner.certificate import INTEGRATION_DEG, INTEGRATION_M, RANGE_SLACK, Certificate, certify
from planner.guess import Guess, first_guess, motion_of, swinging_guesses
from planner.infeasibility import effort_sentence, least_limit, overrun_sentence, tightened, without
from planner.mesh import Mesh, halved, segmented, uniform
from planner.plan import Plan, Step, tracking_errors
from planner.prescribed import highest_frequency, prescribe, reference_demand, rounded_down
from planner.presolve import plain_contradiction, start_pose_of
from planner.problem import PlanningProblem
from planner.solve import OUT_OF_TIME, Solution, solve
from planner.switches import find_cuts, pinned_efforts
from planner.trajectory import Trajectory
from planner.transcription import trajectory_of, transcribe

# Rounds of refinement after the first solve, and the share of its allowance that marks an interval for halving.
_ROUNDS = 8
# A mesh that has grown by this factor without passing will not pass by growing on.
_MOST = 120
# What the integrated state is refined towards where no tolerance is asked for [deg], as far as a mesh of so many
# intervals carries it; and how far below the worst interval's error another may be to be halved with it.
_TARGET_DEG = 1e-6
_COMFORTABLE = 100
_WORST = 0.01
_MARK = 0.5
# A solve with cuts at its switches replaces the one before when it is no slower than the error of a mesh without cuts.
_NO_WORSE = 1e-4
# Cuts next to arcs within the limits settle in a few solves: until the objective gains less than this share, relative.
_SETTLINGS = 4
_SETTLED = 1e-9

Say = Callable[[str], None]


def silent(text: str) -> None:
    """Say nothing: the default for progress."""
    del text


def plan_motion(problem: PlanningProblem, say: Say = silent) -> Plan:
    """Return the plan of a problem; one without an answer says why in `message`.

    Args:
        problem: what to plan.
        say: called with a line of progress now and then.

    Raises:
        ProblemError: when start, goal or reference contradict the mechanism itself.
    """
    start_pose = start_pose_of(problem)
    if problem.motion.kind == "track":
        return _plan_prescribed(problem, start_pose, say)
    contradiction = plain_contradiction(problem)
    if contradiction is not None:
        return Plan(problem=problem, status="infeasible", message=contradiction)
    guess = first_guess(problem, start_pose)
    mesh, durations = uniform(_even(problem)), np.array([guess.duration_s])
    history: list[Step] = []
    found = _solve(problem, guess, mesh, durations, "first solve", history, say)
    if found is None:
        return _explain(problem, guess, mesh, durations, history, say)
    return _certified(problem, found, mesh, history, say)


def _even(problem: PlanningProblem) -> int:
    n = problem.mesh.intervals
    return n + n % 2 if problem.motion.kind == "periodic" else n


def _plan_prescribed(problem: PlanningProblem, start_pose: np.ndarray, say: Say) -> Plan:
    say("following the reference")
    demand = reference_demand(problem, start_pose)
    if demand is not None:
        say("looking for the highest feasible frequency")
        frequency = highest_frequency(problem, start_pose)
        details = {"needed": demand.needed, "limit": demand.limit, "time_s": demand.time_s}
        remedy = "no slower one keeps the limits"
        if frequency is not None:
            details["highest_frequency_hz"] = frequency
            remedy = f"up to {rounded_down(frequency):g} Hz it keeps every limit"
        return Plan(
            problem=problem,
            status="infeasible",
            message=f"infeasible: {demand.sentence('following the reference exactly')}; at this amplitude {remedy};"
            ' motion.kind = "periodic" plans the nearest motion that keeps them',
            details=details,
        )
    trajectory = prescribe(problem, start_pose)
    certificate = certify(problem, trajectory)
    return finished(problem, trajectory, certificate, 0.0, [], "the reference keeps every limit and is followed exactly")


def _solve(
    problem: PlanningProblem,
    guess: Guess,
    mesh: Mesh,
    durations: np.ndarray,
    what: str,
    history: list[Step],
    say: Say,
    position_rows: bool = False,
    pinned: np.ndarray | None = None,
    warm: bool = False,
) -> tuple[Trajectory, Solution] | None:
    say(f"{what}: {problem.mesh.scheme}, {mesh.n_intervals} intervals, {mesh.n_segments} segment(s)")
    transcribed = transcribe(problem, guess, mesh, durations, position_rows=position_rows, pinned=pinned)
    solution = solve(transcribed, warm=warm, max_time_s=problem.solver.max_time_s)
    history.append(
        Step(
            what=what,
            intervals=mesh.n_intervals,
            segments=mesh.n_segments,
            converged=solution.converged,
            solver_status=solution.status,
            objective=solution.objective,
            integration_error_deg=None,
            build_s=transcribed.build_s + solution.build_s,
            solve_s=solution.solve_s,
        )
    )
    if not solution.converged:
        return None
    try:
        return trajectory_of(transcribed, solution.x, problem.limits.effort), solution
    except AssemblyError:  # a start that the solver took to another branch
        return None


def _certified(problem, found: tuple[Trajectory, Solution], mesh: Mesh, history: list[Step], say: Say) -> Plan:
    """Return the plan of a solution: cuts at its switches, then finer meshes until the certificate passes."""
    trajectory, solution = found
    pinned = None
    if problem.objective == "time":
        trajectory, solution, mesh, pinned = _settle_switches(problem, trajectory, solution, mesh, history, say)
    certificate = _try_certify(problem, trajectory, history)
    position_rows, kept, finest = False, problem, _MOST * problem.mesh.intervals
    passed = None  # the last that passed, to go back to where a finer one does not
    for _ in range(_ROUNDS):
        if certificate is not None and certificate.passed:
            passed = trajectory, solution, certificate
            if _exact_enough(problem, certificate):
                break
        position_rows = position_rows or certificate is None or bool(np.any(certificate.position_margin < 0))
        marked = _marked(mesh, certificate, _strictness(problem))
        if not marked.any() and certificate is not None and _overruns(certificate):
            # Only a range or speed is left, between the nodes: ask the solver for a little less than the limit.
            kept = replace(problem, limits=tightened(kept.limits, certificate))
        elif not marked.any():
            marked[:] = True
        if _turns_at_the_middle(problem):
            marked[:] = marked.any()  # keep the middle of the motion on a node
        n_finer = mesh.n_intervals + int(marked.sum())
        if n_finer > finest or (passed is not None and problem.mesh.tolerance_deg is None and n_finer > _COMFORTABLE):
            break
        mesh = halved(mesh, marked)
        durations = np.bincount(mesh.segment, weights=_widths(trajectory, marked))
        what = "finer mesh" if marked.any() else "limits kept between the nodes"
        finer = _solve(kept, motion_of(trajectory), mesh, durations, what, history, say, position_rows, pinned)
        if finer is None:
            break
        trajectory, solution = finer
        certificate = _try_certify(problem, trajectory, history)
    if passed is not None and (certificate is None or not certificate.passed):
        trajectory, solution, certificate = passed
    if certificate is None:
        return Plan(
            problem=problem,
            status="failed",
            message="failed: the motion that the solver returned leaves the branch on which the mechanism was assembled",
            history=tuple(history),
        )
    plan = finished(problem, trajectory, certificate, solution.objective, history, None)
    plan = replace(plan, solved=replace(solution.transcribed, start=solution.x))
    if plan.status == "optimal" and problem.mesh.tolerance_deg is not None and not _exact_enough(problem, certificate):
        missed = (
            f"failed: the integrated model ends {certificate.integration_error_deg:.3g} deg from the plan on"
            f" {plan.intervals} intervals, more than mesh.tolerance_deg = {problem.mesh.tolerance_deg:g}"
        )
        return replace(plan, status="failed", message=missed)
    return plan


def _strictness(problem: PlanningProblem) -> float:
    """Return how many times more exact than a certificate demands the integrated state is to be."""
    return INTEGRATION_DEG / (problem.mesh.tolerance_deg or _TARGET_DEG)


def _exact_enough(problem: PlanningProblem, certificate: Certificate) -> bool:
    strict = _strictness(problem)
    return certificate.integration_error_deg * strict <= INTEGRATION_DEG and (
        certificate.integration_error_m * strict <= INTEGRATION_M
    )


def _marked(mesh: Mesh, certificate: Certificate | None, strictness: float) -> np.ndarray:
    """Return which intervals (n,) to halve: those with more than their share of an error that is too large."""
    if certificate is None or not np.all(np.isfinite(certificate.growth)):
        return np.ones(mesh.n_intervals, dtype=bool)
    growth = certificate.growth * strictness
    marked = np.zeros(mesh.n_intervals, dtype=bool)
    if certificate.residual_share.max() > 1.0:
        marked |= certificate.residual_share > _MARK
    if growth.sum() > 1.0:
        marked |= growth > _MARK * max(1.0, _WORST * growth.max() * mesh.n_intervals) / mesh.n_intervals
    return marked


def _overruns(certificate: Certificate) -> bool:
    """Return whether a joint leaves its range or speed limit."""
    return bool(min(certificate.position_margin.min(), certificate.speed_margin.min()) < -RANGE_SLACK)


def _turns_at_the_middle(problem: PlanningProblem) -> bool:
    """Return whether a periodic motion has to be at its goal after half of its duration."""
    return problem.motion.kind == "periodic" and problem.motion.start is not None


def _widths(trajectory: Trajectory, marked: np.ndarray) -> np.ndarray:
    widths = np.diff(trajectory.breaks_s)
    pieces = np.where(marked, 2, 1)
    return np.repeat(widths / pieces, pieces)


def _try_certify(problem: PlanningProblem, trajectory: Trajectory, history: list[Step]) -> Certificate | None:
    """Return a motion's certificate, its error noted in the history; None where the motion leaves the branch."""
    try:
        certificate = certify(problem, trajectory)
    except AssemblyError:
        return None
    history[-1] = replace(history[-1], integration_error_deg=certificate.integration_error_deg)
    return certificate


def _settle_switches(problem, trajectory, solution, mesh, history, say):
    """Return a least-time solution with mesh cuts at its switches, its mesh, and the efforts held between them.

    First with efforts held at the limits that the arcs showed, which leaves the cuts alone to be found; where that is
    slower than the solution without cuts, the arcs were read wrongly and the efforts are set free again.
    """
    pinned, no_worse = None, _NO_WORSE
    for _ in range(_SETTLINGS):
        cuts = find_cuts(trajectory, problem.limits.effort)
        if len(cuts) == 0 or len(cuts) > mesh.n_intervals // 6 or _turns_at_the_middle(problem):
            break
        durations = np.diff(np.concatenate([[0.0], cuts, [trajectory.duration_s]]))
        finer, guess = segmented(durations, problem.mesh.intervals), motion_of(trajectory)
        held = pinned_efforts(trajectory, problem.limits.effort, cuts)
        better = None
        for efforts, what in ((held, "cuts at the switches"), (None, "cuts at the switches, efforts free")):
            found = _solve(problem, guess, finer, durations, what, history, say, pinned=efforts, warm=True)
            if found is not None and found[1].objective <= solution.objective * (1 + no_worse):
                better = found
                break
        if better is None:
            break
        settled = better[1].objective > solution.objective * (1 - _SETTLED)
        (trajectory, solution), mesh, pinned = better, finer, efforts
        no_worse = _SETTLED  # from now on both have cuts, and only a better one replaces the other
        if settled or not np.any(np.isnan(held)):
            break
    return trajectory, solution, mesh, pinned


def finished(problem, trajectory, certificate, objective, history, message: str | None) -> Plan:
    """Return the plan of a certified motion, its status by the certificate and its message in words."""
    plan = Plan(
        problem=problem, status="optimal", message="", objective=objective, trajectory=trajectory, certificate=certificate
    )
    details: dict[str, float] = {}
    sentence = message or f"{problem.objective}-optimal motion of {trajectory.duration_s:.6g} s"
    errors = tracking_errors(plan)
    if errors is not None and message is None and problem.objective == "tracking":
        joint = problem.mechanism.independent_joints[0]
        details |= {
            f"tracking_rms_{joint.unit}": joint.shown(errors[0]),
            f"tracking_max_{joint.unit}": joint.shown(errors[1]),
        }
        sentence = (
            f"nearest motion to the reference: {joint.shown(errors[0]):.4g} {joint.unit} rms,"
            f" {joint.shown(errors[1]):.4g} {joint.unit} at most away from it"
        )
        demand = reference_demand(problem, trajectory.start_pose)
        if demand is not None:
            sentence += f"; {demand.sentence('the reference itself')}"
            details |= {"reference_needs": demand.needed, "reference_needs_at_s": demand.time_s}
    if not certificate.passed:
        return replace(
            plan,
            status="failed",
            message=f"failed: the solver converged, the certificate does not pass: {'; '.join(certificate.failures)}",
            history=tuple(history),
            details=details,
        )
    return replace(plan, message=sentence, history=tuple(history), details=details)


def _explain(problem, guess: Guess, mesh: Mesh, durations: np.ndarray, history: list[Step], say: Say) -> Plan:
    """Return the plan of a problem whose first solve failed: another start where a motion exists, else the reason."""
    if history[-1].solver_status == OUT_OF_TIME:
        return Plan(
            problem=problem,
            status="failed",
            message=f"failed: the solver ran out of its {problem.solver.max_time_s:g} s (solver.max_time_s)",
            history=tuple(history),
        )
    for swing in swinging_guesses(problem, guess.start_pose):
        found = _solve(problem, swing, mesh, np.array([swing.duration_s]), "start from a swing", history, say)
        plan = None if found is None else _certified(problem, found, mesh, history, say)
        if plan is not None and plan.status == "optimal":
            return plan
    say("no motion found; looking for the limit that forbids one")
    least = least_limit(problem, guess, mesh, durations)
    if least is not None and least.factor <= 1.0:
        start, what = motion_of(least.trajectory), "start from the motion of least peak effort"
        found = _solve(problem, start, least.mesh, least.durations, what, history, say)
        if found is not None:
            return _certified(problem, found, least.mesh, history, say)
    if least is not None and least.factor > 1.0:
        sentence, details = effort_sentence(problem, least)
        return Plan(
            problem=problem,
            status="infeasible",
            message=f"infeasible: {sentence}{_shortest(problem, details, say)}",
            history=tuple(history),
            details=details,
        )
    for what in ("speed", "position"):
        relaxed = replace(problem, limits=without(problem.limits, what))
        found = _solve(relaxed, guess, mesh, durations, f"without limits on {what}", history, say)
        if found is not None:
            sentence = _overrun(problem, found[0], what)
            if sentence is not None:
                return Plan(problem=problem, status="infeasible", message=f"infeasible: {sentence}", history=tuple(history))
    status = history[-1].solver_status if history else "nothing tried"
    return Plan(
        problem=problem,
        status="failed",
        message=f"failed: the solver found neither a motion nor a limit that forbids one ({status})",
        history=tuple(history),
    )


def _overrun(problem: PlanningProblem, trajectory: Trajectory, what: str) -> str | None:
    """Return the sentence on what a motion without limits on "speed" or "position" overruns, or None."""
    try:
        poses = follow(problem.mechanism, trajectory.position_at(trajectory.dense_times(8)), trajectory.start_pose)
    except AssemblyError:
        return None
    return overrun_sentence(problem, trajectory, poses, what)


def _shortest(problem: PlanningProblem, details: dict[str, float], say: Say) -> str:
    """Return the words on the shortest feasible duration of a motion between two states, where it can be found."""
    if problem.motion.kind != "reach" or problem.motion.duration_s is None:
        return ""
    say("looking for the shortest feasible duration")
    quickest = plan_motion(
        replace(problem, objective="time", motion=replace(problem.motion, duration_s=None, max_duration_s=None)), say
    )
    if quickest.status != "optimal":
        return ""
    details["shortest_duration_s"] = quickest.trajectory.duration_s
    return f"; the shortest feasible duration is {quickest.trajectory.duration_s:.5g} s"
