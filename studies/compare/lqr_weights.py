"""The errors and efforts of equal weight in LQR's cost, scaled by the machine's inertia and effort limits."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.settings import Tracking

# Of a longer motion, about as many poses are asked for their inertia.
_MOST_POSES = 64


def unit_effort(effort_limit: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Return the efforts (n_u,) [N.m or N] of unit cost: the limits (n_u, 2), else `effort` (n_u,), at least 1."""
    limit = np.abs(np.asarray(effort_limit, dtype=float)).max(axis=1)
    return np.where(np.isfinite(limit), limit, np.maximum(effort, 1.0))


def scaled(settings: Tracking, mechanism: Mechanism, pose: np.ndarray, unit: np.ndarray) -> Tracking:
    """Return settings with every LQR error set, by the acceleration under efforts `unit` (n_u,) at poses (n, n_q)."""
    pose = pose[:: -(-len(pose) // _MOST_POSES)]
    n, n_s, n_u = len(pose), mechanism.dof, mechanism.n_u
    outputs = mechanism.dynamics.linearisation.map(n)(pose.T, np.zeros((n_s, n)), np.zeros((n_u, n)))
    reached = np.abs(np.array(outputs[2]).reshape(n_s, n, n_u)) @ unit
    most = np.where(mechanism.steered, reached.max(axis=1), 0.0)
    period = max(settings.period_s, float(mechanism.model.opt.timestep))
    return settings.with_lqr_errors(mechanism.independent_joints, most, period)
