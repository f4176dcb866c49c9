"""Anchors of a file that lie beside their hinge's axis: gaps of loops that no joint can change, and what closes them.

No motion changes the part of phi in the directions that no joint moves: the left null space of J at all poses together. In a
planar loop it is the offset of the two anchors along the hinges' common axis. A shift of one anchor along the axis closes it
and changes no motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

import mujoco
import numpy as np

from linkplan.models.closure.equations import Closure, earlier_pin
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.errors import UnassembledError
from linkplan.models.kinematics import data_at
from linkplan.models.ties import tied_points

# The largest shift without a tolerance of the user's, as a share of the mechanism's size.
SHIFT_SHARE = 0.05
# Shifts [m] below this one are rounding of the arithmetic.
_LEAST_SHIFT_M = 1e-13
# Directions whose rate of change by any joint is below this share of the largest do not move: axes of rounded files are
# parallel to about 1e-6 rad.
_STILL_SHARE = 1e-5
# Poses about the reference at which J is taken, and their distance from it [rad; extents on a slide].
_NEARBY_POSES, _POSE_DISTANCE = 6, 0.2


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Shift:
    """A shift (3,) [m] of the end (0 or 1) of a closure's anchor, in its body's frame. `index` is the equality's."""

    index: int
    name: str
    end: int
    by: np.ndarray

    @property
    def sentence(self) -> str:
        """The sentence that names the anchor and the length of its shift."""
        length = 1e3 * float(np.linalg.norm(self.by))
        return f"anchor of closure {self.name} moved by {length:.3g} mm along its hinge's axis, where no joint can close it"


def needless_gaps(loop: KinematicLoop, reference: np.ndarray) -> np.ndarray:
    """Return the part (n_rows,) [m] of the gaps at the reference pose that no joint can change; zero in rows of angles."""
    phi, _ = loop.residual(reference)
    rng = Random(0)  # numpy.random takes long to load
    steps = [np.array([rng.uniform(-_POSE_DISTANCE, _POSE_DISTANCE) for _ in reference]) for _ in range(_NEARBY_POSES)]
    poses = [reference, *(reference + step * loop.unit for step in steps)]
    still, jacobians = np.zeros_like(phi), [loop.jacobian(q) for q in poses]
    for closure in loop.closures:
        if closure.kind != "point" or closure.rows.stop - closure.rows.start != 3:
            continue
        rates = np.hstack([jacobian[closure.rows] for jacobian in jacobians])
        left, size, _ = np.linalg.svd(rates)
        directions = left[:, size <= _STILL_SHARE * size[0]]
        still[closure.rows] = directions @ (directions.T @ phi[closure.rows])
    return still


def shifts(
    model: mujoco.MjModel, closures: Sequence[Closure], still: np.ndarray, qpos: np.ndarray, limit_m: float
) -> list[Shift]:
    """Return the shifts of anchors that close gaps `still` (n_rows,) [m] of at most `limit_m`.

    Args:
        model: with the anchors.
        closures: of the model.
        still: see `needless_gaps`.
        qpos: MuJoCo's reference pose (nq,).
        limit_m: larger gaps are left.
    """
    data = data_at(model, qpos)
    found = []
    for closure in closures:
        gap = still[closure.rows]
        if not _LEAST_SHIFT_M < np.linalg.norm(gap) <= limit_m or earlier_pin(model, closure.index) is not None:
            continue
        in_world = data.xmat[closure.frame].reshape(3, 3) @ gap
        ends = tied_points(model, closure.index)
        end = 1 if ends[1][0] else 0  # the world's own anchors stay
        by = data.xmat[ends[end][0]].reshape(3, 3).T @ (in_world if end else -in_world)
        found.append(Shift(index=closure.index, name=closure.name, end=end, by=by))
    return found


def refuse_large_gaps(loop: KinematicLoop, still: np.ndarray, limit_m: float) -> None:
    """Refuse gaps along a hinge's axis of more than `limit_m`, and name the tolerance that accepts them.

    Raises:
        UnassembledError: for the largest of them.
    """
    gaps = {closure.name: float(np.linalg.norm(still[closure.rows])) for closure in loop.closures}
    widest = max(gaps, key=gaps.__getitem__, default="")
    if widest and gaps[widest] > limit_m:
        raise UnassembledError(
            f"mechanism '{loop.name}' does not close: closure {widest} is open by {1e3 * gaps[widest]:.4g} mm along its"
            " hinge's axis, which no joint can change; mechanism.closure_tolerance_m ="
            f" {1.01 * gaps[widest]:.3g} moves its anchor",
            gaps[widest],
        )


def apply_shifts(model: mujoco.MjModel, found: Sequence[Shift]) -> None:
    """Move the anchors of a compiled model."""
    for shift in found:
        _, point = tied_points(model, shift.index)[shift.end]
        point += shift.by
