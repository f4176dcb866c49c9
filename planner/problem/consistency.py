"""Refusals of parts of a problem that contradict each other, or the mechanism."""

import functools
from collections.abc import Mapping, Sequence

import numpy as np

from linkplan.models.actuation.distribution import UNLIMITED, distribute, lacking, missed_rounding
from linkplan.models.audit import audit
from linkplan.models.errors import AssemblyError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import demanded, sliding_friction
from linkplan.models.poses.assembly import close_at
from linkplan.planner.problem.instant import Robust, corner_out_of_reach, near_home
from linkplan.planner.problem.keys.limits import Motor
from linkplan.planner.problem.limits import Limits
from linkplan.planner.problem.motion import Motion
from linkplan.planner.problem.objective import Objective
from linkplan.planner.problem.reference import GuessedPath, Reference
from linkplan.planner.problem.settings import MeshSettings
from linkplan.planner.problem.sites import key_of
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.scheme_names import MAX_INTERVALS
from linkplan.planner.transcription.schemes import scheme


def no_actuator(mechanism: Mechanism) -> str:
    """Return the error for a mechanism without an actuator."""
    return (
        f"mechanism '{mechanism.name}' has no usable actuator, and a plan needs one: add it to the model, or name joints"
        " that get a motor in mechanism.drive"
    )


def check_honoured(mechanism: Mechanism, unhonoured: str) -> None:
    """Refuse a model without an actuator, and one with forces that make plans wrong unless they are only to be noted."""
    falsifying = _falsifying(mechanism)
    if falsifying and unhonoured == "refuse":
        raise ProblemError(
            f"mechanism '{mechanism.name}' cannot be planned, its model has forces that plans neglect:"
            f' {"; ".join(falsifying)} (limits.unhonoured = "note" plans without them)'
        )
    if mechanism.n_u == 0:
        raise ProblemError(no_actuator(mechanism))


@functools.lru_cache(maxsize=16)
def _falsifying(mechanism: Mechanism) -> tuple[str, ...]:
    """Return phrases on the model's forces that make plans wrong, memoised because a model is planned many times."""
    return tuple(item.text for item in audit(mechanism.model) if item.falsifies)


def check_motion(motion: Motion, objective: Objective, reference: Reference | None) -> None:
    """Refuse a motion whose kind does not fit its ends, its reference or its objective."""
    if motion.kind == "periodic":
        _check_periodic(motion, objective, reference)
    if motion.kind == "reach" and (motion.start is None or motion.goal is None):
        raise ProblemError(
            "motion.kind 'reach' needs motion.start_deg and motion.goal_deg, or motion.start_at and motion.goal_at"
        )
    if motion.kind == "hold" and (motion.start is None or motion.duration_s is None):
        raise ProblemError("motion.kind 'hold' needs a start, motion.start_deg or motion.start_at, and a motion.duration_s")
    if motion.kind == "hold" and reference is not None:
        raise ProblemError("motion.kind 'hold' stays at its start: it takes no [reference]")
    if motion.kind == "track" and reference is not None and not reference.periodic:
        _check_length(motion, reference)
    if motion.kind == "track" and reference is None:
        raise ProblemError("motion.kind 'track' needs a [reference]")
    if motion.kind == "track" and list(objective.weights) != ["tracking"]:
        raise ProblemError(f"motion.kind 'track' prescribes the motion: minimize is 'tracking', got '{objective.name}'")
    if motion.turns is not None and reference is not None:
        raise ProblemError(
            "motion.turns and [reference] exclude each other, because a reference returns to its start: keep one of them"
        )


def _check_length(motion: Motion, reference: Reference) -> None:
    """For a reference that does not repeat, refuse a duration other than its own."""
    if motion.duration_s is not None and abs(motion.duration_s - reference.period_s) > 1e-9 * reference.period_s:
        raise ProblemError(
            f"motion.duration_s must be that of the reference, {reference.period_s:g} s, or 'free' for the shortest within"
            f" the limits, if the reference does not repeat; got {motion.duration_s:g}"
        )


