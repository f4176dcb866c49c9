"""Closure gaps and contacts of many simulations at once, from MuJoCo's positions of the tied points.

MuJoCo's arrays are copied after every step and evaluated for many steps together, because an evaluation takes longer than a
step.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch

from linkplan.controllers.trackers.linear import added

_CONNECT, _WELD = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)
_FIRST, _SECOND = slice(0, 3), slice(3, 6)


class ClosureWatch:
    """The largest gap of tied points and the largest number of contacts of a batch's simulations so far.

    A frozen simulation keeps its last state, which changes neither maximum.
    """

    def __init__(self, batch: Batch, models: Sequence[mujoco.MjModel]) -> None:
        model, n = models[0], len(models)
        ties = [i for i in range(model.neq) if model.eq_active0[i] and int(model.eq_type[i]) in (_CONNECT, _WELD)]
        self._model = model
        self._at_sites = [i for i in ties if model.eq_objtype[i] == int(mujoco.mjtObj.mjOBJ_SITE)]
        self._at_bodies = [i for i in ties if i not in self._at_sites]
        self._anchors = np.array([[one.eq_data[i, :6] for one in models] for i in self._at_bodies])  # (ties, n, 6)
        names = ["ncon", *(["site_xpos"] if self._at_sites else []), *(["xpos", "xmat"] if self._at_bodies else [])]
        self._live = {name: batch.bind(name) for name in names}
        size = sum(array.nbytes for array in self._live.values())
        steps = max(1, min(64, 8_388_608 // max(size, 1)))  # copies of at most 8 MiB
        self._copies = {name: np.empty((steps, *array.shape), array.dtype) for name, array in self._live.items()}
        self._pairs = [(self._copies[name], array) for name, array in self._live.items()]
        self._steps, self._noted = steps, 0
        self._squares, self._contacts = np.zeros(n), np.zeros(n, dtype=int)

    def note(self) -> None:
        """Copy the simulations' present positions and contacts."""
        for copies, live in self._pairs:
            copies[self._noted] = live
        self._noted += 1
        if self._noted == self._steps:
            self._evaluate()

    def largest(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest gaps [m] and numbers of contacts (n,) over all copies."""
        self._evaluate()
        return np.sqrt(self._squares), self._contacts

    def _evaluate(self) -> None:
        noted, self._noted = self._noted, 0
        if not noted:
            return
        copies, model = {name: array[:noted] for name, array in self._copies.items()}, self._model
        self._contacts = np.maximum(self._contacts, copies["ncon"].reshape(noted, -1).max(axis=0))
        for i in self._at_sites:
            sites = copies["site_xpos"]
            self._widen(sites[:, :, model.eq_obj1id[i]] - sites[:, :, model.eq_obj2id[i]])
        for i, anchor in zip(self._at_bodies, self._anchors, strict=True):
            # For a weld, MuJoCo stores the point in the second body's frame first.
            data = (_SECOND, _FIRST) if int(model.eq_type[i]) == _WELD else (_FIRST, _SECOND)
            ends = []
            for body, columns in zip((model.eq_obj1id[i], model.eq_obj2id[i]), data, strict=True):
                turn = copies["xmat"][:, :, body].reshape(noted, -1, 3, 3)
                ends.append(copies["xpos"][:, :, body] + added(turn * anchor[:, None, columns]))
            self._widen(ends[0] - ends[1])

    def _widen(self, gap: np.ndarray) -> None:
        """Update the largest gap with vectors (steps, n, 3) between two tied points."""
        self._squares = np.fmax(self._squares, np.fmax.reduce(added(gap**2), axis=0))
