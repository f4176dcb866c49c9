"""Motions that turn for ever: whether a mechanism is after its turns what it was before."""

import numpy as np

from linkplan.models.errors import AssemblyError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.controls import needed_controls
from linkplan.models.poses.reach import Reach
from linkplan.models.poses.turning import whole_turns
from linkplan.planner.problem.planning_problem import PlanningProblem

# The share of the largest effort by which the effort of springs may differ after a turn.
_SAME_EFFORT_SHARE = 1e-9


def check_turns(problem: PlanningProblem, start_pose: np.ndarray, can: Reach | None) -> None:
    """Refuse turns that the mechanism does not make, or after which it is not what it was.

    Args:
        problem: with `motion.turns`.
        start_pose: a closed pose (n_q,) at the start.
        can: the reach of a single freedom.

    Raises:
        ProblemError: naming the joint that stops the turn, is not back after it, or winds a spring up.
    """
    mechanism, motion = problem.mechanism, problem.motion
    turning = [j for j, n in zip(mechanism.independent_joints, motion.turns, strict=True) if n]
    names = " and ".join(joint.name for joint in turning)
    if can is not None and not can.turns_fully:
        (joint,) = turning
        low, high = joint.said(can.lower.position, 6), joint.said(can.upper.position, 6)
        raise ProblemError(
            f"motion.turns of joint {names}: it does not turn fully, it reaches from {low} deg ({can.lower.reason}) to"
            f" {high} deg ({can.upper.reason})"
        )
    first = start_pose[mechanism.independent]
    # Poses examined in each turn.
    n = int(181 * np.abs(motion.turns).max())
    try:
        path = first + np.linspace(0.0, 1.0, n)[:, None] * motion.advance
        poses = follow(mechanism, path, start_pose, problem.solver.deadline)
    except AssemblyError as error:
        if mechanism.dof > 1:  # another way may be open
            return
        raise ProblemError(f"motion.turns of joint {names}: it does not turn fully: {error}") from error
    travelled = poses[-1] - poses[0]
    gone = whole_turns(mechanism, travelled)
    worst = int(np.argmax(np.abs(travelled - gone)))
    # A joint has returned after whole turns if it is this near [rad or m]: a multiple of the tolerance of assembly.
    if abs(travelled[worst] - gone[worst]) > 1e-5:
        joint = mechanism.joints[worst]
        raise ProblemError(
            f"motion.turns of joint {names}: after it joint {joint.name} is not back, it has gone on by"
            f" {joint.said(travelled[worst], 6)} {joint.unit}: give as many turns as bring all joints back"
        )
    _check_efforts(mechanism, names, poses[0], gone)


def _check_efforts(mechanism: Mechanism, names: str, pose: np.ndarray, gone: np.ndarray) -> None:
    """Refuse springs and servos' ranges for which the next turn is another than the last."""
    still = np.zeros(mechanism.n_q)
    before, after = (np.array(mechanism.dynamics.passive(q, still)).ravel() for q in (pose, pose + gone))
    if np.abs(after - before).max() > _SAME_EFFORT_SHARE * max(np.abs(after).max(), np.abs(before).max()):
        joint = mechanism.joints[int(np.argmax(np.abs(after - before)))]
        raise ProblemError(f"motion.turns of joint {names}: a spring on joint {joint.name} winds up with every turn")
    rest, nothing = np.zeros((1, mechanism.dof)), np.zeros((1, mechanism.n_u))
    ctrl, later = (needed_controls(mechanism, q[None], rest, nothing)[0] for q in (pose, pose + gone))
    for actuator, x, y in zip(mechanism.actuators, ctrl, later, strict=True):
        if actuator.limits_control and abs(y - x) > _SAME_EFFORT_SHARE * max(abs(x), abs(y)):
            raise ProblemError(
                f"motion.turns of joint {names}: the ctrl of servo {actuator.name} goes on by {y - x:.4g} with them and"
                f" has a ctrlrange of {actuator.control_lower:g} to {actuator.control_upper:g}"
            )
