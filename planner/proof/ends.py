"""Findings on single instants of a motion: jumps between pieces, prescribed ends and the start pose. Also on its slope."""

import numpy as np

from linkplan.models.errors import AssemblyError, ProblemError
from linkplan.models.poses.assembly import close_at
from linkplan.planner.certificate.certificate import end_state_error
from linkplan.planner.certificate.further_checks import disagreements
from linkplan.planner.certificate.integration import BOUNDARY_SHARE, ends_off_m
from linkplan.planner.limits.efforts import EFFORT_JUMP_SHARE, end_efforts, ends_off, holds_at_rest, rest_jumps
from linkplan.planner.limits.kinds import limits_of
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import task_words
from linkplan.planner.proof.finding import Finding, finding_of
from linkplan.planner.trajectory import JOIN_SHARE, NO_JUMP_SHARE, Trajectory
from linkplan.planner.transcription.bernstein import PiecewisePolynomial

# Largest difference of the start pose from the problem's own [rad or m].
START_POSE_ERROR = 1e-6


def position_spans(problem: Problem, trajectory: Trajectory) -> np.ndarray:
    """Return the spans (n_s,) [rad or m] that scale the allowed jumps: the largest span among coordinates of a unit.

    The span is bounded from below, because the last digits of a position at rest differ from piece to piece.
    """
    moved, farthest = np.ptp(trajectory.position, axis=(0, 1)), np.abs(trajectory.position).max(axis=(0, 1))
    return np.maximum(_largest_of_unit(problem, np.maximum(moved, 1e-6 * farthest)), 1e-9)


def end_findings(problem: Problem, trajectory: Trajectory) -> list[Finding]:
    """Return the findings on jumps, ends and waypoints, and on the derivative of the planned position."""
    span = position_spans(problem, trajectory)
    largest = _largest_of_unit(problem, np.abs(trajectory.velocity).max(axis=(0, 1)))
    speeds = np.maximum(largest, 1e-9 / trajectory.duration_s)
    found = []
    joined = [("position", trajectory.position, span), ("velocity", trajectory.velocity, speeds)]
    if problem.path is not None:
        joined.append(("the place along the path", trajectory.along, np.array([problem.path.curve.length])))
    for what, of, size in joined:
        jumps = (np.abs(of[0, 1:] - of[-1, :-1]) / size).max(axis=1)
        at = int(np.argmax(jumps)) if len(jumps) else 0
        value = float(jumps.max(initial=0.0))
        when = float(trajectory.breaks_s[at + 1])
        found.append(
            finding_of(f"the pieces of {what} join", value, JOIN_SHARE, "of its span", when, f" at t = {when:.6g} s")
        )
    found += [_slope(trajectory, speeds), *_effort_jumps(problem, trajectory), *_acceleration_jumps(problem, trajectory)]
    error = float(end_state_error(problem, trajectory, float(speeds.max())))
    found.append(finding_of("the motion starts and ends where asked", error, BOUNDARY_SHARE, "of its span"))
    found += [
        Finding(name="the motion is the one asked for", answer="refuted", reason=sentence)
        for sentence in disagreements(problem, trajectory, None)
    ]
    return [*found, *_places(problem, trajectory), *_start(problem, trajectory)]


def _places(problem: Problem, trajectory: Trajectory) -> list[Finding]:
    """Return the finding on the prescribed places of sites and bodies at the start, the goal and the waypoints."""
    tasks = problem.motion.tasks
    if not tasks:
        return []
    name = f"{task_words(tasks)} are where start, goal and waypoints ask"
    try:
        samples = samples_of(problem, trajectory)
        off, _ = ends_off_m(problem, trajectory, samples.time, samples.q)
    except AssemblyError as error:
        return [Finding(name=name, answer="refuted", reason=str(error))]
    return [finding_of(name, float(off), BOUNDARY_SHARE * problem.mechanism.extent_m, "m")]


