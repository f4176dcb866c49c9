"""Plans of a site that follows a path exactly, with the path's parameter as the motion's only coordinate.

The mechanism guided along the path has one degree of freedom and all drives. It is planned like any other; every limit and
objective applies. Its motion and efforts are then those of the mechanism itself.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from linkplan.models.deadline import Deadline
from linkplan.models.guide.guided import GuidedMechanism
from linkplan.models.poses.along import accelerations, joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.certificate.further_checks import objective_value
from linkplan.planner.closed_chain.case import finished
from linkplan.planner.closed_chain.guess import Guess
from linkplan.planner.closed_chain.prescribed import motion_along, rounded_down
from linkplan.planner.limits.kinds import limits_of
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.limits import OF_JOINTS, free_bounds
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.path import Feed
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import bernstein_part

# Polynomial pieces of the joints' motion per interval, if there is a limit on jerk. With one piece on each of fifteen
# intervals, the third derivative has errors of 2e-7 and the acceleration jumps of 1e-7.
_PIECES_FOR_JERK = 3


def plan_along_path(problem: Problem, start_pose: np.ndarray, plan_of: Callable[[Problem], Plan]) -> Plan:
    """Return the plan of a motion along the problem's path; `plan_of` plans that of the guided mechanism."""
    assert problem.path is not None
    mechanism = problem.path.guided(problem.mechanism, start_pose)
    found = plan_of(_guided_problem(problem, mechanism))
    way = problem.path.curve.ways[1][-1]
    if problem.path.feed and "motion.duration_s" in found.verdict.remedy:
        feed = rounded_down(way / found.verdict.remedy["motion.duration_s"])
        said = f"with path.feed_m_s = {feed:g} or less it satisfies every limit"
        found = replace(found, verdict=found.verdict.replace(further=(said,), remedy={"path.feed_m_s": feed}))
    if found.trajectory is None or not found.passed:
        return replace(found, problem=problem, trajectory=None, certificate=None, objective=None)
    # A search that ran out of time still has its motion.
    judged = problem.varied(solver=problem.solver.replace(deadline=Deadline().within(problem.solver.max_time_s)))
    motion = _in_joints(judged, mechanism, found.trajectory)
    objective, _ = objective_value(problem, motion)
    plan = finished(problem, motion, certify(judged, motion), objective, None, optimal=found.status == "optimal")
    if plan.passed:
        feed = f"a constant feed of {way / motion.duration_s:.6g} m/s: " if problem.path.feed else ""
        words = f"{feed}{found.verdict.words}, along the path of site {problem.path.site}"
        plan = replace(plan, verdict=found.verdict.replace(words=words, kind=plan.status))
    return replace(plan, history=found.history)


def _guided_problem(problem: Problem, mechanism: GuidedMechanism) -> Problem:
    """Return the problem of the guided mechanism, from the path's beginning to its end."""
    path, curve, limits = problem.path, mechanism.curve, problem.limits
    assert path is not None
    ends = np.array([[0.0, curve.length]])
    rows = dict.fromkeys(OF_JOINTS, free_bounds(1)) | ({} if path.feed else {"position": ends})
    longer = {name: np.vstack([getattr(limits, name), row]) for name, row in rows.items()}
    forces = np.append(limits.closure_force, np.inf)
    (start_speed, start_acceleration), (goal_speed, goal_acceleration) = (np.array(path.rates(k))[:, None] for k in (0, 1))
    motion = replace(
        problem.motion,
        kind="track" if path.feed else "reach",
        start=np.zeros(1),
        goal=np.array([curve.length]),
        start_speed=start_speed,
        goal_speed=goal_speed,
        start_acceleration=None if path.feed else start_acceleration,
        goal_acceleration=None if path.feed else goal_acceleration,
        goal_named=(0,),
        waypoints=() if path.feed else [Waypoint(position=x) for x in curve.corners[:, None]],
    )
    length = curve.ways[1][-1]
    constant = {"reference": Feed(curve=curve, period_s=problem.motion.duration_s or length), "objective": "tracking"}
    return problem.varied(
        mechanism=mechanism,
        motion=motion,
        path=None,
        limits=replace(limits, closure_force=forces, **longer),
        **(constant if path.feed else {}),
    )


def _in_joints(problem: Problem, mechanism: GuidedMechanism, along: Trajectory) -> Trajectory:
    """Return a motion along the path as one of the mechanism's own joints."""
    free = [int(i) for i in problem.mechanism.independent]

    def poses(time: np.ndarray) -> np.ndarray:
        return follow(mechanism, along.position_at(time), along.start_pose, problem.solver.deadline)

    def acceleration(time: np.ndarray) -> np.ndarray:
        return accelerations(mechanism, poses(time), along.velocity_at(time), along.acceleration_at(time))[:, free]

    guess = Guess(
        position=lambda time: poses(time)[:, free],
        velocity=lambda time: joint_rates(mechanism, poses(time), along.velocity_at(time))[:, free],
        acceleration=acceleration,
        effort=along.effort_at,
        duration_s=along.duration_s,
        start_pose=along.start_pose[:-1],
    )
    n = _PIECES_FOR_JERK if any(limit.rows.jerk for limit in limits_of(problem)) else 1
    motion = motion_along(problem, guess, np.append(along.times_at(np.arange(n) / n), along.breaks_s[-1]))
    degree = len(along.position) - 1
    parts = [np.einsum("pi,iks->pks", bernstein_part(degree, k / n, (k + 1) / n), along.position) for k in range(n)]
    place = np.stack(parts, axis=2).reshape(degree + 1, -1, 1)
    return replace(motion, along=place)
