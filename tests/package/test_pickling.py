"""Values that go to other processes, and values that are refused in one line."""

import copy
import pickle

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import InertiaError, LinkplanError, LockedError, PlanError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.search.replan import NextMotion
from tests.support.plans import optimal
from tests.support.refusals import refusal


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
    for joint, angles in plan.sample(at).position_deg.items():
        np.testing.assert_array_equal(again.sample(at).position_deg[joint], angles)
    assert str(again) == str(plan)


def test_a_problem_is_planned_elsewhere_as_here(plan):
    assert linkplan.plan(sent(plan.problem)).objective == plan.objective


@pytest.mark.parametrize("another", [copy.copy, copy.deepcopy, sent], ids=["copy", "deep copy", "pickle"])
def test_a_planner_s_copy_is_a_new_planner_that_plans_the_same(plan, another):
    planner = linkplan.Planner(progress=lambda _: None)
    assert planner.plan(plan.problem).objective == plan.objective
    again = another(planner)
    assert again is not planner
    assert again.step(plan.problem) is None  # it has no last plan
    assert again.plan(plan.problem).objective == plan.objective


@pytest.mark.parametrize(
    "error", [PlanError("no motion", {"a": 1}), LockedError("locked", {"pin": 1}), InertiaError("no mass", 2)]
)
def test_an_error_keeps_what_it_carries(error):
    assert (str(sent(error)), vars(sent(error))) == (str(error), vars(error))


def test_at_no_times_a_motion_has_no_rows(plan):
    table = plan.sample(np.zeros(0))
    assert {len(column) for column in table.columns().values()} == {0}
    assert table.columns().keys() == plan.sample(np.zeros(2)).columns().keys()


def test_at_no_times_sites_have_no_places():
    trajectory, mechanism = optimal("five-bar-reach").trajectory, load_mechanism("five-bar")
    assert places_of(mechanism, 0, np.zeros((0, mechanism.n_q))).shape == (0, 3)
    for values in (trajectory.position_at, trajectory.velocity_at, trajectory.acceleration_at, trajectory.effort_at):
        assert values(np.zeros(0)).shape == (0, 2)


NO_PATHS = (None, b"plan", 5, ["reach_plan"], "", "a\0b", "\ud800", "x" * 300)


@pytest.fixture(scope="module")
def reach_plan() -> linkplan.Plan:
    return linkplan.Plan.of(optimal("knee-reach"))


@pytest.mark.parametrize("value", NO_PATHS)
def test_what_is_no_path_is_refused(value, reach_plan):
    for action in (linkplan.read_plan, reach_plan.save, reach_plan.report):
        assert "a path" in refusal(lambda action=action: action(value), LinkplanError)


@pytest.mark.usefixtures("drawn_figures")
@pytest.mark.parametrize("value", [b"plan", 5, "a\0b", "\ud800", "no/such/folder.png", "plan.tiff.xyz"])
def test_a_figure_that_cannot_be_saved_is_refused(value, reach_plan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refusal(lambda: reach_plan.plot(value), LinkplanError)


@pytest.mark.parametrize("value", ["now", 10**400, float("nan"), [[0.0]], object()])
def test_what_is_no_time_is_refused_of_a_plan_and_of_a_next_motion(value, reach_plan):
    none = dict.fromkeys(("position_bound_rad", "velocity_bound_rad_s", "effort_bound"), np.zeros(1))
    step = NextMotion(
        problem=reach_plan.problem,
        trajectory=reach_plan.trajectory,
        **none,
        duration_error_s=0.0,
        violation=0.0,
        newton_s=0.0,
        settled=True,
    )
    for motion in (reach_plan, step):
        assert "times must be finite" in refusal(lambda motion=motion: motion.sample(value), LinkplanError)


@pytest.mark.parametrize("value", ["\ud800", range(2), {"O": "\ud800"}])
def test_half_a_character_and_what_only_looks_like_a_table_are_refused(value):
    reach = linkplan.Problem.reach
    refusal(lambda: reach("optimus-knee", start_deg=value, goal_deg={"O": 1.0}, duration_s=0.1), LinkplanError)
    refusal(lambda: reach("optimus-knee", start_deg={"O": 0.0}, goal_deg={"O": 1.0}, waypoints=[value]), LinkplanError)
