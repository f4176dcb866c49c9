"""The least value of a curve between its samples."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.samples import least_between, sample_points
from tests.support.plans import optimal

POINTS = sample_points(3)


@pytest.mark.parametrize(
    "values",
    [
        -5.0 * (POINTS - 0.4) ** 2,
        POINTS + 1.0,
        np.where(POINTS > 0.5, np.inf, 3.0),
        5.0 * (POINTS - 1.01) ** 2,
        5.0 * (POINTS + 0.01) ** 2,
    ],
)
def test_without_a_vertex_inside_the_least_sample_counts(values):
    assert least_between(values, POINTS)[0] == values.min()


@pytest.mark.parametrize("n_nodes", [1, 3, 5, 7, 9])
def test_the_least_value_of_a_wave_as_short_as_nodes_can_follow_is_found_to_a_hundredth(n_nodes):
    """A polynomial follows a wave with some four nodes a period, and a motion of few nodes may still turn within one."""
    points, share = sample_points(n_nodes), np.linspace(0.0, 1.0, 20001)
    pace = 2 * np.pi * max(1.0, n_nodes / 4)
    for phase in np.linspace(0.0, 2 * np.pi, 61):
        least = least_between(np.cos(pace * points + phase), points)[0]
        assert least == pytest.approx(np.cos(pace * share + phase).min(), abs=0.01)


@pytest.mark.parametrize("lowest", [0.02, 0.31, 0.5, 0.77, 0.99])
def test_the_least_value_of_a_curve_that_is_no_parabola_is_found_to_rounding(lowest):
    values = np.cosh(POINTS - lowest) + 0.3 * (POINTS - lowest) ** 3 - 3.0
    assert least_between(values, POINTS)[0] == pytest.approx(-2.0, abs=1e-10)


@pytest.mark.parametrize("joint", ["O", "A", "C"])
def test_a_limit_at_the_largest_speed_passes_above_it_and_fails_below(joint):
    plan = optimal("knee-reach")
    problem, trajectory, mechanism = plan.problem, plan.trajectory, plan.problem.mechanism
    i = mechanism.joint_index(joint)

    def slowness(time_s: float) -> float:
        q = follow(mechanism, trajectory.position_at(np.array([time_s])), trajectory.start_pose)
        return -abs(joint_rates(mechanism, q, trajectory.velocity_at(np.array([time_s])))[0, i])

    times = trajectory.dense_times()
    at = times[int(np.argmin([slowness(t) for t in times]))]
    around = (at - 1e-3, at + 1e-3)
    peak = -scipy.optimize.minimize_scalar(slowness, bounds=around, method="bounded", options={"xatol": 1e-9}).fun
    assert np.degrees(peak) > 700
    for beyond_deg, passes in ((1e-6, True), (-1e-6, False)):
        speed = np.array(problem.limits.speed)
        speed[i] = np.array([-1, 1]) * (peak + np.radians(beyond_deg))
        limited = replace(problem, limits=replace(problem.limits, speed=speed))
        assert certify(limited, trajectory).passed is passes
