"""Motions that follow a reference exactly: overruns of limits, and the highest frequency that limits allow."""

import numpy as np
import pytest

from linkplan.planner.closed_chain import prescribed
from linkplan.planner.closed_chain.prescribed import highest_rate, prescribe, reference_overrun
from linkplan.planner.limits.samples import Samples, samples_of
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import HINGE, HINGE_INERTIA, body_problem

AMPLITUDE, BIAS, PULSE = np.radians(20.0), np.radians(5.0), 2 * np.pi * 0.5


def followed(*more: str, motion: str = 'kind = "track"\n') -> Problem:
    """Return the problem of an inertia that follows a sinusoid of 0.5 Hz."""
    sine = ("reference.amplitude_deg.J=20", "reference.bias_deg.J=5", "reference.frequency_hz=0.5")
    return body_problem(HINGE, motion, *sine, *more)


def along(problem: Problem) -> Samples:
    return samples_of(problem, prescribe(problem, problem.start_pose()))


def test_a_reference_is_followed_between_the_breaks_too():
    problem = followed()
    motion = prescribe(problem, problem.start_pose())
    assert motion.periodic
    t = np.linspace(0.0, 1.999, 997)
    swing = AMPLITUDE * np.sin(PULSE * t)
    assert motion.position_at(t)[:, 0] == pytest.approx(BIAS + swing, abs=1e-11)
    assert motion.velocity_at(t)[:, 0] == pytest.approx(AMPLITUDE * PULSE * np.cos(PULSE * t), abs=1e-11)
    assert motion.effort_at(t)[:, 0] == pytest.approx(-HINGE_INERTIA * PULSE**2 * swing, abs=1e-10)


@pytest.mark.parametrize(("duration", "n_intervals"), [(2.0, 12), (3.0, 18), (0.5, 8)])
def test_a_followed_reference_has_the_intervals_asked_for_in_each_period_and_at_least_eight(duration, n_intervals):
    problem = followed("mesh.intervals=12", f"motion.duration_s={duration}")
    motion = prescribe(problem, problem.start_pose())
    np.testing.assert_allclose(motion.breaks_s, np.linspace(0.0, duration, n_intervals + 1), atol=1e-12)
    assert motion.periodic is (duration == 2.0)


@pytest.mark.parametrize(
    ("limit", "duration", "what", "value", "instant"),
    [
        ("limits.range_deg.J=[-90, 10]", 2.0, "position", 25.0, 0.5),
        ("limits.range_deg.J=[-90, 10]", 0.4, "position", 5.0 + 20.0 * np.sin(PULSE * 0.4), 0.4),
        ("limits.speed_deg_s.J=[-90, 10]", 0.4, "speed", 20.0 * PULSE, 0.0),
    ],
    ids=["within", "at the end", "at the beginning"],
)
def test_the_largest_overrun_is_named_with_its_instant(limit, duration, what, value, instant):
    problem = followed(limit, f"motion.duration_s={duration}")
    over = reference_overrun(along(problem))
    assert (over.what, over.name, over.unit) == (what, "J", {"position": "deg", "speed": "deg/s"}[what])
    assert over.limit == pytest.approx(10.0)
    assert over.value == pytest.approx(value, rel=1e-6)
    assert over.time_s == pytest.approx(instant, abs=1e-4)


@pytest.mark.parametrize(("share", "what"), [(1.01, None), (0.99, "power")])
def test_a_reference_is_refused_for_any_limit_that_it_overruns(share, what):
    """The power of J a v is greatest at twice the pulse: I A^2 w^3 / 2."""
    most = share * HINGE_INERTIA * AMPLITUDE**2 * PULSE**3 / 2
    problem = followed(f"limits.power_w.motor={most}", "limits.range_deg.J=[-90, 26]")
    over = reference_overrun(along(problem))
    assert (None if over is None else over.what) == what


@pytest.mark.parametrize(("range_deg", "speed_deg_s", "worst"), [(20.0, 30.0, "speed"), (10.0, 60.0, "position")])
def test_of_two_limits_that_a_reference_overruns_the_one_of_the_larger_share_is_named(range_deg, speed_deg_s, worst):
    """It reaches 25 deg and moves at 62.8 deg/s."""
    ranges = f"limits.range_deg.J=[-90, {range_deg}]"
    problem = followed(ranges, f"limits.speed_deg_s.J=[-{speed_deg_s}, {speed_deg_s}]")
    assert reference_overrun(along(problem)).what == worst


def test_the_overrun_is_that_of_the_reference_where_the_nearest_motion_has_other_ends():
    rest = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 0.0 }\nduration_s = 2.0\n'
    problem = followed("limits.range_deg.J=[-90, 10]", motion=rest)
    assert reference_overrun(along(problem)).value == pytest.approx(25.0)


SINE_AMPLITUDE, EFFORT = np.radians(20.0), 4.0
OF_EFFORT_HZ = np.sqrt(EFFORT / (HINGE_INERTIA * SINE_AMPLITUDE)) / (2 * np.pi)


def highest(*limits: str) -> float | None:
    problem = body_problem(HINGE, 'kind = "track"\n', "reference.amplitude_deg.J=20", "reference.frequency_hz=5", *limits)
    rate = highest_rate(problem, problem.start_pose(), 1e-3, 1.0)
    return rate and 5 * rate


def test_an_inertia_s_highest_frequency_is_that_of_its_effort_limit():
    assert highest() == pytest.approx(OF_EFFORT_HZ, rel=1e-6)


def test_a_speed_limit_allows_a_frequency_in_proportion():
    assert highest("limits.speed_deg_s.J=60") == pytest.approx(60 / 20 / (2 * np.pi), rel=1e-6)


def test_a_limit_on_acceleration_is_one_of_those_that_are_kept():
    asked = highest("limits.acceleration_deg_s2.J=200")
    assert asked == pytest.approx(np.sqrt(200 / 20) / (2 * np.pi), rel=1e-6)


def test_beyond_its_range_no_frequency_helps():
    assert highest("limits.range_deg.J=[-10, 10]") is None


def test_efforts_that_no_slower_rate_gives_are_known_without_a_motion(monkeypatch):
    problem = followed("limits.effort.motor=[0.5, 1]")
    monkeypatch.setattr(prescribed, "prescribe", None)
    assert highest_rate(problem, problem.start_pose(), 1e-3, 1.0) is None


def test_a_reference_of_a_sprung_joint_without_a_motor_is_infeasible_by_the_effort_that_it_lacks():
    arm = HINGE[HINGE.index('<body name="arm">') : HINGE.index("</worldbody>")]
    tip = arm.replace("arm", "tip").replace('"J"', '"K" stiffness="5"')
    sine = ("reference.amplitude_deg.J=20", "reference.amplitude_deg.K=10", "reference.frequency_hz=0.5")
    plan = plan_motion(body_problem(HINGE.replace("</worldbody>", f"{tip}</worldbody>"), 'kind = "track"\n', *sine))
    (over,) = plan.verdict.overruns
    lacking = (5.0 - HINGE_INERTIA * PULSE**2) * np.radians(10.0)
    assert (plan.status, over.name, abs(over.value)) == ("infeasible", "K", pytest.approx(lacking, rel=1e-6))
    assert f"{abs(over.value):.4g} N.m needed on joint K" in plan.message
