"""Initial guesses: motions that close the kinematic loops, satisfy the boundary states and need a feasible effort."""

import functools
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.limits.kinds import beyond_bounds, needed_efforts
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.reference import GuessedPath
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import PiecewisePolynomial
from linkplan.planner.transcription.mesh import Mesh, with_breaks

# Samples along a guess at which its effort is evaluated: enough for a path of a few radians.
GUESS_SAMPLES = 121
# If forces over time have kinks at more instants, these are left to the refinement and are not in the first mesh.
_MOST_FORCE_TIMES = 200
# Ratio of the guessed duration to the time of the last waypoint with a prescribed time, if the guess would end before that.
_LAST_WAYPOINT_STRETCH = 1.25


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Guess:
    """A motion to start from: functions of time (n,) giving (n, n_s) and efforts (n, n_u), and its duration.

    `boundaries_s` (n_boundaries,) are the times of its phase boundaries (start, waypoints, goal); None without waypoints.
    """

    position: Callable[[np.ndarray], np.ndarray]
    velocity: Callable[[np.ndarray], np.ndarray]
    acceleration: Callable[[np.ndarray], np.ndarray]
    effort: Callable[[np.ndarray], np.ndarray] | None
    duration_s: float
    start_pose: np.ndarray
    boundaries_s: np.ndarray | None = None
    swings: int = 1  # number of swings; each needs its own intervals
    # (n_switches,) switch times between its phase boundaries
    switch_times_s: np.ndarray | None = None
    bang_efforts: np.ndarray | None = None  # (n_segments, n_u) efforts between switch times and phase boundaries
    share_of_effort: float = 0.95  # of the limits at most, because solvers need a distance from bounds


def guess_from(trajectory: Trajectory) -> Guess:
    """Return a trajectory as a guess."""
    return Guess(
        position=trajectory.position_at,
        velocity=trajectory.velocity_at,
        acceleration=trajectory.acceleration_at,
        effort=trajectory.effort_at,
        duration_s=trajectory.duration_s,
        start_pose=trajectory.start_pose,
    )


def first_guess(problem: Problem, start_pose: np.ndarray, *, rests: bool = False) -> Guess:
    """Return the first motion to start from: the reference, or the smoothest path through the phase boundaries.

    With `rests`, or if the loops do not close otherwise, it rests at the waypoints. A free duration is the shortest that the
    effort limits allow on this path.
    """
    motion = problem.motion
    if follows_reference(problem):
        return reference_guess(problem, start_pose)
    duration = motion.duration_s or _within(problem, _shortest_duration(problem, start_pose, rests=rests))
    boundaries = boundary_times(problem, duration)
    guess = guess_along(_smooth_path(problem, duration, rests), duration, start_pose, boundaries)
    if motion.waypoints and not rests and not closes(problem, guess):
        return guess_along(_smooth_path(problem, duration, rests=True), duration, start_pose, boundaries)
    return guess


def reference_guess(problem: Problem, start_pose: np.ndarray) -> Guess:
    """Return the reference of a problem that has one."""
    reference = problem.reference
    assert reference is not None
    return Guess(
        position=lambda t: reference.derivative(t, 0),
        velocity=lambda t: reference.derivative(t, 1),
        acceleration=lambda t: reference.derivative(t, 2),
        effort=None,
        duration_s=problem.motion.duration_s or reference.period_s,
        start_pose=start_pose,
    )


def force_times(problem: Problem) -> np.ndarray:
    """Return the times (n,) [s] within a motion at which a derivative of the forces over time jumps."""
    forces = problem.mechanism.forces
    return np.zeros(0) if forces is None else forces.curve.inner_times(problem.motion.duration_s or 0.0)


def with_force_times(problem: Problem, mesh: Mesh, durations: np.ndarray) -> Mesh:
    """Return a mesh with segments of durations [s] whose intervals end at the kinks of forces over time."""
    times = force_times(problem)
    return with_breaks(mesh, durations, times) if 0 < len(times) <= _MOST_FORCE_TIMES else mesh


