"""What callers give that is no path, no time and no value is refused as everything else, in one line of linkplan's own."""

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import LinkplanError
from linkplan.planner.search.replan import NextMotion
from tests.support.plans import optimal
from tests.support.refusals import refusal

NO_PATHS = (None, b"plan", 5, ["plan"], "", "a\0b", "\ud800", "x" * 300)


@pytest.fixture(scope="module")
def plan() -> linkplan.Plan:
    return linkplan.Plan.of(optimal("knee-reach"))


@pytest.mark.parametrize("value", NO_PATHS)
def test_what_is_no_path_is_refused(value, plan):
    for action in (linkplan.read_plan, plan.save, plan.report):
        assert "a path" in refusal(lambda action=action: action(value), LinkplanError)


@pytest.mark.usefixtures("drawn_figures")
@pytest.mark.parametrize("value", [b"plan", 5, "a\0b", "\ud800", "no/such/folder.png", "plan.tiff.xyz"])
def test_a_figure_that_cannot_be_saved_is_refused(value, plan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refusal(lambda: plan.plot(value), LinkplanError)


@pytest.mark.parametrize("value", ["now", 10**400, float("nan"), [[0.0]], object()])
def test_what_is_no_time_is_refused_of_a_plan_and_of_a_next_motion(value, plan):
    none = dict.fromkeys(("position_bound_rad", "velocity_bound_rad_s", "effort_bound"), np.zeros(1))
    step = NextMotion(
        problem=plan.problem,
        trajectory=plan.trajectory,
        **none,
        duration_error_s=0.0,
        violation=0.0,
        newton_s=0.0,
        settled=True,
    )
    for motion in (plan, step):
        assert "times are finite" in refusal(lambda motion=motion: motion.sample(value), LinkplanError)


@pytest.mark.parametrize("value", ["\ud800", range(2), {"O": "\ud800"}])
def test_half_a_character_and_what_only_looks_like_a_table_are_refused(value):
    reach = linkplan.Problem.reach
    refusal(lambda: reach("optimus-knee", start_deg=value, goal_deg={"O": 1.0}, duration_s=0.1), LinkplanError)
    refusal(lambda: reach("optimus-knee", start_deg={"O": 0.0}, goal_deg={"O": 1.0}, waypoints=[value]), LinkplanError)
