"""Coordinates that nothing but damping acts on: a motion that does not name them ends where their momentum takes them."""

import functools

import numpy as np

from linkplan.models.closure.rank import FILE_ROUNDING_SHARE
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.tree.joints import unit_steps


@functools.lru_cache(maxsize=8)
def coasting_freedoms(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the steered coordinates (columns) s_k whose momentum p = M_k(s) s' obeys p' = -d s_k', with constant d >= 0.

    No actuator, spring, weight or dry friction acts on them, as on a cart on a rail or the vertical axis of a boom. Inverse
    dynamics at random closed poses and speeds about home are compared with this law.
    """
    dynamics, n_s = mechanism.dynamics, mechanism.dof
    arms = np.abs(np.array(dynamics.effort_map(mechanism.home))).max(axis=1, initial=0.0)
    undriven = np.flatnonzero((arms == 0) & mechanism.steered)
    if not undriven.size:
        return ()
    random, step = np.random.default_rng(0), 1e-4
    unit, home = unit_steps(mechanism.independent_joints, mechanism.extent_m), mechanism.home[mechanism.independent]
    places, speeds = unit * random.uniform(-1.0, 1.0, (2, 4, n_s))
    lost, gained = np.empty((2, 4, n_s))
    try:
        for k, v in enumerate(speeds):
            q = close_at(mechanism, home + 0.1 * places[k])
            ahead, behind = (close_at(mechanism, q[mechanism.independent] + side * step * v, q) for side in (1, -1))
            change = np.array(dynamics.reduced_inertia(ahead)) - np.array(dynamics.reduced_inertia(behind))
            gained[k] = change @ v / (2 * step)
            lost[k] = np.array(dynamics.inverse_dynamics(q, v, np.zeros(n_s))).ravel() - gained[k]
    except AssemblyError:  # near a singular pose
        return ()
    damping = np.sum(lost * speeds, axis=0) / np.sum(speeds**2, axis=0)
    apart = np.abs(lost - damping * speeds).max(axis=0) * unit
    return tuple(undriven[apart[undriven] < FILE_ROUNDING_SHARE * np.abs(gained * unit).max()].tolist())
