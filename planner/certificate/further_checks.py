"""Checks of a motion beyond the certificate: its collisions, and whether a file's motion is what its record claims.

Plans contain no contact forces. A motion along which geoms collide is therefore wrong, unless they overlap by construction.

The checks of a file's motion compare its duration, its reference, the pose in the middle of a periodic motion, and its
objective as an independent quadrature.
"""

import json

import casadi as ca
import numpy as np
from msgspec.structs import replace

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.models.kinematics import may_collide
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.contacts import Contact, meetings, new_meetings
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.certificate.certificate import Certificate, certify
from linkplan.planner.certificate.integration import BOUNDARY_SHARE, relative_violation
from linkplan.planner.limits.efforts import effort_rates
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.problem.instant import Scales, force_inputs, free_instant
from linkplan.planner.problem.limits import exact_bounds
from linkplan.planner.problem.objective import motor_losses
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory


def disagreements(problem: Problem, trajectory: Trajectory, objective: float | None) -> tuple[str, ...]:
    """Return sentences on the differences between a motion and its problem or its saved objective; empty if there are none.

    `objective` is the saved value; None is not checked.
    """
    motion, duration = problem.motion, trajectory.duration_s
    found = []
    if trajectory.periodic and motion.ends_at_goal:
        found.append(f"a {motion.kind} does not repeat, and the motion is marked as periodic")
    if not trajectory.periodic and motion.kind == "periodic":
        found.append("a periodic motion repeats, and the motion is not marked as periodic")
    longest = problem.motion.max_duration_s or np.inf
    low, high = motion.min_duration_s or 0.0, longest
    if motion.duration_s is not None:
        low = high = motion.duration_s
    rounding = 1e-8  # durations are unknowns of the program, found to rounding and saved in full
    if not low * (1 - rounding) <= duration <= high * (1 + rounding):
        asked = f"{low:.9g} s" if low == high else f"{low:.9g} to {high:.9g} s"
        found.append(f"the motion lasts {duration:.9g} s instead of {asked}")
    found += _off_states(problem, trajectory)
    if objective is not None:
        found += _off_objective(problem, trajectory, objective)
    return tuple(found)


def _off_states(problem: Problem, trajectory: Trajectory) -> list[str]:
    motion, span = problem.motion, max(float(np.ptp(trajectory.position)), 1e-9)
    reference = problem.reference_over(trajectory.duration_s)
    if motion.kind == "track" and reference is not None:
        time = trajectory.dense_times()
        off = np.abs(trajectory.position_at(time) - reference.derivative(time - trajectory.breaks_s[0])).max()
        # The polynomials of an exactly followed reference miss it by less than 1e-8 of its span, with forty in a period.
        return [f"the reference is missed by {off / span:.3g} of its range"] if not off <= BOUNDARY_SHARE * span else []
    if motion.kind != "periodic":
        return []
    found = []
    middle = trajectory.breaks_s[0] + 0.5 * trajectory.duration_s
    for what, asked, time in (("start", motion.start, trajectory.breaks_s[0]), ("goal", motion.goal, middle)):
        if asked is None or (what == "goal" and motion.waypoints):
            continue
        off = relative_violation(trajectory.position_at(np.array([time])), exact_bounds(asked), span)
        if not off <= BOUNDARY_SHARE:
            found.append(f"the periodic motion misses its {what} by {off:.3g} of its range")
    return found


def _off_objective(problem: Problem, trajectory: Trajectory, saved: float) -> list[str]:
    try:
        value, size = objective_value(problem, trajectory)
    except AssemblyError:  # the certificate already reports a motion off its loops
        return []
    objective, size = problem.objective, max(abs(saved), size)
    # The program's quadrature differs by some thousandths on the coarsest meshes, for positive work with its kinks by some
    # hundredths. A smoothing term in the program may explain up to half of the saved value.
    share = 0.05 if any(term.positive_power for term in objective.terms.values()) else 0.01
    negligible = negligible_objective(problem, trajectory)
    below = (0.5 if objective.is_smoothed else share) * size + negligible
    if saved - below <= value <= saved + share * size + negligible:
        return []
    return [f"its saved objective is {saved:.6g}, and that of its motion is {value:.6g}"]


