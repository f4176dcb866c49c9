"""Floquet multipliers of the sampled closed loop along a periodic motion, and the decay measured in MuJoCo.

About the motion the tracked loop is linear and periodic: z_{k+1} = (A_k - B_k K_k) z_k, where z holds the state and the
delayed commands. The product over a cycle is the monodromy matrix. Its eigenvalues, the multipliers, are the factors by
which disturbances shrink in a cycle (Bittanti & Colaneri, Periodic Systems, 2009, 3.1). MuJoCo measures the same matrix
column by column: the difference between a run that starts with a small disturbance of one coordinate and an undisturbed run.
A tracker without feedforward settles on a motion that differs from the reference. That motion is simulated first, and the
analysis is done about it.
"""

from dataclasses import replace

import numpy as np
from msgspec import Struct

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.sampling import Sampling, augmented, closed, simulated, spectral_radius
from linkplan.controllers.trackers.tracker import AnyTracker, StateFeedback
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at, follow
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.feedback.frequency.simulated_loops import SimulatedLoops

# A transition matrix that grows beyond this is rescaled and its logarithm kept.
_MAX_GROWTH = 1e50
# A disturbance is visible above this share of its largest size, far above rounding.
_VISIBLE_SHARE = 1e-6
# Zeros are replaced by this value before taking logarithms.
_LEAST_SIZE = 1e-300


class Floquet(Struct, frozen=True, kw_only=True, eq=False):
    """A tracked periodic motion: the sizes (M,) of its predicted and measured multipliers, and the decay of disturbances.

    The largest multipliers come first; measured ones below rounding are meaningless. `decay_rate_per_s` is the predicted
    rate at which the largest one shrinks. `size` and `measured_size` (n,) are the largest singular value of the scaled
    transition from the start to `time_s` (n,), which is the remaining share of the worst disturbance; they end at `seen_s`,
    where the decay is no longer visible, with the logarithms `log_left_predicted` and `log_left_measured`.
    """

    cycle_s: float
    converges: bool  # from cycle to cycle
    multiplier_size: np.ndarray
    measured_multiplier_size: np.ndarray
    decay_rate_per_s: float
    seen_s: float
    log_left_predicted: float
    log_left_measured: float
    monodromy: Beside[np.ndarray] = NOT_READ
    time_s: Beside[np.ndarray] = NOT_READ
    size: Beside[np.ndarray] = NOT_READ
    measured_size: Beside[np.ndarray] = NOT_READ


def linear_law(tracker: AnyTracker) -> StateFeedback:
    """Return a tracker as a linear law.

    Raises:
        LinkplanError: for a tracker that is not linear in the state.
    """
    if isinstance(tracker, StateFeedback):
        return tracker
    raise LinkplanError(f"tracker '{tracker.name}' has no state feedback gains to analyse")


def frozen_radii(mechanism: Mechanism, reference: SampledReference, gains: np.ndarray, timing: Sampling) -> np.ndarray:
    """Return the largest pole's magnitude (n,) of the loop frozen at every control instant, with gains K (n, n_u, 2 n_s)."""
    return spectral_radius(_closed_along(mechanism, reference, gains, timing))


def _closed_along(mechanism: Mechanism, reference: SampledReference, gains: np.ndarray, timing: Sampling) -> np.ndarray:
    pose, velocity, effort, *forces = reference.states
    A, B, B_late = simulated(mechanism, pose, velocity, effort, timing, *forces)
    return closed(*augmented(A, B, B_late, timing), gains)


def floquet(
    mechanism: Mechanism, reference: SampledReference, tracker: AnyTracker, timing: Sampling, effort_limit: np.ndarray
) -> Floquet:
    """Return the multipliers of a tracked periodic motion, predicted and measured over one cycle.

    Args:
        mechanism: the moving mechanism.
        reference: a cycle or more of a motion that repeats after whole samples.
        tracker: a tracker of that reference.
        timing: with the reference's control period.
        effort_limit: (n_u, 2) [N.m or N]; the loop is not linear where the motion reaches it.

    Raises:
        LinkplanError: for a motion that does not repeat after whole control periods.
    """
    n = reference.cycle
    if n is None or n > reference.n:
        raise LinkplanError(
            f"Floquet multipliers need a motion that repeats after whole control periods; this one of {reference.n} periods"
            f" of {reference.period_s:g} s does not: choose tracking.period_s so that it divides the motion's duration"
        )
    law, one = linear_law(tracker), reference.part(slice(n), n)
    gains = law.gains[:n]
    if law.feedforward:
        motion, before = one, np.repeat(one.effort[:1], timing.memory, axis=0)
    else:
        motion, before = _steady(mechanism, one, gains, timing, effort_limit)
    steps = _closed_along(mechanism, motion, gains, timing)
    size = steps.shape[1]
    # Disturbances of positions, velocities and delayed commands: small, but far above rounding.
    scale = np.repeat([1e-5, 1e-3, 1e-4], [mechanism.dof, mechanism.dof, size - 2 * mechanism.dof])
    transition = np.empty((n + 1, size, size))
    transition[0] = np.eye(size)
    product, log = np.eye(size), 0.0  # rescaled so that a growing product does not overflow
    for k in range(n):
        product = steps[k] @ product
        largest = np.abs(product).max()
        if largest > _MAX_GROWTH:
            product, log = product / largest, log + np.log(largest)
        transition[k + 1] = product * np.exp(min(log, 460.0))  # e^460 = 1e200
    measured = np.nan_to_num(
        _measured(mechanism, one, motion, before, gains, law.feedforward, timing, effort_limit, scale),
        nan=_MAX_GROWTH,
        posinf=_MAX_GROWTH,
    )
    size, measured_size = (np.linalg.norm(M / scale[:, None] * scale, ord=2, axis=(1, 2)) for M in (transition, measured))
    multipliers, measured_multipliers = (np.sort(np.abs(np.linalg.eigvals(M[-1])))[::-1] for M in (transition, measured))
    cycle_s, time_s = n * reference.period_s, reference.period_s * np.arange(n + 1)
    seen = int(np.flatnonzero(size > _VISIBLE_SHARE * size.max())[-1])
    left, measured_left = (float(np.log(max(values[seen], _LEAST_SIZE))) for values in (size, measured_size))
    return Floquet(
        cycle_s=cycle_s,
        converges=bool(multipliers[0] < 1.0),
        multiplier_size=multipliers,
        measured_multiplier_size=measured_multipliers,
        decay_rate_per_s=float(-np.log(max(multipliers[0], _LEAST_SIZE)) / cycle_s),
        seen_s=float(time_s[seen]),
        log_left_predicted=left,
        log_left_measured=measured_left,
        monodromy=transition[-1],
        time_s=time_s[: seen + 1],
        size=size[: seen + 1],
        measured_size=measured_size[: seen + 1],
    )


