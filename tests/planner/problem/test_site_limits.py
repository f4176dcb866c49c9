"""Limits on sites: each binds, is kept between the nodes by MuJoCo's account, costs, and is named where it forbids."""

import itertools
import re
import tomllib
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.site import SitePathLimit
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.instant import free_instant
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import SiteLimit, site_limits_of
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.replan import Replanner, structure
from linkplan.planner.search.starts import other_limits
from tests.support.arms import LOWER, UPPER, arm, foot_of
from tests.support.margins import other_margins
from tests.support.refusals import assert_names, assert_refused, refusal
from tests.support.sites import ABOVE, BELOW, arm_of, places_along, plan_of, site_problem
from tests.support.tolerances_planner import OUT_OF_REACH_M, SITE_BINDS_M, SITE_M, TIGHTENED_ANEW

PAST = {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}, "duration_s": 0.6}
WALL = 0.22
LIMITS = {"wall": {"foot": {"normal": [2.0, 0.0, 0.0], "at": [WALL, 5.0, 7.0]}}, "box": {"foot": {"x": [WALL, np.inf]}}}
# As a tube: the way from above to below along a bend that the free motion cuts across.
ALONG, RADIUS = [[0.3, 0.0, 0.35], [0.33, 0.0, 0.0], [0.3, 0.0, -0.35]], 0.04
TUBE = {"foot": {"along": ALONG, "radius_m": RADIUS}}


@cache
def unlimited() -> Plan:
    return plan_of(arm_of(UPPER, LOWER), PAST)


def limit_of(site: dict) -> SiteLimit:
    (limit,) = site_limits_of(site, arm_of(UPPER, LOWER))
    return limit


def apart(p: np.ndarray) -> np.ndarray:
    """Return the distance (n,) of places (n, 3) from the tube's bend, by a fine comb of points along it."""
    share = np.linspace(0, 1, 20001)[:, None]
    comb = np.vstack([np.array(a) + share * (np.array(b) - np.array(a)) for a, b in itertools.pairwise(ALONG)])
    return np.array([np.linalg.norm(comb - one, axis=1).min() for one in p])


@pytest.mark.slow
@pytest.mark.parametrize("name", LIMITS)
def test_a_motion_that_would_cut_through_a_wall_goes_along_it(name):
    assert places_along(unlimited())[:, 0].min() < WALL - 0.05  # it would cut through it
    plan = plan_of(arm_of(UPPER, LOWER), PAST, LIMITS[name])
    nearest = float(places_along(plan)[:, 0].min())
    assert WALL - 1e-9 <= nearest < WALL + SITE_BINDS_M
    (margin,) = other_margins(plan.certificate)
    assert margin.kept
    assert margin.unit == "m"
    assert margin.left == pytest.approx(nearest - WALL, abs=1e-7)
    assert plan.objective > 1.05 * unlimited().objective


@pytest.mark.slow
def test_a_motion_keeps_to_its_tube():
    assert apart(places_along(unlimited())[::40]).max() > RADIUS + 0.05
    plan = plan_of(arm_of(UPPER, LOWER), PAST, TUBE)
    furthest = float(apart(places_along(plan, per_interval=10)).max())
    assert RADIUS - 100 * SITE_BINDS_M < furthest < RADIUS + 1e-8
    (margin,) = other_margins(plan.certificate)
    assert (margin.what, margin.unit) == ("tube", "m")
    assert margin.value == pytest.approx(furthest, abs=1e-6)
    assert plan.objective > 1.05 * unlimited().objective


@pytest.mark.parametrize("name", LIMITS)
def test_a_certificate_says_how_far_and_when_a_wall_is_cut(name):
    plan = unlimited()
    found = certify(site_problem(arm_of(UPPER, LOWER), PAST, LIMITS[name]), plan.trajectory)
    nearest = float(places_along(plan, per_interval=400)[:, 0].min())
    (margin,) = other_margins(found)
    assert not found.passed
    assert not margin.kept
    assert margin.left == pytest.approx(nearest - WALL, abs=1e-8)
    at = plan.trajectory.position_at(np.array([margin.time_s]))
    assert foot_of(at)[0, 0] == pytest.approx(nearest, abs=1e-6)
    said = "the distance of site foot from its wall" if name == "wall" else "x of site foot"
    assert any(said in failure and "beyond its limit" in failure for failure in found.failures)


def test_a_certificate_says_how_far_a_tube_is_left():
    found = certify(site_problem(arm_of(UPPER, LOWER), PAST, TUBE), unlimited().trajectory)
    (margin,) = other_margins(found)
    assert margin.value == pytest.approx(apart(places_along(unlimited(), per_interval=100)).max(), abs=1e-5)
    assert any("the distance of site foot from its path" in failure for failure in found.failures)


