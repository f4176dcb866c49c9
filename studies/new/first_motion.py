"""A first motion of a mechanism: a start and a goal within its reach, away from singular poses and contacts, and planned."""

import itertools
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from linkplan.models.audit import audit
from linkplan.models.deadline import Deadline
from linkplan.models.errors import AssemblyError, LinkplanError, ModelError, ProblemError, UnassembledError, one_line
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.contacts import may_collide, meetings, new_meetings
from linkplan.models.poses.reach import Reach, reach
from linkplan.models.tree.joints import Joint
from linkplan.planner.certificate.collisions import contact_note
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.files.problem_file import mechanism_from_tables, problem_from_tables
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.plan import Plan
from linkplan.planner.planning import RUNGS, plan_motion
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.ladder import PATIENT, Rung
from linkplan.planner.search.presolve import start_pose_of
from linkplan.planner.search.starts import from_first_starts
from linkplan.planner.solvers.outcome import OF_TIME
from linkplan.studies.new.hanging import at_rest, driven_columns, hanging_columns, hung, is_equilibrium, rests_by_itself

Say = Callable[[str], None]
# The largest first motion of a hinge [rad], and of a slide as a share of the mechanism's extent; then the shares of it that
# are tried.
_HINGE, _SLIDE = np.radians(60.0), 0.4
_SHARES = (1.0, 0.5, 0.25, 0.1)
# What is kept free of the reach at either end, as a share of it.
_CLEAR = 0.1
# Poses on the way keep det J_z above this share of home's.
_REGULAR = 0.25
_BETWEEN = 61
# More hanging freedoms than this swing in many ways: the smaller motions are tried first, with least change of effort.
_FEW_HANG = 1
# What assembly leaves of a range [rad or m].
_SLACK = 1e-8
# The duration: so many times the shortest one on a smooth path, so that a plan is well within the efforts, and no less than
# people see [s]; where freedoms hang free, without actuator or spring, so many swings of a pendulum of the mechanism's size.
_EASE, _LEAST_S, _SWINGS = 2.0, 0.1, 2.0
_GRAVITY = 9.81
# How long motions are planned for [s of this process's own work], one after the other: each has a share of what is left,
# and no less than a solve takes.
_PATIENCE_S, _SHARE_OF_TIME, _LEAST_LEFT_S = 40.0, 0.5, 1.0
# Motions of many joints are moved together by less: the whole of it is that of so many.
_AT_ONCE = 2
_SMOOTH = (Rung(name="a smooth path", tried=lambda _: True, climb=from_first_starts, budget=PATIENT),)
_SHUT = "every straight way from home is shut: by a singular pose, a joint's range, a contact or too great a weight"
# A feedback loop's natural frequency times the motion's duration.
_CYCLES = 8.0
# What drives miss of the efforts that hold a pose, as a share of their limits: below it they can hold it.
_UNDRIVEN = 1e-9
# A gain of PD sampled every period T is stable up to about 2 J / T: a tenth of that is kept, a period of delay included.
_OF_CRITICAL = 0.1
_PERIOD_S = 1e-4

# Coordinates named in a description.
_NAMED = 3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FirstMotion:
    """A problem to begin with: its mechanism, its tables, and the plan that was made of it, None where none was found."""

    mechanism: Mechanism
    tables: dict[str, dict]
    plan: Plan | None
    why: str  # there is no plan; "" where there is

    @property
    def description(self) -> str:
        """The problem in a few words."""
        motion = self.tables["motion"]
        moves = moves_of(motion)
        some = moves if len(moves) <= _NAMED else [*moves[:_NAMED], f"{len(moves) - _NAMED} more"]
        duration = motion["duration_s"]
        within = f" in {duration:g} s" if duration != "free" else ""
        least = "effort" if self.tables["objective"]["minimize"] == "effort" else "change of effort"
        return f"{self.mechanism.name}: {', '.join(some) or 'no motion'}{within}, from rest to rest with least {least}"

    @property
    def notes(self) -> list[str]:
        """What the motion leaves out: contacts that there are by construction, a sentence each."""
        certificate = None if self.plan is None else self.plan.certificate
        return [] if certificate is None else [contact_note(meeting) for meeting in certificate.contacts]

    @property
    def planned(self) -> bool:
        """Whether a motion was found that passes its certificate."""
        return self.plan is not None and self.plan.passed


