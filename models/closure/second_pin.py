"""A second pin between the same two bodies: what it adds to the first, and nothing that only closed loops make redundant.

Two connects make a hinge of two bodies. With d the way from pin to pin in the one body and d_0 in the other, their residuals
differ by delta = R d - d_0, and since both ways are as long,

    (R d + d_0) . delta = 0,

so that of six rows five are independent, but by a combination that turns with the bodies. Rows chosen once serve everywhere
where only what is across d_0 is asked of the second pin,

    phi_2 = phi_1 + (I - e e^T) delta,   e = d_0 / |d_0|,

which vanishes with phi_1 where R d = d_0 as before (and where R d = -d_0, half a turn away), and has the same Jacobian
there.
"""

import casadi as ca
import numpy as np

# Ways from pin to pin are as long as one another to this share: else the pins gape, and all their rows count.
_SAME = 1e-10
# Residuals that differ by less than this share of the pins' distance at a pose taken at random never differ.
_NOTHING = 1e-9


def across(first: tuple[ca.SX, ca.SX], second: tuple[ca.SX, ca.SX], places: np.ndarray, q: ca.SX) -> ca.SX | None:
    """Return phi_2 (3,) [m] of a second pin, or None where its own residual serves as well.

    Args:
        first: where the first pin's two ends are (3,) [m], expressions of q; along the axes of the one body, or of what
            carries both.
        second: where the second pin's are, of the same bodies in the same order.
        places: of both pins in both bodies' own frames (2 pins, 2 bodies, 3) [m].
        q: the coordinates (n_q,).
    """
    long = np.linalg.norm(places[1] - places[0], axis=-1)
    if min(long) == 0 or abs(long[0] - long[1]) > _SAME * max(long):
        return None
    ways = [later - earlier for earlier, later in zip(first, second, strict=True)]
    still = [way for way in ways if not ca.symvar(way)]
    if len(still) != 1:
        return None
    delta = ways[0] - ways[1]
    pose = np.random.default_rng(0).uniform(-1.0, 1.0, q.numel())
    if np.abs(np.array(ca.Function("delta", [q], [delta])(pose))).max() <= _NOTHING * max(long):
        return None
    e = np.array(ca.evalf(still[0])).ravel() / max(long)
    return first[0] - first[1] + ca.DM(np.eye(3) - np.outer(e, e)) @ delta
