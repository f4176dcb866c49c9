"""The jumps of efforts and jerks of motions of several motors, which become ends of segments with unknown durations."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.assembly import follow
from linkplan.planner.closed_chain.case import MechanismCase
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.limits.rates import smooth_columns
from linkplan.planner.limits.samples import actuator_speeds
from linkplan.planner.refinement.case import Iterate
from linkplan.planner.refinement.constrained_arcs import arc_ends, own_arcs
from linkplan.planner.trajectory import Trajectory

# An effort jumps where its place within the permitted range changes by more than this share from one interval to the next
# but one. The jump costs about the square of the interval's share of the motion; if this is below the second share, the jump
# does not become an unknown.
_JUMP_SHARE, _WORTH_AN_UNKNOWN = 0.4, 1e-4
# Largest number of jumps that are unknowns, per interval. With all 35 jumps of an open chain of twelve motors on 24
# intervals, the least time took 44 s instead of 30 and was no better.
_MOST_JUMPS = 0.9


def jumps_of(case: MechanismCase, found: Iterate) -> np.ndarray:
    """Return the increasing times (n,) [s] at which efforts or limited jerks jump, or at which arcs along limits end.

    The limits are those on speed, acceleration, jerk and power.
    """
    if case.problem.mechanism.forces is not None:  # whose instants are fixed
        return np.zeros(0)
    motion, jumps = found.motion, effort_jumps(case, found.motion)
    arcs = own_arcs(found.solution.transcribed, found.solution.x, ("speed", "acceleration", "jerk", "power"))
    ends = arc_ends(arcs, motion.breaks_s, jumps, motion.breaks_s[found.mesh.boundaries()])
    every = np.concatenate([jumps, ends, _jerk_jumps(case, motion)])
    return apart(np.sort(every), motion.breaks_s[[0, -1]], motion)


def _jerk_jumps(case: MechanismCase, motion: Trajectory) -> np.ndarray:
    """Return the times (n,) [s] at which jerks jump, increasing: a site's turns about while its size stays at the limit."""
    columns = list(smooth_columns(case.problem))
    if not columns or case.problem.objective.has("jerk"):
        return np.zeros(0)
    mean = np.diff(motion.acceleration_at(motion.breaks_s)[:, columns], axis=0) / np.diff(motion.breaks_s)[:, None]
    return _jumps(mean / np.maximum(np.ptp(mean, axis=0), 1e-300), motion)


def effort_jumps(case: MechanismCase, motion: Trajectory) -> np.ndarray:
    """Return the times (n,) [s] at which efforts jump between intervals or inside one, increasing.

    The impulse of an interval gives the instant at which an effort changes from its previous mean to its next one.
    """
    objective = case.asked.objective
    if objective.efforts("bend") or objective.efforts("smooth") or not objective.efforts("jump"):
        return np.zeros(0)
    mean = motion.effort.mean(axis=0)  # of Bernstein coefficients: that of the polynomial
    low, high = np.moveaxis(effort_bounds(case.asked, _middle_speeds(case, motion)), 2, 0)
    is_limited = np.isfinite(low) & np.isfinite(high) & (high > low)
    level, size = np.where(is_limited, mean - low, mean), np.where(is_limited, high - low, np.ptp(mean, axis=0))
    return _jumps(level / np.maximum(size, 1e-300), motion)


def _middle_speeds(case: MechanismCase, motion: Trajectory) -> np.ndarray:
    """Return the actuators' speeds (n_intervals, n_u) at the middles of intervals; zeros if the loops open there."""
    middles = 0.5 * (motion.breaks_s[:-1] + motion.breaks_s[1:])
    try:
        poses = follow(case.asked.mechanism, motion.position_at(middles), motion.start_pose)
    except AssemblyError:
        return np.zeros((len(middles), motion.effort.shape[2]))
    return actuator_speeds(case.asked, poses, motion.velocity_at(middles))


def _jumps(level: np.ndarray, motion: Trajectory) -> np.ndarray:
    """Return the increasing times (n,) [s] at which a column of the intervals' means (n_intervals, m) jumps.

    Of too many jumps, those with the largest cost are returned.
    """
    breaks, found = motion.breaks_s, []
    widths = np.diff(breaks) / motion.duration_s
    for column in level.T:
        k = 1
        while k < len(column) - 1:
            before, after = column[k - 1], column[k + 1]
            if abs(after - before) <= _JUMP_SHARE or widths[k] ** 2 * abs(after - before) <= _WORTH_AN_UNKNOWN:
                k += 1
                continue
            share = float(np.clip((column[k] - after) / (before - after), 0.0, 1.0))
            cost = widths[k] ** 2 * abs(after - before) * share * (1 - share)
            found.append((float(cost), float(breaks[k] + share * (breaks[k + 1] - breaks[k]))))
            k += 2
    dearest = sorted(found, reverse=True)[: int(_MOST_JUMPS * len(widths))]
    return apart(np.array(sorted(time for _, time in dearest)), breaks[[0, -1]], motion)


def apart(times: np.ndarray, from_these: np.ndarray, motion: Trajectory) -> np.ndarray:
    """Return the times at a distance of at least a tenth of a mean interval from each other and from the given others."""
    least = 0.1 * motion.duration_s / (len(motion.breaks_s) - 1)
    kept: list[float] = []
    for time in times:
        others: Sequence[float] = [*from_these, *kept]
        if min(abs(time - other) for other in others) > least:
            kept.append(float(time))
    return np.array(kept)
