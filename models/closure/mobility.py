"""Mobility: which of a closure's weak constraints are a mechanism's, and which a file's rounding.

A singular value of J that is small beside the others may lock a motion, or be what is left of joint axes written with seven
digits: numbers alone do not tell. The motion does: it is tried by a finite amount, the loops are closed by least squares
without the weak constraint, and what stays open is a length. Within `closure_tolerance_m` the motion is free, as it is in a
machine with play in its bearings and in a simulator.
"""

import numbers
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.closure import newton
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.closure.rank import RANK_TOLERANCE, WEAK
from linkplan.models.errors import ModelError

# How far a doubtful motion is tried [rad; on a slide, of the model's extent]: half a right angle, in steps for Newton.
_TRIED = 0.75
_STEP = 0.05
# A doubtful motion counts as tried where so much of it was made: less is next to an end of the reach.
_LEAST_TRIED = 0.1
# The weak singular value may grow by this factor on the way and still be rounding; a pose next to a fold shows more.
_GROWTH = 30.0
# Exact dependence leaves singular values below this share of the largest: beyond it there is rounding of a file in them.
_EXACT = 1e-13
# Rates and moments below this share of the largest are rounding.
_NOTHING = 1e-9
# By default a loop may gape by so much [m], a file's rounding, and by no more than this share of a small mechanism.
_TOLERANCE_M, _TOLERANCE_SHARE = 1e-6, 1e-5


def closure_tolerance(asked: float | None, extent_m: float) -> float:
    """Return the gap [m] that is allowed where rounding alone forbids a motion: as asked, or by the mechanism's size.

    Raises:
        ModelError: for a tolerance that is none.
    """
    if asked is None:
        return min(_TOLERANCE_M, _TOLERANCE_SHARE * extent_m)
    number = isinstance(asked, numbers.Real) and not isinstance(asked, bool)
    if not number or not newton.CLOSED_M <= asked <= extent_m:
        raise ModelError(
            f"mechanism.closure_tolerance_m is a length from {newton.CLOSED_M:g} m to the mechanism's size,"
            f" {extent_m:.3g} m, got {asked!r}"
        )
    return float(asked)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Mobility:
    """What was found: the loop with the tolerances to judge it by, and what stays open where doubtful motions were tried.

    `freed_m` are gaps [m] of motions taken as free, `locked` the directions (n_q,) of those taken as locked with their gaps.
    """

    loop: KinematicLoop
    freed_m: tuple[float, ...]
    locked: tuple[tuple[np.ndarray, float], ...]
    noise: float  # share of the largest singular value that the file's rounding makes up; 0 where there is none


def judge_mobility(loop: KinematicLoop, pose: np.ndarray, unit: np.ndarray, tolerance_m: float) -> Mobility:
    """Return how the closure is to be judged, from doubtful motions tried at a closed pose.

    Args:
        loop: the closure.
        pose: a closed pose (n_q,).
        unit: what counts as a radian for each joint (n_q,) [rad or m].
        tolerance_m: the gap [m] that bearings and rounding are allowed.
    """
    phi, jacobian = loop.residual(pose)
    jacobian = jacobian * unit
    if loop.gap(phi) > loop.closed_m:  # points of the file that are rounded: nothing closes further
        loop = replace(loop, closed_m=tolerance_m)
    if not jacobian.size:
        return Mobility(loop=loop, freed_m=(), locked=(), noise=0.0)
    _, values, directions = np.linalg.svd(jacobian)
    values = np.append(values, np.zeros(max(0, len(pose) - len(values))))
    share = values / max(values[0], np.finfo(float).tiny)
    freed, locked, rank = [], [], int(np.sum(share > RANK_TOLERANCE))
    while rank > 1 and share[rank - 1] < WEAK:
        cut = float(np.sqrt(share[rank - 2] * share[rank - 1]))
        gap = _tried(replace(loop, rank_tolerance=cut, closed_m=tolerance_m), pose, unit, directions[rank - 1], rank - 1)
        if gap > tolerance_m:
            locked = [(directions[k], _tried_alone(loop, pose, unit, directions[k])) for k in range(rank) if share[k] < WEAK]
            break
        freed.append(gap)
        rank -= 1
    noise = float(share[rank]) if rank < len(share) else 0.0
    if noise <= _EXACT:
        return Mobility(loop=loop, freed_m=(), locked=tuple(locked), noise=0.0)
    if freed:
        cut = float(np.sqrt(share[rank - 1] * noise))
        loop = replace(loop, rank_tolerance=max(RANK_TOLERANCE, min(cut, _GROWTH**2 * noise)), closed_m=tolerance_m)
    else:
        loop = replace(loop, closed_m=tolerance_m)
    return Mobility(loop=loop, freed_m=tuple(freed), locked=tuple(locked), noise=noise)


