"""Durations far too short: answered before any solve of the motion, with the shortest one and a limit's factor."""

import numpy as np
import pytest

from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.search.reasons import path_effort
from tests.support.bodies import HINGE, PENDULUM, body_problem
from tests.support.data import KNEE_TABLE
from tests.support.plans import GOAL, LIMIT, START, planned, problem_of

SHORTEST = KNEE_TABLE["min_time_rest_to_rest"]["shank_s"]
# What the phase plane's grid costs of the least time, relative.
PHASE_PLANE = 2e-3
TOO_SHORT = "motion.duration_s=0.001"


def test_a_reach_in_a_millisecond_is_answered_without_a_solve():
    plan = planned("knee-reach", TOO_SHORT)
    assert plan.status == "infeasible"
    assert plan.history == ()
    assert plan.details["shortest_duration_s"] == pytest.approx(SHORTEST, rel=PHASE_PLANE)
    assert "122 times too short" in plan.message
    assert "the shortest feasible duration is about 0.1219 s" in plan.message
    assert f"times its limit of {LIMIT:g}" in plan.message


def test_the_factor_is_that_of_inverse_dynamics_along_the_smoothest_path():
    mechanism = problem_of("knee-reach").mechanism
    x, T = np.linspace(0.0, 1.0, 400), 1e-3
    s = START + (GOAL - START) * (10 * x**3 - 15 * x**4 + 6 * x**5)
    v = (GOAL - START) * (30 * x**2 - 60 * x**3 + 30 * x**4) / T
    a = (GOAL - START) * (60 * x - 180 * x**2 + 120 * x**3) / T**2
    q = follow(mechanism, s[:, None], planned("knee-reach").trajectory.start_pose)
    effort, _ = needed_effort(mechanism, q, v[:, None], a[:, None])
    found = planned("knee-reach", TOO_SHORT).details["smooth_path_limit_factor"]
    assert found == pytest.approx(np.abs(effort).max() / LIMIT, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("duration", ["0.1", "0.03"])
def test_a_duration_that_is_only_a_little_too_short_is_looked_into_as_before(duration):
    plan = planned("knee-reach", f"motion.duration_s={duration}")
    assert plan.status == "infeasible"
    assert plan.history
    assert "times too short" not in plan.message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("problem", "words"),
    [
        ("five-bar-reach", ["act_O", "times its limit of 1.4", "0.2293 s"]),
        ("cart-pole-swing-up", ["act_cart", "no actuator gives", "on pole"]),
        ("gripper-close", ["pull on tendon cable", "times its limit of 20", "0.0885"]),
        ("squeezer-turn", ["drive on joint beta", "0.01408 s"]),
    ],
)
def test_other_mechanisms_are_answered_so_too(problem, words):
    free = ["limits.speed_deg_s={}"] if problem == "five-bar-reach" else []
    plan = planned(problem, TOO_SHORT, *free)
    assert plan.status == "infeasible"
    assert plan.history == ()
    for word in ["times too short", "shortest feasible duration", *words]:
        assert word in plan.message


@pytest.mark.slow
def test_a_weak_motor_that_swings_up_is_not_taken_for_hurried():
    weak = planned("knee-reach", "motion.duration_s=0.2", "limits.effort.act_O=[-0.1, 0.1]")
    assert "times too short" not in weak.message


def test_inertia_alone_asks_for_the_whole_effort_of_a_body_without_weight():
    motion = 'kind = "reach"\nstart_deg = { J = 10.0 }\ngoal_deg = { J = 100.0 }\nduration_s = 0.01\n'
    problem = body_problem(HINGE, motion)
    path = path_effort(problem, first_guess(problem, problem.start_pose()))
    assert path.factor > 1
    assert path.inertial_factor == pytest.approx(path.factor, rel=1e-9)


def test_weight_is_no_part_of_what_inertia_asks_for():
    motion = 'kind = "reach"\nstart_deg = { J = 10.0 }\ngoal_deg = { J = 100.0 }\nduration_s = 0.01\n'
    light, heavy = (body_problem(PENDULUM.format(limit=limit), motion) for limit in (1.0, 2.0))
    factors = [path_effort(one, first_guess(one, one.start_pose())).inertial_factor for one in (light, heavy)]
    inertia = 0.01 + 0.25  # about the hinge
    largest = np.radians(90.0) * 10 / np.sqrt(3) / 0.01**2  # of the fifth-order polynomial
    assert factors[0] == pytest.approx(inertia * largest / 1.0, rel=0.01)
    assert factors[1] == pytest.approx(factors[0] / 2, rel=1e-9)
