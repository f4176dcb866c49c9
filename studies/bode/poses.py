"""The poses at which a loop is looked at: those asked for, or by default some over the motion or the reach."""

from collections.abc import Mapping, Sequence

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.studies.bode.bode import default_poses
from linkplan.studies.frequency.feedback_loops import require_actuated

# A reference is looked at so many times over its period for the ends of its motion.
_SAMPLES = 181


def loop_poses(
    mechanism: Mechanism,
    problem: PlanningProblem | None,
    effort_limit: np.ndarray,
    asked: Sequence[Mapping[str, float]] = (),
) -> tuple[np.ndarray, str | None]:
    """Return independent positions (n, n_s) [rad or m], and a sentence on how they were chosen where that matters.

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
        return default_poses(mechanism, _motion_range(problem), effort_limit)
    names = [joint.name for joint in mechanism.independent_joints]
    home = dict(zip(names, mechanism.home[mechanism.independent], strict=True))
    for pose in asked:
        wrong = [name for name in pose if name not in names]
        if wrong:
            plural = "s" * (len(names) > 1)
            raise ProblemError(f"a pose names the independent joint{plural} {', '.join(names)}; {wrong[0]} follows")
    return np.array([[{**home, **pose}[name] for name in names] for pose in asked]), None


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
