"""Model predictive control along a reference: the LQR's cost under effort limits, one quadratic program per period.

    minimise sum e^T Q e + w^T R w + e_N^T P e_N,   e = x - x_ref,   w = u - u_ref,   low <= u <= high

The terminal cost P is the LQR's cost to go. If the predicted LQR efforts keep the limits, the LQR feedback is therefore the
solution and is used directly. Of more actuators than freedoms, equivalent efforts within the limits suffice. Otherwise
corrections w that are held over blocks of control periods are improved once per period (real-time iteration; Diehl, Bock &
Schloeder, SIAM J. Control Optim. 43, 2005). The previous corrections give the predicted motion from the measured state, and
the reduced dynamics are linearised along it. DAQP solves the quadratic program (Arnstrom, Bemporad & Axehill, IEEE Trans.
Automatic Control 67, 2022).

The program knows the mean reference effort of a block, which smears a switch within the block. At each instant the applied
effort is therefore u_ref + s (limit - u_ref), where s is the share of the mean's distance to the limit that the first
correction uses. The mean over the block is the program's effort, no correction leaves u_ref, and a full one is the limit.
"""

from dataclasses import dataclass, field

import daqp
import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.lqr import Regulator, regulator
from linkplan.controllers.trackers.prediction import Predictor, predictor
from linkplan.controllers.trackers.tracker import Design, ordered_product
from linkplan.models.actuation.distribution import distribute
from linkplan.models.poses.along import evaluated, is_redundant, sampled
from linkplan.models.reduction.closing import MAX_LOOP_GAP_M

# Number of blocks of constant corrections in the horizon.
HORIZON_BLOCKS = 20


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MPC:
    """The corrections of least cost whose prediction keeps the limits. The memory (n, blocks n_u) holds the previous ones.

    `alone` (n, blocks n_u, m): map from an error to the LQR's corrections at the beginning of each block. `ahead`
    (n, blocks + 1): instants at which the blocks begin. `begin` (n, n_q + n_s) and `mean` (n, n_u): the reference's (q, v)
    and mean effort of a block that begins at an instant. `acting`: that effort and the mean forces over time. `own`
    (n, n_q + n_s): the predicted (q, v) after it.
    `effort_limit` (n_u, 2). `room` (n, 2, blocks n_u): limits of the corrections of the blocks that begin at an instant.
    `bounds` (n, 2, n_u + blocks n_u): those of the LQR's effort and corrections, beyond which corrections are improved.
    `maps` (n, n_s, n_u): Gamma^T B along the reference if several efforts are equivalent, else None.
    `kept` (m,): indices of the controlled states in x = (s, v). `weights`: Q and R of a block. The memory is NaN while the
    LQR acts.
    """

    reference: SampledReference
    regulator: Regulator
    alone: np.ndarray
    ahead: np.ndarray
    begin: np.ndarray
    mean: np.ndarray
    acting: np.ndarray
    own: np.ndarray
    effort_limit: np.ndarray
    maps: np.ndarray | None
    kept: np.ndarray
    weights: tuple[np.ndarray, np.ndarray]
    predictor: Predictor
    name: str = "mpc"
    room: np.ndarray = field(init=False)
    bounds: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        limits, mean = self.effort_limit.T, self.mean[self.ahead[:, :-1]].reshape(len(self.ahead), -1)
        room = np.stack([np.tile(end, HORIZON_BLOCKS) - mean for end in limits], axis=1)
        bounds = np.concatenate([np.tile(limits, (len(room), 1, 1)), room], axis=2)
        with np.errstate(invalid="ignore"):
            # Efforts beyond a limit by this share of the range between the limits are rounding.
            slack = 1e-9 * np.diff(bounds, axis=1) * [[-1], [1]]
        object.__setattr__(self, "room", room)
        object.__setattr__(self, "bounds", bounds + np.where(np.isfinite(slack), slack, 0.0))

    def start(self, n: int) -> np.ndarray:
        """Return the initial memory (n, blocks n_u), NaN: the LQR acts."""
        return np.full((n, self.alone.shape[1]), np.nan)

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] for states (n, n_s), and the corrections of the blocks."""
        reference, at = self.reference, k % len(self.ahead)
        error = np.concatenate(
            [position_rad - reference.position_rad[k], velocity_rad_s - reference.velocity_rad_s[k]], axis=-1
        )[:, self.kept]
        effort = reference.effort[k] - ordered_product(self.regulator.gains[at], error)
        # The first row is the effort that the LQR applies now, the others are its corrections in the blocks.
        predicted, next_memory = np.hstack([effort, ordered_product(self.alone[at], error)]), self.start(len(position_rad))
        low, high = self.bounds[at]
        for row in np.flatnonzero(((predicted < low) | (predicted > high)).any(axis=1)):
            if (shared := self._shared(at, predicted[row])) is not None:
                effort[row] = shared
                continue
            before = predicted[row, effort.shape[1] :] if np.isnan(memory[row, 0]) else memory[row]
            found = self._improved(k, position_rad[row], velocity_rad_s[row], before)
            if found is not None:
                next_memory[row], effort[row] = found, self._applied(k, found[: effort.shape[1]])
        return effort, next_memory

    def _shared(self, at: int, predicted: np.ndarray) -> np.ndarray | None:
        """Return the effort (n_u,) now if efforts within the limits are equivalent to all predicted ones, else None."""
        if self.maps is None:
            return None
        blocks = self.ahead[at, :-1]
        maps, asked = self.maps[[at, *blocks]], predicted.reshape(len(blocks) + 1, -1).copy()
        asked[1:] += self.mean[blocks]
        shared = distribute(np.einsum("ksu,ku->ks", maps, asked), maps, self.effort_limit, asked)
        low, high = self.effort_limit.T
        return shared[0] if np.all((shared >= low) & (shared <= high)) else None

    def _applied(self, k: int, correction: np.ndarray) -> np.ndarray:
        """Return the effort (n_u,) that uses the share of its room that the first correction (n_u,) uses of the mean's."""
        about, limit = self.reference.effort[k], np.where(correction < 0, self.effort_limit[:, 0], self.effort_limit[:, 1])
        room = limit - self.mean[k % len(self.ahead)]
        limited = np.isfinite(room)
        share = np.divide(correction, room, out=np.where(limited, 0.0, 1.0), where=limited & (room != 0))
        return about + np.clip(share, 0.0, 1.0) * np.where(limited, limit - about, correction)

    def _improved(self, k: int, s: np.ndarray, v: np.ndarray, before: np.ndarray) -> np.ndarray | None:
        """Return corrections (blocks n_u,) from one state that improve those `before`, or None where none are found.

        A prediction fails for example beyond the poses where the loop closes.
        """
        reference, at = self.reference, k % len(self.ahead)
        blocks, room = self.ahead[at, :-1], self.room[at]
        corrections = np.minimum(np.maximum(before, room[0]), room[1])
        # If a cycle advances by whole turns, subtract the turns made so far.
        s = s - (reference.position_rad[k] - reference.position_rad[at])
        hessian, gradient, gap = evaluated(
            self.predictor.program, reference.pose_rad[at], s, v,
            self.begin[blocks].T, self.acting[blocks].T, self.own[blocks].T, corrections.reshape(HORIZON_BLOCKS, -1).T,
            *self.weights, self.regulator.cost[self.ahead[at, -1]],
        )  # fmt: skip
        if not (gap.item() <= MAX_LOOP_GAP_M and np.isfinite(hessian).all() and np.isfinite(gradient).all()):
            return None
        low, high = room - corrections
        change, _, flag, _ = daqp.solve(hessian.T, gradient.ravel(), np.empty((0, len(low))), high, low)
        return corrections + change if flag > 0 and np.isfinite(change).all() else None


