"""Closed poses at many positions of the output joints, in any order, on the branch of home."""

import numpy as np

from linkplan.models.poses.along import RANGE_ROUNDING
from linkplan.models.poses.assembly import advance_all, step_sizes, strides
from linkplan.models.transfer.output_map import OutputMap

# Status of a point: on the map; the loops do not close there; next to a singular pose; or 100 plus the index of the joint
# that is beyond its range.
ON_MAP, OPEN_LOOPS, NEAR_SINGULAR, BEYOND_RANGE = 0, 1, 2, 100


class KnownPoses:
    """The closed poses found so far. A new pose is continued from the nearest one. Mutable: it grows."""

    def __init__(self, outputs: OutputMap) -> None:
        self.outputs = outputs
        self.poses, self.points = outputs.mechanism.home[None], outputs.home[None]
        self.unit = step_sizes(outputs.mechanism)[outputs.coordinates]
        self._tree = None  # of the points; made when it is first used

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses (n, n_q) at output positions (n, n_o), NaN where the loops open, and each point's status (n,)."""
        mechanism = self.outputs.mechanism
        found, tried = self.near(points), np.full(len(points), -1)
        self._keep(found)
        while True:  # start open points from their nearest known pose, until none has a nearer one
            left = np.flatnonzero(np.isnan(found[:, 0]))
            nearest = self._nearest(points[left])
            left, nearest = left[nearest != tried[left]], nearest[nearest != tried[left]]
            if len(left) == 0:
                return found, self._status(found)
            tried[left] = nearest
            found[left] = advance_all(mechanism, self.poses[nearest], self.outputs.independent(points[left]))
            self._keep(found[left])

    def near(self, points: np.ndarray) -> np.ndarray:
        """Return the poses (n, n_q) that are one stride from a known pose, NaN for others."""
        return strides(self.outputs.mechanism, self.poses[self._nearest(points)], self.outputs.independent(points))

    def _nearest(self, points: np.ndarray) -> np.ndarray:
        """Return the indices (n,) of the known poses that are nearest to output positions (n, n_o)."""
        import scipy.spatial

        if self._tree is None:
            self._tree = scipy.spatial.KDTree(self.points / self.unit, balanced_tree=False, compact_nodes=False)
        return np.asarray(self._tree.query(points / self.unit)[1])

    def _keep(self, found: np.ndarray) -> None:
        closed = found[np.isfinite(found[:, 0])]
        if len(closed):
            self.poses, self._tree = np.concatenate([self.poses, closed]), None
            self.points = self.poses[:, self.outputs.coordinates]

    def _status(self, found: np.ndarray) -> np.ndarray:
        mechanism = self.outputs.mechanism
        lower, upper = np.array([(joint.lower, joint.upper) for joint in mechanism.joints]).T
        beyond = np.maximum(found - upper, lower - found)
        beyond[:, mechanism.independent] = 0.0
        worst = np.argmax(np.nan_to_num(beyond), axis=1)
        status = np.where(np.nan_to_num(beyond).max(axis=1) > RANGE_ROUNDING, BEYOND_RANGE + worst, ON_MAP)
        return np.where(np.isnan(found[:, 0]), OPEN_LOOPS, status)
