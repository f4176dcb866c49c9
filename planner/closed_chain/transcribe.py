"""The transcription of a mechanism's planning problem, and the trajectory of a solution."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import close_at
from linkplan.planner.closed_chain.formulate import SMOOTHING_WEIGHT, formulate, tie_weights
from linkplan.planner.closed_chain.guess import Guess, even_poses, poses_along
from linkplan.planner.limits.kinds import effort_bounds, limits_of, needed_efforts
from linkplan.planner.limits.limit import WhichJoints
from linkplan.planner.problem.instant import Scales, position_units
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.constrained_arcs import interval_rows
from linkplan.planner.refinement.marking import Tightening
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import PiecewisePolynomial, bernstein_gram
from linkplan.planner.transcription.collocation import Transcribed, collocate, curves_of, renumbered_with
from linkplan.planner.transcription.formulation import Formulation, Start
from linkplan.planner.transcription.mesh import Mesh
from linkplan.planner.transcription.schemes import scheme

__all__ = ["Transcribed", "choose_scales", "own_objective", "renumbered", "trajectory_of", "transcribe"]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Origin:
    """The origin of a mechanism's program: the mechanism, its units, and a closed pose (n_q,) near the start.

    `smoothing` is the weight of the squared effort rate that is added to the objective, in scaled units. `ties` is that of
    the squared efforts, see `tie_weights`, which gives `tie_weights` (n_u,) [SI].
    """

    mechanism: Mechanism
    scales: Scales
    start_pose: np.ndarray
    smoothing: float
    ties: float
    tie_weights: np.ndarray


def choose_scales(problem: Problem, guess: Guess) -> Scales:
    """Return units of order one: durations, spans, limits, or the guess's efforts if these are far below the limits."""
    mechanism, limit = problem.mechanism, effort_bounds(problem)
    times, poses = (samples[::2] for samples in even_poses(problem, guess))
    need, _ = needed_efforts(problem, poses, guess.velocity(times), guess.acceleration(times), times)
    position = position_units(mechanism, guess.position(times))
    # A joint at rest needs almost no effort. Its effort unit is the effort that moves it by its position unit if other
    # joints move, and 1e-6 of that if all are at rest in balance.
    inertia = sampled(mechanism.dynamics.reduced_inertia, poses[:1])[0]
    maps = np.array([np.array(mechanism.dynamics.effort_map(q)) for q in poses[::10]])
    leverage = np.maximum(np.abs(maps).max(axis=0), max(1e-3 * np.abs(maps).max(initial=0.0), 1e-300))
    unit = (inertia.diagonal()[:, None] * position[:, None] / guess.duration_s**2 / leverage).min(axis=0)
    need = np.abs(need).max(axis=0)
    need = np.maximum(need, unit * np.clip((need / unit).max(initial=0.0), 1e-6, 1.0))
    largest = np.where(np.isfinite(limit), np.abs(limit), 0.0).max(axis=1)
    if problem.objective.has("time"):
        effort = np.where(largest > 0, largest, need)
    else:
        effort = np.where(largest > 0, np.minimum(largest, need), need)
    effort = np.where(effort > 0, effort, 1.0)
    residual = np.abs(maps).max(axis=0) @ effort
    residual = np.where(residual > 0, residual, effort.max())
    # On a passive spin the actuators' moment arms are rounding errors, so the unit is the effort of the spin's own motion.
    spins, rates, none = ~mechanism.actuated, position / guess.duration_s, 0.0 * position
    moved, still = (mechanism.dynamics.inverse_dynamics(poses[0], v, none) for v in (rates, none))
    own = np.abs(inertia) @ rates / guess.duration_s + np.abs(np.array(moved - still)).ravel()
    return Scales(
        time_s=guess.duration_s,
        position=position,
        effort=effort,
        residual=np.where(spins, own, residual),
        length_m=mechanism.extent_m,
    )


