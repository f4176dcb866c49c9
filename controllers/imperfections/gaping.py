"""The gap of closures in many simulations at once, from MuJoCo's own places of what they tie."""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch

from linkplan.controllers.trackers.linear import added

Rows = np.ndarray | slice


def gaps(batch: Batch, models: Sequence[mujoco.MjModel]) -> Callable[[Rows], np.ndarray]:
    """Return the function of a batch's rows that gives the largest gap's square (r,) [m2] of tied points after a step."""
    model = models[0]
    points = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    ties = [i for i in range(model.neq) if model.eq_active0[i] and int(model.eq_type[i]) in points]
    at_sites = [i for i in ties if model.eq_objtype[i] == int(mujoco.mjtObj.mjOBJ_SITE)]
    at_bodies = [i for i in ties if i not in at_sites]
    sites = batch.bind("site_xpos") if at_sites else None
    places, turns = (batch.bind("xpos"), batch.bind("xmat")) if at_bodies else (None, None)
    anchors = np.array([[one.eq_data[i, :6] for one in models] for i in at_bodies])  # (ties, n, 6)

    def now(rows: Rows) -> np.ndarray:
        squares = [added((sites[rows, model.eq_obj1id[i]] - sites[rows, model.eq_obj2id[i]]) ** 2) for i in at_sites]
        for i, anchor in zip(at_bodies, anchors, strict=True):
            swapped = int(model.eq_type[i]) == points[1]  # a weld's point is in its second body's frame
            ends = []
            for body, data in zip(
                (model.eq_obj1id[i], model.eq_obj2id[i]), (slice(3, 6), slice(0, 3)) if swapped else _CONNECT, strict=True
            ):
                turn = turns[rows, body].reshape(-1, 3, 3)
                ends.append(places[rows, body] + added(turn * anchor[rows, None, data]))
            squares.append(added((ends[0] - ends[1]) ** 2))
        if not squares:
            return np.zeros(len(batch.qpos[rows]))
        worst = squares[0]
        for square in squares[1:]:
            worst = np.fmax(worst, square)
        return worst

    return now


_CONNECT = (slice(0, 3), slice(3, 6))
