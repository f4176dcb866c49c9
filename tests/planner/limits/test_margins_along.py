"""Margins of an actuator's limits along a motion whose effort and speed are polynomials, against their closed forms."""

import numpy as np
import pytest

from linkplan.planner.limits.kinds import margins_along
from linkplan.planner.limits.samples import samples_of
from tests.support.bodies import HINGE, body_problem
from tests.support.motions import motion_along

REACH = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 90.0 }\nduration_s = 1.0\n'


def margin(*limit: str):
    """Return the margin of a limit along q = t^2, w = 2 t, u = 3 - t for a second."""
    problem = body_problem(HINGE, REACH, *limit)
    motion = motion_along([0.0, 1.0], [0.0, 0.0, 1.0], effort=[3.0, 2.0])
    samples = samples_of(problem, motion)
    (found,) = margins_along(samples)
    return found


@pytest.mark.parametrize(("stall", "no_load", "most"), [(4.0, 4.0, 1.0), (4.0, 5.0, 0.9), (2.0, 10.0, 1.5), (5.0, 2.0, 1.4)])
def test_a_motors_line_is_the_sum_of_the_shares_of_its_stall_effort_and_no_load_speed(stall, no_load, most):
    line = margin(f"motors.motor={{stall_effort={stall},no_load_speed_deg_s={float(np.degrees(no_load))}}}")
    assert line.value == pytest.approx(most, rel=1e-9)
    assert line.kept is (most <= 1.0)


@pytest.mark.parametrize(("most", "left"), [(5.0, 1.0), (3.5, -0.5)])
def test_power_is_effort_times_speed(most, left):
    """u w = 2 t (3 - t) is 4 W at the end."""
    power = margin(f"limits.power_w.motor={most}")
    assert power.value == pytest.approx(4.0, rel=1e-9)
    assert power.left == pytest.approx(left, rel=1e-9)
