"""The rung at a distance from singular poses: a search within a margin to them that was not asked for.

A linkage may swing up to a dead centre, where its actuator holds or turns it the more easily the nearer it comes. No motion
is the best then: its cost falls with the margin, down to a motion that leaves the branch. A crank that turns fully may pass
a pose that is nearly singular: a coarse mesh steps over it onto the other branch. In both cases solvers are lost, and within
a margin they find the best motion.
"""

from collections.abc import Sequence
from dataclasses import replace

from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.plan import Plan
from linkplan.planner.search.attempts import only_feasible
from linkplan.planner.search.ladder import Search, climb
from linkplan.planner.search.presolve import only_way
from linkplan.planner.search.rungs import Budget, Rung
from linkplan.planner.search.starts import no_time, other_limits


def may_near_singular(search: Search) -> bool:
    """True if no plan passes, though the phase plane knows a motion and loops may come near a singular pose."""
    problem = search.problem
    # Plans that failed do not exclude this rung: they may have left the branch at a nearly singular pose.
    if search.solved or problem.solver.starts > 1 or problem.limits.singular_margin or problem.guess is not None:
        return False
    if search.quickest is None or other_limits(problem) or no_time(search):
        return False
    return len(problem.mechanism.dependent) > 0


def at_a_distance(search: Search, budget: Budget, rungs: Sequence[Rung[Search]]) -> Plan | None:
    """Return the best plan that keeps a margin to singular poses; None if the rungs find none.

    One that is optimal within the margin is "feasible" where it is next to it.
    """
    problem = search.within(budget)
    way = only_way(problem)
    if way is None:
        return None
    # The least |det J_z| relative to home: a quarter of it may lose the motion, more of it costs more. All poses between
    # start and goal keep half of what they have.
    margin = min(0.02, 0.5 * float(singularity_ratios(problem, way).min()))
    limits = replace(problem.limits, singular_margin=margin)
    plan = climb(search.of_another(replace(problem, limits=limits)), rungs)
    if plan is None or not plan.passed:
        return None
    found = replace(plan, problem=search.problem)
    # A margin is met within a hundredth of it.
    if plan.status == "feasible" or plan.certificate.singularity_ratio > 1.01 * margin:
        return found
    why = f"; it keeps {margin:.3g} of the home pose's distance from singular poses, nearer to them it may cost less"
    return only_feasible(found, why)