def first_motion(model: str, say: Say) -> FirstMotion:
    """Return a problem that a mechanism can do, its motion planned.

    Args:
        model: a built-in name or a path to an MJCF file.
        say: called with a line of text now and then.

    Raises:
        ModelError: when the model cannot be used.
        ProblemError: when nothing drives it, or no coordinate that is driven can move, saying what to add.
    """
    mechanism = _assembled(model)
    _refuse_undriven(mechanism)
    found = FirstMotion(mechanism=mechanism, tables=_tables(mechanism, *_ends(mechanism, 0.0, 1)), plan=None, why=_SHUT)
    deadline = Deadline().within(_PATIENCE_S)
    tried: list[tuple[Mechanism, dict[str, dict]]] = []
    for rungs in (_SMOOTH, RUNGS):  # a smooth path leads to most motions at once; what else there is takes its time
        for moving, tables in tried if rungs is RUNGS else _of_all_homes(mechanism, say):
            left = deadline.left_s
            if left < _LEAST_LEFT_S:
                return found
            if rungs is _SMOOTH:
                tried.append((moving, tables))
            hurried = tables | {"solver": {"max_time_s": max(_LEAST_LEFT_S, _SHARE_OF_TIME * left)}}
            try:
                answer = plan_motion(problem_from_tables(moving.name, hurried, mechanism=moving), say, rungs)
            except LinkplanError as error:
                found = FirstMotion(mechanism=moving, tables=tables, plan=None, why=one_line(error))
                continue
            why = "" if answer.passed else answer.message
            if OF_TIME in why:
                why = f"no motion was found within {_PATIENCE_S:g} s of work; planning it without that bound may find one"
            found = FirstMotion(mechanism=moving, tables=tables, plan=answer, why=why)
            if found.planned:
                return found
    return found


def _of_all_homes(mechanism: Mechanism, say: Say) -> Iterator[tuple[Mechanism, dict[str, dict]]]:
    """Yield mechanisms and the tables of their motions: from home, and from where hangs what nothing drives.

    A home that nothing holds comes last: a motion from rest there begins with a fall.
    """
    other = hung(mechanism)
    homes = [mechanism] if other is None else [other, mechanism]
    for home in homes if not is_equilibrium(mechanism, mechanism.home) else reversed(homes):
        if home is other:
            say("from where hangs what no actuator moves")
        for tables in _candidates(home, say):
            yield home, tables


def _candidates(mechanism: Mechanism, say: Say) -> Iterator[dict[str, dict]]:
    """Yield the tables of motions whose straight way is clear: all that is driven, then one of it alone, the larger first.

    Of each kind and size one: what forbids it mostly forbids its mirror image, too.
    """
    driven = driven_columns(mechanism).tolist()
    alone = [[column] for column in driven] if len(driven) > 1 else []
    # what hangs on many joints swings in as many ways: the shorter its way, the less of that there is to steer
    for share in reversed(_SHARES) if _many_hang(mechanism) else _SHARES:
        for kind in ([driven], alone):
            for moved, side in itertools.product(kind, (1, -1)):
                tables = _clear_motion(mechanism, moved, share, side)
                if tables is not None:
                    say(f"{', '.join(moves_of(tables['motion']))} in {tables['motion']['duration_s']:g} s")
                    yield tables
                    break


def _clear_motion(mechanism: Mechanism, moved: list[int], share: float, side: int) -> dict[str, dict] | None:
    """Return the tables of a motion of some columns, by a share of their room to one side; None where it is not clear."""
    start, goal = _ends(mechanism, share * min(1.0, _AT_ONCE / len(moved)), side)
    rest = np.setdiff1d(np.arange(mechanism.dof), moved)
    goal[rest] = start[rest]
    try:
        start = at_rest(mechanism, start, mechanism.home)
        goal[rest] = start[rest]
        goal = at_rest(mechanism, goal, close_at(mechanism, start))
        tables = _tables(mechanism, start, goal)
        problem = problem_from_tables(mechanism.name, tables, mechanism=mechanism)
        if np.array_equal(start, goal) or not _is_clear(problem):
            return None
        duration = _duration_s(problem)
    except LinkplanError:
        return None
    tables["motion"]["duration_s"] = duration
    tables["tracking"] = _gains(mechanism, problem, duration)
    return tables


