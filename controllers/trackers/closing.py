"""The whole pose at a measured position, as an expression: trackers are given the independent joints alone."""

import casadi as ca

from linkplan.models.mechanism import Mechanism

# The loop is closed by Newton along this many strides from a pose near.
_STRIDES, _NEWTON_STEPS = 4, 2
# How often functions of the reduced dynamics are called for that.
CLOSING_CALLS = {"velocity_map": _STRIDES, "closure_step": _STRIDES * _NEWTON_STEPS, "independent_closure": 1}
# A loop that is open by more than this [m] was not closed: the position is too far from the pose near.
CLOSED_NEAR_M = 1e-6


def closed_near(mechanism: Mechanism, near: ca.MX, s: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return the pose q (n_q,) at independent positions s (n_s,) on the branch of a pose near, and its loops' gap [m]."""
    dynamics, dependent = mechanism.dynamics, mechanism.dependent.tolist()
    independent = mechanism.independent.tolist()
    q = ca.MX(near)
    if not dependent:
        q[independent] = s
        return q, ca.MX(0)
    for stride in range(_STRIDES):
        onward = (s - q[independent]) / (_STRIDES - stride)
        there = q[independent] + onward
        q = q + dynamics.velocity_map(q) @ onward
        q[independent] = there
        for _ in range(_NEWTON_STEPS):
            q[dependent] += dynamics.closure_step(q)[1]
    return q, ca.norm_inf(dynamics.independent_closure(q))
