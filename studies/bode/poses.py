"""The poses at which a loop is looked at: those asked for, or by default some over the motion or the reach."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.presolve import start_pose_of
from linkplan.studies.bode.bode import POINTS, default_poses, is_held, most_of_reach, turns
from linkplan.studies.bode.scan import Line, coordinate_line, motion_line
from linkplan.studies.frequency.feedback_loops import require_actuated

# A reference is looked at so many times over its period for the ends of its motion.
_SAMPLES = 181
# Instants of a motion of several freedoms: its line's nodes.
_INSTANTS = 61


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LoopPoses:
    """Independent positions (n, n_s) [rad or m], a sentence on their choice where that matters, the line they stand for.

    `line` is None where the poses themselves were asked for, or are home alone.
    """

    positions: np.ndarray
    note: str | None = None
    line: Line | None = None


def loop_poses(
    mechanism: Mechanism,
    problem: PlanningProblem | None,
    effort_limit: np.ndarray,
    asked: Sequence[Mapping[str, float]] = (),
) -> LoopPoses:
    """Return the poses to look at.

    Args:
        mechanism: of which every freedom has its actuator.
        problem: over whose motion the default poses lie, where there is one.
        effort_limit: (n_u, 2) [N.m or N], which is to hold the default poses.
        asked: positions [rad or m] by joint, home for those that are not named; none for the default.

    Raises:
        ProblemError: for a joint that follows from others, or a mechanism with a freedom that nothing drives.
    """
    require_actuated(mechanism)
    if not asked:
        return (
            _along_motion(mechanism, problem, effort_limit) if mechanism.dof > 1 else _one(mechanism, problem, effort_limit)
        )
    names = [joint.name for joint in mechanism.independent_joints]
    home = dict(zip(names, mechanism.home[mechanism.independent], strict=True))
    for pose in asked:
        wrong = [name for name in pose if name not in names]
        if wrong:
            plural = "s" * (len(names) > 1)
            raise ProblemError(f"a pose names the independent joint{plural} {', '.join(names)}; {wrong[0]} follows")
    return LoopPoses(positions=np.array([[{**home, **pose}[name] for name in names] for pose in asked]))


def _one(mechanism: Mechanism, problem: PlanningProblem | None, effort_limit: np.ndarray) -> LoopPoses:
    """Return default poses of a single freedom, over the motion or most of the reach, and the line between their ends."""
    ends = _motion_range(problem)
    positions, note = default_poses(mechanism, ends, effort_limit)
    low, high = float(positions.min()), float(positions.max())
    if ends is None and note is None and turns(mechanism, 0):
        low, high = most_of_reach(mechanism, 0)
    line = coordinate_line(mechanism, 0, low, high, positions[0]) if low < high else None
    return LoopPoses(positions=positions, note=note, line=line)


def _along_motion(mechanism: Mechanism, problem: PlanningProblem | None, effort_limit: np.ndarray) -> LoopPoses:
    """Return default poses of several freedoms: along a problem's reference or smooth path, home without one."""
    home = LoopPoses(positions=mechanism.home[mechanism.independent][None])
    if problem is None:
        return home
    try:
        guess = first_guess(problem, start_pose_of(problem))
    except LinkplanError:  # a problem that cannot begin is for `plan` to explain
        return home
    time = np.linspace(0.0, guess.duration_s, _INSTANTS)
    path = guess.position(time)
    held = np.array([is_held(mechanism, s, effort_limit) for s in path])
    if not held.any():  # the first one's refusal says why
        return LoopPoses(positions=path[:1])
    kept = np.flatnonzero(held)
    positions = path[kept[np.linspace(0, len(kept) - 1, POINTS).round().astype(int)]]
    note = f"poses are taken along the path of {problem.name}, at equal times"
    if not held.all():
        note += f", where the actuators hold them at rest: not at {int((~held).sum())} of {len(held)} instants"
    return LoopPoses(positions=np.unique(positions, axis=0), note=note, line=motion_line(time, path))


def _motion_range(problem: PlanningProblem | None) -> np.ndarray | None:
    """Return the ends of a problem's motion (2,) [rad or m]; None without one, or of more than one freedom."""
    if problem is None or problem.mechanism.dof != 1:
        return None
    motion, reference = problem.motion, problem.reference
    if motion.start is not None and motion.goal is not None:
        return np.array([motion.start[0], motion.goal[0]])
    if reference is None:
        return None
    values = reference.derivative(np.linspace(0.0, reference.period_s, _SAMPLES))[:, 0]
    return np.array([values.min(), values.max()])
