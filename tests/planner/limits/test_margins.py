"""Margins of quantities along a motion: extremes between samples against parabolas, and sentences on joints."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.joints import RangeLimit, SpeedLimit
from linkplan.planner.limits.kinds import violation
from linkplan.planner.limits.limit import LimitFacts, Measured, margin_of
from linkplan.planner.limits.samples import Samples, least_between, sample_points, samples_of
from linkplan.planner.transcription.bernstein import bernstein_matrix
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
from tests.support.limited_row import LimitedRow
from tests.support.motions import motion_along
from tests.support.plans import optimal


def parabolas() -> Samples:
    """Return a hinge's motion by 20 (t - 0.37)^2 + 3 in its first second, and 20 (t - 1.37)^2 - 2 in the next."""
    begin, slope, end = 20 * 0.37**2, -40 * 0.37, 20 * 0.63**2
    position = np.array([begin, begin + slope / 2, end])[:, None] + np.array([3.0, -2.0])
    motion = motion_along(np.arange(3.0), position)
    return samples_of(body_problem(HINGE, QUARTER_TURN + "duration_s = 2.0\n"), motion)


SAMPLES = parabolas()
CURVE, POINTS = SAMPLES.q[:, 0], SAMPLES.points
ROW = LimitedRow(LimitFacts(kind="q"), 0)


@pytest.mark.parametrize(
    ("sign", "bounds", "upper", "left", "overruns"),
    [
        (1.0, (-1.0, 29.0), False, -1.0, (0.0, 1.0)),
        (-1.0, (-29.0, 1.0), True, -1.0, (0.0, 1.0)),
        (1.0, (-4.0, 29.0), False, 2.0, (0.0, 0.0)),
        (-1.0, (-np.inf, 4.0), True, 2.0, (0.0, 0.0)),
    ],
)
def test_the_extreme_of_a_parabola_is_the_value_nearest_to_its_limit(sign, bounds, upper, left, overruns):
    margin = margin_of(ROW, Measured("q", sign * CURVE, bounds, "N"), POINTS, SAMPLES.time)
    assert margin.upper is upper
    assert margin.limit == bounds[upper]
    assert margin.value == pytest.approx(-2.0 * sign, rel=1e-9)
    assert margin.left == pytest.approx(left, rel=1e-9)
    assert margin.overrun == pytest.approx(overruns, rel=1e-9)
    assert margin.time_s == pytest.approx(1.37, abs=0.1)
    assert margin.kept is (left >= 0)


def test_an_interval_with_a_kink_has_the_least_of_its_samples():
    values, bent = np.concatenate([20 * (POINTS - 0.37) ** 2 - 2.0, POINTS + 5.0]), np.arange(2 * len(POINTS)) == 3
    margin = margin_of(ROW, Measured("q", values, (0.0, np.inf), "N", bent=bent), POINTS, SAMPLES.time)
    assert margin.left == values.min()


REACH = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 90.0 }\nduration_s = 2.0\n'


def turn(*overrides: str):
    """Return a problem and the motion q = 100 deg sin(pi t / 2), up and back in two seconds, by polynomials."""
    problem = body_problem(HINGE, REACH, *overrides)
    breaks = np.linspace(0.0, 2.0, 5)
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(6) / 5)
    time = breaks[:-1] + 0.5 * nodes[:, None]
    angle, rate = np.radians(100.0), 0.5 * np.pi
    position, velocity = angle * np.sin(rate * time), angle * rate * np.cos(rate * time)
    solved = [np.linalg.solve(bernstein_matrix(5, nodes), values)[:, :, None] for values in (position, velocity)]
    motion = motion_along(breaks, solved[0], velocity=solved[1])
    return problem, motion


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        ("[-10.0, 95.0]", "joint J would have to be 100 deg at t = 1 s, 5 deg beyond its limit of 95 deg"),
        ("[-10.0, 101.0]", None),
    ],
)
def test_a_joint_that_would_leave_its_range_is_named_with_the_instant_and_the_excess(limit, said):
    over = violation(RangeLimit, *turn(f"limits.range_deg.J={limit}"))
    assert (over and over.sentence("would have to be")) == said


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        (
            "[-150.0, 500.0]",
            "the speed of joint J would have to be -157.1 deg/s at t = 2 s, 7.08 deg/s beyond its limit of -150 deg/s",
        ),
        ("158.0", None),
    ],
)
def test_a_joint_that_would_be_too_fast_is_named_with_the_instant_and_the_excess(limit, said):
    over = violation(SpeedLimit, *turn(f"limits.speed_deg_s.J={limit}"))
    assert (over and over.sentence("would have to be")) == said


SAMPLE_POINTS = sample_points(3)


@pytest.mark.parametrize(
    "values",
    [
        -5.0 * (SAMPLE_POINTS - 0.4) ** 2,
        SAMPLE_POINTS + 1.0,
        np.where(SAMPLE_POINTS > 0.5, np.inf, 3.0),
        5.0 * (SAMPLE_POINTS - 1.01) ** 2,
        5.0 * (SAMPLE_POINTS + 0.01) ** 2,
    ],
)
def test_without_a_vertex_inside_the_least_sample_counts(values):
    assert least_between(values, SAMPLE_POINTS)[0] == values.min()


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
    values = np.cosh(SAMPLE_POINTS - lowest) + 0.3 * (SAMPLE_POINTS - lowest) ** 3 - 3.0
    assert least_between(values, SAMPLE_POINTS)[0] == pytest.approx(-2.0, abs=1e-10)


def test_a_kink_elsewhere_in_the_interval_does_not_change_the_least_value():
    points = sample_points(9)
    values = np.cosh(points - 0.31) + 5.0 * np.maximum(points - 0.8, 0.0)
    assert least_between(values, points)[0] == pytest.approx(1.0, abs=1e-10)


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
        limited = problem.varied(limits=replace(problem.limits, speed=speed))
        assert certify(limited, trajectory).passed is passes