def transcribe(
    problem: Problem,
    guess: Guess,
    mesh: Mesh,
    durations: np.ndarray,
    *,
    scales: Scales | None = None,
    position_rows: WhichJoints = False,
    enclosed: bool = False,
    least_limit: bool = False,
    bang_efforts: np.ndarray | None = None,
    constrained_paths: np.ndarray | None = None,
    tightenings: tuple[Tightening, ...] = (),
    smoothing: float = SMOOTHING_WEIGHT,
    ties: float = 0.0,
    free_ends: np.ndarray | None = None,
) -> Transcribed:
    """Return the program of a problem on a mesh, with bounds and a starting point.

    Args:
        problem: what to plan.
        guess: the motion to start from.
        mesh: intervals; its segments have `durations` (n_segments,) [s] in the guess.
        durations: guessed durations of the segments.
        scales: units; chosen from the guess by default.
        position_rows: impose the ranges of independent joints between the nodes too, of all or of some by their index.
        enclosed: impose enclosable limits (power, pin force, accelerations, jerk) between the nodes too.
        least_limit: minimise the common factor on the effort limits instead of the objective.
        bang_efforts: (n_segments, n_u) efforts fixed over whole segments, NaN where they are free.
        constrained_paths: (n_segments, n_path) path quantities fixed at their upper limit (1) or lower limit (-1) over whole
            segments.
        tightenings: amounts by which limits are tightened, because a motion overran them between nodes.
        smoothing: see `formulate`.
        ties: likewise.
        free_ends: likewise.
    """
    scales = scales or choose_scales(problem, guess)
    formulation = formulate(
        problem,
        scales,
        position_rows=position_rows,
        enclosed=enclosed,
        least_limit=least_limit,
        tightenings=tightenings,
        smoothing=smoothing,
        ties=ties,
        free_ends=free_ends,
    )
    transcribed = collocate(
        formulation,
        scheme(problem.mesh.scheme, problem.mesh.effort),
        mesh,
        durations,
        _start(problem, guess, scales, formulation),
        compile_mode=problem.solver.compile,
        deadline=problem.solver.deadline,
        least_limit=least_limit,
        bang_efforts=bang_efforts,
        constrained_paths=constrained_paths,
    )
    weight = smoothing if problem.objective.is_smoothed and not least_limit else 0.0
    origin = Origin(
        mechanism=problem.mechanism,
        scales=scales,
        start_pose=np.array(guess.start_pose),
        smoothing=weight,
        ties=ties,
        tie_weights=tie_weights(problem, 0.0 if least_limit else ties),
    )
    return replace(transcribed, origin=origin, start=_with_limits_unknowns(transcribed, _n_unknowns(problem, formulation)))


def _n_unknowns(problem: Problem, formulation: Formulation) -> int:
    """Return the number of the limits' algebraic unknowns at a node."""
    return sum(limit.rows.n_unknowns for limit in limits_of(problem, enclosed=formulation.rows.encloses))


def _with_limits_unknowns(transcribed: Transcribed, n_unknowns: int) -> np.ndarray:
    """Return a program's start with the limits' unknowns at nodes, the last ones, equal to the values that they stand for.

    Their equations, also the last ones, are value - unknown = 0.
    """
    x, interval = np.array(transcribed.start), transcribed.program.interval
    if n_unknowns:
        n, m, n_rows = transcribed.program.mesh.n_intervals, interval.n_nodes, interval.n_equations + interval.n_path
        of_nodes = slice(interval.n_own, interval.n_own + m * n_rows)
        off = interval_rows(transcribed, x)[:, of_nodes].reshape(n, m, n_rows)[:, :, : interval.n_equations]
        x[transcribed.program.layout.dependent()[:, :, -n_unknowns:]] += off[:, :, -n_unknowns:]
    return x


def renumbered(
    transcribed: Transcribed, problem: Problem, x: np.ndarray, tightenings: tuple[Tightening, ...] = ()
) -> Transcribed:
    """Return a program with the numbers of another problem, without building it again.

    Args:
        transcribed: program of a problem with the same mechanism, kind, objective terms, mesh and kinds of limits.
        problem: gives the new numbers.
        x: unknowns to start from, usually the last solution; a fixed duration is replaced by the new problem's.
        tightenings: see `transcribe`.
    """
    again = renumbered_with(transcribed, _with_numbers_of(problem, transcribed, tightenings), x)
    origin = transcribed.origin
    weights = tie_weights(problem, origin.ties)
    return replace(again, origin=replace(origin, mechanism=problem.mechanism, tie_weights=weights))


