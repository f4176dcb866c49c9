"""The note on pins that lie off the shapes of both bodies that they join, as after a wrong length."""

import mujoco
import numpy as np

from linkplan.models.kinematics import tied_points
from linkplan.models.mechanism import Mechanism

# A pin farther than this share of the mechanism's extent from a body's shapes is off the body: shapes are simplified.
_OFF_SHARE = 0.02


def stray_pins(mechanism: Mechanism) -> list[str]:
    """Return the notes on connects given by an anchor that is off both bodies: an anchor closes its loop wherever it is."""
    model, found = mechanism.model, []
    for closure in mechanism.closures:
        if closure.kind != "point" or int(model.eq_objtype[closure.index]) != int(mujoco.mjtObj.mjOBJ_BODY):
            continue
        off = [_distance_from_shapes(model, body, point) for body, point in tied_points(model, closure.index)]
        if min(off) > _OFF_SHARE * mechanism.extent_m:
            names = " and ".join(model.body(body).name for body, _ in tied_points(model, closure.index))
            found.append(
                f"pin {closure.name} lies {1e3 * min(off):.3g} mm off the shapes of both its bodies, {names}: check its"
                " anchor, or give a site on each body (site1, site2), so that a wrong length opens the loop"
            )
    return found


def _distance_from_shapes(model: mujoco.MjModel, body: int, point: np.ndarray) -> float:
    """Return the distance [m] of a point (3,) in a body's frame from the boxes around its geoms; 0 without any."""
    off = []
    for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        inside = turn.reshape(3, 3).T @ (point - model.geom_pos[geom]) - model.geom_aabb[geom, :3]
        off.append(float(np.linalg.norm(np.maximum(np.abs(inside) - model.geom_aabb[geom, 3:], 0.0))))
    return min(off, default=0.0)
