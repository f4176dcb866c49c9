"""Limits on the speeds of sites, such as feed rates: closed forms, legs of the phase plane, and proofs."""

import numpy as np
import pytest

from linkplan.models.poses.along import sampled, site_motion
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion

# 2 kg pushed over a metre by 8 N, at most at 1 m/s.
SLED = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"/><site name="tool"/>
<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody>
<actuator><motor name="m" joint="x" ctrlrange="-8 8"/></actuator></mujoco>"""


def sled(**asked) -> Problem:
    limits = {"site_speed_m_s": {"tool": 1.0}}
    return Problem.reach(SLED, start_m={"x": 0.0}, goal_m={"x": 1.0}, limits=limits, **asked)


def test_a_sled_travels_at_its_feed_rate_between_two_ramps():
    plan = plan_motion(sled(duration_s="free", minimize="time"))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(1.25, rel=1e-7)  # v / a + d / v
    assert plan.prove().verdict == "proved"


def test_the_least_effort_within_a_feed_rate_is_that_of_ramps_without_jumps():
    # Of least effort, x' is a parabola up to the limit: 4 m^2 times the integral of a^2, with a = a_0 (1 - t / T) on a ramp.
    plan = plan_motion(sled(duration_s=1.4))
    ramp = 1.5 * (1.4 - 1.0)  # its way is 2 / 3 of T
    assert plan.objective == pytest.approx(4 * 2 * (2 / ramp) ** 2 * ramp / 3, rel=1e-5)


def test_too_little_time_is_named_with_the_speed_that_would_do():
    verdict = plan_motion(sled(duration_s=1.0)).verdict
    assert (verdict.kind, verdict.overruns[0].limit) == ("infeasible", "site_speed")
    assert verdict.overruns[0].value == pytest.approx(2.0, rel=1e-4)


@pytest.mark.parametrize("limit", [0.2])
def test_a_pin_of_a_closed_chain_turns_back_at_its_dead_centre_and_keeps_its_speed(limit):
    problem = load_problem("knee-reach").replace({"motion.duration_s": "free", "objective.minimize": "time"})
    problem = problem.replace("limits.site_speed_m_s", {"B_rocker": limit})
    plan = plan_motion(problem)
    assert plan.status == "optimal"
    assert plan.prove().verdict == "proved"
    at, k = samples_of(problem, plan.trajectory), int(problem.mechanism.model.site("B_rocker").id)
    speed = np.linalg.norm(sampled(site_motion(problem.mechanism, 1), at.q, at.v, at.a)[:, :, k], axis=1)
    assert np.median(speed) == pytest.approx(limit, rel=1e-6)  # at its limit most of the time
    assert speed.max() <= limit * (1 + 1e-8)
