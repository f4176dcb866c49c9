"""The shortest feasible duration of a motion, found by planning a motion of least time."""

import numpy as np

from linkplan.planner.search.durations import longest
from linkplan.planner.search.ladder import Search
from linkplan.planner.search.least_time import shortest_motion


def shortest_sentence(search: Search, details: dict[str, float]) -> str:
    """Return a phrase on the shortest feasible duration, if it can be found, and add its value to the details."""
    problem, motion = search.problem, search.problem.motion
    if motion.kind != "reach" or motion.stays or not np.isfinite(longest(problem)):
        return ""
    if any(w.time_s is not None for w in motion.waypoints) or not np.all(np.isfinite(problem.limits.effort)):
        return ""
    quickest = shortest_motion(search)
    if quickest is None:
        return ""
    details["shortest_duration_s"] = quickest.trajectory.duration_s
    return f"; the shortest feasible duration is {quickest.trajectory.duration_s:.5g} s"
