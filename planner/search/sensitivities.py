"""How much an optimum's objective changes with the numbers of its machine: by one per cent, and by a tolerance."""

from collections.abc import Callable
from dataclasses import replace

from msgspec import Struct

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import guess_from
from linkplan.planner.closed_chain.sensitivity import parameter_slopes
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import silent
from linkplan.planner.search.jumps import effort_jumps
from linkplan.planner.search.solving import graded_mesh, solve_from
from linkplan.planner.solvers.solve import Solution, build_solver, run_solver

# A slope [SI] is in the details of a plan, which are saved, under the parameter's name after these words.
_DETAIL = "slope by "
# Objectives of a plan and of the program whose multipliers are used agree to this share.
_SAME_SHARE = 1e-5


class Sensitivity(Struct, frozen=True, kw_only=True):
    """The slope of an optimum's objective by a number of the machine, in the objective's unit per unit of the number."""

    name: str
    unit: str
    value: float
    slope: float
    by_one_percent: float  # change of the objective by one per cent more of the number
    by_tolerance: float | None  # change by the number's tolerance, of either sign; None without a tolerance


def with_sensitivities(plan: Plan, say: Callable[[str], None] = silent) -> Plan:
    """Return a plan with the slopes of its objective by the parameters of its mechanism in its details.

    A plan without them gets a phrase with the reason: it is no optimum, or its multipliers are not known.
    """
    say("slopes of the objective by the parameters")
    if plan.problem.path is not None:  # the program of the guided mechanism has numbers in place of its parameters
        return plan.adding("no sensitivities: along a path the numbers of the machine are constants of the program")
    solution = _solution(plan) if plan.status == "optimal" else None
    if solution is None:
        why = "it is no optimum" if plan.status != "optimal" else "no program with its objective and multipliers was found"
        return plan.adding(f"no sensitivities: {why}")
    parameters, slopes = plan.problem.mechanism.parameters, parameter_slopes(solution)
    fixed = _has_fixed_places(plan.problem, solution)
    left = [one.name for one in parameters if fixed and one.moves_pins]
    known = {one.name: float(x) for one, x in zip(parameters, slopes, strict=True) if one.name not in left}
    plan = replace(plan, details={**plan.details, **{f"{_DETAIL}{name}": slope for name, slope in known.items()}})
    if not left:
        return plan
    return plan.adding(f"no slopes by {', '.join(left)}: ends or limits at sites, or jerks, change with them")


def sensitivities_of(plan: Plan) -> list[Sensitivity]:
    """Return the slopes in a plan's details, by the largest change of the objective first; empty without any."""
    known = {one.name: one for one in plan.problem.mechanism.parameters}
    tolerances = plan.problem.tolerances
    found = []
    for key, slope in plan.details.items():
        one = known.get(key.removeprefix(_DETAIL)) if key.startswith(_DETAIL) else None
        if one is None:
            continue
        by = abs(slope) * tolerances[one.name][0] if one.name in tolerances else None
        percent = slope * one.value / 100
        found.append(
            Sensitivity(name=one.name, unit=one.unit, value=one.value, slope=slope, by_one_percent=percent, by_tolerance=by)
        )
    return sorted(found, key=lambda one: -max(abs(one.by_one_percent), one.by_tolerance or 0.0))


def _has_fixed_places(problem: Problem, solution: Solution) -> bool:
    """Return whether a program contains places and jerks of the nominal machine, which move with its pins."""
    has_jerk = solution.transcribed.formulation.build_system().has_jerk
    motion, limits = problem.motion, problem.limits
    at_sites = (*limits.site, *limits.site_speed, *limits.site_acceleration, *limits.site_jerk)
    return has_jerk or any((motion.tasks, at_sites, limits.body, problem.tracked_bodies, problem.extras))


def _solution(plan: Plan) -> Solution | None:
    """Return the solution of a program at a plan's motion, with multipliers; None without one of the same objective."""
    problem, motion = plan.problem, plan.trajectory
    assert motion is not None
    assert plan.objective is not None
    if plan.solved is not None:
        solver = build_solver(plan.solved.program, problem.solver, warm=True, close=True)
        found = run_solver(solver, plan.solved)
    else:
        guess = guess_from(motion)
        mesh, durations = graded_mesh(guess, effort_jumps(case_of(problem), motion), problem.mesh.intervals)
        again = solve_from(problem, guess, mesh, durations, "for the multipliers of the motion", warm=True)
        if again is None:
            return None
        found = again.solution
    near = abs(found.objective - plan.objective) <= _SAME_SHARE * abs(plan.objective)
    return found if found.converged and near and found.multipliers is not None else None