def is_program_of(transcribed: Transcribed, problem: Problem) -> bool:
    """Check that a program has the rows of a problem; a program for other limits has different rows."""
    own, asked = transcribed.formulation, _with_numbers_of(problem, transcribed)
    return (
        repr(own.rows) == repr(asked.rows)
        and own.path.shape == asked.path.shape
        and len(own.boundaries) == len(asked.boundaries)
    )


def _with_numbers_of(problem: Problem, transcribed: Transcribed, tightenings: tuple[Tightening, ...] = ()) -> Formulation:
    origin, rows = transcribed.origin, transcribed.formulation.rows
    return formulate(
        problem,
        origin.scales,
        position_rows=rows.position_columns,
        enclosed=rows.encloses,
        tightenings=tightenings,
        smoothing=origin.smoothing,
        ties=origin.ties,
    )


def own_objective(transcribed: Transcribed, objective: float, motion: Trajectory) -> float:
    """Return a motion's objective in SI without the terms that its program adds for smoothing and breaking ties.

    They are smoothing x unit x T x integral of (u' / U)^2 dt over all actuators, and the integral of ties x u^2 dt; both are
    exact for the efforts' polynomials.
    """
    origin: Origin = transcribed.origin
    if origin.smoothing:
        slope = PiecewisePolynomial(motion.effort / origin.scales.effort, motion.breaks_s).derivative().coefficients
        weight = origin.smoothing * transcribed.units.objective * origin.scales.time_s
        objective -= weight * float(_integrated_squares(slope, motion).sum())
    if np.any(origin.tie_weights):
        objective -= float(origin.tie_weights @ _integrated_squares(motion.effort, motion))
    return objective


def _integrated_squares(coefficients: np.ndarray, motion: Trajectory) -> np.ndarray:
    """Return the integrals (n_u,) of the squares of polynomials with coefficients (degree + 1, n, n_u) along a motion."""
    squares = np.einsum("ikl,ij,jkl->kl", coefficients, bernstein_gram(len(coefficients) - 1), coefficients)
    return np.diff(motion.breaks_s) @ squares


def _start(problem: Problem, guess: Guess, scales: Scales, formulation: Formulation) -> Start:
    """Return a guess as a scaled start, with closed loops, and efforts by inverse dynamics if the guess has none."""
    mechanism = problem.mechanism
    rate, n_unknowns = scales.position / scales.time_s, _n_unknowns(problem, formulation)

    def states(times: np.ndarray) -> np.ndarray:
        return np.hstack([guess.position(times) / scales.position, guess.velocity(times) / rate])

    def nodes(times: np.ndarray):
        v, a = guess.velocity(times), guess.acceleration(times)
        poses = poses_along(mechanism, guess, times, problem.solver.deadline)
        if guess.effort is not None:
            effort = guess.effort(times)
        else:
            effort, _ = needed_efforts(problem, poses, v, a, times)
        algebraic = poses[:, mechanism.dependent]
        if formulation.n_z > algebraic.shape[1]:
            maps = sampled(mechanism.dynamics.effort_map, poses)
            spent = np.maximum(effort * np.einsum("ksu,ks->ku", maps, v) / scales.power, 0.0)
            n_works = formulation.n_z - algebraic.shape[1] - n_unknowns
            algebraic = np.column_stack([algebraic, spent[:, :n_works], np.zeros((len(times), n_unknowns))])
        return a / (rate / scales.time_s), np.zeros((len(times), 0)), algebraic, effort

    return Start(states=states, nodes=nodes, share_of_effort=guess.share_of_effort)


def trajectory_of(transcribed: Transcribed, x: np.ndarray, limit: np.ndarray | None = None) -> Trajectory:
    """Return the motion of a program's unknowns x (n,), with efforts clipped to `limit`, by default the program's."""
    limit, origin = transcribed.formulation.effort if limit is None else limit, transcribed.origin
    curves = curves_of(transcribed, x, limit)
    return Trajectory(
        breaks_s=curves.breaks_s,
        position=curves.position,
        velocity=curves.velocity,
        effort=curves.effort,
        start_pose=close_at(origin.mechanism, curves.position[0, 0], origin.start_pose),
        periodic=transcribed.formulation.periodic,
    )
