"""Motions of any mechanism without a solver: from rest to rest with ripples, with efforts by inverse dynamics."""

from dataclasses import replace

import numpy as np

from linkplan.models.actuation.distribution import distribute
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import demanded
from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import Samples
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import PiecewisePolynomial, bernstein_matrix
from tests.support.motions import motion_along

INTERVALS = 3
_EFFORT_DEGREE = 4


def motion_of(mechanism: Mechanism, rng: np.random.Generator, size: float = 0.25) -> tuple[Problem, Trajectory]:
    """Return a problem without limits and a motion from home, from rest to rest, with efforts by inverse dynamics.

    `size` is how far each coordinate moves, in radians or as a share of the extent.
    """
    independent = list(mechanism.independent)
    begin = np.array(mechanism.home[independent], dtype=float)
    unit = np.array([1.0 if joint.kind == "hinge" else 0.3 * mechanism.extent_m for joint in mechanism.independent_joints])
    for _ in range(40):
        goal = begin + size * unit * rng.uniform(0.5, 1.0, len(begin)) * rng.choice([-1, 1], len(begin))
        duration = float(rng.uniform(0.4, 1.2))
        try:
            return _along(mechanism, begin, goal, np.linspace(0.0, duration, INTERVALS + 1), rng)
        except AssemblyError:
            size *= 0.8  # beyond the reach
    raise AssemblyError("no motion from home")


def _along(mechanism: Mechanism, begin, goal, breaks, rng) -> tuple[Problem, Trajectory]:
    share = (breaks / breaks[-1])[:, None]
    ripple = 0.1 * np.sin(np.pi * share) ** 2 * rng.normal(size=(len(breaks), len(begin)))
    place = begin + (goal - begin) * (share**3 * (10 - 15 * share + 6 * share**2) + ripple)
    speed = np.gradient(place, breaks, axis=0)
    speed[[0, -1]], place[0], place[-1] = 0.0, begin, goal
    position = PiecewisePolynomial.through(breaks, place, speed).coefficients
    effort = np.zeros((_EFFORT_DEGREE + 1, INTERVALS, mechanism.n_u))
    motion = motion_along(breaks, position, effort=effort, start_pose=mechanism.home)
    q = follow(mechanism, motion.position_at(motion.dense_times(40)), motion.start_pose)
    ratios = np.array(mechanism.dynamics.block_singularity.map(len(q))(q.T)).T.reshape(len(q), -1)
    if (np.abs(ratios).min(axis=0) < 0.2 * np.abs(ratios[0])).any():
        raise AssemblyError("next to a singular pose")
    start, goals = ({"deg": {}, "m": {}} for _ in range(2))
    for joint, first, last in zip(mechanism.independent_joints, begin, goal, strict=True):
        start[joint.unit][joint.name], goals[joint.unit][joint.name] = joint.shown(first), joint.shown(last)
    said = {f"{name}_{unit}": of[unit] for name, of in (("start", start), ("goal", goals)) for unit in of if of[unit]}
    tables = {"motion": {"kind": "reach", "duration_s": float(breaks[-1]), **said}, "objective": {"minimize": "effort"}}
    problem = Problem.from_tables("spoilt", tables, mechanism=mechanism)
    problem = problem.varied(motion=replace(problem.motion, start=begin, goal=goal))
    wide = replace(problem.limits, effort=free_bounds(mechanism.n_u), position=free_bounds(mechanism.n_q))
    problem = problem.varied(limits=wide)
    return problem, with_efforts(problem, motion)


def with_efforts(problem: Problem, motion: Trajectory) -> Trajectory:
    """Return a motion whose planned efforts pass through those by inverse dynamics at five instants of every interval."""
    shares = np.linspace(0, 1, _EFFORT_DEGREE + 1)
    basis = bernstein_matrix(_EFFORT_DEGREE, shares)
    shares[-1] = 1 - 1e-12
    values = needed(problem, motion, motion.times_at(shares)).reshape(INTERVALS, _EFFORT_DEGREE + 1, -1)
    columns = values.transpose(1, 0, 2).reshape(_EFFORT_DEGREE + 1, -1)
    return replace(motion, effort=np.linalg.solve(basis, columns).reshape(motion.effort.shape))


def samples_at(problem: Problem, motion: Trajectory, time: np.ndarray) -> Samples:
    """Return the certificate's samples at any times (n,)."""
    q = follow(problem.mechanism, motion.position_at(time), motion.start_pose)
    return Samples(problem=problem, trajectory=motion, points=np.linspace(0, 1, len(time)), time=time, q=q)


def needed(problem: Problem, motion: Trajectory, time: np.ndarray) -> np.ndarray:
    """Return the efforts (n, n_u) by inverse dynamics: the planned ones plus the least that compensate the difference."""
    at = samples_at(problem, motion, time)
    tau, maps = demanded(problem.mechanism, at.q, at.v, at.a)
    return distribute(tau, maps, np.array([-np.inf, np.inf]), at.u)
