"""Motions of random four-bars without a solver, whose limits are placed beside what they need."""

from dataclasses import replace

import numpy as np

from linkplan.models.actuation.distribution import distribute
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import demanded
from linkplan.models.poses.assembly import close_at, follow
from linkplan.planner.limits.efforts import INVERSE_DYNAMICS_SHARE
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import PiecewisePolynomial
from tests.support.four_bars import PLAIN, load
from tests.support.mechanisms import random_four_bar, replaced
from tests.support.motions import motion_along

INTERVALS = 4
# Nearer to a singular pose, relative to home, a proof takes thousands of boxes.
_LEAST_RATIO = 0.1


def swing(seed: int) -> tuple[Problem, Trajectory]:
    """Return a problem of a random four-bar and a motion that solves it, from rest to rest with random ripples.

    Its efforts are polynomials through the efforts by inverse dynamics. The limit on effort is wide.
    """
    rng = np.random.default_rng(seed)
    while True:
        try:
            problem, motion = _swing(rng, load(random_four_bar(rng), seed))
        except AssemblyError:
            continue  # beyond the reach: another one
        if samples_of(problem, motion).block_ratios.min() > _LEAST_RATIO:
            return problem, motion


def rubbing_swing() -> tuple[Problem, Trajectory]:
    """Return a motion of a crank-rocker with dry friction at its crank, slow at its ends."""
    text = replaced(PLAIN, '<joint name="O"', '<joint name="O" frictionloss="0.05"')
    return _swing(np.random.default_rng(0), load_mechanism(text))


def _swing(rng: np.random.Generator, mechanism: Mechanism) -> tuple[Problem, Trajectory]:
    begin = float(mechanism.home[mechanism.independent][0])
    goal = begin + float(rng.uniform(0.2, 0.5) * rng.choice([-1, 1]))
    breaks = np.linspace(0.0, float(rng.uniform(0.4, 1.2)), INTERVALS + 1)
    position = _positions(begin, goal, breaks, rng)
    start = np.array(close_at(mechanism, np.array([begin])))
    velocity = PiecewisePolynomial(position, breaks).derivative().coefficients
    trajectory = motion_along(breaks, position, velocity=velocity, effort=np.zeros((5, INTERVALS, 1)), start_pose=start)
    trajectory = replace(trajectory, effort=_efforts(mechanism, trajectory))
    angles = {name: np.degrees(x) for name, x in (("start", begin), ("goal", goal))}
    name = mechanism.independent_joints[0].name
    problem = Problem.reach(
        mechanism,
        start_deg={name: angles["start"]},
        goal_deg={name: angles["goal"]},
        duration_s=trajectory.duration_s,
        minimize="effort",
    )
    exact = replace(problem.motion, start=position[0, 0], goal=position[-1, -1])
    return limited(problem.varied(motion=exact), 10 * np.abs(trajectory.effort).max()), trajectory


def limited(problem: Problem, size: float) -> Problem:
    """Return the problem with a symmetric limit on its effort."""
    return problem.varied(limits=replace(problem.limits, effort=np.array([[-size, size]])))


def _positions(begin: float, goal: float, breaks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return Bernstein coefficients of quintics through ripples on a smooth step."""
    share = breaks / breaks[-1]
    step = share**3 * (10 - 15 * share + 6 * share**2)
    ripple = 0.05 * np.sin(np.pi * share) ** 2 * rng.normal(size=len(share))
    place = begin + (goal - begin) * (step + ripple)
    speed = np.gradient(place, breaks)
    speed[[0, -1]] = 0.0
    place[[0, -1]] = begin, goal
    return PiecewisePolynomial.through(breaks, place[:, None], speed[:, None]).coefficients


def _efforts(mechanism: Mechanism, trajectory: Trajectory) -> np.ndarray:
    shares = np.linspace(0, 1, 5)
    basis = np.array([[float(b) for b in _bernstein_row(4, t)] for t in shares])
    shares[-1] = 1 - 1e-12
    values = needed(mechanism, trajectory, trajectory.times_at(shares)).reshape(INTERVALS, 5)
    return np.linalg.solve(basis, values.T)[:, :, None]


def _bernstein_row(degree: int, t: float) -> np.ndarray:
    k = np.arange(degree + 1)
    of = np.array([1, 4, 6, 4, 1])
    return of * t**k * (1 - t) ** (degree - k)


def needed(mechanism: Mechanism, trajectory: Trajectory, time: np.ndarray) -> np.ndarray:
    """Return the efforts (n,) by inverse dynamics at times (n,)."""
    q = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    tau, maps = demanded(mechanism, q, trajectory.slope_at(time), trajectory.acceleration_at(time))
    return distribute(tau, maps, np.array([-np.inf, np.inf]))[:, 0]


def peak(mechanism: Mechanism, trajectory: Trajectory) -> float:
    """Return the largest absolute effort by inverse dynamics: a fine grid, refined about its largest value."""
    time = trajectory.times_at(np.append(np.linspace(0, 1, 200, endpoint=False), 1 - 1e-12))
    for _ in range(3):
        values = np.abs(needed(mechanism, trajectory, time))
        at = int(np.argmax(values))
        around = time[max(at - 1, 0) : at + 2]
        time = np.linspace(around[0], around[-1], 41)
    return float(np.abs(needed(mechanism, trajectory, time)).max())


def beside_its_limit(seed: int, share: float) -> tuple[Problem, Trajectory]:
    """Return a random four-bar's motion whose largest effort is the pass mark times 1 + `share`."""
    problem, motion = swing(seed)
    largest = peak(problem.mechanism, motion)
    return limited(problem, largest / (1 + INVERSE_DYNAMICS_SHARE) / (1 + share)), replace(motion, effort=0 * motion.effort)


def with_a_spoilt_coefficient(seed: int) -> tuple[Problem, Trajectory]:
    """Return a motion with a coefficient moved: its largest effort exceeds the pass mark by 1e-6 between the samples."""
    problem, motion = swing(seed)
    mechanism, rng = problem.mechanism, np.random.default_rng(seed)
    at = int(rng.integers(2, 4)), int(rng.integers(INTERVALS)), 0
    way = max((1e-3, -1e-3), key=lambda by: peak(mechanism, _moved(motion, at, by)))
    found = _moved(motion, at, way)
    return limited(problem, peak(mechanism, found) / (1 + INVERSE_DYNAMICS_SHARE + 1e-6)), found


def _moved(motion: Trajectory, at: tuple, by: float) -> Trajectory:
    position = np.array(motion.position)
    position[at] += by
    slope = 5 * np.diff(position, axis=0) / np.diff(motion.breaks_s)[:, None]
    return replace(motion, position=position, velocity=slope)
