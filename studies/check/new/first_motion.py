"""A first motion of a mechanism: start and goal within its reach, away from singular poses and contacts, with a plan."""

import itertools
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from linkplan.models.deadline import Deadline
from linkplan.models.errors import LinkplanError, ModelError, ProblemError, listed, one_line
from linkplan.models.kinematics import STIFF
from linkplan.models.library import compiled_once
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import sprung_freedoms
from linkplan.models.poses.period import turn_of
from linkplan.models.poses.reach import Reach, reach
from linkplan.models.tree.joints import Joint
from linkplan.planner.certificate.further_checks import contact_notes
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.ladder import SHORT_BUDGET, SearchMethod
from linkplan.planner.search.planning import DIAGNOSES, SEARCH_METHODS, plan_motion
from linkplan.planner.search.reasons import nothing_found, solver_stopped
from linkplan.planner.search.smooth_path import along_smooth_path
from linkplan.planner.search.starts import from_first_starts
from linkplan.planner.solvers.solve import OF_TIME
from linkplan.studies.check.new.changes import (
    changed_mechanism,
    left_out,
    left_out_notes,
    overlap_sentence,
    overlapping_bodies,
    raised_limits,
    raised_notes,
    with_exclusions,
)
from linkplan.studies.check.new.clear_way import (
    obstacle_on_way,
    refuse_undriven,
    servos_hold,
    tendons_kept,
    why_not,
    why_stuck,
)
from linkplan.studies.check.new.hanging import (
    at_gravity_equilibrium,
    at_rest,
    driven_columns,
    is_equilibrium,
    rests_by_itself,
    with_home,
)
from linkplan.studies.check.new.loop_gap import SOFT_GAP, SOFT_IN_MOTION, planned_gap, travel
from linkplan.studies.check.new.pace import critical_gains, is_large, many_hang, moderate_duration

Say = Callable[[str], None]
# The shares of the largest first motion that are tried.
_SHARES, _SMALL_FIRST = (1.0, 0.5, 0.25, 0.1), (0.25, 0.1, 0.5, 1.0)
# The mesh where each digit costs seconds: half of what a certificate allows.
_COARSE_MESH = {"intervals": 20, "tolerance_deg": 5e-3}
# Processor time [s] for all motions, and the least time that a motion gets.
_TIME_BUDGET_S, _MIN_SOLVE_S = 40.0, 1.0
# A large robot's smooth path is mostly a motion itself, and most others are found at once from it.
_SMOOTH: tuple[SearchMethod, ...] = (
    SearchMethod(
        name="the smooth path itself",
        tried=lambda search: is_large(search.problem.mechanism),
        run=lambda search, _: along_smooth_path(search),
        budget=SHORT_BUDGET,
    ),
    SearchMethod(name="a smooth path", tried=lambda search: not search.solved, run=from_first_starts, budget=SHORT_BUDGET),
)
_IN_BRIEF = (solver_stopped, nothing_found)  # another motion is tried next: why one was not found does not matter yet
_OTHER_HOME = (
    "the motion begins at another home than the model's, where undriven joints hang at rest or the driven ones are in the"
    " middle of their reach (mechanism.home_deg, home_m)"
)
_SHUT = "every straight way from home is shut: by a singular pose, a joint's range, a contact or too great a weight"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FirstMotion:
    """A first problem: its mechanism, its tables, and its plan, None if no plan was found."""

    mechanism: Mechanism
    tables: dict[str, dict]
    plan: Plan | None
    why: str  # the reason why there is no plan, else ""
    changes: tuple[str, ...]  # sentences on what was changed of the model

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
        """A sentence on each change of the model, and on each contact by construction that the motion ignores."""
        certificate = None if self.plan is None else self.plan.certificate
        return [*self.changed, *(() if certificate is None else contact_notes(certificate.contacts))]

    @property
    def planned(self) -> bool:
        """Whether a motion was found that passes its certificate."""
        return self.plan is not None and self.plan.passed


