"""From a planning problem to a certified plan: attempts, then the reason if there is no motion; the price of robustness.

The three tables below are the complete strategy, in order. A method is tried within its budget if its condition holds. The
first plan that passes ends the search, unless the phase plane knows a possibly better motion. Repairs are applied to a
motion whose certificate fails, before the next method. Diagnoses give the reason why there is no motion, and never return
one. A new method is one function, `(Search, Budget) -> Plan | None`, and one row.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

from msgspec import Struct

from linkplan.models.deadline import ONE_THREAD, OutOfTimeError
from linkplan.planner.closed_chain.case import plan_hold, plan_prescribed
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import out_of_time
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import share_gained
from linkplan.planner.refinement.history import Say, progress, recorded, recording, silent
from linkplan.planner.refinement.state import REPORTED_CHANGE
from linkplan.planner.search import attempts, reasons, starts, waiting, without_solver
from linkplan.planner.search.attempts import of_several
from linkplan.planner.search.methods import FULL_BUDGET, SHORT_BUDGET, Budget, Repair, Search, SearchMethod, run_search
from linkplan.planner.search.multistart import from_several_starts
from linkplan.planner.search.site_path import plan_along_path
from linkplan.planner.search.solving import longest

__all__ = ["DIAGNOSES", "REPAIRS", "SEARCH_METHODS", "Say", "plan_motion", "silent"]
# The key of the nominal plan's objective in a plan's details, in the objective's SI unit.
_DETAIL = "objective_as_modelled"


def _leaves_time_to_wait(search: Search) -> bool:
    """True if several driven coordinates may rest: the refinement of a swing-up's first start may use up all the time."""
    return search.problem.mechanism.dof > 1 and waiting.may_wait(search)


def _is_worth_a_start(search: Search) -> bool:
    """True if the first starts are tried one after another; False for several motors, whose own search has tried them."""
    return starts.one_start_is_worth_it(search) and not of_several(search.problem)


def _swings_are_worth_it(search: Search) -> bool:
    """True if swings may lead to a motion in the given time."""
    if not starts.one_start_is_worth_it(search) or starts.no_time(search):
        return False
    return not (of_several(search.problem) and starts.is_too_short(search))


def _legs_may_help(search: Search) -> bool:
    """True if no plan passes, and the phase plane knows a motion to the goal, or the motion is a turn without damping."""
    if search.solved or search.quickest is None:
        return not search.solved and search.problem.motion.turns is not None
    return search.quickest.duration_s <= longest(search.problem)


SEARCH_METHODS: tuple[SearchMethod, ...] = (
    SearchMethod(
        name="the phase plane along its limits",
        tried=starts.may_be_along_limits,
        run=starts.along_limits,
        budget=SHORT_BUDGET,
    ),
    SearchMethod(
        name="several starts: cheap first solves, the best refined",
        tried=lambda search: of_several(search.problem) or search.problem.solver.starts > 1,
        run=from_several_starts,
        budget=Budget(share_of_time=0.85),
    ),
    SearchMethod(
        name="the user's guess, then a smooth path",
        tried=_is_worth_a_start,
        run=starts.from_first_starts,
        budget=FULL_BUDGET,
        shares_time=_leaves_time_to_wait,
    ),
    SearchMethod(
        name="the phase plane: dynamic programming, then bang efforts",
        tried=starts.phase_plane_may_help,
        run=starts.from_the_phase_plane,
        budget=SHORT_BUDGET,
    ),
    SearchMethod(
        name="the cheapest legs of the phase plane, if meshes over time led to false motions",
        tried=lambda search: bool(search.plans) and _legs_may_help(search),
        run=without_solver.from_legs,
        budget=SHORT_BUDGET,
    ),
    SearchMethod(
        name="at a distance from singular poses",
        tried=starts.may_near_singular,
        run=starts.at_a_distance,
        budget=FULL_BUDGET,
    ),
    SearchMethod(
        name="swings",
        tried=_swings_are_worth_it,
        run=starts.from_swings,
        budget=SHORT_BUDGET,
        shares_time=_leaves_time_to_wait,
    ),
    SearchMethod(
        name="the least time, and waiting",
        tried=lambda search: waiting.may_wait(search) and (not search.solved or starts.swings_may_be_better(search)),
        run=waiting.from_waiting,
        budget=FULL_BUDGET,
    ),
    SearchMethod(
        name="the cheapest legs of the phase plane",
        tried=_legs_may_help,
        run=without_solver.from_legs,
        budget=SHORT_BUDGET,
    ),
)