def test_between_the_nodes_a_limit_is_looked_at_closely():
    """The foot of a pendulum touches its circle's rim and goes no further: no sampling says that it does."""
    plan = plan_of(arm_of(0.3), {"start_deg": {"J1": 60}, "goal_deg": {"J1": -55}, "duration_s": 0.5})
    touching = site_problem(arm_of(0.3), {"start_deg": {"J1": 60}, "goal_deg": {"J1": -55}, "duration_s": 0.5}, RIM)
    (margin,) = other_margins(certify(touching, plan.trajectory))
    assert margin.kept
    assert abs(margin.left) < 1e-9


RIM = {"foot": {"x": [-np.inf, 0.3]}}


def test_start_and_goal_may_stand_on_the_limit():
    motion = {"start_at": {"foot": [0.3, 0, -0.3]}, "goal_at": {"foot": [0.45, 0, -0.3]}, "duration_s": 1.0}
    heights = places_along(plan_of(arm_of(UPPER, LOWER), motion))[:, 2]
    plan = plan_of(arm_of(UPPER, LOWER), motion, {"foot": {"z": [-0.3, np.inf]}})
    assert places_along(plan)[:, 2].min() >= -0.3 - 1e-9
    below = plan_of(arm_of(UPPER, LOWER), motion, {"foot": {"z": [-np.inf, -0.3]}})
    assert places_along(below)[:, 2].max() <= -0.3 + 1e-9
    assert np.ptp(heights) > 1e-3  # it does not stay at that height by itself


@pytest.mark.parametrize(
    ("motion", "box", "words"),
    [
        ({}, {"z": [-1.0, 0.3]}, [f"z of site foot is {ABOVE[2]:g} m at the start", "limit of 0.3"]),
        ({}, {"z": [-0.3, 1.0]}, [f"z of site foot is {BELOW[2]:g} m at the goal", "limit of -0.3"]),
        (
            {"goal_at": {"foot": {"z": -0.35}}},
            {"z": [-0.3, 1.0], "x": [-np.inf, np.inf]},  # without a finite end there is no limit
            ["z of site foot is -0.35 m at the goal", "limit of -0.3"],
        ),
        (
            {"waypoints": [{"at_deg": {"J1": 90.0, "J2": 0.0}}]},
            {"z": [-1.0, 0.5]},
            ["z of site foot is 0.55 m at motion.waypoints[0]", "limit of 0.5"],
        ),
    ],
    ids=["start", "goal", "open goal", "waypoint"],
)
def test_a_pose_outside_is_named_without_solving(motion, box, words):
    plan = plan_motion(site_problem(arm_of(UPPER, LOWER), PAST | motion, {"foot": box}))
    assert plan.status == "infeasible"
    assert not plan.history
    assert len(plan.problem.limits.site) == 1
    assert_names(plan.message, "0.05 m beyond its limit", *words)


def test_what_every_motion_of_one_freedom_passes_is_named_without_solving():
    motion = {"start_deg": {"J1": 60}, "goal_deg": {"J1": -60}}
    plan = plan_motion(site_problem(arm_of(0.3), motion, {"foot": {"x": [0, 0.28]}}))
    assert plan.status == "infeasible"
    assert not plan.history
    words = "x of site foot is 0.3 m where J1 = ", "between start and goal", "0.02 m beyond its limit of 0.28"
    assert_names(plan.message, *words)


@pytest.mark.slow
def test_a_limit_that_forbids_a_motion_is_named():
    """The arm is to be stretched on the way, to 0.55 m from the hip; the box around its foot ends at 0.5 m from there."""
    motion = {"start_at": {"foot": [0.35, 0, 0.2]}, "goal_at": {"foot": [-0.35, 0, 0.2]}, "duration_s": 1.0}
    via = {"waypoints": [{"at_deg": {"J2": 0.0}}]}
    box = {"foot": {"x": [-0.4, 0.4], "z": [0.0, 0.3]}}
    plan = plan_motion(site_problem(arm_of(UPPER, LOWER), motion | via, box, mesh={"intervals": 10}, solver={"starts": 2}))
    assert plan.status == "infeasible", plan.message
    assert_names(plan.message, "site foot would have to be", "beyond its limit")


def test_the_phase_plane_knows_that_there_are_other_limits():
    motion = {"start_deg": {"J1": 60}, "goal_deg": {"J1": -60}}
    assert other_limits(site_problem(arm_of(0.3), motion, {"foot": {"x": [0.0, 1.0]}}))
    assert not other_limits(site_problem(arm_of(0.3), motion))