def _check_periodic(motion: Motion, objective: Objective, reference: Reference | None) -> None:
    """Refuse a periodic motion with unsuitable ends, or without a reason to move."""
    if motion.waypoints and motion.goal is not None:
        raise ProblemError("motion.kind 'periodic' with motion.waypoints ends where it starts: it takes no motion.goal_deg")
    if reference is not None and not reference.periodic:
        raise ProblemError(
            "motion.kind 'periodic' needs a reference that repeats (reference.spline or reference.period_s); kind 'reach'"
            " follows one that does not"
        )
    turns = motion.turns is not None
    one_end = (motion.start is None) != (motion.goal is None) and not (turns and motion.goal is None)
    if not motion.waypoints and one_end:
        raise ProblemError("motion.kind 'periodic' takes motion.start_deg and motion.goal_deg together, or neither")
    moves = motion.goal is not None or bool(motion.waypoints) or turns
    if reference is None and not moves:
        raise ProblemError(
            "motion.kind 'periodic' needs a [reference], or motion.start_deg and motion.goal_deg, or motion.waypoints"
            " or motion.turns"
        )
    if not objective.has("tracking") and not moves:
        raise ProblemError(
            f"motion.kind 'periodic' with minimize '{objective.name}' needs motion.start_deg and motion.goal_deg to move"
            " between, or motion.waypoints: without them the optimum is to rest"
        )


def check_end_accelerations(motion: Motion, mechanism: Mechanism, smooth: np.ndarray) -> None:
    """Refuse accelerations at ends of a motion whose accelerations may jump there, or of joints that rest there.

    Args:
        motion: with the accelerations.
        mechanism: with the joints.
        smooth: (n_s,) for each independent joint, whether a limit or a cost keeps its acceleration from jumping.
    """
    along = motion.kind == "follow"
    for name, asked in zip(("start", "goal"), motion.end_accelerations(mechanism.dof), strict=True):
        speed = getattr(motion, f"{name}_speed")
        for column, joint in enumerate(mechanism.independent_joints):
            if np.isnan(asked[column]):
                continue
            where = f"motion.{name}_acceleration_{joint.unit}_s2 of joint {joint.name}"
            where, unit = (f"path.{name}_acceleration_m_s2", "site_jerk_m_s3") if along else (where, f"jerk_{joint.unit}_s3")
            if motion.kind not in ("reach", "follow"):
                raise ProblemError(f"{where} belongs to motion.kind 'reach', got '{motion.kind}'")
            if not (smooth.any() if along else smooth[column]):
                raise ProblemError(
                    f"{where}: the acceleration may jump there; set limits.{unit} or limits.effort_rate, or minimize 'jerk'"
                )
            if asked[column] and not along and (speed is None or not speed[column]):
                raise ProblemError(f"{where} is 0 where the joint is at rest, got {joint.text(asked[column], 6)}")


def check_open_goal(motion: Motion, mechanism: Mechanism, limits: Limits, mesh: MeshSettings) -> None:
    """Refuse limits on the effort rates of some motors where these do not determine what holds an open goal."""
    limited = np.any(np.isfinite(limits.effort_rate), axis=1)
    asked = motion.kind == "reach" and motion.goal_is_free and limited.any() and not limited.all()
    if asked and (mechanism.n_u > mechanism.dof or (mechanism.n_u == mechanism.dof and mesh.scheme.startswith("gauss"))):
        raise ProblemError(
            "limits.effort_rate of some motors only needs a goal of every independent joint, or as many motors as degrees of"
            f" freedom and a mesh.scheme with a node at the end; got {mechanism.n_u} motors, {mechanism.dof} degrees of"
            f" freedom, a goal whose pose is open, and {mesh.scheme}"
        )


def check_node_at_end(motion: Motion, mechanism: Mechanism, mesh: MeshSettings) -> None:
    """Refuse a scheme without a node at an interval's end if the pose there is free."""
    needs_node = []
    if motion.goal_is_free and len(mechanism.dependent):
        needs_node = [f"{key_of(motion.goal_at, 'motion.goal_{}')} that leaves a loop's pose open"]
    via = [(waypoint.at, f"motion.waypoints[{k}].{{}}") for k, waypoint in enumerate(motion.waypoints) if waypoint.at_rows]
    opened = [key_of(tasks, where) for tasks, where in via]
    needs_node += [f"{where} that leaves a pose open" for where in opened]
    if needs_node and mesh.scheme.startswith("gauss"):
        raise ProblemError(
            f"{needs_node[0]} needs a mesh.scheme with a node at the end (radau, trapezoid, hermite-simpson), got"
            f" {mesh.scheme}"
        )


