"""Obstacles on the straight path from a motion's start to its goal, and the reasons why no motion was found or searched."""

import numpy as np

from linkplan.models.audit import audit
from linkplan.models.errors import AssemblyError, ProblemError, listed, one_line
from linkplan.models.foreign.floating import floating_sentence
from linkplan.models.kinematics import may_collide
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import (
    RANGE_ROUNDING,
    control_excess,
    demanded,
    distributed,
    sampled,
    shut_balls,
)
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.contacts import meetings, new_meetings
from linkplan.planner.certificate.further_checks import geom_names
from linkplan.planner.limits.kinds import effort_bounds, limits_of
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.default_gains import driven_columns
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.presolve import ONLY_WAY_SLACK, pose_beyond
from linkplan.studies.check.drives import drivable, motors_hint
from linkplan.studies.check.inspection_blocks import grouped
from linkplan.studies.check.new.hanging import hanging_columns, lock_at_home


def obstacle_on_way(problem: Problem) -> str | None:
    """Return the obstacle on the straight path from start to goal, checked at 61 poses; None if the path is clear.

    On a clear path the loops close, the poses satisfy their limits, det J_z stays above a quarter of its value at home, no
    geoms collide, and the actuators can hold every pose if they act on all coordinates.
    """
    mechanism, start, goal = problem.mechanism, problem.motion.start, problem.motion.goal
    assert start is not None  # a reach has both ends
    assert goal is not None
    shares = np.linspace(0.0, 1.0, 61)

    def position_at(share: np.ndarray) -> np.ndarray:
        return start + np.asarray(share)[:, None] * (goal - start)

    try:
        home = mechanism.home[mechanism.independent]
        lead = follow(mechanism, np.linspace(home, start, len(shares)), mechanism.home)
        poses = follow(mechanism, position_at(shares), lead[-1])
    except AssemblyError as error:
        return one_line(error)
    limits = [limit for limit in limits_of(problem) if limit.facts.of_position]
    beyond = pose_beyond(problem, limits, poses, "on the straight path", ONLY_WAY_SLACK)
    if beyond is not None:
        return beyond.words
    if np.min(singularity_ratios(mechanism, poses)) < 0.25:
        return "a singular pose is near"
    if (sentence := _too_weak(problem, poses)) is not None or not may_collide(mechanism.model):
        return sentence
    meeting = new_meetings(meetings(mechanism, shares, poses, position_at))
    return f"{geom_names(meeting[0])} collide" if meeting else None


def why_not(answer: Plan, within_s: float | None) -> str:
    """Return the reason why no motion was found: the plan's message, or after the time [s] the last plan's first failure."""
    mechanism, reason = answer.problem.mechanism, answer.message
    if within_s is not None:
        failures = () if answer.certificate is None else answer.certificate.failures
        last = f"; the last one failed: {failures[0]}" if failures else ""
        reason = (
            f"no motion was found within {within_s:g} s of processor time{last}; `linkplan plan`, without this bound, may"
            " find one"
        )
    coasting = np.flatnonzero(np.isin(mechanism.independent, mechanism.coasting_dofs)).tolist()
    loose = sorted({*hanging_columns(mechanism), *coasting})
    lock = lock_at_home(mechanism, loose)  # including the joints that `new` has locked
    names = listed([mechanism.independent_joints[k].name for k in loose], 8)
    remedy = f"{lock} holds them" if lock else f"start and goal must be poses in which {names} hang at rest"
    return f"{reason}; these joints have no actuator and swing or coast when others move: {remedy}" if loose else reason


