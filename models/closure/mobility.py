"""Mobility: distinguish a mechanism's weak constraints from constraints that only rounding of the file creates.

A small singular value of J may lock a motion, or it may result from joint axes written with seven digits. A finite motion
decides: it is made with the loops closed by least squares without the weak constraint, and the remaining gap is measured.
If the gap stays within `closure_tolerance_m` the motion is free, as it is in a machine with bearing play and in a simulator.
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.closure import newton
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.closure.rank import RANK_TOLERANCE, ROUNDING_SHARE, WEAK_SHARE
from linkplan.models.errors import ModelError

# Length of a trial motion and of its Newton steps [rad; extents on a slide].
_TRIAL_LENGTH = 0.75
_TRIAL_STEP = 0.05
# Shortest trial motion that gives a gap [rad; extents on a slide]: a shorter one ended at an end of reach.
_LEAST_TRIAL_LENGTH = 0.1
# A weak singular value that grows by more than this factor on the way is not rounding but a fold nearby.
_MAX_ROUNDING_GROWTH = 30.0
# Singular values above this share of the largest, but below the rank's tolerance, contain rounding of the file.
_EXACT_RANK_SHARE = 1e-13


def closure_tolerance(asked: float | None, extent_m: float) -> float:
    """Return the asked closure tolerance [m], by default 1e-6 m but at most 1e-5 of the mechanism's extent.

    Raises:
        ModelError: if the tolerance is not a length in the legal range.
    """
    if asked is None:
        return min(1e-6, 1e-5 * extent_m)
    if not newton.CLOSED_M <= asked <= extent_m:
        raise ModelError(
            f"mechanism.closure_tolerance_m is a length from {newton.CLOSED_M:g} m to the mechanism's size,"
            f" {extent_m:.3g} m, got {asked!r}"
        )
    return float(asked)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Mobility:
    """The loop with the tolerances that fit its file, and the gaps of the trial motions.

    `freed_m` are the gaps [m] of motions that count as free. `locked` holds the directions (n_q,) and gaps [m] of motions
    that count as locked.
    """

    loop: KinematicLoop
    freed_m: tuple[float, ...]
    locked: tuple[tuple[np.ndarray, float], ...]
    noise: float  # largest singular value due to rounding of the file, as a share of the largest; 0 without rounding


def judge_mobility(loop: KinematicLoop, pose: np.ndarray, tolerance_m: float) -> Mobility:
    """Return the closure's mobility and tolerances from trial motions at a closed pose (n_q,).

    `tolerance_m` is the gap [m] allowed for bearing play and rounding.
    """
    jacobian = loop.jacobian(pose)
    if (
        loop.gap(loop.residual(pose)[0]) > loop.closed_m
    ):  # the points of the file are rounded, and the gap cannot get smaller
        loop = replace(loop, closed_m=tolerance_m)
    if not jacobian.size:
        return Mobility(loop=loop, freed_m=(), locked=(), noise=0.0)
    values, directions = _all_values(jacobian)
    share = values / max(values[0], np.finfo(float).tiny)
    freed, locked, rank = [], [], int(np.sum(share > RANK_TOLERANCE))
    while rank > 1 and share[rank - 1] < WEAK_SHARE:
        cut = float(np.sqrt(share[rank - 2] * share[rank - 1]))
        free_loop = replace(loop, rank_tolerance=cut, closed_m=tolerance_m)
        gap = _gap_of_motion(free_loop, pose, directions[rank - 1], rank - 1)
        if gap > tolerance_m:
            weak = [directions[k] for k in range(rank) if share[k] < WEAK_SHARE]
            locked = [(direction, _gap_of_step(loop, pose, direction)) for direction in weak]
            break
        freed.append(gap)
        rank -= 1
    noise = float(share[rank]) if rank < len(share) else 0.0
    if noise <= _EXACT_RANK_SHARE:
        return Mobility(loop=loop, freed_m=(), locked=tuple(locked), noise=0.0)
    if freed:
        cut = float(np.sqrt(share[rank - 1] * noise))
        rank_tolerance = max(RANK_TOLERANCE, min(cut, _MAX_ROUNDING_GROWTH**2 * noise))
        loop = replace(loop, rank_tolerance=rank_tolerance, closed_m=tolerance_m)
    else:
        loop = replace(loop, closed_m=tolerance_m)
    return Mobility(loop=loop, freed_m=tuple(freed), locked=tuple(locked), noise=noise)


def _all_values(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the singular values (n_q,) of a Jacobian, zero beyond its rows, and their directions (n_q, n_q)."""
    _, values, directions = np.linalg.svd(jacobian)
    return np.append(values, np.zeros(len(directions) - len(values))), directions