def test_a_program_is_built_anew_where_another_quantity_is_limited():
    def of(site: dict) -> tuple:
        return structure(site_problem(arm_of(UPPER, LOWER), PAST, site))

    assert of({"foot": {"x": [0.1, 1.0]}}) == of({"foot": {"x": [0.2, 0.9]}})  # numbers alone
    assert of({"foot": {"x": [0.1, 1.0]}}) != of({"foot": {"x": [0.1, np.inf]}})
    assert of({"foot": {"x": [0.1, 1.0]}}) != of({"foot": {"z": [-0.9, 1.0]}})
    assert of(TUBE) != of({"foot": {"along": ALONG, "radius_m": 0.05}})


@pytest.mark.slow
def test_a_motion_along_a_wall_is_solved_again_and_keeps_the_wall():
    """A motion to another goal may cross the wall between nodes; the constraints are then tightened."""
    planner = Replanner()
    motion = {"start_at": {"foot": ABOVE}, "duration_s": 0.24}

    def to(z: float):
        return site_problem(arm_of(UPPER, LOWER), motion | {"goal_at": {"foot": [0.3, 0.0, z]}}, LIMITS["box"])

    planner.plan(to(-0.35))
    again, fresh = planner.plan(to(-0.34)), plan_motion(to(-0.34))
    assert again.solved_again
    assert again.history[0].what == "solved again"
    assert {step.what for step in again.history} <= {"solved again", "constraints tightened"}
    assert float(places_along(again)[:, 0].min()) > WALL - 1e-9
    assert again.objective == pytest.approx(fresh.objective, rel=TIGHTENED_ANEW)


def test_quantities_are_coordinates_and_distances():
    p = np.array([[0.1, 0.2, 0.3], [-0.4, 0.0, 0.25]])
    assert limit_of({"foot": {"z": [0, 1]}}).value(p) == pytest.approx([0.3, 0.25], abs=SITE_M)
    wall = limit_of({"foot": {"normal": [0, 3, 4], "at": [9, 1, 1]}})
    assert wall.value(p) == pytest.approx([(0.2 - 1) * 0.6 + (0.3 - 1) * 0.8, -0.6 - 0.75 * 0.8], abs=SITE_M)
    tube = limit_of({"foot": {"along": [[0, 0, 0], [1, 0, 0], [1, 1, 0]], "radius_m": 0.1}})
    points = np.array([[0.5, 0.0, 0.2], [-0.3, 0.4, 0.0], [1.2, 0.5, 0.0], [1.0, 2.0, 0.0], [0.9, 0.1, 0.0]])
    assert tube.value(points) == pytest.approx([0.2, 0.5, 0.2, 1.0, 0.1], abs=SITE_M)


def test_a_tubes_row_is_never_short_of_the_distance_and_next_to_it():
    mechanism, limit = arm_of(UPPER, LOWER), limit_of(TUBE)
    at, (q, *_) = free_instant(mechanism)
    row = ca.Function("row", [q], [SitePathLimit(0, limit.key).rows.node(at, ca.SX(0, 1))])
    poses = np.random.default_rng(3).uniform([-1.5, -2.5], [1.5, 2.5], (400, 2))
    motion = unlimited().trajectory
    poses = np.vstack([poses, motion.position_at(motion.dense_times(3))])
    rows = np.array([float(row(pose)) for pose in poses])
    exact = (limit.value(foot_of(poses)) / RADIUS) ** 2
    assert np.all(rows >= exact * (1 - 1e-10) - 1e-10)
    assert np.all(rows <= exact + 0.0028 + 1e-9)  # 0.28 / k


REFUSED = [
    ({"fot": {"z": [0, 1]}}, ["'fot'", "limits.site", "did you mean 'foot'", "base, foot"]),
    ({"foot": {"z": [1, 0]}}, ["limits.site.foot.z", "low < high", "[1, 0]"]),
    ({"foot": {"z": [0, 0]}}, ["limits.site.foot.z", "low < high"]),
    ({"foot": {"z": 3}}, ["limits.site.foot.z", "[low, high]", "3"]),
    ({"foot": {"z": [0, np.nan]}}, ["limits.site.foot.z", "nan"]),
    ({"foot": {"w": [0, 1]}}, ["limits.site.foot.w", "x, y, z, normal, at, along, radius_m"]),
    ({"foot": {}}, ["limits.site.foot", "limits nothing", "normal", "radius_m"]),
    ({"foot": []}, ["limits.site.foot", "limits nothing"]),
    ({"foot": [{"z": [0, 1]}, {"z": [2, 1]}]}, ["limits.site.foot[1].z"]),
    ({"foot": {"normal": [0, 0, 1]}}, ["limits.site.foot", "lacks at"]),
    ({"foot": {"normal": [0, 0, 0], "at": [0, 0, 0]}}, ["limits.site.foot.normal", "not be zero"]),
    ({"foot": {"normal": [0, 1], "at": [0, 0, 0]}}, ["limits.site.foot.normal", "[x, y, z]", "[0, 1]"]),
    ({"foot": {"normal": [0, 0, 1], "at": [0, np.inf, 0]}}, ["limits.site.foot.at[1]", "inf"]),
    ({"foot": {"normal": [0, 0, 1], "at": [0, 0, 0], "z": [0, 1]}}, ["limits.site.foot.z", "normal, at"]),
    ({"foot": {"along": [[0, 0, 0]], "radius_m": 0.1}}, ["limits.site.foot.along", "2 to 200 points"]),
    ({"foot": {"along": [[0, 0, 0], [0, 0, 0]], "radius_m": 0.1}}, ["limits.site.foot.along", "twice in a row"]),
    ({"foot": {"along": [[0, 0, 0], [0, 0]], "radius_m": 0.1}}, ["limits.site.foot.along[1]", "[0, 0]"]),
    ({"foot": {"along": [[0, 0, 0], [0, 0, 1]]}}, ["limits.site.foot", "lacks radius_m"]),
    ({"foot": {"along": [[0, 0, 0], [0, 0, 1]], "radius_m": 0}}, ["limits.site.foot.radius_m", "positive"]),
    ([1], ["limits.site", "table"]),
]