def _steady(mechanism, reference: SampledReference, gains: np.ndarray, timing: Sampling, effort_limit):
    """Return a cycle of the motion to which gains without feedforward converge, and the commands (memory, n_u) before it."""
    n = reference.n
    batch = SimulatedLoops(
        mechanism,
        pose=reference.pose_rad[:1],
        velocity=reference.velocity_rad_s[:1],
        gain=gains[:1],
        under_way=reference.effort[:1],
        timing=timing,
        effort_limit=effort_limit,
        motion=reference,
    )
    along, forward = _signals(reference, False)
    states, commands = np.full((n, 1, 2 * mechanism.dof), np.inf), np.zeros((n, 1, mechanism.n_u))
    for _ in range(40):
        last = states[0]
        states, commands = batch.run(np.arange(1), along, forward, gains)
        if np.all(np.abs(states[0] - last) <= 1e-9 * np.abs(states).max(axis=0)):
            break
    position, velocity = states[:, 0, : mechanism.dof], states[:, 0, mechanism.dof :]
    acting = np.clip(np.roll(commands[:, 0], timing.whole, axis=0), *effort_limit.T)
    # The simulated cycle is steady, so the next cycle repeats it.
    pose = follow(mechanism, position, reference.pose_rad[0])
    motion = replace(reference, pose_rad=pose, position_rad=position, velocity_rad_s=velocity, effort=acting)
    return motion, commands[n - timing.memory :, 0]


def _signals(reference: SampledReference, forward: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the reference states (n, 1, 2 n_s) and feedforward efforts (n, 1, n_u), zero without `forward`."""
    along = np.concatenate([reference.position_rad, reference.velocity_rad_s], axis=1)
    return along[:, None], reference.effort[:, None] * forward


def _measured(
    mechanism: Mechanism,
    reference: SampledReference,
    motion: SampledReference,
    before: np.ndarray,
    gains: np.ndarray,
    forward: bool,
    timing: Sampling,
    effort_limit: np.ndarray,
    scale: np.ndarray,
) -> np.ndarray:
    """Return MuJoCo's transition matrices (n + 1, M, M) from the start: disturbed runs minus an undisturbed run."""
    n, n_s, n_u = reference.n, mechanism.dof, mechanism.n_u
    size = len(scale)
    pose, velocity = np.tile(motion.pose_rad[0], (size + 1, 1)), np.tile(motion.velocity_rad_s[0], (size + 1, 1))
    for i in range(n_s):
        s = motion.position_rad[0].copy()
        s[i] += scale[i]
        pose[i + 1] = close_at(mechanism, s, motion.pose_rad[0])
        velocity[n_s + i + 1, i] += scale[n_s + i]
    # The commands in the state are ordered from u_{-1} backwards.
    p = timing.memory
    under_way = np.repeat(before[:, None], size + 1, axis=1)
    for back in range(p):
        for j in range(n_u):
            row = 2 * n_s + back * n_u + j
            under_way[p - 1 - back, row + 1, j] += scale[row]
    batch = SimulatedLoops(
        mechanism,
        pose=pose,
        velocity=velocity,
        gain=np.broadcast_to(gains[0], (size + 1, n_u, 2 * n_s)),
        under_way=under_way,
        timing=timing,
        effort_limit=effort_limit,
        motion=reference,
    )
    along, fed = (np.repeat(x, size + 1, axis=1) for x in _signals(reference, forward))
    states, commands = batch.run(np.arange(size + 1), along, fed, gains)
    history = np.empty((n + 1, size + 1, size))
    history[:n, :, : 2 * n_s], history[n, :, : 2 * n_s] = states, batch.state()
    whole = np.concatenate([under_way, commands])  # whole[k + p] = u_k
    for back in range(p):
        columns = slice(2 * n_s + back * n_u, 2 * n_s + (back + 1) * n_u)
        history[:, :, columns] = whole[p - 1 - back : p - back + n]
    return ((history[:, 1:] - history[:, :1]) / scale[:, None]).transpose(0, 2, 1)


def floquet_text(found: Floquet) -> str:
    """Return a sentence about the multipliers."""
    verdict = "dies away" if found.converges else "grows"
    left, predicted = np.exp(found.log_left_measured), np.exp(found.log_left_predicted)
    return (
        f"along the motion a disturbance {verdict}: the largest Floquet multiplier is {found.multiplier_size[0]:.3g} a cycle"
        f" of {found.cycle_s:g} s ({found.decay_rate_per_s:.4g} 1/s); over {1e3 * found.seen_s:.3g} ms MuJoCo reduces it to"
        f" {left:.3g} of its size, predicted {predicted:.3g}"
    )
