"""The whole pose at measured independent positions, as a CasADi expression: trackers measure independent joints only."""

import casadi as ca

from linkplan.models.mechanism import Mechanism

# Continuation steps from the near pose, each with this many Newton steps.
_CONTINUATION_STEPS, _NEWTON_STEPS = 4, 2
# Number of calls of functions of the reduced dynamics.
CLOSING_CALLS = {
    "velocity_map": _CONTINUATION_STEPS,
    "closure_step": _CONTINUATION_STEPS * _NEWTON_STEPS,
    "independent_closure": 1,
}
# Largest loop gap of a closed pose. A larger gap means that the position is too far from the near pose.
MAX_LOOP_GAP_M = 1e-6


def closed_near(mechanism: Mechanism, near: ca.MX, s: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return the pose q (n_q,) at independent positions s (n_s,) on the assembly branch of a near pose, and the gap [m]."""
    dynamics, dependent = mechanism.dynamics, mechanism.dependent.tolist()
    independent = mechanism.independent.tolist()
    q = ca.MX(near)
    if not dependent:
        q[independent] = s
        return q, ca.MX(0)
    for step in range(_CONTINUATION_STEPS):
        change = (s - q[independent]) / (_CONTINUATION_STEPS - step)
        target = q[independent] + change
        q = q + dynamics.velocity_map(q) @ change
        q[independent] = target
        for _ in range(_NEWTON_STEPS):
            q[dependent] += dynamics.closure_step(q)[1]
    return q, ca.norm_inf(dynamics.independent_closure(q))
