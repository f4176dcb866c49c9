"""Candidates for a mechanism's first motion: starts and goals within its reach with a clear path between them."""

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np

from linkplan.models.errors import LinkplanError, one_line
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import sprung_freedoms
from linkplan.models.poses.period import turn_of
from linkplan.models.poses.reach import Reach, reach
from linkplan.models.tree.joints import Joint
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.problem.default_gains import driven_columns, fastest_feedback, with_gains
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Say
from linkplan.studies.check.drives import outside_at_home
from linkplan.studies.check.new.changes import left_out, raised_limits
from linkplan.studies.check.new.clear_way import obstacle_on_way, servos_hold, tendons_kept
from linkplan.studies.check.new.hanging import (
    GRAVITY_M_S2,
    at_gravity_equilibrium,
    hanging_columns,
    is_equilibrium,
    is_large,
    many_hang,
    resting_positions,
    rests_by_itself,
    with_home,
)

# Sizes of first motions that are tried, as shares of the largest one.
_SHARES, _SMALL_FIRST = (1.0, 0.5, 0.25, 0.1), (0.25, 0.1, 0.5, 1.0)
# The mesh tolerance of large mechanisms, where each digit costs seconds: half of what a certificate allows.
_COARSE_MESH = {"intervals": 20, "tolerance_deg": 5e-3}
# The phase [rad] that a frequency [rad/s] covers in a first motion's duration [s].
_EIGHT_CYCLES = 8 * 2 * np.pi


def motions_of_all_homes(
    mechanism: Mechanism, say: Say, obstacles: Counter[str]
) -> Iterator[tuple[Mechanism, dict[str, dict]]]:
    """Yield mechanisms and the tables of their motions: from home, and from the gravity equilibrium of undriven joints.

    A home that is no equilibrium comes last, because a motion from rest there starts with a fall. If every path from these
    poses is blocked, motions begin in the middle of the joints' reach. `obstacles` counts the obstacles of the other
    motions.
    """
    other, some = at_gravity_equilibrium(mechanism), False
    homes = [mechanism] if other is None else [other, mechanism]
    for home in homes if not is_equilibrium(mechanism, mechanism.home) else reversed(homes):
        if home is other:
            say("motions from the pose in which undriven joints hang")
        for tables in _candidates(home, say, obstacles):
            some = True
            yield home, tables
    if not some and (middle := _in_mid_reach(mechanism)) is not None:
        say("motions from the middle of the joints' reach")
        for tables in _candidates(middle, say, obstacles):
            yield middle, tables


def _in_mid_reach(mechanism: Mechanism) -> Mechanism | None:
    """Return a mechanism whose home has the driven joints in the middle of their reach; None if its loops open there.

    If home is outside the range of a tendon or of a servo's ctrl, the middle of the positions within these ranges is used.
    """
    middle = mechanism.home[mechanism.independent].copy()
    for column in driven_columns(mechanism):
        can = reach(mechanism, int(column))
        positions = can.poses[:, mechanism.independent[column]]
        within = tendons_kept(mechanism, can.poses)
        moved = within[:, within.any(axis=0)]  # a tendon that is always outside its range depends on another coordinate
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
    """Yield the tables of motions with a clear straight path: of all driven coordinates, then of one, larger ones first.

    There is one motion of each kind and size, because an obstacle of a motion often also blocks its mirror image.
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
    """Return the problem's tables for a motion of some coordinates by a share of their range, or its obstacle.

    `moved` are the indices of these coordinates; `side` is 1 for the longer side of the reach, -1 for the shorter one.

    If more than two joints move together, each moves less.
    """
    start, goal = _ends(mechanism, share * min(1.0, 2 / len(moved)), side)
    rest = np.setdiff1d(np.arange(mechanism.dof), moved)
    goal[rest] = start[rest]
    try:
        start = resting_positions(mechanism, start, mechanism.home)
        goal[rest] = start[rest]
        goal = resting_positions(mechanism, goal, close_at(mechanism, start))
        tables = _tables(mechanism, start, goal)
        problem = Problem.from_tables(mechanism.name, tables, mechanism=mechanism)
        if np.array_equal(start, goal):
            outside = outside_at_home(mechanism)
            remedy = "set another pose by mechanism.home_deg and home_m"
            return f"{outside[0]}; {remedy}" if outside else "the joints cannot leave home"
        if (obstacle := obstacle_on_way(problem)) is not None:
            return obstacle
        duration, slow = moderate_duration(problem)
    except LinkplanError as error:
        return one_line(error)
    tables["motion"]["duration_s"] = duration
    if slow:  # with least effort, slow motions leave the clear path for poses that need less holding effort
        tables |= {"objective": {"minimize": "effort_rate"}, "mesh": dict(_COARSE_MESH)}
    tables["tracking"] = gains_table(problem)
    return tables


def tables_at_home(mechanism: Mechanism) -> dict[str, dict]:
    """Return the tables of a problem that stays at home."""
    return _tables(mechanism, *_ends(mechanism, 0.0, 1))


def _ends(mechanism: Mechanism, share: float, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a start and a goal (n_s,).

    The start is home, moved away from the ends of the reach; the goal is on one side of it.

    Side 1 is the longer side of the reach, -1 the shorter one. The motion is a share of the reach to that side. Without an
    end, it is a share of 60 degrees for a hinge (after its gear) or of 40 % of the mechanism's extent for a slide.
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
    """Return the part of a reach around home without singular poses and without a tenth at each end."""
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

    Least effort rate is for two kinds of mechanisms; its motion stays near the holding efforts. With several hanging joints,
    the motion of least effort waits near the lowest pose and many motions have nearly the same cost, so the solver takes
    hundreds of iterations. With springs in series with the drives, the least efforts jump at start and goal and excite the
    springs.
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


def moderate_duration(problem: Problem) -> tuple[float, bool]:
    """Return a duration [s] with two digits, and True if only the simulation of the model makes it that long.

    It is some times the shortest one on a smooth path, so that the efforts are moderate.

    With hanging joints it is at least two swings of a pendulum of the mechanism's size, else at least 0.1 s. The model's own
    simulation must be able to follow it.
    """
    mechanism = problem.mechanism
    shortest = first_guess(problem, problem.start_pose()).duration_s
    swing = 2 * np.pi * np.sqrt(mechanism.extent_m / GRAVITY_M_S2)
    least = 2 * swing if hanging_columns(mechanism) else 0.1
    longer = 4 if sprung_freedoms(mechanism) else 2  # fast motions excite undriven springs
    followed = _EIGHT_CYCLES / fastest_feedback(mechanism, problem.tracking.period_s)
    moderate = max(longer * shortest, least)
    return float(f"{max(moderate, followed):.2g}"), followed > moderate


def gains_table(problem: Problem) -> dict:
    """Return the default gains of a first motion, as its [tracking] table."""
    found = with_gains(problem.tracking.replace(kp=None, kd=None), problem.mechanism, problem.start_pose)
    return {"kp": found.kp, "kd": found.kd}