@compiled_once()
def first_motion(table: Mapping[str, object], say: Say) -> FirstMotion:
    """Return a feasible problem of a mechanism, with its plan.

    Each motion gets at most half of the remaining time budget; at first, all motions are tried for a short time.

    Args:
        table: the [mechanism] table: its model, a built-in name or a path to an MJCF file, and what is selected of it.
        say: called with lines on the progress.

    Raises:
        ModelError: if the model cannot be used.
        ProblemError: if no actuator drives the mechanism; the text has an actuator to add.
    """
    mechanism, changes = changed_mechanism(table)
    refuse_undriven(mechanism)
    tables = _tables(mechanism, *_ends(mechanism, 0.0, 1))
    found = FirstMotion(mechanism=mechanism, tables=tables, plan=None, why=_SHUT, changes=changes)
    try:
        Problem.from_tables(mechanism.name, tables, mechanism=mechanism)
    except ProblemError as error:
        found = replace(found, why=one_line(error))
    deadline, obstacles = Deadline().within(_TIME_BUDGET_S), Counter()
    tried: list[tuple[Mechanism, dict[str, dict]]] = []
    for methods in (_SMOOTH, SEARCH_METHODS):
        for moving, tables in tried if methods is SEARCH_METHODS else _of_all_homes(mechanism, say, obstacles):
            left = deadline.left_s
            if left < _MIN_SOLVE_S:
                return found
            if methods is _SMOOTH:
                tried.append((moving, tables))
            limit = max(_MIN_SOLVE_S, 0.5 * left if methods is SEARCH_METHODS else min(0.5 * left, _first_try_s(moving)))
            hurried = tables | {"solver": {"max_time_s": limit}}
            try:
                problem = Problem.from_tables(moving.name, hurried, mechanism=moving)
                answer = plan_motion(problem, say, methods, _IN_BRIEF if methods is _SMOOTH else DIAGNOSES)
            except LinkplanError as error:
                found = replace(found, mechanism=moving, tables=tables, plan=None, why=one_line(error))
                continue
            late = OF_TIME in answer.message or left - deadline.left_s > 0.95 * limit  # planning stops a little before it
            why = "" if answer.passed else why_not(answer, _TIME_BUDGET_S if late else None)
            said = changes if moving is mechanism else (*changes, _OTHER_HOME)
            found = replace(found, mechanism=moving, tables=tables, plan=answer, why=why, changes=said)
            if found.planned:
                return _stiffened(_without_contacts(_with_brief_search(found, answer, left - deadline.left_s), answer))
    if not tried and obstacles and found.why == _SHUT:
        found = replace(found, why=f"every straight way from home is shut; most often, {obstacles.most_common(1)[0][0]}")
    return found


def _first_try_s(mechanism: Mechanism) -> float:
    """Return the time [s] of a first try: an easy motion needs no more."""
    return (0.125 if is_large(mechanism) else 0.3) * _TIME_BUDGET_S


def _with_brief_search(found: FirstMotion, plan: Plan, took_s: float) -> FirstMotion:
    """Return a first motion whose problem does not search for longer than a first try, if a smooth path is its plan.

    For a large robot, whose smooth path is tried first, the limit is at least twice the time [s] that this took: with less,
    its certificate may not be reached.
    """
    if plan.solved is not None:
        return found
    limit = _first_try_s(found.mechanism)
    if is_large(found.mechanism):
        limit = max(limit, float(np.ceil(2 * took_s)))
    note = (
        f"the smooth path keeps every limit: planning searches for a better motion for {limit:g} s of work and no longer"
        " (solver.max_time_s)"
    )
    tables = found.tables | {"solver": {"max_time_s": limit}}
    return replace(found, tables=tables, changes=(*found.changes, note))


def _without_contacts(found: FirstMotion, plan: Plan) -> FirstMotion:
    """Return a first motion without the contacts of links that overlap by construction, which no plan contains."""
    pairs = overlapping_bodies(() if plan.certificate is None else plan.certificate.contacts)
    if not pairs or plan.certificate is None:
        return found
    left = tuple(meeting for meeting in plan.certificate.contacts if list(meeting.bodies) not in pairs)
    plan = replace(plan, certificate=replace(plan.certificate, contacts=left))
    return _with_table(found, plan, with_exclusions(found.tables["mechanism"], pairs), overlap_sentence(pairs))


def _stiffened(found: FirstMotion) -> FirstMotion:
    """Return a first motion whose loops are stiff if its own efforts open them in simulation."""
    table, plan = found.tables["mechanism"], found.plan
    if plan is None or "solref" in table or planned_gap(plan) <= SOFT_GAP * travel(plan):
        return found
    return _with_table(found, plan, {**table, "solref": STIFF}, SOFT_IN_MOTION)


def _with_table(found: FirstMotion, plan: Plan, table: dict, note: str) -> FirstMotion:
    """Return a first motion with another [mechanism] table, for which its plan holds too, and a note on the change."""
    tables = found.tables | {"mechanism": table}
    mechanism = mechanism_from_tables(tables)
    problem = Problem.from_tables(mechanism.name, tables, mechanism=mechanism)
    tables["tracking"] = critical_gains(mechanism, problem, tables["motion"]["duration_s"])
    changes = (*found.changes, note)
    return replace(found, mechanism=mechanism, tables=tables, plan=replace(plan, problem=problem), changes=changes)


