"""The poses at which a loop is analysed: the requested ones, or by default poses over the motion or the reach."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.models.external_forces import omitted_forces
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.reach import reach
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.problem.limits import within_reserve
from linkplan.planner.problem.motion import check_asked_pose
from linkplan.planner.problem.problem import Problem
from linkplan.studies.check.holding import EFFORT_RESERVE, require_actuated
from linkplan.studies.feedback.bode.bode import REACH_SHARES, inner_reach
from linkplan.studies.feedback.bode.scan import PoseLine, coordinate_line, motion_line
from linkplan.studies.feedback.frequency.feedback_loops import operating_point

_DEFAULT_POSES = 5


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LoopPoses:
    """Independent positions (n, n_s) [rad or m], a note on their choice, and the line that they sample.

    `line` is None if the poses were requested, or if home is the only pose.
    """

    positions: np.ndarray
    note: str | None = None
    line: PoseLine | None = None

    def said(self, mechanism: Mechanism, command: str) -> str | None:
        """Return the note of a command on the poses' choice, and on forces over time that do not act at them."""
        notes = [self.note, omitted_forces(mechanism.forces, f"at the poses of {command}")]
        return "; ".join(filter(None, notes)) or None


def loop_poses(
    mechanism: Mechanism,
    problem: Problem | None,
    effort_limit: np.ndarray,
    asked: Sequence[Mapping[str, float]] = (),
) -> LoopPoses:
    """Return the poses to analyse.

    Args:
        mechanism: with an actuator.
        problem: the default poses cover its motion, if given.
        effort_limit: (n_u, 2) [N.m or N]; efforts within it must hold the default poses.
        asked: positions [rad or m] by joint for each pose, home for other joints; empty for the default poses.

    Raises:
        ProblemError: for a dependent joint, or a pose beyond reach.
        LinkplanError: for a mechanism without an actuator.
    """
    require_actuated(mechanism)
    if not asked:
        return (_along_motion if mechanism.dof > 1 else _over_reach)(mechanism, problem, effort_limit)
    names = [joint.name for joint in mechanism.independent_joints]
    home = dict(zip(names, mechanism.home[mechanism.independent], strict=True))
    for pose in asked:
        wrong = [name for name in pose if name not in names]
        if wrong:
            plural = "s" * (len(names) > 1)
            raise ProblemError(f"a pose names the independent joint{plural} {', '.join(names)}; {wrong[0]} is dependent")
        check_asked_pose(mechanism, pose)
    return LoopPoses(positions=np.array([[{**home, **pose}[name] for name in names] for pose in asked]))


def _over_reach(mechanism: Mechanism, problem: Problem | None, effort_limit: np.ndarray) -> LoopPoses:
    """Return five poses over the motion of one degree of freedom, or seven over its reach, and the line between their ends.

    They are restricted to positions that efforts within the limits hold at rest; a note says so.
    """
    ends, joint, note = _motion_range(problem), mechanism.independent_joints[0], None
    periodic = ends is None and reach(mechanism, 0).period is not None
    if ends is not None:
        low, high, shares = float(ends.min()), float(ends.max()), np.linspace(0.0, 1.0, _DEFAULT_POSES)
    else:
        low, high = inner_reach(mechanism, 0)
        shares = (np.array(REACH_SHARES) - REACH_SHARES[0]) / (REACH_SHARES[-1] - REACH_SHARES[0])
        if periodic:  # a full turn has no ends: the same number of poses, evenly spaced over a period
            high, shares = high - (high - low) / len(shares), np.linspace(0.0, 1.0, len(shares))
    tried = np.linspace(low, high, 81)
    held = _are_held(mechanism, tried[:, None], effort_limit)
    positions = low + shares * (high - low)
    if held.any() and not held.all():  # if none can be held, `operating_point` raises the reason later
        kept, unheld = tried[held], tried[~held]
        positions = kept[(shares * (len(kept) - 1)).round().astype(int)]
        note = (
            f"poses are taken from {joint.name} = {joint.text(kept[0], 4)} to {joint.text(kept[-1], 4)} {joint.unit}: the"
            f" actuators cannot hold {len(unheld)} of {len(tried)} positions from {joint.text(low, 4)} to"
            f" {joint.text(high, 4)} at rest, all between {joint.text(unheld[0], 4)} and {joint.text(unheld[-1], 4)}"
        )
    positions = positions[:, None]
    low, high = float(positions.min()), float(positions.max())
    if periodic and note is None:
        low, high = inner_reach(mechanism, 0)
    line = coordinate_line(mechanism, 0, low, high, positions[0]) if low < high else None
    return LoopPoses(positions=positions, note=note, line=line)


def _are_held(mechanism: Mechanism, positions: np.ndarray, effort_limit: np.ndarray) -> np.ndarray:
    """Return True for each of the positions (n, n_s) that the actuators hold with a reserve to both limits, (n,)."""
    inside, held = within_reserve(effort_limit, EFFORT_RESERVE), np.zeros(len(positions), dtype=bool)
    for k, position in enumerate(positions):
        with contextlib.suppress(LinkplanError):
            operating_point(mechanism, position, inside)
            held[k] = True
    return held


def _along_motion(mechanism: Mechanism, problem: Problem | None, effort_limit: np.ndarray) -> LoopPoses:
    """Return default poses for several degrees of freedom: along a problem's reference or smooth path, else home."""
    home = LoopPoses(positions=mechanism.home[mechanism.independent][None])
    if problem is None:
        return home
    try:
        guess = first_guess(problem, problem.start_pose())
    except LinkplanError:  # `linkplan plan` explains why a problem has no initial guess
        return home
    time = np.linspace(0.0, guess.duration_s, 61)
    path = guess.position(time)
    held = _are_held(mechanism, path, effort_limit)
    if not held.any():  # `operating_point` raises the reason later
        return LoopPoses(positions=path[:1])
    kept = np.flatnonzero(held)
    positions = path[kept[np.linspace(0, len(kept) - 1, _DEFAULT_POSES).round().astype(int)]]
    note = f"poses are taken along the path of {problem.name}, at equal times"
    if not held.all():
        note += f"; the actuators cannot hold the path at rest at {int((~held).sum())} of {len(held)} instants"
    return LoopPoses(positions=np.unique(positions, axis=0), note=note, line=motion_line(time, path))


def _motion_range(problem: Problem | None) -> np.ndarray | None:
    """Return the ends (2,) [rad or m] of a problem's motion; None without a motion or with several degrees of freedom."""
    if problem is None or problem.mechanism.dof != 1:
        return None
    motion, reference = problem.motion, problem.reference
    if motion.start is not None and motion.goal is not None:
        return np.array([motion.start[0], motion.goal[0]])
    if reference is None:
        return None
    values = reference.derivative(np.linspace(0.0, reference.period_s, 181))[:, 0]
    return np.array([values.min(), values.max()])
