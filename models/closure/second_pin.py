"""The residual of a second pin between the same two bodies, without the component that is redundant at closed poses.

Two connects between two bodies form a hinge. Let d be the vector from pin to pin in one body, d_0 in the other, and R the
relative rotation. The two residuals differ by delta = R d - d_0, and since d and d_0 have the same length,

    (R d + d_0) . delta = 0.

Five of the six rows are therefore independent, but the dependent combination changes with the pose. The same rows serve at
every pose if the second pin only has the components normal to d_0,

    phi_2 = phi_1 + (I - e e^T) delta,   e = d_0 / |d_0|.

Together with phi_1 this vanishes where R d = d_0, as before (and where R d = -d_0, half a turn away), and has the same
Jacobian there.
"""

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE


def second_pin_residual(
    first: tuple[ca.SX, ca.SX], second: tuple[ca.SX, ca.SX], places: np.ndarray, q: ca.SX
) -> ca.SX | None:
    """Return phi_2 (3,) [m] of a second pin, or None if the pin's own residual serves.

    Args:
        first: the positions (3,) [m] of the first pin's two ends, expressions of q in the axes of one of the bodies or of
            their common carrier.
        second: the positions of the second pin's ends, with the bodies in the same order.
        places: the positions of both pins in both bodies' own frames (2 pins, 2 bodies, 3) [m].
        q: the coordinates (n_q,).
    """
    long = np.linalg.norm(places[1] - places[0], axis=-1)
    if min(long) == 0 or abs(long[0] - long[1]) > 1e-10 * max(long):
        return None  # the two pins cannot both close, and all rows are needed
    ways = [later - earlier for earlier, later in zip(first, second, strict=True)]
    still = [way for way in ways if not ca.symvar(way)]
    if len(still) != 1:
        return None
    delta = ways[0] - ways[1]
    pose = np.random.default_rng(0).uniform(-1.0, 1.0, q.numel())
    if np.abs(np.array(ca.Function("delta", [q], [delta])(pose))).max() <= ROUNDING_SHARE * max(long):
        return None  # delta is zero at every pose
    e = np.array(ca.evalf(still[0])).ravel() / max(long)
    return first[0] - first[1] + ca.DM(np.eye(3) - np.outer(e, e)) @ delta