@np.errstate(all="ignore")  # the duration in an edited file may be 1e200 s
def negligible_objective(problem: Problem, trajectory: Trajectory) -> float:
    """Return the objective [SI] that counts as zero: a motion without work still has the solver's rounding.

    The value is 1e-6 of every term's quantity on its natural scale, a hundred times the solver's tolerance. The scales are a
    radian or the mechanism's extent for each joint, and the effort limit; without a limit, the motion's largest effort or,
    if larger, the effort that accelerates the inertia within the duration.
    """
    mechanism, T = problem.mechanism, np.float64(trajectory.duration_s)
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    pose = trajectory.start_pose
    maps = np.abs(np.array(mechanism.dynamics.effort_map(pose)))
    inertial = (np.abs(np.array(mechanism.dynamics.reduced_inertia(pose))) @ unit).max(initial=0.0) / T**2
    largest = np.abs(effort_bounds(problem)).max(axis=1)
    asked = np.maximum(np.abs(trajectory.effort).max(axis=(0, 1)), inertial / max(maps.max(initial=0.0), 1e-300))
    effort = np.where(np.isfinite(largest), largest, asked)
    natural = Scales(time_s=T, position=unit, effort=effort, residual=maps @ effort, length_m=mechanism.extent_m)
    floors = [
        problem.objective.weight(name) * 1e-6**term.order * np.sum(term.size(natural, problem.motors))
        for name, term in problem.objective.terms.items()
        if term.order
    ]
    return float(sum(floors))


def objective_value(problem: Problem, trajectory: Trajectory) -> tuple[float, float]:
    """Return a motion's objective and the sum of its terms' absolute values [SI], integrals by Gauss-Legendre quadrature.

    Raises:
        AssemblyError: when the loops cannot close along the motion.
    """
    time, width = trajectory.quadrature()
    objective, reference = problem.objective, problem.reference_over(trajectory.duration_s)
    at, symbols = free_instant(problem.mechanism, motor_losses(problem.motors))
    integrands = ca.vertcat(*(objective.weight(name) * term.integrand(at) for name, term in objective.terms.items()))
    s, v, a, u = (
        f(time) for f in (trajectory.position_at, trajectory.velocity_at, trajectory.acceleration_at, trajectory.effort_at)
    )
    q = follow(problem.mechanism, s, trajectory.start_pose)
    rate, _ = effort_rates(trajectory, time)
    wanted = s if reference is None else reference.derivative(time - trajectory.breaks_s[0])
    with np.errstate(over="ignore", invalid="ignore"):  # the duration in an edited file may be 1e-200 s
        jerk = trajectory.jerk_at(time)
    columns = (q, v, a, u, rate, wanted, jerk, *problem.mechanism.forces_at(time))
    values = sampled(ca.Function("objective", [*symbols, *force_inputs(at)], [ca.densify(integrands)]), *columns)[:, :, 0]
    peak = objective.weight("peak_effort") and objective.weight("peak_effort") * peak_share(problem, trajectory)
    return float(width @ values.sum(axis=1) + peak), float(width @ np.abs(values).sum(axis=1) + peak)


def peak_share(problem: Problem, trajectory: Trajectory) -> float:
    """Return the largest effort of a motion at any instant, as a share of its limit."""
    effort = trajectory.effort_at(trajectory.dense_times(40))
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.nan_to_num(effort[:, :, None] / effort_bounds(problem), nan=0.0, posinf=0.0, neginf=0.0)
    return float(shares.max(initial=0.0))