def _of_all_homes(mechanism: Mechanism, say: Say, obstacles: Counter[str]) -> Iterator[tuple[Mechanism, dict[str, dict]]]:
    """Yield mechanisms and the tables of their motions: from home, and from the gravity equilibrium of undriven joints.

    A home that is no equilibrium comes last: a motion from rest there starts with a fall. Where every way from these is
    shut, motions begin in the middle of the joints' reach. What shuts the other motions' ways is counted in `obstacles`.
    """
    other, some = at_gravity_equilibrium(mechanism), False
    homes = [mechanism] if other is None else [other, mechanism]
    for home in homes if not is_equilibrium(mechanism, mechanism.home) else reversed(homes):
        if home is other:
            say("from where hangs what no actuator moves")
        for tables in _candidates(home, say, obstacles):
            some = True
            yield home, tables
    if not some and (middle := _in_mid_reach(mechanism)) is not None:
        say("from the middle of the joints' reach")
        for tables in _candidates(middle, say, obstacles):
            yield middle, tables


def _in_mid_reach(mechanism: Mechanism) -> Mechanism | None:
    """Return a mechanism whose home has the driven joints in the middle of their reach; None if its loops open there.

    If home is outside the range of a tendon or of a servo's ctrl, the middle of the positions within these ranges is taken.
    """
    middle = mechanism.home[mechanism.independent].copy()
    for column in driven_columns(mechanism):
        can = reach(mechanism, int(column))
        positions = can.poses[:, mechanism.independent[column]]
        within = tendons_kept(mechanism, can.poses)
        moved = within[:, within.any(axis=0)]  # a tendon that is outside its range all along is another coordinate's
        kept = np.flatnonzero(moved.all(axis=1) & servos_hold(mechanism, can.poses, column))
        if 0 < len(kept) < len(positions):
            longest = max(np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1), key=len)
            middle[column] = positions[longest[len(longest) // 2]]
        elif not can.turns_fully:
            low, high = _interval(can, float(middle[column]))
            joint = mechanism.independent_joints[column]
            middle[column] = _rounded(joint, 0.5 * (low + high), low, high)
    try:
        return with_home(mechanism, close_at(mechanism, middle))
    except LinkplanError:
        return None


def _candidates(mechanism: Mechanism, say: Say, obstacles: Counter[str]) -> Iterator[dict[str, dict]]:
    """Yield the tables of motions with a clear straight way: of all driven coordinates, then of one, larger ones first.

    There is one motion of each kind and size. The reason that forbids a motion often forbids its mirror image, too.
    """
    driven = driven_columns(mechanism).tolist()
    alone = [[column] for column in driven] if len(driven) > 1 else []
    together = [driven]
    # Several hanging joints swing in many ways: shorter motions excite them less and are tried first. One drive excites
    # undriven springs less than all do, and a large motion of a robot's leg, or one of all drives, needs most of the time.
    small = bool(sprung_freedoms(mechanism)) or is_large(mechanism)
    shares = reversed(_SHARES) if many_hang(mechanism) else _SMALL_FIRST if small else _SHARES
    for share in shares:
        for kind in (alone, together) if alone and small else (together, alone):
            for moved, side in itertools.product(kind, (1, -1)):
                tables = _clear_motion(mechanism, moved, share, side)
                if isinstance(tables, str):
                    obstacles[tables] += 1
                else:
                    say(f"{', '.join(moves_of(tables['motion']))} in {tables['motion']['duration_s']:g} s")
                    yield tables
                    break


def _clear_motion(mechanism: Mechanism, moved: list[int], share: float, side: int) -> dict[str, dict] | str:
    """Return the tables of a motion of some columns, by a share of their range to one side, or what shuts its way.

    Joints that move together move less: more than two share the motion of two.
    """
    start, goal = _ends(mechanism, share * min(1.0, 2 / len(moved)), side)
    rest = np.setdiff1d(np.arange(mechanism.dof), moved)
    goal[rest] = start[rest]
    try:
        start = at_rest(mechanism, start, mechanism.home)
        goal[rest] = start[rest]
        goal = at_rest(mechanism, goal, close_at(mechanism, start))
        tables = _tables(mechanism, start, goal)
        problem = Problem.from_tables(mechanism.name, tables, mechanism=mechanism)
        if np.array_equal(start, goal):
            return why_stuck(mechanism)
        if (obstacle := obstacle_on_way(problem)) is not None:
            return obstacle
        duration, slow = moderate_duration(problem)
    except LinkplanError as error:
        return one_line(error)
    tables["motion"]["duration_s"] = duration
    if slow:  # with least effort, slow motions dip to where the weight is light, on other ways than the clear one
        tables |= {"objective": {"minimize": "effort_rate"}, "mesh": dict(_COARSE_MESH)}
    tables["tracking"] = critical_gains(mechanism, problem, duration)
    return tables


def _ends(mechanism: Mechanism, share: float, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a start and a goal (n_s,): home, moved off the ends of the reach, and a motion from it to one side.

    Side 1 is the longer side of the reach, -1 the shorter one. The motion is a share of the reach to that side, or of 60
    degrees for a hinge or what its gear drives and 40 % of the mechanism's extent for a slide.
    """
    start = mechanism.home[mechanism.independent].copy()
    goal = start.copy()
    for column in driven_columns(mechanism):
        joint = mechanism.independent_joints[column]
        low, high = _interval(reach(mechanism, int(column)), float(start[column]))
        turn = turn_of(mechanism, int(column))
        start[column] = _rounded(joint, float(np.clip(start[column], low, high)), low, high)
        most = turn / 6 if joint.kind == "hinge" else 0.4 * mechanism.extent_m
        up = (high - start[column] >= start[column] - low) == (side > 0)
        room = high - start[column] if up else start[column] - low
        goal[column] = _rounded(joint, float(start[column] + (1 if up else -1) * share * min(most, room)), low, high)
    return start, goal


def _interval(can: Reach, home: float) -> tuple[float, float]:
    """Return the part of a reach around home without singular poses, less a tenth at each end."""
    low, high = can.lower.position, can.upper.position
    low = max([low, *(x for x in can.singular if x < home)])
    high = min([high, *(x for x in can.singular if x > home)])
    margin = 0.1 * (high - low)
    return low + margin, high - margin


def _rounded(joint: Joint, position: float, low: float, high: float) -> float:
    """Return a position rounded to degrees or centimetres, or finer if the interval is short."""
    for digits in (0, 1, 2) if joint.kind == "hinge" else (2, 3, 4):
        found = joint.read(round(joint.shown(position), digits))
        if abs(found - position) < 0.05 * (high - low) and low <= found <= high:
            return found
    return position


def _tables(mechanism: Mechanism, start: np.ndarray, goal: np.ndarray) -> dict[str, dict]:
    """Return a problem's tables: from rest to rest with least effort, or least effort rate.

    With several hanging joints, the motion of least effort waits near the lowest pose, and many motions have nearly the same
    cost: the solver takes hundreds of iterations. With springs in series with the drives, its efforts jump at start and goal
    and let the springs ring. The motion of least effort rate stays near the holding efforts.
    """
    motion: dict = {"kind": "reach"}
    driven = driven_columns(mechanism)
    named = [k for k in range(mechanism.dof) if k in driven or not rests_by_itself(mechanism, k)]
    for name, values in (("start", start), ("goal", goal)):
        for column in named:
            joint = mechanism.independent_joints[column]
            value = float(f"{joint.shown(values[column]):.6g}")
            motion.setdefault(f"{name}_{joint.unit}", {})[joint.name] = value + 0.0
    motion["duration_s"] = "free"
    raised = raised_limits(mechanism)
    limits = {"effort": raised} if raised else {}
    limits |= {"unhonoured": "note"} if left_out(mechanism) else {}
    gentle = many_hang(mechanism) or bool(sprung_freedoms(mechanism)) or is_large(mechanism)
    return {
        "mechanism": dict(mechanism.source),
        "motion": motion,
        "objective": {"minimize": "effort_rate" if gentle else "effort"},
        **({"limits": limits} if limits else {}),
        **({"mesh": dict(_COARSE_MESH)} if is_large(mechanism) else {}),
    }


def moves_of(motion: Mapping) -> list[str]:
    """Return a phrase with start and goal for each joint that moves in a motion's table."""
    ends = [(unit, *(motion.get(f"{end}_{unit}", {}) for end in ("start", "goal"))) for unit in ("deg", "m")]
    return [
        f"{j} from {round(x, 9) + 0.0:g} to {goal[j]:g} {unit}"  # an equilibrium at zero is found to 1e-15
        for unit, start, goal in ends
        for j, x in start.items()
        if goal[j] != x
    ]


def relative_model_path(model: str, place: Path | None) -> str:
    """Return a model file's path relative to the folder of the problem file at `place`."""
    if place is None:
        return model
    try:
        return Path(os.path.relpath(Path(model).resolve(), place.resolve().parent)).as_posix()
    except ValueError as error:  # another drive
        raise ModelError(f"'{model}' and '{place}' are on different drives: {error}") from error