def follows_reference(problem: Problem) -> bool:
    """Check whether the reference is the first guess: the problem has no waypoints, and the ends that the reference has."""
    motion, reference = problem.motion, problem.reference
    if reference is None or motion.waypoints:
        return False
    if not motion.ends_at_goal:
        return True
    assert motion.start is not None  # of a reach
    assert motion.goal is not None
    first, last = reference.derivative(np.array([0.0, motion.duration_s or reference.period_s]))
    return bool(np.allclose(motion.start, first) and np.allclose(motion.goal, last))


def perturbed_guesses(problem: Problem, start_pose: np.ndarray) -> Iterator[tuple[str, Guess]]:
    """Yield without end the first guess with a few half waves of pseudo-random size added, the same in every run."""
    base = first_guess(problem, start_pose)
    unit = unit_steps(problem.mechanism.independent_joints, problem.mechanism.extent_m)
    moved = np.ptp(base.position(np.linspace(0.0, base.duration_s, GUESS_SAMPLES)), axis=0)
    span = np.maximum(moved, 0.1 * unit)  # the size of perturbations of a guess that hardly moves
    for number in itertools.count(1):
        yield f"perturbed guess {number}", perturbed(base, number, span)


def perturbed(guess: Guess, number: int, span: np.ndarray) -> Guess:
    """Return a guess to which three half waves of random size are added; they are zero at the motion's ends.

    Together they have half of the size `span` (n_s,); every fourth perturbation is larger. `number` is the random seed.
    """
    wave = np.arange(1, 4)
    size = np.random.default_rng(number).uniform(-1.0, 1.0, (len(wave), len(span))) / wave[:, None]
    size, rate = 0.5 * (1 + number // 4) * span * size, np.pi / guess.duration_s * wave

    def waves(t: np.ndarray, order: int) -> np.ndarray:
        return np.sin(np.outer(t, rate) + 0.5 * np.pi * order) @ (rate[:, None] ** order * size)

    return replace(
        guess,
        position=lambda t: guess.position(t) + waves(t, 0),
        velocity=lambda t: guess.velocity(t) + waves(t, 1),
        acceleration=lambda t: guess.acceleration(t) + waves(t, 2),
    )


def closes(problem: Problem, guess: Guess) -> bool:
    """Check that the loops can be closed along a guess.

    Raises:
        OutOfTimeError: when the problem's deadline passes meanwhile.
    """
    try:
        even_poses(problem, guess)
    except AssemblyError:
        return False
    return True


def boundary_times(problem: Problem, duration: float) -> np.ndarray | None:
    """Return the times (n_boundaries,) [s] of start, waypoints and goal in a guess, free times distributed by distance.

    None if the motion has neither waypoints nor a periodic goal.
    """
    motion = problem.motion
    if not motion.waypoints:
        return np.array([0.0, 0.5, 1.0]) * duration if motion.kind == "periodic" and motion.goal is not None else None
    states = _boundary_positions(problem)
    steps = np.linalg.norm(np.diff(states, axis=0), axis=1)
    steps = np.maximum(steps, 0.05 * max(float(steps.max()), 1e-9))
    along = np.concatenate([[0.0], np.cumsum(steps)])
    given = [(0, 0.0), *((k + 1, w.time_s) for k, w in enumerate(motion.waypoints) if w.time_s is not None)]
    last = given[-1][1]
    given.append((len(states) - 1, duration if duration > last else _LAST_WAYPOINT_STRETCH * last))
    index, at = (np.array(x) for x in zip(*given, strict=True))
    return np.interp(along, along[index], at)


def _boundary_positions(problem: Problem) -> np.ndarray:
    """Return the positions (n_boundaries, n_s) of start, waypoints and goal, with free ones interpolated."""
    motion = problem.motion
    first = motion.start
    if first is None:
        first = motion.waypoints[0].guessed if problem.reference is None else problem.reference.derivative(np.zeros(1))[0]
    last = first + motion.advance if motion.goal is None or not motion.ends_at_goal else motion.goal
    states = np.vstack([first, *(w.guessed for w in motion.waypoints), last])
    for column in states.T:
        known = ~np.isnan(column)
        column[~known] = np.interp(np.flatnonzero(~known), np.flatnonzero(known), column[known]) if known.any() else 0.0
    return states


def _within(problem: Problem, duration: float) -> float:
    """Return a duration clipped to the bounds on a free duration."""
    motion = problem.motion
    return float(np.clip(duration, motion.min_duration_s or 0.0, motion.max_duration_s or np.inf))


def users_guess(problem: Problem, start_pose: np.ndarray) -> Guess | None:
    """Return the problem's own guess, stretched to its duration; None if there is no guess or the loops cannot close."""
    given, motion = problem.guess, problem.motion
    if given is None:
        return None
    if isinstance(given, GuessedPath):
        import scipy

        duration = motion.duration_s or given.duration_s or _within(problem, _shortest_duration(problem, start_pose))
        times = np.linspace(0.0, duration, len(given.path))
        path = scipy.interpolate.CubicSpline(times, given.path)
        guess = guess_along(path, duration, start_pose, boundary_times(problem, duration))
    else:
        duration = motion.duration_s or given.duration_s
        guess = replace(
            stretched(guess_from(given), duration),
            effort=lambda t: given.effort_at(given.duration_s / duration * t),
            boundaries_s=boundary_times(problem, duration),
        )
    return guess if closes(problem, guess) else None


def guess_along(
    path: PiecewisePolynomial,
    duration: float,
    start_pose: np.ndarray,
    boundaries_s: np.ndarray | None = None,
    *,
    swings: int = 1,
) -> Guess:
    """Return a path, also one of scipy's splines, as a guess whose efforts follow from inverse dynamics."""
    return Guess(
        position=path,
        velocity=path.derivative(1),
        acceleration=path.derivative(2),
        effort=None,
        duration_s=duration,
        start_pose=start_pose,
        boundaries_s=boundaries_s,
        swings=swings,
    )


def stretched(guess: Guess, duration: float) -> Guess:
    """Return a guess scaled in time to a duration; its efforts are left to inverse dynamics."""
    factor = guess.duration_s / duration
    return Guess(
        position=lambda t: guess.position(factor * t),
        velocity=lambda t: factor * guess.velocity(factor * t),
        acceleration=lambda t: factor**2 * guess.acceleration(factor * t),
        effort=None,
        duration_s=duration,
        start_pose=guess.start_pose,
        boundaries_s=None if guess.boundaries_s is None else guess.boundaries_s / factor,
        swings=guess.swings,
    )


def swinging_guesses(problem: Problem, start_pose: np.ndarray) -> Iterator[Guess]:
    """Yield motions for a reach that gain energy by swinging: first away from the goal, or past the goal and back.

    With less effort than gravity requires, the direct path is infeasible, and a solver that starts from it fails.
    """
    motion = problem.motion
    if motion.kind != "reach" or motion.waypoints:
        return
    way = motion.goal - motion.start
    duration = motion.duration_s or _within(problem, 4.0 * _shortest_duration(problem, start_pose))
    for via, at in ((motion.start - 0.5 * way, 0.4), (motion.goal + 0.5 * way, 0.6)):
        states = np.array([motion.start, via, motion.goal])
        path = PiecewisePolynomial.through(np.array([0.0, at * duration, duration]), states, np.zeros_like(states))
        guess = guess_along(path, duration, start_pose)
        if closes(problem, guess):
            yield guess


def _smooth_path(problem: Problem, duration: float, rests: bool = False) -> PiecewisePolynomial:
    """Return quintics through phase boundaries without acceleration there (Flash & Hogan 1985), or speed if `rests`."""
    motion = problem.motion
    if motion.waypoints:
        times, s = boundary_times(problem, duration), _boundary_positions(problem)
        assert times is not None  # a motion with waypoints has them
        v = np.zeros_like(s)
        v[1:-1] = (s[2:] - s[:-2]) / (times[2:] - times[:-2])[:, None]
        turning = (s[2:] - s[1:-1]) * (s[1:-1] - s[:-2]) <= 0
        v[1:-1][turning | rests] = 0.0
        for k, waypoint in enumerate(motion.waypoints if not rests else ()):
            v[k + 1] = np.where(np.isnan(waypoint.speed), v[k + 1], waypoint.speed)
    else:
        first = problem.mechanism.home[problem.mechanism.independent] if motion.start is None else motion.start
        goal = first + motion.advance if motion.goal is None else motion.goal
        there_and_back = motion.kind == "periodic" and motion.goal is not None
        times = np.array([0.0, duration / 2, duration] if there_and_back else [0.0, duration])
        s = np.vstack([first, goal, first + motion.advance] if there_and_back else [first, goal])
        v = np.zeros_like(s)
    if motion.turns is not None and not rests:  # constant speed
        v[:, motion.turns != 0] = (motion.advance / duration)[motion.turns != 0]
    if motion.ends_at_goal:
        v[[0, -1]] = [np.zeros(s.shape[1]) if w is None else w for w in (motion.start_speed, motion.goal_speed)]
    return PiecewisePolynomial.through(times, s, v)


def _shortest_duration(problem: Problem, start_pose: np.ndarray, *, rests: bool = False) -> float:
    """Return the duration at which the smooth path needs exactly the effort limit, by bisection in the log of time.

    It is 1 s if the loops cannot close along the path, if no duration is enough, or if no actuator has a limit.
    """
    given = [w.time_s for w in problem.motion.waypoints if w.time_s is not None]
    if given:
        return _LAST_WAYPOINT_STRETCH * given[-1]
    unit = _smooth_path(problem, 1.0, rests)
    tau = np.linspace(0.0, 1.0, GUESS_SAMPLES)
    try:
        poses = follow(problem.mechanism, unit(tau), start_pose, problem.solver.deadline)
    except AssemblyError:
        return 1.0

    # With the pace r = 1 / T, speeds are r v_0 + v_1 and accelerations r^2 a_0 + r a_1; the prescribed speeds at the ends
    # give v_1 and a_1. Efforts are quadratic in r except for nonlinear dampers, so three paces determine all others.
    twice = _smooth_path(problem, 2.0, rests)
    v, a = (np.array([path.derivative(order)(path.breaks[-1] * tau) for path in (unit, twice)]) for order in (1, 2))
    v_1, a_1 = 2 * v[1] - v[0], 4 * a[1] - a[0]
    v_0, a_0 = v[0] - v_1, a[0] - a_1
    still, ahead, back = (needed_efforts(problem, poses, r * v_0 + v_1, r**2 * a_0 + r * a_1)[0] for r in (0.0, 1.0, -1.0))
    linear, quadratic = 0.5 * (ahead - back), 0.5 * (ahead + back) - still

    def excess(log_duration: float) -> float:
        pace = float(np.exp(-log_duration))
        effort = still + pace * linear + pace**2 * quadratic
        return float(np.max(beyond_bounds(problem, effort)))

    low, high = np.log(1e-5), np.log(1e4)  # [s]
    if excess(high) > 0 or excess(low) <= 0:
        return 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return float(np.exp(high))


@dataclass(frozen=True, slots=True)
class _PosesRequest:
    """An argument for the memoised `_even_poses`: equal for equal mechanism and guess, whatever the deadline."""

    mechanism: Mechanism
    guess: Guess
    deadline: Deadline = field(compare=False)


def even_poses(problem: Problem, guess: Guess) -> tuple[np.ndarray, np.ndarray]:
    """Return evenly spaced times (n,) over a guess and its closed poses (n, n_q) there; the result is memoised.

    Raises:
        AssemblyError: if its loops cannot close.
        OutOfTimeError: when the problem's deadline passes meanwhile.
    """
    return _even_poses(_PosesRequest(problem.mechanism, guess, problem.solver.deadline))


@functools.lru_cache(maxsize=4)
def _even_poses(request: _PosesRequest) -> tuple[np.ndarray, np.ndarray]:
    times = np.linspace(0.0, request.guess.duration_s, GUESS_SAMPLES)
    poses = poses_along(request.mechanism, request.guess, times, request.deadline)
    times.flags.writeable = poses.flags.writeable = False
    return times, poses


def poses_along(mechanism: Mechanism, guess: Guess, time_s: np.ndarray, deadline: Deadline = NO_DEADLINE) -> np.ndarray:
    """Return the closed poses (n, n_q) of a guess at increasing times (n,), with the exceptions of `follow`."""
    return follow(mechanism, guess.position(time_s), guess.start_pose, deadline)