def tendons_kept(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return a mask (n, n_tendons) of the limited tendons whose lengths are within their ranges at poses (n, n_q)."""
    low, high = np.array([(tendon.low, tendon.high) for tendon in mechanism.tendons]).reshape(-1, 2).T
    lengths = sampled(mechanism.dynamics.tendon_length, poses)[:, :, 0]
    return (lengths >= low - RANGE_ROUNDING) & (lengths <= high + RANGE_ROUNDING)


def servos_hold(mechanism: Mechanism, poses: np.ndarray, column: int) -> np.ndarray:
    """Return a mask (n,) of the poses (n, n_q) at which servos on a coordinate hold the weight within their ctrlranges."""
    still = np.zeros((len(poses), mechanism.dof))
    tau, maps = demanded(mechanism, poses, still, still)
    acting = np.any(maps[:, column] != 0, axis=0)
    hold = np.clip(distributed(mechanism, tau, maps), *mechanism.effort_limit.T)
    return ~np.any(_beyond_ctrl(mechanism, poses, hold)[:, acting], axis=1)


def _beyond_ctrl(mechanism: Mechanism, poses: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Return a mask (n, n_u) of the servos that cannot exert efforts (n, n_u) within their ctrlranges."""
    servos = np.array([actuator.limits_control for actuator in mechanism.actuators], dtype=bool)
    if not servos.any():
        return np.zeros(effort.shape, dtype=bool)
    still = np.zeros((len(poses), mechanism.dof))
    return servos & (control_excess(mechanism, poses, still, effort) > 0)


def _too_weak(problem: Problem, poses: np.ndarray) -> str | None:
    """Return the sentence on an actuator that cannot hold the weight at one of the poses (n, n_q), or None.

    Coordinates that no actuator moves are ignored.
    """
    mechanism, still = problem.mechanism, np.zeros((len(poses), problem.mechanism.dof))
    (tau, maps), limit = demanded(mechanism, poses, still, still), effort_bounds(problem)
    effort = distributed(mechanism, tau, maps, limit)
    hold = np.clip(effort, *limit.T)
    if np.abs(tau - np.einsum("ksu,ku->ks", maps, effort)).max() >= 1e-9 * np.abs(tau).max():
        return None
    names = [actuator.name for actuator in mechanism.actuators]
    weak = np.any(np.abs(effort - hold) > 1e-6 * np.abs(effort).max(), axis=0)
    if weak.any():
        return f"actuator {names[int(np.argmax(weak))]} is too weak to hold the weight"
    short = np.any(_beyond_ctrl(mechanism, poses, hold), axis=0)
    return f"servo {names[int(np.argmax(short))]} cannot hold the weight within its ctrlrange" if short.any() else None


def refuse_undriven(mechanism: Mechanism) -> None:
    """Refuse a mechanism that no actuator moves, or whose ball joints may not turn; the message names the remedy."""
    joint = mechanism.joints[0]  # the first joint is attached to the world, where drives usually are
    force = "100" if joint.kind == "slide" else "10"
    line = f'<actuator><motor name="act_{joint.name}" joint="{joint.name}" ctrlrange="-{force} {force}"/></actuator>'
    if joint.chart is None and joint.name not in [mechanism.model.joint(j).name for j in range(mechanism.model.njnt)]:
        line = f'name="{joint.name}" to its first joint, which has no name, and {line}'
    if not drivable(mechanism).any():
        but = " but the spins of rods" if mechanism.dof else ""
        raise ProblemError(f"mechanism '{mechanism.name}' has no degree of freedom{but}: its loops lock it")
    if (shut := shut_balls(mechanism)) is not None:
        raise ProblemError(f"mechanism '{mechanism.name}': {shut}")
    if (floats := floating_sentence(mechanism.model)) is not None:
        raise ProblemError(f"mechanism '{mechanism.name}': {floats}")
    if mechanism.n_u == 0:
        unusable = "".join(f"; {text}" for text in grouped(mechanism, (item.text for item in audit(mechanism.model))))
        raise ProblemError(
            f"mechanism '{mechanism.name}' has no usable actuator; {motors_hint(mechanism)}; or add for example {line} to"
            f" its model, with the drive's effort limit{unusable}"
        )
    if not len(driven_columns(mechanism)):
        raise ProblemError(f"the actuators of mechanism '{mechanism.name}' move none of its joints at home; add {line}")
