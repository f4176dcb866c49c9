"""The collision check of a planned motion: what a certificate says of contacts.

A plan knows no contact forces: geoms that collide on the way, and do not overlap by construction, make it false.
"""

from dataclasses import replace

import numpy as np

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.contacts import Meeting, exclusion, may_collide, meetings, new_meetings
from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.trajectory import Trajectory

# Poses checked on an interval, and on a fine mesh in all; between them more are checked where geoms come near.
_PER_INTERVAL, _SAMPLES = 12, 5000


def with_contacts(problem: PlanningProblem, trajectory: Trajectory, certificate: Certificate) -> Certificate:
    """Return a motion's certificate with the contacts along it; it fails where geoms meet, unless they are only noted.

    Refinement certifies a motion many times, on which contacts do not depend; they are checked once, at the end.
    """
    if not may_collide(problem.mechanism.model):
        return certificate
    n = len(trajectory.breaks_s) - 1
    time = np.unique(trajectory.dense_times(max(1, min(_PER_INTERVAL, _SAMPLES // n))))
    solver = problem.solver
    try:
        poses = follow(problem.mechanism, trajectory.position_at(time), trajectory.start_pose, solver.judging_deadline)
        found = meetings(problem.mechanism, time, poses, trajectory.position_at, solver.judging_deadline)
    except OutOfTimeError:
        said = f"its check for contacts ran out of the plan's {solver.max_time_s:g} s (solver.max_time_s)"
        return replace(certificate, failures=(*certificate.failures, said))
    if problem.contacts == "refuse" and new_meetings(found):
        said = (_failure(new_meetings(found)),)
        failures, unmendable = certificate.failures + said, certificate.unmendable + said
        return replace(certificate, contacts=found, failures=failures, unmendable=unmendable)
    return replace(certificate, contacts=found)


def unavoidable(problem: PlanningProblem, trajectory: Trajectory, certificate: Certificate) -> bool:
    """Return whether geoms collide where every motion passes: between start and goal of a single freedom."""
    start, goal = problem.motion.start, problem.motion.goal
    if problem.contacts != "refuse" or problem.mechanism.dof != 1 or start is None or goal is None:
        return False
    met = np.array([meeting.since for meeting in new_meetings(certificate.contacts)])
    at = trajectory.position_at(met)[:, 0] if len(met) else np.empty(0)
    low, high = sorted((float(start[0]), float(goal[0])))
    return bool(np.any((low <= at) & (at <= high)))


def _failure(found: tuple[Meeting, ...]) -> str:
    """Return the sentence on the first of the contacts that make a plan false, and how many there are."""
    first, others = found[0], len(found) - 1
    already = f", {1e3 * first.home_depth_m:.2g} mm at home" if first.home_depth_m > 0 else ""
    more = f", and {others} more pair{'s' if others > 1 else ''} of geoms after them" if others else ""
    return (
        f"{who(first)} collide at t = {first.since:.5g} s and penetrate by up to {1e3 * first.depth_m:.2g} mm, at"
        f' t = {first.deepest_at:.5g} s{already}{more}; contact forces are not planned for (limits.contacts = "note"'
        " plans without them)"
    )


def who(meeting: Meeting) -> str:
    """Return the words for two geoms and their bodies."""
    first, second = (
        f"{geom} ({body})" if not geom.endswith(f" of {body}") else geom
        for geom, body in zip((meeting.first, meeting.second), meeting.bodies, strict=True)
    )
    return f"geoms {first} and {second}"


def noted(meeting: Meeting) -> str:
    """Return the words for a contact that a plan leaves out."""
    depth = f"up to {1e3 * meeting.depth_m:.2g} mm deep along the motion: its forces are not planned for"
    if meeting.since is not None:
        return f"contact of {who(meeting)} from t = {meeting.since:.5g} s on, {depth}"
    return (
        f"contact of {who(meeting)}, as deep at home, or on a pin that they share, {depth}; the simulator"
        f" applies them unless told {exclusion(meeting.bodies)}"
    )