def _assembled(model: str) -> Mechanism:
    """Return a model's mechanism, assembled at the nearest closed pose where its own pose is none."""
    tables = {"mechanism": {"model": model}}
    try:
        return mechanism_from_tables(tables)
    except UnassembledError as error:
        if not error.home:
            raise
        tables["mechanism"] |= error.home
        try:
            return mechanism_from_tables(tables)
        except LinkplanError:
            raise error from None


def _refuse_undriven(mechanism: Mechanism) -> None:
    """Refuse a mechanism that nothing drives, with the line that its model lacks."""
    joint = mechanism.joints[0]  # of MuJoCo's order: on the world, where drives stand
    force = "100" if joint.kind == "slide" else "10"
    line = f'<actuator><motor name="act_{joint.name}" joint="{joint.name}" ctrlrange="-{force} {force}"/></actuator>'
    if mechanism.dof == 0:
        raise ProblemError(f"mechanism '{mechanism.name}' has no degree of freedom: its loops hold it still")
    if mechanism.n_u == 0:
        unusable = "".join(f"; {item.text}" for item in audit(mechanism.model))
        joints = ", ".join(j.name for j in mechanism.joints)
        raise ProblemError(
            f"mechanism '{mechanism.name}' has no usable actuator, so that nothing moves it; add for example {line} to its"
            f" model, with the effort that the drive has; joints are {joints}{unusable}"
        )
    if not len(driven_columns(mechanism)):
        raise ProblemError(f"the actuators of mechanism '{mechanism.name}' move none of its joints at home; add {line}")


