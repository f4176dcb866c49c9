"""The period of a coordinate: how far it travels until the mechanism may be as it was.

A crank is back after a turn. The motor behind a gear of 20 has turned twenty times by then, and the motor of a lead screw
never brings its nut back. Only joints whose position matters must return: a balanced rotor feels the same at every angle.
"""

import functools

import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import RANGE_ROUNDING, sampled, whole_turns
from linkplan.models.tree.joints import unit_steps

# Poses at which a joint's influence is examined.
_EXAMINED_POSES = 3
_GOLDEN_RATIO = 0.5 * (1 + np.sqrt(5))


@functools.lru_cache(maxsize=16)
def mattering(mechanism: Mechanism) -> np.ndarray:
    """Return a mask (n_q,) of the joints whose position matters: slides, and hinges that the reduced dynamics depend on."""
    return np.array([not joint.turns or _matters(mechanism, j) for j, joint in enumerate(mechanism.joints)])


@functools.lru_cache(maxsize=256)
def _matters(mechanism: Mechanism, j: int) -> bool:
    """Return True if the reduced dynamics depend on the position of joint j.

    Inverse dynamics, transmission and rates are compared at poses around home while the joint is turned alone, without
    closing the loops.
    """
    n_q, n_s, unit = mechanism.n_q, mechanism.dof, unit_steps(mechanism.joints, mechanism.extent_m)
    # Irregular numbers from 0 to 1, so that the motions are generic.
    spread = np.modf(_GOLDEN_RATIO * np.arange(_EXAMINED_POSES * (n_q + 2 * n_s)))[0].reshape(_EXAMINED_POSES, -1)
    poses = mechanism.home + 0.1 * unit * (2 * spread[:, :n_q] - 1)
    moved = poses.copy()
    moved[:, j] += 0.7 * unit[j]
    v, a = 0.5 + 0.5 * spread[:, n_q : n_q + n_s], 0.5 + 0.5 * spread[:, n_q + n_s :]
    before, after = (_influence(mechanism, v, a, at) for at in (poses, moved))
    size = np.abs(before).max(axis=(0, 2), keepdims=True)
    same = np.abs(after - before) <= ROUNDING_SHARE * np.where(size > 0, size, 1.0)
    return not np.all(same)  # NaN matters


def _influence(mechanism: Mechanism, v: np.ndarray, a: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return inverse dynamics, transmission and rates (n, 3, m) at poses (n, n_q), filled up with zeros."""
    dynamics = mechanism.dynamics
    parts = [sampled(dynamics.inverse_dynamics, poses, v, a)]
    parts += [sampled(function, poses) for function in (dynamics.effort_map, dynamics.velocity_map)]
    flat = [part.reshape(len(poses), -1) for part in parts]
    width = max(part.shape[1] for part in flat)
    return np.stack([np.pad(part, ((0, 0), (0, width - part.shape[1]))) for part in flat], axis=1)


@functools.lru_cache(maxsize=16)
def travel_scales(mechanism: Mechanism) -> np.ndarray:
    """Return how much farther than usual each coordinate (n_s,) travels for the same change of the mechanism, at home.

    It is 1 for a joint whose position matters. For a rotor that only drives others through gears or screws it is the least
    ratio of its travel to that of a joint that matters, in units of 1 rad and of the extent: 20 for a motor behind a gear of
    20.
    """
    gamma = np.abs(np.array(mechanism.dynamics.velocity_map(mechanism.home)))
    return np.array([_slowness(mechanism, k, gamma[:, k]) for k in range(mechanism.dof)])


def _slowness(mechanism: Mechanism, coordinate: int, rates: np.ndarray) -> float:
    """Return the ratio of a rotor's travel to that of the fastest joint that matters, at rates (n_q,), or 1."""
    unit, index = unit_steps(mechanism.joints, mechanism.extent_m), int(mechanism.independent[coordinate])
    share = rates * unit[index] / unit
    share[index] = 0.0
    if not mechanism.joints[index].turns or not ROUNDING_SHARE < share.max(initial=0.0) < 1.0 or _matters(mechanism, index):
        return 1.0
    moving = share[mattering(mechanism)]
    return 1.0 / float(moving.max() if np.any(moving) else share.max())


def turn_of(mechanism: Mechanism, coordinate: int) -> float:
    """Return the travel [rad] after which an independent hinge may be back: a turn, or the turn of what its gear drives.

    What drives slides alone never comes back; the travel is then that in which they move by about the mechanism's extent.
    """
    return float(_turns(mechanism)[coordinate])


@functools.lru_cache(maxsize=16)
def _turns(mechanism: Mechanism) -> np.ndarray:
    """Return the travel of `turn_of` for all coordinates (n_s,)."""
    gamma, n_q = mechanism.dynamics.velocity_map, mechanism.n_q
    varies = np.zeros(n_q * mechanism.dof, dtype=bool)
    varies[gamma.jac_sparsity(0, 0).row()] = True
    varies = varies.reshape((n_q, mechanism.dof), order="F")
    hinges = np.array([joint.turns for joint in mechanism.joints])
    geared = (hinges & mattering(mechanism))[:, None] & ~varies
    rates = np.where(geared, np.abs(np.array(gamma(mechanism.home))), 0.0)
    scales = [
        _slowness(mechanism, k, rates[:, k]) if np.any(rates[:, k]) else travel_scales(mechanism)[k]
        for k in range(mechanism.dof)
    ]
    return 2 * np.pi * np.array(scales)


def returned(mechanism: Mechanism, travelled: np.ndarray) -> np.ndarray | None:
    """Return the part of the joints' travel (n_q,) [rad or m] that changes nothing, if that is all the travel; else None.

    This part consists of whole turns of hinges, and of any travel of rotors
    whose position does not matter, beside joints that do move.
    """
    matters = mattering(mechanism)
    rounding = RANGE_ROUNDING * np.maximum(1.0, np.abs(travelled))
    if not np.any(matters & (np.abs(travelled) > rounding)):
        matters = np.ones(len(matters), dtype=bool)
    gone = np.where(matters, whole_turns(mechanism, travelled), travelled)
    return gone if np.all(np.abs(travelled - gone) <= rounding) else None
