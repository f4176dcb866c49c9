"""The least limits with which a motion exists, as an initial guess or as the reason why there is no plan."""

import contextlib
import itertools
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.planner.closed_chain.guess import Guess, closes, guess_from, perturbed_guesses
from linkplan.planner.closed_chain.transcribe import renumbered, trajectory_of, transcribe
from linkplan.planner.limits.kinds import are_efforts_bounded, effort_bounds, factor_of, overrun_margins
from linkplan.planner.limits.limit import RELAXED_FACTOR, Limit
from linkplan.planner.phase_plane.legs_motion import legs_motion
from linkplan.planner.phase_plane.power_legs import power_legs
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import add_step, step_of
from linkplan.planner.refinement.switches import MESH_ERROR_SHARE, find_bang_efforts, find_switch_times, mesh_with_switches
from linkplan.planner.search.solving import first_mesh
from linkplan.planner.solvers.solve import build_solver, run_solver, solve
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import Mesh, halved

# The bisection of a factor on a limit ends at this relative distance.
_FACTOR_RESOLUTION = 1e-4
# It also ends at most at this share of what the limit lacks, which a message names, too.
_LACK_RESOLUTION = 1e-2
# Meshes of a least relaxation; each one halves intervals near a switch, which lasts some percents of an interval at least.
_MAX_ROUNDS = 6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LeastLimit:
    """The smallest common factor on the effort limits with which a problem has a motion, that motion, and its mesh."""

    factor: float
    trajectory: Trajectory
    mesh: Mesh
    durations: np.ndarray  # (n_segments,) [s]
    first: float  # the factor on the given mesh


def least_limit_of_starts(problem: Problem, guess: Guess) -> LeastLimit | None:
    """Return the least factor on the effort limits from several starts; None if no start led to a motion.

    While the factor is above 1, which may be a local optimum, up to three starts are tried. At most twenty perturbed guesses
    are tried to find them.
    """
    perturbed = itertools.islice(perturbed_guesses(problem, guess.start_pose), 20)
    every = itertools.chain([guess], (start for _, start in perturbed))
    closed = (start for start in every if closes(problem, start))
    best = None
    for start in problem.solver.deadline.take(itertools.islice(closed, 3)):
        known = None if best is None else best.first
        found = least_limit(problem, start, *first_mesh(problem, start), known=known)
        if found is not None and (best is None or found.factor < best.factor):
            best = found
        if best is None or best.factor <= 1.0:
            break
    return best


def settled_limit(problem: Problem, found: LeastLimit) -> LeastLimit:
    """Return the least factor on finer and finer meshes, until it hardly changes.

    A motion can exploit the error of a coarse mesh, and then needs more effort than the factor says.
    """
    # A message names the factor to four digits. With several degrees of freedom, a change of 1e-3 is small enough: finer
    # meshes would take most of the time of a diagnosis, and may lead to a worse local optimum.
    tolerance, before = (1e-3, found.first) if problem.mechanism.dof > 1 else (1e-4, np.inf)
    for _ in range(3):
        if abs(found.factor - before) <= tolerance * found.factor:
            break
        mesh = halved(found.mesh, np.ones(found.mesh.n_intervals, dtype=bool))
        finer = least_limit(problem, guess_from(found.trajectory), mesh, found.durations)
        if finer is None:
            break
        before, found = found.factor, finer
    return found


def least_limit(
    problem: Problem,
    guess: Guess,
    mesh: Mesh,
    durations: np.ndarray,
    *,
    known: float | None = None,
) -> LeastLimit | None:
    """Return the least factor on the effort limits with which a motion exists, or None if none was found.

    It is solved twice: on the given mesh, then with phase boundaries at the switch times found, where the factor is exact.
    The result is None if the first factor equals `known`, the factor of another start on such a mesh: it is the same motion.
    """
    if not are_efforts_bounded(problem):
        return None
    limit = effort_bounds(problem)
    best, bang_efforts = None, None
    for _ in problem.solver.deadline.take(range(2)):
        try:
            transcribed = transcribe(problem, guess, mesh, durations, least_limit=True, bang_efforts=bang_efforts)
        except AssemblyError:  # the first motion leaves the reach between its nodes
            break
        solution = solve(transcribed, problem.solver)
        add_step(step_of("least effort limit", transcribed, solution))
        if not solution.converged:
            break
        factor = float(solution.x[transcribed.program.layout.extra()][0])
        # Relative difference of factors on one mesh that belong to the same motion.
        if best is None and known is not None and abs(factor - known) <= 1e-7 * known:
            return None
        if best is not None and factor > best.factor * (1 + MESH_ERROR_SHARE):
            break
        best = LeastLimit(
            factor=factor,
            trajectory=trajectory_of(transcribed, solution.x, factor * limit),
            mesh=mesh,
            first=factor if best is None else best.first,
            durations=solution.x[transcribed.program.layout.durations()] * transcribed.units.time_s,
        )
        boundaries = best.trajectory.breaks_s[mesh.boundaries()]
        switch_times = find_switch_times(best.trajectory, factor * limit, boundaries)
        if len(switch_times) == 0 or problem.mechanism.forces is not None:  # forces over time have fixed instants
            break
        mesh, durations = mesh_with_switches(boundaries, switch_times, mesh.n_intervals)
        bang_efforts = find_bang_efforts(best.trajectory, factor * limit, np.cumsum(durations)[:-1]) / factor
        for bound in limit.T:  # equal to the limits' own numbers, without rounding
            bang_efforts = np.where(np.isclose(bang_efforts, bound, rtol=1e-9), bound, bang_efforts)
        guess = guess_from(best.trajectory)
    return best


