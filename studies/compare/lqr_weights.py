"""The errors and efforts of equal weight in LQR's cost, scaled by the inertia of each joint and the effort limits."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import felt_inertia, sampled
from linkplan.planner.problem.settings import Tracking

# The inertia of a longer motion is computed at about this many poses.
_MOST_POSES = 64


def unit_effort(effort_limit: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Return the efforts (n_u,) [N.m or N] of unit cost: the limits (n_u, 2) or else `effort` (n_u,), at least 1."""
    limit = np.abs(np.asarray(effort_limit, dtype=float)).max(axis=1)
    return np.where(np.isfinite(limit), limit, np.maximum(effort, 1.0))


def scaled(settings: Tracking, mechanism: Mechanism, pose: np.ndarray, unit: np.ndarray) -> Tracking:
    """Return settings with every LQR error set, from the accelerations under efforts `unit` (n_u,) at poses (n, n_q)."""
    pose = pose[:: -(-len(pose) // _MOST_POSES)]
    n, n_s, n_u = len(pose), mechanism.dof, mechanism.n_u
    outputs = mechanism.dynamics.linearisation.map(n)(pose.T, np.zeros((n_s, n)), np.zeros((n_u, n)))
    by_effort = np.array(outputs[2]).reshape(n_s, n, n_u).transpose(1, 0, 2)
    reached = np.abs(by_effort) @ unit
    # Behind a soft loop, an effort initially accelerates little more than its own link.
    effort = np.abs(sampled(mechanism.dynamics.reduced_inertia, pose) @ by_effort) @ unit
    felt = np.array([felt_inertia(mechanism, at) for at in pose])
    most = np.where(mechanism.actuated, np.maximum(reached, effort / felt).max(axis=0), 0.0)
    period = max(settings.period_s, float(mechanism.model.opt.timestep))
    return settings.with_lqr_errors(mechanism.independent_joints, most, period)
