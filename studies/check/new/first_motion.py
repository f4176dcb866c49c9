"""A first motion of a mechanism: start, goal and plan within its reach, away from singular poses and contacts."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from linkplan.models.deadline import Deadline
from linkplan.models.errors import LinkplanError, ProblemError, listed, one_line
from linkplan.models.kinematics import STIFF
from linkplan.models.library import compiled_once
from linkplan.models.mechanism import Mechanism
from linkplan.planner.certificate.further_checks import contact_notes
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Say
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.reasons import nothing_found
from linkplan.studies.check.new.candidates import gains_table, motions_of_all_homes, moves_of, tables_at_home
from linkplan.studies.check.new.changes import (
    changed_mechanism,
    left_out_notes,
    not_on_ground,
    overlap_sentence,
    raised_notes,
    with_exclusions,
)
from linkplan.studies.check.new.clear_way import refuse_undriven, why_not
from linkplan.studies.check.new.hanging import is_large
from linkplan.studies.check.softness import SOFT_GAP, SOFT_IN_MOTION, planned_gap, travel

# Processor time [s] for all motions, the share of the rest that each motion gets, and the least time for a motion.
_TIME_BUDGET_S, _TIME_SHARE, _MIN_SOLVE_S = 40.0, 0.3, 1.0
# The least processor time [s] in which planning looks for a better motion than the smooth path.
_MIN_SEARCH_S = 5.0
_OTHER_HOME = (
    "the motion starts from another home than the model's, in which undriven joints hang at rest or driven ones are in the"
    " middle of their reach (mechanism.home_deg, home_m)"
)
_SHUT = "every straight path from home is blocked by a singular pose, a joint's range, a contact or too large a weight"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FirstMotion:
    """A first problem: its mechanism, its tables, and its plan, None if no plan was found."""

    mechanism: Mechanism
    tables: dict[str, dict]
    plan: Plan | None
    why: str  # the reason why there is no plan, else ""
    changes: tuple[str, ...]  # a sentence on each change of the model

    @property
    def description(self) -> str:
        """The problem in a few words."""
        motion = self.tables["motion"]
        duration = motion["duration_s"]
        within = f" in {duration:g} s" if duration != "free" else ""
        least = "effort" if self.tables["objective"]["minimize"] == "effort" else "change of effort"
        moves = listed(moves_of(motion), 3) or "no motion"
        return f"{self.mechanism.name}: {moves}{within}, from rest to rest with least {least}"

    @property
    def changed(self) -> list[str]:
        """A sentence on each change of the model."""
        return [*self.changes, *raised_notes(self.mechanism, self.tables), *left_out_notes(self.mechanism)]

    @property
    def notes(self) -> list[str]:
        """A sentence on each change of the model, and on each overlap by construction that the motion ignores."""
        certificate = None if self.plan is None else self.plan.certificate
        return [*self.changed, *(() if certificate is None else contact_notes(certificate.contacts))]

    @property
    def planned(self) -> bool:
        """Whether a motion that passes its certificate was found."""
        return self.plan is not None and self.plan.passed


@compiled_once()
def first_motion(table: Mapping[str, object], say: Say) -> FirstMotion:
    """Return a feasible problem of a mechanism, with its plan.

    Each motion gets a share of the remaining time budget.

    Args:
        table: the [mechanism] table: its model (a built-in name or a path to an MJCF file) and the selected part of it.
        say: called with lines on the progress.

    Raises:
        ModelError: if the model cannot be used.
        ProblemError: if no actuator drives the mechanism; the text has an actuator to add.
    """
    mechanism, changes = changed_mechanism(table)
    refuse_undriven(mechanism)
    tables = tables_at_home(mechanism)
    first = FirstMotion(mechanism=mechanism, tables=tables, plan=None, why=_SHUT, changes=changes)
    try:
        Problem.from_tables(mechanism.name, tables, mechanism=mechanism)
    except ProblemError as error:
        first = replace(first, why=one_line(error))
    deadline, obstacles, took_s = Deadline().within(_TIME_BUDGET_S), Counter(), 0.0
    for moving, tables in motions_of_all_homes(mechanism, say, obstacles):
        left = deadline.left_s
        if left < max(_MIN_SOLVE_S, took_s):  # the certificate of a large robot takes more than its share
            break
        limit = max(_MIN_SOLVE_S, _TIME_SHARE * left)
        first = replace(first, mechanism=moving, tables=tables, plan=None)
        try:
            problem = Problem.from_tables(moving.name, tables | {"solver": {"max_time_s": limit}}, mechanism=moving)
            # The smooth path is usually feasible for a large robot, so it is tried first. If its certificate takes all the
            # time, none is left for a search.
            until = Deadline().within(limit)
            answer = plan_motion(problem, say, (), (nothing_found,)) if is_large(moving) else None
            answer = plan_motion(problem, say) if answer is None or not (answer.passed or until.passed) else answer
        except LinkplanError as error:
            first = replace(first, why=one_line(error))
            continue
        took_s = left - deadline.left_s
        late = answer.verdict.out_of_time or took_s > 0.95 * limit  # planning stops early
        why = "" if answer.passed else why_not(answer, _TIME_BUDGET_S if late else None)
        notes = changes if moving is mechanism else (*changes, _OTHER_HOME)
        first = replace(first, plan=answer, why=why, changes=notes)
        if first.planned:
            return _stiffened(_without_contacts(_with_brief_search(first, answer, took_s), answer))
    if obstacles and first.why == _SHUT:
        first = replace(
            first,
            why=f"every straight path from home is blocked; the most frequent reason: {obstacles.most_common(1)[0][0]}",
        )
    return first


def _with_brief_search(first: FirstMotion, plan: Plan, took_s: float) -> FirstMotion:
    """Limit the planning time of a first motion's problem if its plan, which took a time [s], is the smooth path.

    The limit is at least twice this time, because planning might otherwise end before the certificate.
    """
    if plan.solved is not None:
        return first
    limit = max(_MIN_SEARCH_S, float(np.ceil(2 * took_s)))
    note = (
        f"the smooth path satisfies every limit: planning searches for a better motion for at most {limit:g} s of processor"
        " time (solver.max_time_s)"
    )
    tables = first.tables | {"solver": {"max_time_s": limit}}
    return replace(first, tables=tables, changes=(*first.changes, note))


def _without_contacts(first: FirstMotion, plan: Plan) -> FirstMotion:
    """Return a first motion without the contacts of links that overlap by construction; plans have no contact forces."""
    contacts = () if plan.certificate is None else plan.certificate.contacts
    pairs = not_on_ground(meeting for meeting in contacts if meeting.since_s is None)
    if not pairs or plan.certificate is None:
        return first
    left = tuple(meeting for meeting in plan.certificate.contacts if list(meeting.bodies) not in pairs)
    plan = replace(plan, certificate=structs.replace(plan.certificate, contacts=left))
    return _with_table(first, plan, with_exclusions(first.tables["mechanism"], pairs), overlap_sentence(pairs))


def _stiffened(first: FirstMotion) -> FirstMotion:
    """Return a first motion whose loops are stiff if its own efforts open them in simulation."""
    table, plan = first.tables["mechanism"], first.plan
    if plan is None or "solref" in table or planned_gap(plan) <= SOFT_GAP * travel(plan):
        return first
    return _with_table(first, plan, {**table, "solref": STIFF}, SOFT_IN_MOTION)


def _with_table(first: FirstMotion, plan: Plan, table: dict, note: str) -> FirstMotion:
    """Return a first motion with another [mechanism] table, with which its plan remains valid, and a note on the change."""
    tables = first.tables | {"mechanism": table}
    mechanism = mechanism_from_tables(tables)
    problem = Problem.from_tables(mechanism.name, tables, mechanism=mechanism)
    tables["tracking"] = gains_table(problem)
    changes = (*first.changes, note)
    return replace(first, mechanism=mechanism, tables=tables, plan=replace(plan, problem=problem), changes=changes)
