"""The method of waiting: the motion of least time, or a slightly slower one, with a rest before or after it.

It is feasible if the given duration is longer and start or goal can be held at rest.
"""

import itertools
from dataclasses import replace

import numpy as np

from linkplan.planner.certificate.further_checks import objective_value
from linkplan.planner.closed_chain.guess import guess_from, stretched
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.kinds import MIN_INTERVAL_SHARE
from linkplan.planner.search.attempts import certified, without_solving
from linkplan.planner.search.methods import Budget, Search
from linkplan.planner.search.solving import solve_from
from linkplan.planner.search.starts import shortest_motion
from linkplan.planner.search.without_solver import held, joined

# Terms of an objective to which a rest contributes only by its effort and its length.
_STILL_TERMS = {"time", "effort", "copper_loss"}


def may_wait(search: Search) -> bool:
    """True if a motion of fixed duration starts or ends at rest and efforts within their limits can hold that pose."""
    motion = search.problem.motion
    if motion.kind != "reach" or motion.duration_s is None or motion.stays or motion.waypoints:
        return False
    return any(held(search.problem, end) is not None for end in ("start", "goal"))


def from_waiting(search: Search, budget: Budget) -> Plan | None:
    """Return the cheapest plan of a known motion and a rest; None if no certificate of one passes.

    The known motions are that of least time, and a slightly slower one that costs far less. If the slower one takes the
    whole duration, it needs no rest.
    """
    quick = shortest_motion(search) if set(search.problem.objective.weights) <= _STILL_TERMS else None
    if quick is None:
        return None
    problem = search.within(budget)
    asked = problem.motion.duration_s
    assert asked is not None  # a free duration needs no rest
    if asked - quick.trajectory.duration_s <= MIN_INTERVAL_SHARE * asked:
        return None
    restless = None
    if len(search.known.motions) == 1 and quick.solved is not None:
        longer = _a_little_longer(search, budget, quick)
        if longer is not None and longer.trajectory.duration_s >= (1 - MIN_INTERVAL_SHARE) * asked:
            restless = longer
        elif longer is not None:
            search.known.add(longer.require_motion("wait after"))
    wholes = []
    for end, motion in itertools.product(("start", "goal"), search.known.shorter_than(asked)):
        holding, wait = held(problem, end), asked - motion.duration_s
        if holding is not None and wait > MIN_INTERVAL_SHARE * asked:
            whole = joined(motion, holding.lasting(wait), first=end == "start")
            said = (
                f"motion of {asked:.6g} s: a motion of {motion.duration_s:.6g} s and a rest of {wait:.4g} s"
                f" {'before' if end == 'start' else 'after'} it"
            )
            wholes.append((objective_value(problem, whole)[0], whole, said))
    for objective, whole, said in sorted(wholes, key=lambda one: one[0]):
        if restless is not None and restless.objective <= objective:
            break
        plan = without_solving(problem, whole, objective, said, "a longer motion may be better")
        if plan.passed:
            return plan
    return restless


def _a_little_longer(search: Search, budget: Budget, quick: Plan) -> Plan | None:
    """Return the plan of the best motion in 1.05 times the least time, or in the given time; None if it does not pass."""
    motion, asked = quick.require_motion("lengthen"), search.problem.motion.duration_s
    duration = min(1.05 * motion.duration_s, asked or np.inf)
    problem = search.within(budget)
    # In the transcription with which the least-time motion's certificate passed.
    mesh = problem.mesh.replace(scheme=quick.solved.scheme.name, refine="intervals")
    problem = problem.varied(guess=None, mesh=mesh, motion=replace(problem.motion, duration_s=duration))
    start, mesh = stretched(guess_from(motion), duration), quick.solved.program.mesh
    lengths = np.bincount(mesh.segment, weights=np.diff(motion.breaks_s))
    durations = lengths * duration / lengths.sum()
    what = "the least-time motion with a little more time"
    found = solve_from(problem, start, mesh, durations, what, warm=True)
    plan = None if found is None else certified(problem, found, warm=True, kinks=False)
    return plan if plan is not None and plan.passed else None