REPAIRS: tuple[Repair, ...] = (
    Repair(
        name="limits satisfied at every instant, by rows on coefficients",
        tried=attempts.may_be_enclosed,
        repair=attempts.enclosed,
    ),
    Repair(
        name="finer meshes started near the coarser solution",
        tried=lambda _problem, plan: attempts.unsound(plan),
        repair=attempts.from_next_to_it,
        always=False,
    ),
)

Diagnosis = Callable[[Search], Plan | None]
# In this order: the first diagnosis that applies gives the reason.
DIAGNOSES: tuple[Diagnosis, ...] = (
    reasons.solver_stopped,
    reasons.one_limit,
    reasons.efforts_contradicted,
    reasons.efforts_without_proof,
    reasons.efforts,
    reasons.efforts_without_other_limits,
    reasons.one_last_limit,
    reasons.efforts_by_the_phase_plane,
    reasons.less_than_least_time,
    reasons.nothing_found,
)


def plan_motion(
    problem: Problem,
    say: Say = silent,
    methods: Sequence[SearchMethod] = SEARCH_METHODS,
    diagnoses: Sequence[Diagnosis] = DIAGNOSES,
) -> Plan:
    """Return the plan of a problem; `message` gives the reason if it has no motion.

    Args:
        problem: the problem; `solver.max_time_s` limits the whole of planning.
        say: called with lines on the progress.
        methods: the attempts, in order.
        diagnoses: the searches for the reason why there is no motion, in order; the last one has a reason for every problem.

    Raises:
        ProblemError: if start, goal or reference contradict the mechanism.
    """
    plans: list[Plan] = []
    with ONE_THREAD, recording(_with_the_best(say, plans)):
        begun = problem.varied(solver=problem.solver.begun())  # the deadline starts after any wait for another thread
        try:
            plan = _planned(begun, methods, diagnoses, plans)
        except OutOfTimeError:
            plan = Plan(problem=problem, verdict=out_of_time(problem.solver.max_time_s), history=recorded())
    return replace(plan, problem=problem)


def search_for(
    problem: Problem, methods: Sequence[SearchMethod] = SEARCH_METHODS, plans: list[Plan] | None = None
) -> Search:
    """Return the search for a problem's motion, whose plans are appended to `plans`.

    Raises:
        ProblemError: if the problem's start contradicts the mechanism.
    """
    plans = [] if plans is None else plans
    return Search(problem=problem, start_pose=problem.start_pose(), methods=methods, repairs=REPAIRS, plans=plans)


def _planned(problem: Problem, methods: Sequence[SearchMethod], diagnoses: Sequence[Diagnosis], plans: list[Plan]) -> Plan:
    """Return the plan of a problem with a deadline; plans of the methods are appended to `plans`.

    Raises:
        OutOfTimeError: if the deadline passes before any result.
    """
    if problem.motion.kind == "track":
        return plan_prescribed(problem, problem.start_pose())
    if problem.path is not None:
        return plan_along_path(problem, problem.start_pose(), lambda guided: _planned(guided, methods, diagnoses, plans))
    search = search_for(problem, methods, plans)
    plan = reasons.contradicted(search) or reasons.too_short(search)
    if plan is None and problem.motion.kind == "hold":
        plan = plan_hold(problem)
    elif plan is None:
        plan = rest = without_solver.at_rest(search) if problem.motion.stays else None
        if rest is None or rest.status != "optimal":
            plan = _or_simpler(search, run_search(search), rest)
    if plan is not None and plan.status == "failed" and reasons.less_than_least_time in diagnoses:
        with contextlib.suppress(OutOfTimeError):
            return reasons.less_than_least_time(search) or plan
    return plan or _diagnosed(search, diagnoses)