@pytest.mark.parametrize(("site", "words"), REFUSED, ids=lambda item: str(item)[:60])
def test_what_cannot_be_meant_is_refused_in_one_line(site, words):
    said = refusal(lambda: site_problem(arm_of(UPPER, LOWER), PAST, site), ProblemError)
    assert_names(said, *words)


def test_a_problem_with_sites_goes_to_toml_and_back(tmp_path):
    site = {"foot": [{"z": [-0.5, np.inf]}, LIMITS["wall"]["foot"], TUBE["foot"]], "base": {"x": [-1.0, 1.0]}}
    asked = {"start_at": {"foot": ABOVE}, "goal_at": {"foot": {"x": 0.3, "z": -0.35}}, "duration_s": 0.6}
    built = linkplan.Problem.reach(arm(UPPER, LOWER), **asked, limits={"site": site})
    (tmp_path / "arm.toml").write_text(built.to_toml(), encoding="utf-8")
    again = linkplan.Problem.from_file(tmp_path / "arm.toml")
    assert again.to_dict() == built.to_dict()
    assert again.to_dict()["limits"]["site"]["foot"][0]["z"][1] == np.inf
    assert [limit.key for limit in again.limits.site] == [limit.key for limit in built.limits.site]
    assert len(again.limits.site) == 4
    assert np.array_equal(again.motion.goal, built.motion.goal)


def test_builders_vary_places():
    built = linkplan.Problem.reach(
        arm(UPPER, LOWER), start_at={"foot": ABOVE}, goal_at={"foot": np.array(BELOW)}, duration_s=0.6
    )
    moved = built.replace({"motion.goal_at.foot": [0.35, 0.0, -0.3]})
    assert foot_of(moved.motion.goal)[0] == pytest.approx([0.35, 0, -0.3], abs=OUT_OF_REACH_M)
    by_joints = built.replace(goal_at=None, goal_deg={"J1": -30, "J2": 20})
    assert not by_joints.motion.goal_at
    assert_refused(lambda: built.replace(goal_deg={"J1": -30, "J2": 20}), "keep one", kind=ProblemError)


def example() -> dict:
    """Return the tables of the example in the documents."""
    text = (Path(__file__).resolve().parents[3] / "docs" / "problem-files.md").read_text(encoding="utf-8")
    (block,) = [block for block in re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL) if "limits.site" in block]
    return tomllib.loads(block)


@pytest.mark.slow
def test_the_example_of_the_documents_is_planned_along_its_wall():
    plan = plan_motion(Problem.from_tables("example", example()))
    assert plan.status == "optimal", plan.message
    assert len(other_margins(plan.certificate)) == 4
    assert 0.25 - 1e-9 < places_along(plan)[:, 0].min() < 0.25 + SITE_BINDS_M
    free = Problem.from_tables("example", {key: table for key, table in example().items() if key != "limits"})
    assert places_along(plan_motion(free))[:, 0].min() < 0.2


def test_a_saved_plan_is_read_with_its_open_ends(tmp_path):
    plan = plan_of(arm_of(0.3), {"start_deg": {"J1": 60}, "goal_deg": {"J1": -55}, "duration_s": 0.5}, RIM)
    write_plan(plan, tmp_path)
    again = read_plan(tmp_path)
    assert again.status == "optimal"
    assert (again.problem.limits.site[0].low, again.problem.limits.site[0].high) == (-np.inf, 0.3)
    assert len(other_margins(again.certificate)) == 1