def _tried(loop: KinematicLoop, pose: np.ndarray, unit: np.ndarray, direction: np.ndarray, rank: int) -> float:
    """Return the largest gap [m] of the motion along `direction`, infinite where it is none to either side."""
    gaps = []
    for sign in (1.0, -1.0):
        q, worst, made = np.array(pose), 0.0, 0.0
        along = sign * direction / np.abs(direction).max()
        while made < _TRIED:
            trial, gap = newton.close(loop, q + _STEP * unit * along, list(range(len(q))))
            jacobian = loop.residual(trial)[1] * unit
            _, values, right = np.linalg.svd(jacobian)
            values = np.append(values, np.zeros(max(0, len(pose) - len(values))))
            if gap > loop.closed_m or values[rank] > _GROWTH * loop.rank_tolerance * values[0]:
                break
            moved = (trial - q) / unit
            worst, made, q = max(worst, gap), made + float(np.abs(moved).max()), trial
            if not np.any(moved):
                break
            free = right[rank:]
            along = free.T @ (free @ moved)  # on along the same motion, tangent to the loops
            along /= max(float(np.abs(along).max()), np.finfo(float).tiny)
        if made >= _LEAST_TRIED:
            gaps.append(worst)
    return min(gaps, default=np.inf)


def _tried_alone(loop: KinematicLoop, pose: np.ndarray, unit: np.ndarray, direction: np.ndarray) -> float:
    """Return the gap [m] that is left after one tried step along a direction that is held as far as it was moved."""
    lead = int(np.argmax(np.abs(direction)))
    trial = pose + _LEAST_TRIED * unit * direction / np.abs(direction[lead])
    return newton.least_gap(loop, trial, [i for i in range(len(pose)) if i != lead])


def lost_freedoms(joints, actuators, dynamics, poses, mobility: Mobility, tolerance_m: float) -> list[str]:
    """Return a sentence on motions freed or lost by rounding, on each joint that the loops lock, each idle actuator.

    Args:
        joints: of the mechanism.
        actuators: of the mechanism.
        dynamics: its reduced dynamics.
        poses: closed poses (n_q,) to judge at.
        mobility: as judged.
        tolerance_m: the gap [m] that was allowed.
    """
    notes = []
    if mobility.freed_m:
        notes.append(
            f"{len(mobility.freed_m)} motion{'s' if len(mobility.freed_m) > 1 else ''} that the file's rounding alone"
            f" forbids taken as free: the loops gape by {max(mobility.freed_m):.2g} m along"
            f" {'them' if len(mobility.freed_m) > 1 else 'it'} (closure_tolerance_m = {tolerance_m:g})"
        )
    for direction, gap in mobility.locked:
        lead = joints[int(np.argmax(np.abs(direction)))]
        notes.append(
            f"a motion of joint {lead.name} is locked by loops that are slightly off: moved by 0.1 rad they open by"
            f" {gap:.2g} m (closure_tolerance_m = {tolerance_m:g})"
        )
    gammas = [np.array(dynamics.velocity_map(q)) for q in poses]
    largest = max(float(np.abs(gamma).max(initial=0.0)) for gamma in gammas)
    still = [
        joint.name
        for i, joint in enumerate(joints)
        if all(np.abs(gamma[i]).max(initial=0.0) <= _NOTHING * largest for gamma in gammas)
    ]
    if still:
        notes.append(f"the loops lock joint{'s' if len(still) > 1 else ''} {', '.join(still)}")
    maps = [np.array(dynamics.effort_map(q)).reshape(gammas[0].shape[1], -1) for q in poses]
    full = [np.array(dynamics.effort_matrix(q)).reshape(len(joints), -1) for q in poses]
    for j, actuator in enumerate(actuators):
        if all(
            np.abs(m[:, j]).max() <= _NOTHING * max(np.abs(b[:, j]).max(), _NOTHING) for m, b in zip(maps, full, strict=True)
        ):
            notes.append(f"actuator {actuator.name} has no effect: the loops hold what it acts on, {actuator.target}")
    return notes