def least_relaxation(
    problem: Problem, kind: type[Limit], motion: Trajectory, mesh: Mesh, durations: np.ndarray, about: float = np.inf
) -> tuple[Trajectory, float]:
    """Return the motion with the least relaxation of a limit, and its factor, by bisection with warm solves.

    The motion satisfies the relaxed limit at the nodes of its mesh.

    Args:
        problem: a problem without a motion.
        kind: the kind of limit.
        motion: a motion planned without the limit; returned with an infinite factor if no motion is closer to the limit.
        mesh: of the solves.
        durations: of the mesh's segments in the motion [s].
        about: a factor that may be the least; the bisection begins on both sides of it.
    """
    near, far = 1.0, factor_of(kind, problem, motion) or RELAXED_FACTOR  # of an infinite overrun no factor is known
    transcribed = transcribe(kind.relaxed(problem, far), guess_from(motion), mesh, durations)
    best = solve(transcribed, problem.solver)
    add_step(step_of(f"least {kind.key}", transcribed, best))
    if not best.converged:
        return motion, np.inf
    with contextlib.suppress(AssemblyError):
        loose = trajectory_of(transcribed, best.x)
        far = min(far, factor_of(kind, problem, loose) or far)
    solver = build_solver(transcribed.program, problem.solver, warm=True)
    # A message names the limit to four digits, and what it lacks; an infinite overrun leaves a range up to `RELAXED_FACTOR`.
    while not problem.solver.deadline.passed:
        lack = min(_FACTOR_RESOLUTION * abs(far), _LACK_RESOLUTION * abs(far - 1.0))
        if abs(far - near) <= lack:
            break
        expected = [about + side * lack for side in (0.4, -0.4, 4.0, -4.0, 30.0, -30.0) if near < about + side * lack < far]
        middle = expected[0] if expected else 0.5 * (near + far)
        trial = run_solver(solver, renumbered(best.transcribed, kind.relaxed(problem, middle), best.x))
        if trial.converged:
            best, far = trial, middle
        else:
            near = middle
    add_step(step_of(f"least {kind.key}", best.transcribed, best))
    try:
        return trajectory_of(best.transcribed, best.x), far
    except AssemblyError:
        return motion, np.inf


def settled_relaxation(
    problem: Problem, kind: type[Limit], motion: Trajectory, mesh: Mesh, durations: np.ndarray
) -> tuple[Trajectory, float]:
    """Return the result of `least_relaxation` on meshes that are refined where the motion overruns the relaxed limit."""
    factor = np.inf
    for _ in problem.solver.deadline.take(range(_MAX_ROUNDS)):
        before = factor
        motion, factor = least_relaxation(problem, kind, motion, mesh, durations, before)
        if not abs(factor - before) > _LACK_RESOLUTION * abs(factor - 1.0):
            break
        over = [margin.overrun for margin in overrun_margins(kind, kind.relaxed(problem, factor), motion)]
        marked = np.max(over, axis=0, initial=0.0) > _LACK_RESOLUTION * abs(factor - 1.0)
        if not np.any(marked):
            break
        durations = np.bincount(mesh.segment, np.diff(motion.breaks_s))
        mesh = halved(mesh, marked)
    return motion, factor


def least_relaxation_of_legs(
    problem: Problem, kind: type[Limit], start_pose: np.ndarray, motion: Trajectory
) -> Trajectory | None:
    """Return the legs of the phase plane with the least relaxation of a limit that take no longer than a motion.

    A mesh encloses values between its nodes, so the limits that its motions need are too large by some percents.

    Args:
        problem: a reach of one degree of freedom with limits on all efforts.
        kind: the kind of limit.
        start_pose: the closed pose (n_q,) at the start.
        motion: one with a relaxation that is too large or almost the least. If legs do not follow the limit, or its least
            relaxation cannot be found with them, the result is None.
    """
    import scipy

    far = factor_of(kind, problem, motion)
    if far is None:
        return None

    def time_left(factor: float) -> float:
        """Return the share of the duration that the legs leave; squares make it almost linear in the factor."""
        legs = power_legs(kind.relaxed(problem, factor), start_pose)
        return np.nan if legs is None else (motion.duration_s / float(legs[1][-1])) ** 2 - 1.0

    far *= 1 + _FACTOR_RESOLUTION
    if not time_left(1.0) < 0.0 <= time_left(far):
        return None
    with contextlib.suppress(ValueError):  # no legs at a factor between
        least = scipy.optimize.brentq(time_left, 1.0, far, rtol=0.1 * _FACTOR_RESOLUTION)
        return legs_motion(kind.relaxed(problem, least), start_pose)
    return None