def _effort_jumps(problem: Problem, trajectory: Trajectory) -> list[Finding]:
    """Return the findings on jumps of efforts with a limited rate, also from one period to the next and at the start."""
    ahead = trajectory.effort[0] if trajectory.periodic else trajectory.effort[0, 1:]
    before = trajectory.effort[-1, np.arange(-1 if trajectory.periodic else 0, len(trajectory.breaks_s) - 2)]
    jumps, given = np.abs(ahead - before).max(axis=0, initial=0.0), np.isfinite(problem.limits.initial_effort[:, 0])
    size = max(float(np.abs(trajectory.effort).max()), float(np.finfo(float).tiny))
    (first, last), (start, goal) = ends_off(problem, trajectory), np.any(np.isfinite(end_efforts(problem)), axis=2)
    found = (
        ("the pieces of effort of {} join", jumps, np.isfinite(problem.limits.effort_rate).any(axis=1)),
        ("the effort of {} begins at limits.initial_effort", first, given),
        ("the other motors can hold the start with the effort of {}", first, start & ~given),
        ("the other motors can hold the goal with the effort of {}", last, goal),
    )
    return [
        finding_of(name.format(actuator.name), float(of[j]) / size, EFFORT_JUMP_SHARE, "of the largest")
        for name, of, where in found
        for j, actuator in enumerate(problem.mechanism.actuators)
        if where[j]
    ]


def _acceleration_jumps(problem: Problem, trajectory: Trajectory) -> list[Finding]:
    """Return the findings on jumps of accelerations with a limited rate, including those from rest and to rest."""
    columns = sorted({column for limit in limits_of(problem) for column in limit.rows.jerk})
    size = max(float(np.abs(trajectory.acceleration_at(trajectory.dense_times(4))).max()), float(np.finfo(float).tiny))
    jumps = np.abs(trajectory.acceleration_jumps())
    every = holds_at_rest(problem, trajectory.position[-1, -1])
    held = [
        finding_of(f"efforts hold the {end} at rest", jump, NO_JUMP_SHARE, "of the largest")
        for end, jump, sums in zip(("start", "goal"), rest_jumps(problem, trajectory), every, strict=True)
        if len(sums)
    ]
    return held + [
        finding_of(
            f"the pieces of acceleration of {problem.mechanism.independent_joints[column].name} join",
            float(jumps[:, column].max()) / size,
            NO_JUMP_SHARE,
            "of the largest",
            float(trajectory.breaks_s[np.argmax(jumps[:, column])]),
        )
        for column in columns
    ]


def _largest_of_unit(problem: Problem, values: np.ndarray) -> np.ndarray:
    """Return, for each coordinate, the largest of the values (n_s,) of all coordinates with the same unit, rad or m."""
    hinges = np.array([joint.kind == "hinge" for joint in problem.mechanism.independent_joints])
    return np.where(hinges, *(values[of].max(initial=0.0) for of in (hinges, ~hinges)))


def _slope(trajectory: Trajectory, speed: np.ndarray) -> Finding:
    """Return the finding on the difference of the planned velocity from the slope of the planned position."""
    slope = PiecewisePolynomial(trajectory.position, trajectory.breaks_s).derivative().coefficients
    name, velocity = "the planned velocity is the slope of the planned position", trajectory.velocity
    if slope.shape == velocity.shape:  # coefficients of the difference bound it
        apart = np.maximum(np.abs(slope - velocity) - trajectory.slope_rounding(), 0.0) / speed
    else:
        apart = trajectory.slope_errors(trajectory.dense_times(24)) / speed
    share, apart = trajectory.slope_share, float(apart.max())
    if slope.shape == velocity.shape or apart > share:
        return finding_of(name, apart, share, "of the largest speed")
    reason = f"at samples it differs by {apart:.2g} of the largest speed: the scheme is not second-order consistent"
    return Finding(name=name, answer="sampled", reason=reason)


def _start(problem: Problem, trajectory: Trajectory) -> list[Finding]:
    """Return the finding on the start pose: it must be the pose on the problem's branch, because it selects the branch.

    If the problem prescribes no start, the branch is that of the planner's initial pose.
    """
    name, spins = "the motion starts on the problem's branch", problem.mechanism.cyclic
    moved = np.zeros(problem.mechanism.n_q, dtype=bool)
    moved[problem.mechanism.independent[spins]] = True
    try:
        begin = problem.start_pose()
    except (AssemblyError, ProblemError) as error:
        return [Finding(name=name, answer="refuted", reason=str(error))]
    try:
        own = close_at(problem.mechanism, trajectory.position[0, 0], begin)
    except AssemblyError as error:
        return [Finding(name=name, answer="undecided", reason=f"not proved: {error}")]
    apart = np.where(moved, 0.0, np.abs(trajectory.start_pose - own))
    return [finding_of(name, float(apart.max(initial=0.0)), START_POSE_ERROR, "rad or m", float(trajectory.breaks_s[0]))]