def _ends(mechanism: Mechanism, share: float, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a start and a goal (n_s,): home, moved off the ends of the reach, and a share of the way to one side of it.

    Side 1 is where there is more room, -1 the other.
    """
    start = mechanism.home[mechanism.independent].copy()
    goal = start.copy()
    for column in driven_columns(mechanism):
        joint = mechanism.independent_joints[column]
        low, high = _interval(reach(mechanism, int(column)), start[column])
        start[column] = _rounded(joint, float(np.clip(start[column], low, high)), low, high)
        most = _HINGE if joint.kind == "hinge" else _SLIDE * mechanism.extent_m
        up = (high - start[column] >= start[column] - low) == (side > 0)
        room = high - start[column] if up else start[column] - low
        goal[column] = _rounded(joint, start[column] + (1 if up else -1) * share * min(most, room), low, high)
    return start, goal


def _interval(can: Reach, home: float) -> tuple[float, float]:
    """Return the part of a reach about home that stays clear of its ends and of the singular poses in it."""
    low, high = can.lower.position, can.upper.position
    low = max([low, *(x for x in can.singular if x < home)])
    high = min([high, *(x for x in can.singular if x > home)])
    clear = _CLEAR * (high - low)
    return low + clear, high - clear


def _rounded(joint: Joint, position: float, low: float, high: float) -> float:
    """Return a position that reads well [whole degrees, millimetres], where there is room for such."""
    for digits in (0, 1, 2) if joint.kind == "hinge" else (2, 3, 4):
        found = joint.read(round(joint.shown(position), digits))
        if abs(found - position) < 0.05 * (high - low) and low <= found <= high:
            return found
    return position


def _is_clear(problem: PlanningProblem) -> bool:
    """Return whether the straight way is open, and each of its poses can be held where there are actuators for that.

    Loops close, ranges are kept, no pose is nearly singular, geoms do not meet.
    """
    mechanism, start, goal = problem.mechanism, problem.motion.start, problem.motion.goal
    shares = np.linspace(0.0, 1.0, _BETWEEN)

    def position_at(at: np.ndarray) -> np.ndarray:
        return start + np.asarray(at)[:, None] * (goal - start)

    try:
        home = mechanism.home[mechanism.independent]
        lead = follow(mechanism, np.linspace(home, start, _BETWEEN), mechanism.home)
        poses = follow(mechanism, position_at(shares), lead[-1])
    except AssemblyError:
        return False
    ranges = np.array([[joint.lower, joint.upper] for joint in mechanism.joints])
    if np.any(poses < ranges[:, 0] - _SLACK) or np.any(poses > ranges[:, 1] + _SLACK):
        return False
    if np.min(singularity_ratios(problem, poses)) < _REGULAR:
        return False
    still = np.zeros((len(poses), mechanism.dof))
    hold, missing = needed_effort(mechanism, poses, still, still)
    limit = problem.limits.effort
    if np.abs(missing).max() < _UNDRIVEN * np.abs(limit).max() and np.any((hold < limit[:, 0]) | (hold > limit[:, 1])):
        return False
    if not may_collide(mechanism.model):
        return True
    return not new_meetings(meetings(mechanism, shares, poses, position_at))


def _tables(mechanism: Mechanism, start: np.ndarray, goal: np.ndarray) -> dict[str, dict]:
    """Return a problem's tables: from rest to rest with least effort; with least change of it where many freedoms hang.

    There least effort is that of another pose, the lowest, which it goes and stays near as long as it can, by ways
    that have next to the same cost: the solver takes hundreds of iterations. What changes least moves from one rest to
    the other beside the efforts that hold it.
    """
    motion: dict = {"kind": "reach"}
    named = [k for k in range(mechanism.dof) if k in driven_columns(mechanism) or not rests_by_itself(mechanism, k)]
    for name, values in (("start", start), ("goal", goal)):
        for column in named:
            joint = mechanism.independent_joints[column]
            value = float(f"{joint.shown(values[column]):.6g}")
            motion.setdefault(f"{name}_{joint.unit}", {})[joint.name] = value + 0.0
    motion["duration_s"] = "free"
    return {
        "mechanism": dict(mechanism.source),
        "motion": motion,
        "objective": {"minimize": "effort_rate" if _many_hang(mechanism) else "effort"},
    }


def _many_hang(mechanism: Mechanism) -> bool:
    """Return whether so many freedoms hang that a motion swings in many ways at once."""
    return len(hanging_columns(mechanism)) > _FEW_HANG


def _duration_s(problem: PlanningProblem) -> float:
    """Return a duration in two digits with which the efforts are well within their limits."""
    mechanism = problem.mechanism
    shortest = first_guess(problem, start_pose_of(problem)).duration_s
    swing = 2 * np.pi * np.sqrt(mechanism.extent_m / _GRAVITY)
    least = _SWINGS * swing if hanging_columns(mechanism) else _LEAST_S
    return float(f"{max(_EASE * shortest, least):.2g}")


def _gains(mechanism: Mechanism, problem: PlanningProblem, duration: float) -> dict:
    """Return gains of PD for a motion of such a duration: critically damped on the inertia at its start, none undriven."""
    inertia = np.array(mechanism.dynamics.reduced_inertia(start_pose_of(problem))).diagonal()
    inertia = np.where(np.isin(np.arange(mechanism.dof), driven_columns(mechanism)), inertia, 0.0)
    frequency = min(2 * np.pi * _CYCLES / duration, _OF_CRITICAL / _PERIOD_S)  # [rad/s]
    gains = {"kp": inertia * frequency**2, "kd": 2 * inertia * frequency}
    names = [joint.name for joint in mechanism.independent_joints]
    found = {key: [float(f"{value:.2g}") for value in values] for key, values in gains.items()}
    return {key: v[0] if len(v) == 1 else dict(zip(names, v, strict=True)) for key, v in found.items()}


def moves_of(motion: Mapping) -> list[str]:
    """Return what moves in a motion's table from where to where, a phrase each."""
    ends = [(unit, *(motion.get(f"{end}_{unit}", {}) for end in ("start", "goal"))) for unit in ("deg", "m")]
    return [f"{j} from {x:g} to {goal[j]:g} {unit}" for unit, start, goal in ends for j, x in start.items() if goal[j] != x]


def model_beside(model: str, place: Path | None) -> str:
    """Return a model file's path as a problem file at a place names it: from its own folder."""
    if place is None:
        return model
    try:
        return Path(os.path.relpath(Path(model).resolve(), place.resolve().parent)).as_posix()
    except ValueError as error:  # another drive
        raise ModelError(f"'{model}' and '{place}' are on different drives: {error}") from error
