"""Mobility: which motions the loops leave, which constraints lock them, and which freedoms are passive.

A small singular value of J may lock a motion, or it may result from joint axes written with seven digits. A finite motion
decides: it is made with the loops closed by least squares without the weak constraint, and the remaining gap is measured.
If the gap stays within `closure_tolerance_m` the motion is free, as it is in a machine with bearing play and in a simulator.

A passive freedom is a spin of a body about a line through its centre while all other bodies rest: of a rod between two ball
joints, or of a rod on a hinge along its own line. In the kernel of the closure it is a motion in which every body rests or
turns about its own centre of mass, and on which no actuator and no spring acts.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from random import Random

import mujoco
import numpy as np

from linkplan.models.closure import newton
from linkplan.models.closure.equations import Closure
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.closure.rank import (
    FILE_ROUNDING_SHARE,
    RANK_TOLERANCE,
    ROUNDING_SHARE,
    WEAK_SHARE,
    numerical_rank,
    weak_rank,
)
from linkplan.models.errors import LockedError, ModelError, counted
from linkplan.models.kinematics import data_at
from linkplan.models.tree.coordinates import Coordinates
from linkplan.models.tree.joints import Joint

# The distance, as a share of the mechanism's size, up to which a centre of mass beside its body's line of spin moves other
# bodies little: a millimetre on a leg. Exported rods are half a millimetre off.
_OFFSET_SHARE = 1e-3


def find_passive_dofs(
    model: mujoco.MjModel,
    joints: Sequence[Joint],
    coordinates: Coordinates,
    dynamics,
    independent: np.ndarray,
    poses: Sequence[np.ndarray],
    extent_m: float,
) -> tuple[tuple[int, ...], list[str]]:
    """Return the independent coordinates that are passive degrees of freedom, and a note on each.

    Args:
        model: the compiled model.
        joints: of the mechanism.
        coordinates: of the mechanism.
        dynamics: its reduced dynamics.
        independent: coordinates (n_s,).
        poses: closed poses (n_q,), one or more.
        extent_m: the mechanism's size [m].
    """
    if not dynamics.closure.size1_out(0):
        return (), []
    spins = [_spinning_bodies(model, coordinates, dynamics, q, extent_m) for q in poses]
    passive = np.flatnonzero(np.logical_and.reduce([one.any(axis=0) for one in spins]))
    notes = []
    for column in passive:
        bodies, chart = np.flatnonzero(spins[0][:, column]), joints[independent[column]].chart
        ball = chart is not None and len(bodies) == 1 and not any(joint.name == f"{chart}_x" for joint in joints)
        name = f"ball joint {chart}" if ball else " and ".join(f"body {model.body(b).name}" for b in bodies)
        notes.append(f"{name} can spin while all other joints rest: a passive degree of freedom, which no actuator drives")
    return tuple(independent[passive].tolist()), notes


def _spinning_bodies(
    model: mujoco.MjModel, coordinates: Coordinates, dynamics, q: np.ndarray, extent_m: float
) -> np.ndarray:
    """Return a mask (n_body, n_s) of the bodies that spin as an independent coordinate moves, if that is a passive spin."""
    gamma = np.array(dynamics.velocity_map(q))
    spring = np.array(dynamics.passive(q, np.zeros(len(q)))).reshape(-1, 1)
    acting = np.hstack([np.array(dynamics.effort_matrix(q)).reshape(len(q), -1), spring])
    scale = ROUNDING_SHARE * max(1.0, float(np.abs(acting).max()))
    free = np.abs(acting.T @ gamma).max(axis=0) <= scale * np.abs(gamma).max(axis=0)
    rates = gamma * free
    data, qvel = data_at(model, coordinates.qpos_of(q)), coordinates.qvel_of(np.broadcast_to(q, rates.T.shape), rates.T).T
    linear, angular = np.zeros((2, model.nbody, 3, model.nv))
    for body in np.flatnonzero(model.body_mass > 0):
        mujoco.mj_jacBodyCom(model, data, linear[body], angular[body], body)
    speeds, turns = np.linalg.norm(linear @ qvel, axis=1), np.linalg.norm(angular @ qvel, axis=1)  # of centres; (n_body, n)
    moment, whole = model.body_mass @ speeds, model.body_mass[model.body_weldid > 0].sum()
    # With a more distant centre of mass a light rod still moves the others little: a bent rod of 10 g in a leg of 10 kg.
    least = _OFFSET_SHARE * extent_m * turns.max(axis=0)
    spins = free & ((speeds.max(axis=0) <= least) | (moment <= 0.01 * whole * least))
    return spins & (turns > ROUNDING_SHARE * turns.max(axis=0))


def find_coasting_dofs(
    dynamics, independent: np.ndarray, passive: Sequence[int], poses: Sequence[np.ndarray]
) -> tuple[int, ...]:
    """Return the independent coordinates q_k whose momentum p = M_k(q) v obeys p' = -d q_k' in every motion, with d >= 0.

    No actuator, spring, weight or dry friction acts on them, as on a cart on a rail or the vertical axis of a boom. Inverse
    dynamics at the poses, with random speeds, are compared with this law.

    Args:
        dynamics: the reduced dynamics.
        independent: coordinates (n_s,).
        passive: those that are passive degrees of freedom.
        poses: closed poses (n_q,) with no common symmetry; with fewer than three of them the law is not judged.
    """
    arms = np.array([np.abs(np.array(dynamics.effort_map(q))).max(axis=1, initial=0.0) for q in poses])
    undriven = [k for k in np.flatnonzero(np.all(arms == 0, axis=0)).tolist() if independent[k] not in passive]
    if not undriven or len(poses) < 3:
        return ()
    random, step, still = Random(0), 1e-4, np.zeros(len(independent))
    speeds = np.array([[random.uniform(-1.0, 1.0) for _ in independent] for _ in poses])
    needed, gained = np.empty((2, *speeds.shape))
    for k, (q, v) in enumerate(zip(poses, speeds, strict=True)):
        along = step * np.array(dynamics.velocity_map(q)) @ v
        change = np.array(dynamics.reduced_inertia(q + along)) - np.array(dynamics.reduced_inertia(q - along))
        needed[k], gained[k] = np.array(dynamics.inverse_dynamics(q, v, still)).ravel(), change @ v / (2 * step)
    damping = np.sum((needed - gained) * speeds, axis=0) / np.sum(speeds**2, axis=0)
    apart = np.abs(needed - gained - damping * speeds).max(axis=0)
    least = FILE_ROUNDING_SHARE * max(np.abs(needed).max(), np.abs(gained).max())
    return tuple(int(independent[k]) for k in undriven if apart[k] <= least)


def round_spins(dynamics, home: np.ndarray, passive: np.ndarray) -> np.ndarray:
    """Return a mask (n_s,) of the `passive` coordinates that leave the inertia unchanged one radian from the home pose."""
    inertia, found = np.array(dynamics.reduced_inertia(home)), np.array(passive)
    for column in np.flatnonzero(passive):
        turned = home + np.array(dynamics.velocity_map(home))[:, column]
        found[column] = (
            np.abs(np.array(dynamics.reduced_inertia(turned)) - inertia).max() <= FILE_ROUNDING_SHARE * inertia.max()
        )
    return found


# Length of a trial motion and of its Newton steps [rad; extents on a slide].
_TRIAL_LENGTH = 0.75
_TRIAL_STEP = 0.05
# Shortest trial motion that gives a gap [rad; extents on a slide]: a shorter one ended at an end of reach.
_LEAST_TRIAL_LENGTH = 0.1
# A weak singular value that grows by more than this factor on the way is not rounding but a fold nearby.
_MAX_ROUNDING_GROWTH = 30.0
# Singular values above this share of the largest, but below the rank's tolerance, may come from rounding in the file.
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
    # Even the shortest trial motion along a larger singular value would open the loops by more than the tolerance. Values
    # ten times as large as rounding's are geometry, whatever the tolerance.
    opening = tolerance_m / (_LEAST_TRIAL_LENGTH * max(values[0], np.finfo(float).tiny))
    weak = min(max(WEAK_SHARE, opening), 10 * WEAK_SHARE)
    while rank > 1 and share[rank - 1] < weak:
        cut = float(np.sqrt(share[rank - 2] * share[rank - 1]))
        free_loop = replace(loop, rank_tolerance=cut, closed_m=tolerance_m)
        gap = _gap_of_motion(free_loop, pose, directions[rank - 1], rank - 1)
        if gap > tolerance_m:
            along = [directions[k] for k in range(rank) if share[k] < WEAK_SHARE]
            locked = [(direction, _gap_of_step(loop, pose, direction)) for direction in along]
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
    return newton.least_gap(loop, trial, [i for i in range(len(pose)) if i != lead])[0]


def lost_freedoms(joints, dynamics, poses, mobility: Mobility, tolerance_m: float) -> list[str]:
    """Return notes on motions that rounding frees or locks, and on joints that the loops lock.

    Args:
        joints: of the mechanism.
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
    return [*_rounding_notes(joints, mobility, tolerance_m), *locked]


