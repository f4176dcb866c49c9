"""The least jerk of a sled under a limit on its acceleration, against the arcs of the maximum principle."""

import numpy as np
import pytest
import scipy

import linkplan
from linkplan.planner.proof.motion import _kinetics
from linkplan.planner.trajectory import Trajectory

DISTANCE_M, DURATION_S = 0.3, 0.8
SLED = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"/>
  <geom type="box" size="0.05 0.05 0.05" mass="2"/></body></worldbody>
  <actuator><motor name="f" joint="x" ctrlrange="-40 40"/></actuator></mujoco>"""


def least_jerk(limit: float) -> float:
    """Return the least integral of the squared jerk [m2/s5] from rest to rest with accelerations up to a limit [m/s2].

    With s the time before the middle, the jerk is m (s^2 - s_1^2) / 2 until the acceleration reaches its limit at s_1, zero
    on the limit, and -m (s_2^2 - s^2) / 2 from s_2 to the middle: it is continuous, and its derivative m s is that of one
    costate. The second half mirrors the first.
    """
    half = 0.5 * DURATION_S

    def of(s_1: float) -> tuple[float, float, float]:
        m = limit / (0.5 * ((half**3 - s_1**3) / 3 - s_1**2 * (half - s_1)))
        s_2 = (3 * limit / m) ** (1 / 3)

        def acceleration(s: float) -> float:
            if s > s_1:
                return 0.5 * m * ((half**3 - s**3) / 3 - s_1**2 * (half - s))
            return limit if s > s_2 else 0.5 * m * (s_2**2 * s - s**3 / 3)

        way = scipy.integrate.quad(lambda s: 2 * s * acceleration(s), 0, half, points=[s_1, s_2], epsabs=1e-13)[0]
        first = scipy.integrate.quad(lambda s: (s**2 - s_1**2) ** 2, s_1, half)[0]
        last = scipy.integrate.quad(lambda s: (s_2**2 - s**2) ** 2, 0, s_2)[0]
        return way, 0.5 * m**2 * (first + last), s_2

    touching = scipy.optimize.brentq(lambda s: of(s)[2] - s, 0.3 * half, 0.9 * half)  # the arc on the limit is empty
    s_1 = scipy.optimize.brentq(lambda s: of(s)[0] - DISTANCE_M, touching, 0.995 * half)
    return of(s_1)[1]


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.0125, 1.05, 1.25])
def test_the_least_jerk_under_an_acceleration_limit_is_that_of_the_maximum_principle(share):
    """4 d / T^2 is the least acceleration that covers the distance, 5.77 d / T^2 that of the least jerk without a limit."""
    limit = share * 4 * DISTANCE_M / DURATION_S**2
    problem = linkplan.Problem.reach(
        linkplan.load_mechanism(SLED), start_m={"x": 0.0}, goal_m={"x": DISTANCE_M}, duration_s=DURATION_S, minimize="jerk",
        limits={"acceleration_m_s2": {"x": limit}},
    )  # fmt: skip
    plan = linkplan.plan(problem)
    assert plan.status == "optimal", plan.message
    least = least_jerk(limit)
    assert least > 1.005 * 720 * DISTANCE_M**2 / DURATION_S**5  # the limit costs something
    assert plan.objective == pytest.approx(least, rel=2e-5)


def test_rounding_of_positions_on_short_intervals_does_not_refute_an_acceleration_at_its_limit():
    """At an acceleration of 1 m/s2, second differences of positions err by 1e-7 on an interval of 0.1 ms."""

    def kinetics(width: float) -> tuple[str, ...]:
        velocity = np.array([0.5, 0.5 + width])[:, None, None]
        position = (0.3 + np.array([0.0, 0.25 * width, 0.5 * width + 0.5 * width**2]))[:, None, None]
        motion = Trajectory(
            breaks_s=np.array([0.0, width]), position=position, velocity=velocity, effort=np.ones((1, 1, 1)),
            start_pose=np.array([0.3]), periodic=False,
        )  # fmt: skip
        return _kinetics(motion, 0)

    assert kinetics(0.1) == ("of_position",)
    assert kinetics(1e-4) == ("of_velocity",)
