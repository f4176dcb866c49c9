"""The certificate of a motion whose damping acts within microseconds."""

import numpy as np

from linkplan.planner.certificate import integration
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import QUARTER_TURN, TURN, body_problem
from tests.support.motions import motion_along

# Inertia over damping is 10 us. The motion takes 1.5 s.
INERTIA, DAMPING, DURATION_S = 1e-5, 1.0, 1.5
DAMPED = f"""<mujoco><option gravity="0 0 0"/><worldbody>
<body name="finger"><joint name="J" axis="0 1 0" damping="{DAMPING}"/>
<inertial pos="0 0 0" mass="0.01" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/></body></worldbody>
<actuator><motor name="motor" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""


def cubic_turn(n: int = 10) -> Trajectory:
    """Return the quarter turn by a cubic from rest to rest in n intervals, with the efforts that it needs."""
    t = np.linspace(0.0, 1.0, n + 1)
    s, v = np.radians(10.0) + TURN * t**2 * (3 - 2 * t), 6 * TURN * t * (1 - t) / DURATION_S
    a, jerk, h = 6 * TURN * (1 - 2 * t) / DURATION_S**2, -12 * TURN / DURATION_S**3, DURATION_S / n
    u, rate = INERTIA * a + DAMPING * v, INERTIA * jerk + DAMPING * a
    position = [s[:-1], s[:-1] + h * v[:-1] / 3, s[1:] - h * v[1:] / 3, s[1:]]
    return motion_along(DURATION_S * t, position, effort=[u[:-1], u[:-1] + h * rate[:-1] / 2, u[1:]])


def test_a_stiff_motion_is_integrated_by_an_implicit_method_after_one_explicit_attempt(monkeypatch):
    counts, called = [], integration.called

    def counting(*given):
        rate = called(*given)
        counts.append(0)

        def counted(t, y):
            counts[-1] += 1
            return rate(t, y)

        return counted

    monkeypatch.setattr(integration, "called", counting)
    certificate = certify(body_problem(DAMPED, QUARTER_TURN + f"duration_s = {DURATION_S}\n"), cubic_turn())
    assert certificate.passed, certificate.failures
    # Only the first interval is tried explicitly, with at most 2,000 evaluations. Explicit steps alone take up to 27,000.
    *others, most = sorted(counts)
    assert 1_000 < most < 2_400
    assert max(others) < 100