def _rounding_notes(joints, mobility: Mobility, tolerance_m: float) -> list[str]:
    """Return notes on the motions that count as free and on those that count as locked."""
    notes = []
    if mobility.freed_m:
        n, gap = len(mobility.freed_m), max(mobility.freed_m)
        motions, count, it = ("motion", "counts", "it") if n == 1 else ("motions", "count", "them")
        notes.append(
            f"{n} {motions} that only rounding in the file locks {count} as free: the loops open by {gap:.2g} m along {it}"
            f" (closure_tolerance_m = {tolerance_m:g})"
        )
    for direction, gap in mobility.locked:
        lead = joints[int(np.argmax(np.abs(direction)))]
        notes.append(
            f"a motion of joint {lead.name} is locked by slightly inaccurate joint axes or points: after 0.1 rad the loops"
            f" open by {gap:.2g} m (closure_tolerance_m = {tolerance_m:g})"
        )
    return notes


def refuse_locked(mobility: Mobility, pose: np.ndarray, tolerance_m: float) -> None:
    """Refuse a mechanism with no degree of freedom at a closed pose (n_q,) with a mobility and an allowed gap [m].

    Raises:
        LockedError: if the mechanism is locked; the message names the closures that lock it.
    """
    loop = mobility.loop
    rank, n_joints = loop.rank(pose), len(loop.joints)
    if rank < n_joints:
        return
    error = LockedError(
        f"mechanism '{loop.name}' is locked: {n_joints} joints minus {rank} independent closure rows leave 0 degrees of"
        f" freedom{_hint(weak_rank(loop.jacobian(pose), loop.rank_tolerance), mobility.locked, tolerance_m)}"
    )
    raise locked_by(error, loop, pose)


