"""Which limit forbids a motion: each taken away in turn, and the least that it would have to be."""

from dataclasses import replace

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.tendons import TendonLimit
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.closed_chain.guess import motion_of
from linkplan.planner.closed_chain.transcribe import renumbered, trajectory_of, transcribe
from linkplan.planner.diagnosis.infeasibility import overrun_sentence
from linkplan.planner.problem.limits import free
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.problem.robust import Robust
from linkplan.planner.problem.sites import SiteLimit
from linkplan.planner.refinement.history import record, step_of
from linkplan.planner.solvers.solve import build_solver, run_solver, solve
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import Mesh

# What may be taken away to see whether it is what forbids a motion, in this order, before the efforts' limits are looked at.
RELAXABLE = (
    "robust",
    "speed",
    "power",
    "closure_force",
    "motor",
    "control",
    "effort_rate",
    "singular_margin",
    "tendon",
    "site",
)
# Efforts that may jump have no rate to speak of: their rates are limited to so many times the limit in place of not at all.
# So are servos' ctrl ranges.
_ALL_BUT_FREE = 1e3
# Halvings of the range of a limit's factor: its least is then known to four digits of what a motion without it comes to.
_HALVINGS = 13
# A motion comes to a little more between the nodes than at them.
_ROOM = 1.001


def scaled(problem: PlanningProblem, what: str, factor: float) -> PlanningProblem:
    """Return a problem with one of its `RELAXABLE` limits multiplied by a factor."""
    limits = problem.limits
    if what == "site":
        room = (factor - 1) * problem.mechanism.extent_m
        return replace(problem, limits=replace(limits, site=tuple(_wider(limit, room) for limit in limits.site)))
    if what == "tendon":
        return _with_tendons(
            problem, tuple(_longer(tendon, (factor - 1) * tendon.span) for tendon in problem.mechanism.tendons)
        )
    if what == "robust":
        return replace(problem, robust=replace(problem.robust, room=factor * problem.robust.room))
    if what == "motor":
        lined = [m for m in problem.motors if m is not None and m.has_line]
        wider = {
            id(m): replace(m, stall_effort=m.stall_effort * factor, no_load_speed=m.no_load_speed * factor) for m in lined
        }
        return replace(problem, motors=tuple(wider.get(id(m), m) for m in problem.motors))
    if what == "control":
        return _with_controls(problem, factor)
    return replace(problem, limits=replace(limits, **{what: getattr(limits, what) * factor}))


def _with_controls(problem: PlanningProblem, factor: float) -> PlanningProblem:
    """Return a problem in which the ctrl ranges of its servos are multiplied by a factor."""
    mechanism = problem.mechanism
    wider = tuple(
        replace(a, control_lower=a.control_lower * factor, control_upper=a.control_upper * factor) if a.limits_control else a
        for a in mechanism.actuators
    )
    return replace(problem, mechanism=replace(mechanism, actuators=wider))


def _with_tendons(problem: PlanningProblem, tendons: tuple[TendonLimit, ...]) -> PlanningProblem:
    return replace(problem, mechanism=replace(problem.mechanism, tendons=tendons))


def _longer(tendon: TendonLimit, room: float) -> TendonLimit:
    """Return a tendon's limit that gives it so much more room at either end."""
    return replace(tendon, low=tendon.low - room, high=tendon.high + room)


def _wider(limit: SiteLimit, room_m: float) -> SiteLimit:
    """Return a limit on a site that gives it so much more room on every side."""
    return replace(limit, low=limit.low if limit.is_tube else limit.low - room_m, high=limit.high + room_m)


