"""Starting points: motions that already close the loop, keep the boundary states and ask for a possible effort."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly

from models.along import needed_effort
from models.assembly import follow
from models.errors import AssemblyError
from models.mechanism import Mechanism
from planner.problem import PlanningProblem
from planner.trajectory import Trajectory

# Samples along a guess at which its effort is looked at: enough for a path of a few radians.
_SAMPLES = 121
# The longest and shortest durations considered for a free one [s].
_DURATIONS = (1e-5, 1e4)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Guess:
    """A motion to start from: functions of time (n,) giving (n, n_s) and efforts (n, n_u), and its duration."""

    position: Callable[[np.ndarray], np.ndarray]
    velocity: Callable[[np.ndarray], np.ndarray]
    acceleration: Callable[[np.ndarray], np.ndarray]
    effort: Callable[[np.ndarray], np.ndarray] | None
    duration_s: float
    start_pose: np.ndarray


def motion_of(trajectory: Trajectory) -> Guess:
    """Return a trajectory as a guess."""
    return Guess(
        position=trajectory.position_at,
        velocity=trajectory.velocity_at,
        acceleration=trajectory.acceleration_at,
        effort=trajectory.effort_at,
        duration_s=trajectory.duration_s,
        start_pose=trajectory.start_pose,
    )


def first_guess(problem: PlanningProblem, start_pose: np.ndarray) -> Guess:
    """Return a motion to start from: the reference itself, or the smoothest path between the boundary states.

    A free duration is the shortest that the effort limits allow on that path.
    """
    if problem.motion.kind != "reach" and problem.reference is not None:
        reference = problem.reference
        return Guess(
            position=lambda t: reference.derivative(t, 0),
            velocity=lambda t: reference.derivative(t, 1),
            acceleration=lambda t: reference.derivative(t, 2),
            effort=None,
            duration_s=problem.motion.duration_s or reference.period_s,
            start_pose=start_pose,
        )
    duration = problem.motion.duration_s
    if duration is None:
        duration = min(_shortest_duration(problem, start_pose), problem.motion.max_duration_s or np.inf)
    return _guess_along(_smooth_path(problem, duration), duration, start_pose)


def _guess_along(path: BPoly, duration: float, start_pose: np.ndarray) -> Guess:
    """Return a path as a guess, its efforts left to inverse dynamics."""
    return Guess(
        position=path,
        velocity=path.derivative(1),
        acceleration=path.derivative(2),
        effort=None,
        duration_s=duration,
        start_pose=start_pose,
    )


def swinging_guesses(problem: PlanningProblem, start_pose: np.ndarray) -> Iterator[Guess]:
    """Yield motions for a reach of free duration that gather way first: back from the goal before it, or beyond it and back.

    Where effort is short of gravity's, the way straight there is not open, and a solver that starts on it finds none.
    """
    motion = problem.motion
    if motion.kind != "reach" or motion.duration_s is not None:
        return
    way, rest = motion.goal - motion.start, np.zeros_like(motion.goal)
    duration = min(4.0 * _shortest_duration(problem, start_pose), motion.max_duration_s or np.inf)
    for via, at in ((motion.start - 0.5 * way, 0.4), (motion.goal + 0.5 * way, 0.6)):
        states = [[motion.start, rest, rest], [via, rest, rest], [motion.goal, rest, rest]]
        path = BPoly.from_derivatives([0.0, at * duration, duration], states)
        guess = _guess_along(path, duration, start_pose)
        try:
            poses_along(problem.mechanism, guess, np.linspace(0.0, duration, _SAMPLES))
        except AssemblyError:  # the swing leaves what the loop allows
            continue
        yield guess


def _smooth_path(problem: PlanningProblem, duration: float) -> BPoly:
    """Return quintics between the boundary states with no acceleration at the ends (Flash & Hogan 1985)."""
    motion = problem.motion
    rest = np.zeros_like(motion.start)
    begin = [motion.start, motion.start_speed if motion.start_speed is not None else rest, rest]
    end = [motion.goal, motion.goal_speed if motion.goal_speed is not None else rest, rest]
    if motion.kind == "periodic":
        rest_state = [motion.start, rest, rest]
        middle = [motion.goal, rest, rest]
        return BPoly.from_derivatives([0.0, duration / 2, duration], [rest_state, middle, rest_state])
    return BPoly.from_derivatives([0.0, duration], [begin, end])


def _shortest_duration(problem: PlanningProblem, start_pose: np.ndarray) -> float:
    """Return the duration at which the smooth path just asks for the whole effort limit; bisection in log time."""
    mechanism, limit = problem.mechanism, problem.limits.effort
    unit = _smooth_path(problem, 1.0)
    tau = np.linspace(0.0, 1.0, _SAMPLES)
    poses = follow(mechanism, unit(tau), start_pose)

    def excess(log_duration: float) -> float:
        duration = float(np.exp(log_duration))
        path = _smooth_path(problem, duration)
        time = duration * tau
        effort, _ = needed_effort(mechanism, poses, path.derivative(1)(time), path.derivative(2)(time))
        return float(np.max(np.maximum(effort - limit[:, 1], limit[:, 0] - effort)))

    low, high = (float(np.log(d)) for d in _DURATIONS)
    if not np.all(np.isfinite(limit)) or excess(high) > 0:
        return 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return float(np.exp(high))


def poses_along(mechanism: Mechanism, guess: Guess, time_s: np.ndarray) -> np.ndarray:
    """Return the closed poses (n, n_q) of a guess at increasing times (n,)."""
    return follow(mechanism, guess.position(time_s), guess.start_pose)