def with_contacts(problem: Problem, trajectory: Trajectory, certificate: Certificate) -> Certificate:
    """Return a motion's certificate with the contacts along it; it fails if geoms collide, unless contacts are only noted.

    Contacts are checked once, at the end, and not in each certificate of the refinement, which hardly changes them.
    """
    if not may_collide(problem.mechanism.model):
        return certificate
    n = len(trajectory.breaks_s) - 1
    # Twelve poses per interval, fewer on fine meshes; more are checked where geoms come near.
    time = np.unique(trajectory.dense_times(max(1, min(12, 5000 // n))))
    solver = problem.solver
    try:
        poses = follow(problem.mechanism, trajectory.position_at(time), trajectory.start_pose, solver.judging_deadline)
        found = meetings(problem.mechanism, time, poses, trajectory.position_at, solver.judging_deadline)
    except OutOfTimeError:
        late = f"its check for contacts ran out of the plan's time, {solver.max_time_s:g} s (solver.max_time_s)"
        return replace(certificate, failures=(*certificate.failures, late))
    if problem.limits.contacts == "refuse" and new_meetings(found):
        collision = (_failure(new_meetings(found)),)
        failures, unrepairable = certificate.failures + collision, certificate.unrepairable + collision
        return replace(certificate, contacts=found, failures=failures, unrepairable=unrepairable)
    return replace(certificate, contacts=found)


def surely_collides(problem: Problem, trajectory: Trajectory) -> Certificate | None:
    """Return the certificate, without other failures, of a motion that collides on every finer mesh too; None if it may not.

    At its nodes the geoms penetrate each other by more than ten times the largest travel that its integration error may
    cause. Only the few nodes are checked, so the check takes little time.
    """
    if problem.limits.contacts != "refuse" or not may_collide(problem.mechanism.model):
        return None
    mechanism, deadline = problem.mechanism, problem.solver.judging_deadline
    nodes = trajectory.breaks_s
    try:
        poses = follow(mechanism, trajectory.position_at(nodes), trajectory.start_pose, deadline)
        found = new_meetings(meetings(mechanism, nodes, poses, trajectory.position_at, deadline))
        certificate = certify(problem, trajectory) if found else None
    except (AssemblyError, OutOfTimeError):
        return None
    if certificate is None:
        return None
    travel = mechanism.extent_m * np.radians(certificate.integration_error_deg) + certificate.integration_error_m
    if not max(meeting.depth_m for meeting in found) > 10 * travel:  # not if the integration failed
        return None
    return replace(certificate, failures=(), unrepairable=())


def unavoidable(problem: Problem, trajectory: Trajectory, certificate: Certificate) -> bool:
    """Check whether geoms collide at poses between start and goal of a mechanism with one degree of freedom."""
    start, goal = problem.motion.start, problem.motion.goal
    if problem.limits.contacts != "refuse" or problem.mechanism.dof != 1 or start is None or goal is None:
        return False
    met = np.array([meeting.since_s for meeting in new_meetings(certificate.contacts)])
    at = trajectory.position_at(met)[:, 0] if len(met) else np.empty(0)
    low, high = sorted((float(start[0]), float(goal[0])))
    return bool(np.any((low <= at) & (at <= high)))


def _failure(found: tuple[Contact, ...]) -> str:
    """Return the sentence on the first collision of a plan, with the number of others."""
    first, others = found[0], len(found) - 1
    already = f", {1e3 * first.home_depth_m:.2g} mm at home" if first.home_depth_m > 0 else ""
    more = f", and {others} more pair{'s' if others > 1 else ''} of geoms after them" if others else ""
    return (
        f"{geom_names(first)} collide at t = {first.since_s:.5g} s and penetrate by up to {1e3 * first.depth_m:.2g} mm, at"
        f" t = {first.deepest_at_s:.5g} s{already}{more}; plans contain no contact forces (limits.contacts ="
        ' "note" only notes the contacts)'
    )


def geom_names(meeting: Contact) -> str:
    """Return a phrase that names two geoms and their bodies."""
    first, second = (
        f"{geom} ({body})" if not geom.endswith(f" of {body}") else geom
        for geom, body in zip(meeting.geoms, meeting.bodies, strict=True)
    )
    return f"geoms {first} and {second}"


def contact_notes(found: tuple[Contact, ...]) -> tuple[str, ...]:
    """Return phrases on the contacts that a plan neglects: one for each that begins on the way, one for all the others."""
    if not found:
        return ()
    begun = [
        f"contact of {geom_names(meeting)} from t = {meeting.since_s:.5g} s on, {_neglected(meeting.depth_m)}"
        for meeting in new_meetings(found)
    ]
    constant = [meeting for meeting in found if meeting.since_s is None]
    if not constant:
        return tuple(begun)
    which = geom_names(constant[0]) if len(constant) == 1 else f"{len(constant)} pairs of geoms"
    pairs = json.dumps(list(dict.fromkeys(meeting.bodies for meeting in constant)))
    said = (
        f"contact of {which}, as deep at home, or on a pin that they share,"
        f" {_neglected(max(meeting.depth_m for meeting in constant))}; the simulator applies them, and"
        f" mechanism.exclude_contacts = {pairs} excludes them"
    )
    return (*begun, said)


def _neglected(depth_m: float) -> str:
    return f"up to {1e3 * depth_m:.2g} mm deep along the motion: plans contain no contact forces"
