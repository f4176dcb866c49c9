"""Mechanisms, problems and plans go to other processes and come back: what they say is the same there."""

import pickle

import numpy as np
import pytest

import linkplan


@pytest.fixture(scope="module")
def plan():
    knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    return linkplan.plan(linkplan.Problem.reach(knee, start_deg={"O": -20}, goal_deg={"O": 20}, duration_s=0.2))


def sent(what):
    return pickle.loads(pickle.dumps(what))


def test_a_plan_is_the_same_motion_with_the_same_certificate(plan):
    again = sent(plan)
    assert (again.status, again.objective) == (plan.status, plan.objective)
    at = np.linspace(0.0, 0.2, 7)
    for joint, angles in plan.sample(at).position.items():
        np.testing.assert_array_equal(again.sample(at).position[joint], angles)
    assert str(again) == str(plan)


def test_a_problem_is_planned_elsewhere_as_here(plan):
    assert linkplan.plan(sent(plan.problem)).objective == plan.objective


def test_a_mechanisms_loops_close_elsewhere_too(plan):
    knee = plan.problem.planning.mechanism
    again = sent(knee)
    pose = knee.home + np.array([0.1, 0.0, 0.0])
    np.testing.assert_array_equal(np.array(again.dynamics.closure(pose)), np.array(knee.dynamics.closure(pose)))
    np.testing.assert_array_equal(again.qpos_of(pose), knee.qpos_of(pose))