def mpc(design: Design) -> MPC:
    """Return the MPC tracker of a design, whose horizon is rounded up to blocks of whole control periods.

    The program of the prediction is compiled as `Design.compile_mode` says; interpreted it is two to three times slower.

    Raises:
        GainError: if no stabilising gain exists.
    """
    mechanism, reference = design.mechanism, design.reference
    found, kept = regulator(mechanism, reference, design.errors())
    n, m, n_u = found.B.shape
    loop = found.A - found.B @ found.gains
    periods = max(1, int(np.ceil(design.settings.horizon_s / (HORIZON_BLOCKS * reference.period_s) - 1e-9)))
    acting = np.hstack([reference.effort, *reference.forces])
    way, mean, at = np.tile(np.eye(m), (n, 1, 1)), np.zeros((n, acting.shape[1])), np.arange(n)
    for _ in range(periods):
        mean += acting[at] / periods
        way, at = loop[at] @ way, found.after[at]
    alone, ahead = np.empty((n, HORIZON_BLOCKS, n_u, m)), np.empty((n, HORIZON_BLOCKS + 1), dtype=int)
    ahead[:, 0], so_far = np.arange(n), np.tile(np.eye(m), (n, 1, 1))
    for b in range(HORIZON_BLOCKS):
        here = ahead[:, b]
        alone[:, b] = -found.gains[here] @ so_far
        so_far, ahead[:, b + 1] = way[here] @ so_far, at[here]
    model = predictor(mechanism, kept, HORIZON_BLOCKS, periods * reference.period_s, design.compile_mode)
    begin = np.hstack([reference.pose_rad[:n], reference.velocity_rad_s[:n]])
    return MPC(
        reference=reference,
        regulator=found,
        alone=alone.reshape(n, -1, m),
        ahead=ahead,
        begin=begin,
        mean=mean[:, :n_u],
        acting=mean,
        own=sampled(model.step, begin, mean)[:, :, 0],
        effort_limit=np.array(design.effort_limit, dtype=float),
        maps=sampled(mechanism.dynamics.effort_map, reference.pose_rad[:n]) if is_redundant(mechanism) else None,
        kept=kept,
        weights=(periods * found.Q, periods * found.R),
        predictor=model,
    )