def _gap_of_motion(loop: KinematicLoop, pose: np.ndarray, direction: np.ndarray, rank: int) -> float:
    """Return the largest gap [m] of a trial motion along `direction`, infinite if neither sense can be followed."""
    gaps = []
    for sign in (1.0, -1.0):
        q, worst, made = np.array(pose), 0.0, 0.0
        along = sign * direction / np.abs(direction).max()
        while made < _TRIAL_LENGTH:
            trial, gap = newton.close(loop, q + _TRIAL_STEP * loop.unit * along)
            values, right = _all_values(loop.jacobian(trial))
            if gap > loop.closed_m or values[rank] > _MAX_ROUNDING_GROWTH * loop.rank_tolerance * values[0]:
                break
            moved = (trial - q) / loop.unit
            worst, made, q = max(worst, gap), made + float(np.abs(moved).max()), trial
            if not np.any(moved):
                break
            free = right[rank:]
            along = free.T @ (free @ moved)  # continue in the same direction, tangent to the loops
            along /= max(float(np.abs(along).max()), np.finfo(float).tiny)
        if made >= _LEAST_TRIAL_LENGTH:
            gaps.append(worst)
    return min(gaps, default=np.inf)


def _gap_of_step(loop: KinematicLoop, pose: np.ndarray, direction: np.ndarray) -> float:
    """Return the least gap [m] after one step along `direction`, with the joint that moves most held there."""
    lead = int(np.argmax(np.abs(direction)))
    trial = pose + _LEAST_TRIAL_LENGTH * loop.unit * direction / np.abs(direction[lead])
    return newton.least_gap(loop, trial, [i for i in range(len(pose)) if i != lead])


def lost_freedoms(joints, actuators, dynamics, poses, mobility: Mobility, tolerance_m: float) -> list[str]:
    """Return notes on motions that rounding frees or locks, on joints that the loops lock and on idle actuators.

    Args:
        joints: of the mechanism.
        actuators: of the mechanism.
        dynamics: its reduced dynamics.
        poses: closed poses (n_q,).
        mobility: of the mechanism.
        tolerance_m: the allowed gap [m].
    """
    gammas = [np.array(dynamics.velocity_map(q)) for q in poses]
    largest = max(float(np.abs(gamma).max(initial=0.0)) for gamma in gammas)
    still = [
        joint.name
        for i, joint in enumerate(joints)
        if all(np.abs(gamma[i]).max(initial=0.0) <= ROUNDING_SHARE * largest for gamma in gammas)
    ]
    locked = [f"the loops lock joint{'s' if len(still) > 1 else ''} {', '.join(still)}"] if still else []
    maps = [np.array(dynamics.effort_map(q)).reshape(gammas[0].shape[1], -1) for q in poses]
    full = [np.array(dynamics.effort_matrix(q)).reshape(len(joints), -1) for q in poses]
    idle = [
        f"actuator {actuator.name} has no effect: the loops lock {actuator.target}"
        for j, actuator in enumerate(actuators)
        if all(
            np.abs(m[:, j]).max() <= ROUNDING_SHARE * max(np.abs(b[:, j]).max(), ROUNDING_SHARE)
            for m, b in zip(maps, full, strict=True)
        )
    ]
    return [*_rounding_notes(joints, mobility, tolerance_m), *locked, *idle]


def _rounding_notes(joints, mobility: Mobility, tolerance_m: float) -> list[str]:
    """Return notes on the motions that count as free and on those that count as locked."""
    notes = []
    if mobility.freed_m:
        n, gap = len(mobility.freed_m), max(mobility.freed_m)
        motions = "1 motion counts" if n == 1 else f"{n} motions count"
        notes.append(
            f"{motions} as free that only rounding of the file locks: the loops open by {gap:.2g} m along"
            f" {'it' if n == 1 else 'them'} (closure_tolerance_m = {tolerance_m:g})"
        )
    for direction, gap in mobility.locked:
        lead = joints[int(np.argmax(np.abs(direction)))]
        notes.append(
            f"a motion of joint {lead.name} is locked by slightly inaccurate joint axes or points: after 0.1 rad the loops"
            f" open by {gap:.2g} m (closure_tolerance_m = {tolerance_m:g})"
        )
    return notes