def rest_notes(motion: Motion, mechanism: Mechanism, limits: Limits) -> list[str]:
    """Return the notes on a start and a goal at rest that no efforts within their limits hold, apart from dry friction."""
    found = {name: lacking_at_rest(motion, mechanism, limits, name) for name in ("start", "goal")}
    return [f"{words}, so the machine leaves it at once" for words in found.values() if words is not None]


def lacking_at_rest(
    motion: Motion, mechanism: Mechanism, limits: Limits, name: str, free: np.ndarray | None = None
) -> str | None:
    """Return the words on the effort that the motors lack to hold "start" or "goal"; None if they hold it or it moves.

    Accelerations there are allowed along the columns of `free` (n_s, n).
    """
    s, speed = getattr(motion, name), getattr(motion, f"{name}_speed")
    if motion.kind not in ("reach", "follow") or mechanism.forces is not None or s is None:
        return None
    if (name == "goal" and motion.goal_is_free) or (speed is not None and np.any(speed)):
        return None
    try:
        pose, still = close_at(mechanism, s)[None], np.zeros((1, mechanism.dof))
    except AssemblyError:  # the search says so
        return None
    tau, maps = demanded(mechanism, pose, still, still)
    free = np.zeros((mechanism.dof, 0)) if free is None else free
    # Free accelerations are efforts of further actuators, without limits.
    maps = np.concatenate([maps, -(np.array(mechanism.dynamics.reduced_inertia(pose[0])) @ free)[None]], axis=2)
    limit = np.vstack([limits.effort, np.tile(UNLIMITED, (free.shape[1], 1))])
    missed = lacking(tau, maps, distribute(tau, maps, limit), limit)[0]
    rub = [float(sliding_friction(mechanism, pose, column)[0]) for column in range(mechanism.dof)]
    over = np.abs(missed) - missed_rounding(limits.effort) - rub
    row = int(np.argmax(over))
    if over[row] <= 0:
        return None
    joint = mechanism.independent_joints[row]
    return (
        f"the motors cannot hold the {name} at rest: their limits lack {abs(missed[row]):.4g} {joint.si_units[1]} on joint"
        f" {joint.name}"
    )


def check_turning_joints(motion: Motion, mechanism: Mechanism, limits: Limits) -> None:
    """Refuse turns of a joint whose range is limited."""
    turns = np.zeros(mechanism.dof) if motion.turns is None else motion.turns
    for joint, index, n in zip(mechanism.independent_joints, mechanism.independent, turns, strict=True):
        if n and np.any(np.isfinite(limits.position[index])):
            low, high = (joint.text(x, 6) for x in limits.position[index])
            raise ProblemError(
                f"motion.turns of joint {joint.name}: a joint that turns continuously must have no range; its range is"
                f" {low} to {high} deg"
            )


def check_periods(motion: Motion, reference: Reference | None, mesh: MeshSettings) -> None:
    """Refuse a motion over more periods of its reference than the finest mesh can resolve."""
    if reference is None or motion.duration_s is None:
        return
    periods = motion.duration_s / reference.period_s
    if periods * mesh.intervals > MAX_INTERVALS:
        raise ProblemError(
            f"motion.duration_s = {motion.duration_s:g} s is {periods:.6g} periods of the reference; with"
            f" mesh.intervals = {mesh.intervals} each, at most {MAX_INTERVALS / mesh.intervals:.6g} are legal"
        )


def check_robust(robust: Robust, mechanism: Mechanism) -> None:
    """Refuse ranges that do not apply to this mechanism."""
    for joint in (*robust.viscous_friction, *robust.coulomb_friction):
        mechanism.joint_index(joint, ProblemError)
    maps = [np.array(mechanism.dynamics.effort_map(q)) for q in near_home(mechanism)] if robust.corners else []
    driven = max((int(np.linalg.matrix_rank(one)) for one in maps), default=0)
    if tuple(robust.payload_factor) != (1.0, 1.0) and mechanism.payload is None:
        raise ProblemError("robust.payload_factor needs a mechanism.payload; there is none")
    if robust.corners and driven < mechanism.dof:
        _check_robust_of_driven(robust, mechanism, driven)