def locked_by(error: LockedError, loop: KinematicLoop, pose: np.ndarray) -> LockedError:
    """Return the error with the closures added that lock the mechanism at a closed pose (n_q,)."""
    freed = freedoms_without(loop.closures, loop.jacobian(pose), loop.rank_tolerance)
    return LockedError(f"{error}{_freed_text(freed)}", freed)


def freedoms_without(closures: Sequence[Closure], jacobian: np.ndarray, share: float) -> dict[str, int]:
    """Return the degrees of freedom gained by leaving out closures, or orientations of welds, by the names left out.

    A key joins names with " and " if only the set frees the mechanism. Sets of three closures are tried only if no smaller
    set frees it. At most eight sets are returned.
    """
    least = numerical_rank(jacobian, share)
    parts = list(_parts(closures))
    found: dict[frozenset[str], int] = {}
    for size in (1, 2, 3):
        if size == 3 and found:
            break
        for chosen in itertools.combinations(parts, size):
            names = frozenset(part for part, _ in chosen)
            if any(fewer <= names for fewer in found):
                continue
            left_out = np.unique([row for _, rows in chosen for row in rows])
            more = least - numerical_rank(np.delete(jacobian, left_out, axis=0), share)
            if more:
                found[names] = more
    order = [part for part, _ in parts]
    named = {" and ".join(sorted(names, key=order.index)): more for names, more in found.items()}
    return dict(itertools.islice(named.items(), 8))


def _parts(closures: Sequence[Closure]) -> Iterator[tuple[str, list[int]]]:
    """Yield the names of the closures, and of the orientations of welds, with their rows."""
    rows: dict[int, list[int]] = {}
    for gap in closures:
        rows.setdefault(gap.index, []).extend(range(gap.rows.start, gap.rows.stop))
    names = {gap.index: gap.name for gap in closures}
    for index, own in rows.items():
        yield names[index], own
    for gap in closures:
        if gap.kind == "orientation":
            yield f"weld {gap.name}'s orientation", list(range(gap.rows.start, gap.rows.stop))


def _freed_text(freed: dict[str, int]) -> str:
    """Return the clause that lists the closures which lock a mechanism, empty if there are none."""
    if not freed:
        return ""
    parts = [f"{part} ({more})" for part, more in freed.items()]
    first = next(iter(freed.values()))
    parts[0] = parts[0].replace(f"({first})", f"({counted(first, 'degree')} of freedom)")
    return f"; it moves without {', '.join(parts)}"


def _hint(weak: int, locked, tolerance_m: float) -> str:
    if not weak:
        return ""
    gap = max((gap for _, gap in locked), default=0.0)
    opens = f" (after 0.1 rad the loops open by {gap:.3g} m; closure_tolerance_m = {tolerance_m:g})" if gap else ""
    return (
        f"; {weak} of these rows is nearly dependent on the others (1e-4 of the largest singular value): joint axes or"
        f" points meant to be aligned are slightly off{opens}"
    )