def _or_simpler(search: Search, plan: Plan | None, rest: Plan | None) -> Plan | None:
    """Return a plan of the methods, or a rest unless it costs more; if neither is sound, the smooth path, or None.

    An optimal plan is locally optimal unless the phase plane proves more. A rest that costs as much as an optimal
    plan is that plan's motion without the solver's rounding.
    """
    if plan is not None and plan.status == "optimal" and starts.judged_by_the_phase_plane(search)[0]:
        plan = plan.adding(is_global=True, known_by="phase plane")
    sound = plan if plan is not None and plan.passed else None
    if sound is not None and (rest is None or _costs_less(sound, rest)):
        return sound
    if rest is not None:
        same = sound is not None and sound.status == "optimal"
        return replace(rest, verdict=rest.verdict.replace(kind="optimal", further=())) if same else rest
    smooth = None
    with contextlib.suppress(OutOfTimeError):
        if plan is not None and plan.certificate is not None and plan.certificate.is_carried and plan.trajectory is not None:
            smooth = without_solver.slower(search.problem, [plan.trajectory])  # its mesh errs by a little effort
        smooth = smooth or without_solver.along_smooth_path(search)
    return smooth or plan


def _costs_less(plan: Plan, rest: Plan) -> bool:
    assert plan.objective is not None
    assert rest.objective is not None
    return share_gained(rest.objective, plan.objective) > REPORTED_CHANGE


def _with_the_best(say: Say, plans: Sequence[Plan]) -> Say:
    """Return a progress function that appends the objective of the best passing plan so far."""

    def say_with_best(text: str) -> None:
        passed = [plan.objective for plan in plans if plan.passed and plan.objective is not None]
        say(f"{text}; best certified {min(passed):.6g}" if passed else text)

    return say_with_best


def _diagnosed(search: Search, diagnoses: Sequence[Diagnosis]) -> Plan:
    """Return the plan with the reason why no motion was found."""
    progress("no motion found; searching for the limit that forbids one")
    with contextlib.suppress(OutOfTimeError):
        return next(plan for diagnosis in diagnoses if (plan := diagnosis(search)) is not None)
    return reasons.nothing_found(search)


class Price(Struct, frozen=True, kw_only=True):
    """The objectives of a plan with a reserve or corners and of the nominal plan, in the objective's unit."""

    objective: float
    nominal: float
    unit: str
    name: str

    @property
    def share(self) -> float:
        """The relative increase of the objective over the nominal one."""
        return self.objective / self.nominal - 1 if self.nominal else float("inf")

    def sentence(self) -> str:
        """Return the price as a sentence."""
        unit = f" {self.unit}" if self.unit else ""
        dearer = f"{100 * round(self.share, 9):+.3g} %" if self.share < 2.0 else f"{1 + self.share:.3g} times as much"
        return (
            f"price of robustness: {self.name} {self.objective:.6g}{unit} against {self.nominal:.6g}{unit} of the nominal"
            f" machine within its full limits, {dearer}"
        )


def nominal_of(problem: Problem) -> Problem | None:
    """Return a problem without its ranges and its reserve; None if it has neither."""
    has_either = problem.robust.corners or problem.limits.reserve
    return problem.replace(robust=None, reserve=None) if has_either else None


def price_of(plan: Plan, say: Callable[[str], None] = silent) -> Price | None:
    """Return the price of a plan's ranges and reserve; None if it has none, or one of the two plans has no motion."""
    nominal = nominal_of(plan.problem) if plan.trajectory is not None else None
    if nominal is None:
        return None
    say("plan of the nominal machine, for the price of robustness")
    cheaper = plan_motion(nominal, say)
    if cheaper.trajectory is None or cheaper.objective is None or plan.objective is None:
        return None
    # The plan itself is a motion of the nominal machine, so the nominal optimum cannot cost more.
    return _price(plan, min(cheaper.objective, plan.objective))


def with_price(plan: Plan, price: Price | None) -> Plan:
    """Return a plan with its price in the details, which are saved."""
    return plan if price is None else replace(plan, details={**plan.details, _DETAIL: price.nominal})


def saved_price(plan: Plan) -> Price | None:
    """Return the price in a plan's details; None if there is none."""
    nominal = plan.details.get(_DETAIL)
    if plan.objective is None or not isinstance(nominal, int | float):
        return None
    return _price(plan, float(nominal))


def _price(plan: Plan, nominal: float) -> Price:
    problem = plan.problem
    assert plan.objective is not None  # the price of a motion that passes
    return Price(objective=plan.objective, nominal=nominal, unit=problem.objective_unit, name=problem.objective.name)
