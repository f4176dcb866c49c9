"""The certified plan of least time for a problem of any duration and objective, which waiting and diagnoses begin with."""

from dataclasses import replace

import numpy as np

from linkplan.planner.plan import Plan
from linkplan.planner.refinement.history import progress, recording
from linkplan.planner.search.ladder import Search, climb
from linkplan.planner.search.margins import at_a_distance, may_near_singular
from linkplan.planner.search.rungs import HURRIED, PATIENT, Rung
from linkplan.planner.search.starts import (
    PHASE_PLANE_LEAST_TIME,
    along_power,
    from_first_starts,
    from_the_phase_plane,
    is_along_power,
    phase_plane_may_help,
)

_FIRST = (
    Rung(
        name="the phase plane along limits on power and pin force", tried=is_along_power, climb=along_power, budget=HURRIED
    ),
    Rung(name="a smooth path", tried=lambda search: not search.solved, climb=from_first_starts, budget=PATIENT),
    Rung(name="the phase plane", tried=phase_plane_may_help, climb=from_the_phase_plane, budget=HURRIED),
)
_RUNGS = (
    *_FIRST,
    Rung(
        name="at a distance from singular poses",
        tried=may_near_singular,
        climb=lambda search, budget: at_a_distance(search, budget, _FIRST),
        budget=PATIENT,
    ),
)


def shortest_motion(search: Search) -> Plan | None:
    """Return the certified plan of least time within a reach's limits; None where it was not found."""
    if not np.all(np.isfinite(search.problem.limits.effort)):  # no time is the least then, and none may be asked for
        return None
    plan = search.known.sought.get(PHASE_PLANE_LEAST_TIME)
    if plan is None or not plan.passed:
        plan = search.known.once("least time by the ladder", lambda: _by_the_ladder(search))
    return plan if plan is not None and plan.passed else None


def _by_the_ladder(search: Search) -> Plan | None:
    motion = replace(search.problem.motion, duration_s=None, min_duration_s=None, max_duration_s=None)
    # Efforts constant over intervals, as least work has them, would be late.
    mesh = replace(search.problem.mesh, effort="polynomial")
    # The share of the remaining time for the motion of least time; the search that uses it needs the rest.
    hurried = search.within(replace(PATIENT, share_of_time=0.5))
    free = replace(hurried, objective="time", motion=motion, mesh=mesh, guess=None)
    progress("looking for the shortest feasible duration")
    with recording():
        return climb(search.of_another(free), _RUNGS)
