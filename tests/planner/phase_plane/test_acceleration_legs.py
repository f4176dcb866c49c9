"""Least times along limits on accelerations of joints and sites, against closed forms and a grid in (s, s'^2)."""

import numpy as np
import pytest

from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.phase_plane.legs_motion import legs_motion
from linkplan.planner.phase_plane.power_legs import power_legs
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.bench.acceleration_limits import N_CELLS, drawn, text_of
from tests.support.bodies import cart
from tests.support.grid_least_time import least_time_on_grid

# Of the least time: the share of limits that is left for polynomials, and the error of the grid.
LATE, GRID = 1e-8, 1e-5
# Random four-bars and slider-cranks: a limited rocker at rest in between, a limited site, both, and one with a speed limit.
DRAWN = (0, 2, 4, 15)

# An arm without weight whose tip moves on a circle of 0.5 m.
ARM = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/><site name="tip" pos="0.5 0 0"/></body></worldbody>
<actuator><motor name="u" joint="J" ctrlrange="-100 100"/></actuator></mujoco>"""


def test_a_cart_with_a_limited_acceleration_takes_the_closed_form_s_time():
    asked = {"start_m": {"x": 0.0}, "goal_m": {"x": 2.0}, "minimize": "time", "limits": {"acceleration_m_s2": {"x": 0.5}}}
    problem = Problem.reach(cart(), **asked)
    _, boundaries = power_legs(problem, problem.start_pose())
    assert boundaries[-1] == pytest.approx(2 * np.sqrt(2.0 / 0.5), rel=1e-9)


def test_a_tip_on_a_circle_gathers_speed_by_its_whole_acceleration_and_keeps_the_speed_of_its_limit():
    """On the way to the speed v_0^2 = A / r, v' = sqrt(A^2 / r^2 - v^4), over an angle of pi / 4."""
    largest, radius, angle = 20.0, 0.5, np.radians(150.0)
    problem = Problem.reach(
        ARM,
        start_deg={"J": 0.0},
        goal_deg={"J": 150.0},
        minimize="time",
        limits={"site_acceleration_m_s2": {"tip": largest}},
    )
    top = np.sqrt(largest / radius)
    gathered = 1.3110287771460600  # the integral of 1 / sqrt(1 - x^4) from 0 to 1
    least = 2 * gathered / top + (angle - np.pi / 2) / top
    motion = legs_motion(problem, problem.start_pose())
    assert motion.duration_s == pytest.approx(least, rel=LATE)
    certificate = certify(problem, motion)
    assert certificate.passed, certificate.failures


@pytest.mark.slow
@pytest.mark.parametrize("number", DRAWN)
def test_least_times_under_acceleration_limits_are_those_of_a_grid(number):
    problem, _ = drawn(number)
    plan = plan_motion(problem)
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(least_time_on_grid(problem, N_CELLS), rel=GRID)


def test_a_limited_rocker_passes_its_dead_centre_at_the_speed_that_its_limit_allows_there():
    """There the crank's acceleration has no effect on the rocker's, r' v^2, and the grid's least time is 0.3380584 s."""
    text = text_of("four-bar", gravity=-9.81, damping=0.05, mass=0.4, low=1.2, high=1.2)
    asked = {"start_deg": {"P": -40.0}, "goal_deg": {"P": 60.0}, "minimize": "time"}
    problem = Problem.reach(text, **asked, limits={"acceleration_deg_s2": {"R": 2000.0}})
    legs, boundaries = power_legs(problem, problem.start_pose())
    assert boundaries[-1] == pytest.approx(0.3380584, rel=1e-6)
    place, speed = legs[2].state(legs[2].begin)
    gamma = problem.mechanism.dynamics.velocity_map
    rocker, step = [joint.name for joint in problem.mechanism.joints].index("R"), 1e-5
    ratios = [float(gamma(follow(problem.mechanism, np.array([[at]]), problem.start_pose())[0])[rocker])
              for at in (place - step, place, place + step)]  # fmt: skip
    assert ratios[1] == pytest.approx(0.0, abs=1e-6)
    assert (ratios[2] - ratios[0]) / (2 * step) * speed**2 == pytest.approx(-np.radians(2000.0), rel=1e-6)
