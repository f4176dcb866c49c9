"""Closed poses at many positions of the output joints, in any order, on the branch of home."""

import numpy as np

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.poses.along import evaluated, mapped
from linkplan.models.poses.assembly import advance, step_sizes
from linkplan.models.poses.continuation import MAX_CORRECTION_SHARE, MAX_GAMMA_CHANGE
from linkplan.models.poses.reach import RANGE_ROUNDING
from linkplan.models.transfer.output_map import OutputMap

# Newton steps from a neighbour's tangent. Three leave rounding after a stride of two degrees.
_NEWTON_STEPS = 4
# Status of a point: on the map; the loops do not close there; next to a singular pose; or 100 plus the index of the joint
# that is beyond its range.
ON_MAP, OPEN_LOOPS, NEAR_SINGULAR, BEYOND_RANGE = 0, 1, 2, 100


class KnownPoses:
    """The closed poses found so far, from which a new one starts at its nearest neighbour. Mutable: it grows."""

    def __init__(self, outputs: OutputMap) -> None:
        self.outputs = outputs
        home = outputs.mechanism.home
        self.poses = np.array([home])
        self.points = self.poses[:, self._output_joints]

    @property
    def _output_joints(self) -> np.ndarray:
        return self.outputs.mechanism.independent[list(self.outputs.columns)]

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses (n, n_q) at output positions (n, n_o), NaN where the loops open, and each point's status (n,)."""
        mechanism = self.outputs.mechanism
        unit = step_sizes(mechanism)[self._output_joints]
        distance = np.linalg.norm((points - mechanism.home[self._output_joints]) / unit, axis=1)
        found = self.near(points)
        self._keep(found)
        left = [k for k in np.argsort(distance, kind="stable").tolist() if np.isnan(found[k, 0])]
        for k in left:
            start = self.poses[np.argmin(np.linalg.norm((self.points - points[k]) / unit, axis=1))]
            pose, arrived = advance(mechanism, start, self.outputs.independent(points[k : k + 1])[0])
            if arrived:
                found[k] = pose
                self._keep(found[k : k + 1])
        return found, self._status(found)

    def near(self, points: np.ndarray) -> np.ndarray:
        """Return the poses (n, n_q) that are one stride from a known pose, NaN for others."""
        import scipy.spatial

        unit = step_sizes(self.outputs.mechanism)[self._output_joints]
        _, nearest = scipy.spatial.KDTree(self.points / unit).query(points / unit)
        return self._stride(self.poses[nearest], points)

    def _keep(self, found: np.ndarray) -> None:
        closed = found[np.isfinite(found[:, 0])] if len(found) else found
        self.poses = np.concatenate([self.poses, closed])
        self.points = self.poses[:, self._output_joints]

    def _stride(self, start: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return the poses one stride from closed poses `start` (n, n_q), NaN where the stride is not regular."""
        mechanism = self.outputs.mechanism
        if mechanism.projected:  # overconstrained loops fold unseen in a single stride
            return np.full_like(start, np.nan)
        dependent = mechanism.dependent
        _, _, gamma, before = self._newton(start)
        wanted = self.outputs.independent(points)
        trial = start + np.einsum("nqs,ns->nq", gamma, wanted - start[:, mechanism.independent])
        trial[:, mechanism.independent] = wanted
        predicted = trial[:, dependent].copy()
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(_NEWTON_STEPS):
                trial[:, dependent] += self._newton(trial)[1][:, :, 0]
            phi, _, after, turned = self._newton(trial)
            moved = np.abs(trial[:, dependent] - predicted) / step_sizes(mechanism)[dependent]
            change = np.abs(after - gamma).max(axis=(1, 2)) / (1 + np.abs(gamma).max(axis=(1, 2)))
            regular = np.abs(phi).max(axis=(1, 2), initial=0.0) <= CLOSED_M
            regular &= (moved.max(axis=1, initial=0.0) < MAX_CORRECTION_SHARE) & (change <= MAX_GAMMA_CHANGE)
            regular &= np.all(turned * before > 0, axis=(1, 2))
        trial[~regular] = np.nan
        return trial

    def _newton(self, q: np.ndarray) -> list[np.ndarray]:
        """Return phi, Newton's step, Gamma and the determinants at poses (n, n_q), each (n, rows, columns)."""
        function = self.outputs.mechanism.dynamics.closure_step
        stacked = evaluated(mapped(function, len(q)), q.T)
        shapes = [function.size_out(k) for k in range(function.n_out())]
        return [
            x.reshape(rows, len(q), columns).transpose(1, 0, 2) for x, (rows, columns) in zip(stacked, shapes, strict=True)
        ]

    def _status(self, found: np.ndarray) -> np.ndarray:
        mechanism = self.outputs.mechanism
        lower, upper = np.array([(joint.lower, joint.upper) for joint in mechanism.joints]).T
        beyond = np.maximum(found - upper, lower - found)
        beyond[:, mechanism.independent] = 0.0
        worst = np.argmax(np.nan_to_num(beyond), axis=1)
        status = np.where(np.nan_to_num(beyond).max(axis=1) > RANGE_ROUNDING, BEYOND_RANGE + worst, ON_MAP)
        return np.where(np.isnan(found[:, 0]), OPEN_LOOPS, status)