def _check_robust_of_driven(robust: Robust, mechanism: Mechanism, driven: int) -> None:
    """If the actuators move only some degrees of freedom, refuse ranges that they cannot compensate."""
    moved = f"the actuators of '{mechanism.name}' move {driven} of {mechanism.dof} degrees of freedom"
    if driven < mechanism.n_u:
        raise ProblemError(
            f"[robust] needs actuators that move every degree of freedom, or that each move a different one; {moved}"
        )
    lost = corner_out_of_reach(mechanism, robust.corners)
    if lost is not None:
        raise ProblemError(
            f"[robust] plans one motion for every machine in its ranges; {moved}, and the others move differently at the"
            f" corner: {lost.description}; legal are only ranges that actuators can compensate: torque constant, friction at"
            " driven joints"
        )


def lacking_parts(
    motion: Motion,
    mechanism: Mechanism,
    motors: Sequence[Motor | None],
    reference: Reference | None,
    mesh: MeshSettings,
    limits: Limits,
) -> dict[str, str | None]:
    """Return for each key of `Term.needs` a phrase on what the problem lacks; None if it lacks nothing."""
    given = motion.duration_s
    unknown = [
        actuator.name
        for actuator, motor in zip(mechanism.actuators, motors, strict=False)
        if motor is None or motor.torque_constant is None
    ]
    motors_lack = f"motors.NAME.torque_constant and resistance_ohm of every actuator; missing for {', '.join(unknown)}"
    return {
        "reference": "a [reference]" if reference is None else None,
        "free duration": None if given is None else f'motion.duration_s = "free", got {given:g}',
        "fixed duration": "a fixed motion.duration_s, got 'free'" if given is None and motion.kind != "track" else None,
        "motors": motors_lack if unknown else None,
        "closures": None if mechanism.closure_names else f"a closure; '{mechanism.name}' has none",
        "changing efforts": "mesh.effort linear or polynomial, got constant" if mesh.effort == "constant" else None,
        "effort limits": _unlimited(mechanism, limits),
        "changing accelerations": _constant_acceleration(mesh),
    }


def _unlimited(mechanism: Mechanism, limits: Limits) -> str | None:
    """Return a phrase on actuators without a limit on effort; None if all have one."""
    unlimited = [
        actuator.name
        for actuator, ends in zip(mechanism.actuators, limits.effort, strict=False)
        if not np.all(np.isfinite(ends))
    ]
    missing = f"a motor's ctrlrange, a servo's forcerange; missing for {', '.join(unlimited)}"
    return f"finite limits.effort ({missing})" if unlimited else None


def _constant_acceleration(mesh: MeshSettings) -> str | None:
    """Return a phrase on a transcription whose accelerations are constant over an interval; None for the others."""
    if mesh.effort != "polynomial":
        return f"mesh.effort polynomial, got {mesh.effort}"
    if scheme(mesh.scheme).n_nodes < 3:
        return f"a mesh.scheme with three nodes or more in an interval, got {mesh.scheme}"
    return None


def check_objective(
    objective: Objective, motion: Motion, mechanism: Mechanism, limits: Limits, lacking: Mapping[str, str | None]
) -> None:
    """Refuse an objective that does not fit the motion or the actuators; `lacking` is that of `lacking_parts`."""
    unlimited = _unlimited(mechanism, limits)
    if list(objective.weights) == ["time"] and unlimited is not None:
        raise ProblemError(f"objective.minimize 'time' needs {unlimited}: without them there is no least time")
    if list(objective.weights) == ["time"] and motion.stays:
        raise ProblemError(
            "objective.minimize is 'time' and the motion ends where it starts, which takes no time: set another goal or"
            " objective"
        )
    for name, term in objective.terms.items():
        for need in term.needs:
            if lacking[need] is not None:
                raise ProblemError(f"objective.minimize '{name}' needs {lacking[need]}")
    needs = {"effort_rate": "changing efforts", "jerk": "changing accelerations", "site_jerk": "changing accelerations"}
    given = {"site_jerk": bool(limits.site_jerk)}
    given |= {name: bool(np.any(np.isfinite(getattr(limits, name)))) for name in ("effort_rate", "jerk")}
    for name, need in needs.items():
        if given[name] and lacking[need] is not None:
            raise ProblemError(f"limits.{name} needs {lacking[need]}")


def check_guess(guess: GuessedPath | Trajectory | None, mechanism: Mechanism) -> None:
    """Refuse a saved plan's motion as a guess for another mechanism."""
    n_q = mechanism.n_q
    if isinstance(guess, Trajectory) and (other := guess.misfit(mechanism.dof, mechanism.n_u, n_q)):
        raise ProblemError(f"the guess does not fit mechanism '{mechanism.name}': {other}")
