"""The shortest feasible duration of a motion between two states: the same ladder, asked for a motion of least time."""

from dataclasses import replace

import numpy as np

from linkplan.planner.search.ladder import HURRIED, PATIENT, Rung, Search, climb
from linkplan.planner.search.starts import from_a_smooth_path, from_the_phase_plane

# Rungs that look for it.
_RUNGS = (
    Rung(name="a smooth path", climb=from_a_smooth_path, budget=PATIENT),
    Rung(
        name="the phase plane",
        tried=lambda search: search.starts_are_worth_it and search.quickest is not None,
        climb=from_the_phase_plane,
        budget=HURRIED,
    ),
)


def shortest_sentence(search: Search, details: dict[str, float]) -> str:
    """Return the words on the shortest feasible duration, where it can be found; its figure goes into the details."""
    problem, motion = search.problem, search.problem.motion
    if motion.kind != "reach" or motion.duration_s is None or motion.stays:
        return ""
    if any(w.time_s is not None for w in motion.waypoints) or not np.all(np.isfinite(problem.limits.effort)):
        return ""
    search.say("looking for the shortest feasible duration")
    free = replace(search.within(PATIENT), objective="time", motion=replace(motion, duration_s=None))
    quickest = climb(search.of_another(free), _RUNGS)
    if quickest is None or quickest.status != "optimal":
        return ""
    details["shortest_duration_s"] = quickest.trajectory.duration_s
    return f"; the shortest feasible duration is {quickest.trajectory.duration_s:.5g} s"