def without(problem: PlanningProblem, what: str) -> PlanningProblem | None:
    """Return a problem with one of its `RELAXABLE` limits, or "position", taken away; None where it has no such limit."""
    limits = problem.limits
    if what == "motor":
        if not any(motor is not None and motor.has_line for motor in problem.motors):
            return None
        bare = tuple(m and replace(m, stall_effort=None, no_load_speed=None) for m in problem.motors)
        return replace(problem, motors=bare)
    if what == "robust":
        return replace(problem, robust=Robust()) if problem.robust.corners else None
    if what == "control":
        limited = any(actuator.limits_control for actuator in problem.mechanism.actuators)
        return _with_controls(problem, _ALL_BUT_FREE) if limited else None
    if what == "tendon":
        far = tuple(_longer(tendon, _ALL_BUT_FREE * tendon.span) for tendon in problem.mechanism.tendons)
        return _with_tendons(problem, far) if far else None
    value = getattr(limits, what)
    if what == "singular_margin":
        return replace(problem, limits=replace(limits, singular_margin=0.0)) if value else None
    if what == "site":
        return replace(problem, limits=replace(limits, site=())) if value else None
    if not np.any(np.isfinite(value)):
        return None
    if what == "effort_rate":
        return scaled(problem, what, _ALL_BUT_FREE)
    freed = np.full(len(value), np.inf) if what == "closure_force" else free(len(value))
    return replace(problem, limits=replace(limits, **{what: freed}))


def least_of(problem: PlanningProblem, what: str, motion: Trajectory, mesh: Mesh, durations: np.ndarray) -> Trajectory:
    """Return the motion for which a limit has to be relaxed least: bisection of a common factor on it, solved warm.

    Args:
        problem: one without a motion.
        what: the limit, one of `RELAXABLE`.
        motion: made without it; what is returned where none comes nearer.
        mesh: of the solves.
        durations: of the mesh's segments in the motion [s].
    """
    factor = _overrun(problem, motion, what)
    if factor is None:
        return motion
    near, far = 1.0, factor
    transcribed = transcribe(scaled(problem, what, far), motion_of(motion), mesh, durations)
    best = solve(transcribed, problem.solver)
    record(step_of(f"least {what}", transcribed, best))
    if not best.converged:
        return motion
    solver = build_solver(transcribed.program, problem.solver, warm=True)
    for _ in range(_HALVINGS):
        if problem.solver.deadline.passed:
            break
        middle = 0.5 * (near + far)
        trial = run_solver(solver, renumbered(best.transcribed, scaled(problem, what, middle), best.x))
        if trial.converged:
            best, far = trial, middle
        else:
            near = middle
    record(step_of(f"least {what}", best.transcribed, best))
    try:
        return trajectory_of(best.transcribed, best.x, problem.limits.effort)
    except AssemblyError:
        return motion


def _overrun(problem: PlanningProblem, motion: Trajectory, what: str) -> float | None:
    """Return the factor on a limit with which a motion keeps it, a little beyond; None where there is none."""
    if what == "speed":
        time = motion.dense_times(8)
        poses = follow(problem.mechanism, motion.position_at(time), motion.start_pose, problem.solver.deadline)
        rates, bounds = joint_rates(problem.mechanism, poses, motion.velocity_at(time)), problem.limits.speed
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.maximum(rates / bounds[:, 1], rates / bounds[:, 0])
        largest = float(np.nan_to_num(ratios, posinf=0.0, neginf=0.0).max())
        return _ROOM * largest if largest > 1 else None
    over = [m for m in certify(problem, motion).margins if m.key == what and not m.kept and np.isfinite(m.value)]
    if what == "site":
        return 1 + _ROOM * max(-m.left for m in over) / problem.mechanism.extent_m if over else None
    if what == "tendon":
        spans = [tendon.span for tendon in problem.mechanism.tendons]
        return 1 + _ROOM * max(-m.left / spans[m.item] for m in over) if over else None
    over = [m for m in over if m.limit]
    if not over:
        return None
    ratios = [m.value / m.limit for m in over]
    return min(ratios) / _ROOM if what == "singular_margin" else _ROOM * max(ratios)


def violated_sentence(problem: PlanningProblem, trajectory: Trajectory, what: str) -> str | None:
    """Return the sentence on what a motion made without a limit comes to, against that limit; None where it keeps it."""
    if what in ("speed", "position"):
        try:
            time = trajectory.dense_times(8)
            until = problem.solver.deadline
            poses = follow(problem.mechanism, trajectory.position_at(time), trajectory.start_pose, until)
        except AssemblyError:
            return None
        return overrun_sentence(problem, trajectory, poses, what)
    try:
        found = certify(problem, trajectory).margins
    except AssemblyError:
        return None
    over = [margin for margin in found if margin.key == what and not margin.kept]
    return over[0].sentence("would have to come to") if over else None
