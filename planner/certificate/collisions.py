"""The check of a planned motion for collisions.

Plans contain no contact forces. A motion along which geoms collide is therefore wrong, unless they overlap by construction.
"""

import json
from dataclasses import replace

import numpy as np

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.contacts import Meeting, may_collide, meetings, new_meetings
from linkplan.planner.certificate.certificate import Certificate, certify
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory


def with_contacts(problem: Problem, trajectory: Trajectory, certificate: Certificate) -> Certificate:
    """Return a motion's certificate with the contacts along it; it fails if geoms collide, unless contacts are only noted.

    Contacts are checked once, at the end, and not with each of refinement's certificates, which hardly change them.
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
        late = f"its check for contacts ran out of the plan's {solver.max_time_s:g} s (solver.max_time_s)"
        return replace(certificate, failures=(*certificate.failures, late))
    if problem.contacts == "refuse" and new_meetings(found):
        collision = (_failure(new_meetings(found)),)
        failures, unmendable = certificate.failures + collision, certificate.unmendable + collision
        return replace(certificate, contacts=found, failures=failures, unmendable=unmendable)
    return replace(certificate, contacts=found)


def surely_collides(problem: Problem, trajectory: Trajectory) -> Certificate | None:
    """Return the certificate, without other failures, of a motion that collides on every finer mesh too; None if it may not.

    At its nodes the geoms are deeper in each other than the motion is exact by far: by ten times the largest travel that its
    integration error stands for. Nodes are few, and a motion without such a collision costs little here.
    """
    if problem.contacts != "refuse" or not may_collide(problem.mechanism.model):
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
    return replace(certificate, failures=(), unmendable=())


def unavoidable(problem: Problem, trajectory: Trajectory, certificate: Certificate) -> bool:
    """Check whether geoms collide at poses between start and goal of a mechanism with one degree of freedom."""
    start, goal = problem.motion.start, problem.motion.goal
    if problem.contacts != "refuse" or problem.mechanism.dof != 1 or start is None or goal is None:
        return False
    met = np.array([meeting.since for meeting in new_meetings(certificate.contacts)])
    at = trajectory.position_at(met)[:, 0] if len(met) else np.empty(0)
    low, high = sorted((float(start[0]), float(goal[0])))
    return bool(np.any((low <= at) & (at <= high)))


def _failure(found: tuple[Meeting, ...]) -> str:
    """Return the sentence on the first collision of a plan, with the number of others."""
    first, others = found[0], len(found) - 1
    already = f", {1e3 * first.home_depth_m:.2g} mm at home" if first.home_depth_m > 0 else ""
    more = f", and {others} more pair{'s' if others > 1 else ''} of geoms after them" if others else ""
    return (
        f"{geom_names(first)} collide at t = {first.since:.5g} s and penetrate by up to {1e3 * first.depth_m:.2g} mm, at"
        f' t = {first.deepest_at:.5g} s{already}{more}; contact forces are not planned for (limits.contacts = "note"'
        " plans without them)"
    )


def geom_names(meeting: Meeting) -> str:
    """Return a phrase that names two geoms and their bodies."""
    first, second = (
        f"{geom} ({body})" if not geom.endswith(f" of {body}") else geom
        for geom, body in zip((meeting.first, meeting.second), meeting.bodies, strict=True)
    )
    return f"geoms {first} and {second}"


def contact_notes(found: tuple[Meeting, ...]) -> tuple[str, ...]:
    """Return phrases on the contacts that a plan neglects: one for each that begins on the way, one for all the others."""
    begun = [
        f"contact of {geom_names(meeting)} from t = {meeting.since:.5g} s on, {_neglected(meeting.depth_m)}"
        for meeting in new_meetings(found)
    ]
    constant = [meeting for meeting in found if meeting.since is None]
    if not constant:
        return tuple(begun)
    which = geom_names(constant[0]) if len(constant) == 1 else f"{len(constant)} pairs of geoms"
    pairs = json.dumps(list(dict.fromkeys(meeting.bodies for meeting in constant)))
    said = (
        f"contact of {which}, as deep at home, or on a pin that they share,"
        f" {_neglected(max(meeting.depth_m for meeting in constant))}; the simulator applies them, and"
        f" mechanism.exclude_contacts = {pairs} leaves them out"
    )
    return (*begun, said)


def _neglected(depth_m: float) -> str:
    return f"up to {1e3 * depth_m:.2g} mm deep along the motion: contact forces are not planned for"
