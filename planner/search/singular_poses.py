"""The distance of a motion from singular poses."""

import numpy as np

from linkplan.models.poses.along import sampled
from linkplan.planner.closed_chain.guess import Guess, poses_along
from linkplan.planner.problem.problem import Problem

# A motion nears a singular pose if its least distance is below this share of that at its ends, at so many instants.
NEAR_SHARE, N_SAMPLES = 0.5, 1001


def nears_singular(problem: Problem, guess: Guess) -> bool:
    """True if a motion comes much nearer to a singular pose than its ends do."""
    nearest = _singular_margin(problem, guess, np.linspace(0.0, guess.duration_s, N_SAMPLES))
    return nearest < NEAR_SHARE * _singular_margin(problem, guess, np.array([0.0, guess.duration_s]))


def _singular_margin(problem: Problem, guess: Guess, times: np.ndarray) -> float:
    """Return the least |det J_z| of a kinematic loop at times (n,) [s] of a guess, as a share of home's; else infinite."""
    singularity = problem.mechanism.dynamics.block_singularity
    poses = poses_along(problem.mechanism, guess, times, problem.solver.deadline)
    share = sampled(singularity, poses)[:, :, 0] / np.array(singularity(problem.mechanism.home)).ravel()
    return float(np.abs(share).min(initial=np.inf))
