"""Angles of bodies as start, goal, waypoint, limit, reference and column, by a four-bar in closed form and by MuJoCo."""

import csv
from dataclasses import replace
from functools import cache

import casadi as ca
import mujoco
import numpy as np
import pytest
import scipy

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.extra import ExtraPathLimit
from linkplan.planner.limits.site import BodyAngleLimit
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.extra import ExtraLimit
from linkplan.planner.problem.instant import free_instant
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.search.planning import plan_motion
from tests.support.arms import LOWER, UPPER, arm
from tests.support.polycentric import KNEE, shank_deg
from tests.support.refusals import assert_names, refusal
from tests.support.sites import arm_of, plan_of, site_problem

BENT = {"start_deg": {"J1": 60.0, "J2": 40.0}}


@cache
def knee_plan() -> Plan:
    """Return the plan of a shank's turn from 0 to 30 degrees."""
    problem = Problem.reach(
        load_mechanism(KNEE), start_body_deg={"shank": 0.0}, goal_body_deg={"shank": 30.0}, duration_s=0.5
    )
    plan = plan_motion(problem)
    assert plan.passed, plan.message
    return plan


def pitch_along(plan: Plan, body: str) -> np.ndarray:
    """Return a body's pitch about +y (n,) [rad] along a plan, unwrapped, by MuJoCo."""
    mechanism, motion = plan.problem.mechanism, plan.trajectory
    data, found = mujoco.MjData(mechanism.model), []
    for qpos in mechanism.qpos_of(follow(mechanism, motion.position_at(motion.dense_times(40)), motion.start_pose)):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(mechanism.model, data)
        R = np.array(data.xmat[mechanism.model.body(body).id]).reshape(3, 3)
        found.append(np.arctan2(R[0, 2], R[0, 0]))
    return np.unwrap(found)


def test_a_shank_ends_at_the_angle_of_the_goal_by_the_closed_form_and_by_mujoco():
    plan = knee_plan()
    start, goal = (float(np.degrees(plan.trajectory.position_at(plan.trajectory.breaks_s[[k]])[0, 0])) for k in (0, -1))
    assert float(shank_deg(np.array(start))) == pytest.approx(0.0, abs=1e-7)
    assert float(shank_deg(np.array(goal))) == pytest.approx(30.0, abs=1e-7)
    assert np.degrees(pitch_along(plan, "shank")[[0, -1]]) == pytest.approx([0.0, 30.0], abs=1e-6)


def test_the_column_of_a_body_is_its_angle_in_every_row_and_is_saved(tmp_path):
    write_plan(knee_plan(), tmp_path)
    with (tmp_path / "trajectory.csv").open() as file:
        rows = list(csv.DictReader(file))
    rear, shank = (np.array([float(row[name]) for row in rows]) for name in ("C_deg", "body_shank_deg"))
    assert np.ptp(shank) > 20
    np.testing.assert_allclose(shank, shank_deg(rear), atol=1e-6)
    with np.load(tmp_path / "trajectory.npz") as arrays:
        np.testing.assert_allclose(arrays["body_shank_deg"], shank, atol=1e-9)
    assert read_plan(tmp_path).sample(0.5).body_deg["shank"] == pytest.approx(30.0, abs=1e-6)


def test_a_goal_that_misses_the_angle_is_named_with_its_error_in_degrees():
    plan = knee_plan()
    (goal,) = plan.problem.motion.goal_at
    moved = replace(plan.problem.motion, goal_at=(replace(goal, angle_rad=goal.angle_rad + np.radians(0.01)),))
    found = certify(plan.problem.varied(motion=moved), plan.trajectory)
    assert found.site_error_m == pytest.approx(np.radians(0.01) * plan.problem.mechanism.extent_m, rel=1e-4)
    assert any(
        "body shank is 0.01 deg away from the place that motion.goal_body_deg gives" in said for said in found.failures
    )


@pytest.mark.parametrize(("high", "kept"), [(31.0, True), (29.9, False)])
def test_the_margin_and_the_proof_of_a_limit_follow_the_closed_form(high, kept):
    plan = knee_plan()
    limited = plan.problem.replace({"limits.body_deg": {"shank": [-60.0, high]}})
    (margin,) = [one for one in certify(limited, plan.trajectory).margins if isinstance(one.of, BodyAngleLimit)]
    rear = np.degrees(plan.trajectory.position_at(plan.trajectory.dense_times(400))[:, 0])
    assert margin.left == pytest.approx(high - shank_deg(rear).max(), abs=1e-6)
    assert (margin.unit, margin.kept) == ("deg", kept)
    answers = {one.name: one.answer for one in prove(limited, plan.trajectory, existence=False).findings}
    assert answers["angle of body shank"] == ("proved" if kept else "refuted")


def test_an_expression_of_ones_own_has_the_angle():
    plan, most = knee_plan(), 0.4
    limit = ExtraLimit(name="shank", expression=lambda at: at.body_angle_rad("shank"), upper=most, unit="rad")
    found = certify(plan.problem.varied(extra_limits=(limit,)), plan.trajectory)
    (margin,) = [one for one in found.margins if isinstance(one.of, ExtraPathLimit)]
    assert margin.left == pytest.approx(most - np.radians(30.0), abs=1e-6)


def test_a_limit_holds_back_the_shank_that_would_swing_beyond_it():
    motion = {**BENT, "goal_deg": {"J1": -60.0, "J2": 160.0}, "duration_s": 0.6}
    free = plan_of(arm_of(UPPER, LOWER), motion)
    most = -np.degrees(pitch_along(free, "link2")).min()  # counted like J1, whose axis is -y
    assert most > 101.0, "it begins and ends at 100 deg"
    half = 0.5 * (100.0 + most)
    plan = plan_of(arm_of(UPPER, LOWER), motion, limits={"body_deg": {"link2": [-np.inf, half]}})
    assert -np.degrees(pitch_along(plan, "link2")).min() == pytest.approx(half, abs=1e-3)
    assert plan.objective > free.objective


def test_the_row_of_a_limit_is_as_far_from_its_bounds_as_the_angle_from_the_limit():
    """The arm's joints are at 60 and 40 deg in its home pose."""
    bent = load_mechanism(arm(UPPER, LOWER), home={"J1": np.radians(60.0), "J2": np.radians(40.0)})
    asked = site_problem(bent, BENT | TO, limits={"body_deg": {"link2": [-10.0, 110.0]}})
    at, (q, *_) = free_instant(bent)
    (limit,) = BodyAngleLimit.of(asked)
    row = ca.Function("row", [q], [limit.rows.node(at, ca.SX())])
    for bound, end in zip(limit.bounds(asked, None), (-10.0, 110.0), strict=True):
        assert float(row(np.radians([30.0, 20.0]))) - bound == pytest.approx(np.radians(50.0 - end), abs=1e-12)


def test_an_open_goal_ends_with_the_sum_of_the_hinges_and_leaves_the_rest_to_the_planner():
    plan = plan_of(arm_of(UPPER, LOWER), BENT | {"goal_body_deg": {"link2": -20.0}, "duration_s": 0.5})
    assert plan.problem.motion.goal_rows == (0,)
    end = np.degrees(plan.trajectory.position_at(plan.trajectory.breaks_s[[-1]])[0])
    assert end.sum() == pytest.approx(-20.0, abs=1e-6)
    other = plan_of(arm_of(UPPER, LOWER), BENT | {"goal_deg": {"J1": 60.0, "J2": -80.0}, "duration_s": 0.5})
    assert plan.objective < other.objective * 0.999, "one pose with this angle of many costs more"


def test_a_waypoint_of_a_body_is_passed_at_its_time():
    waypoint = {"body_deg": {"link2": 150.0}, "time_s": 0.3}
    motion = BENT | {"goal_deg": {"J1": 0.0, "J2": 90.0}, "waypoints": [waypoint], "duration_s": 0.6}
    plan = plan_of(arm_of(UPPER, LOWER), motion)
    assert plan.problem.motion.waypoints[0].at_rows == (0,)
    there = np.degrees(plan.trajectory.position_at(plan.trajectory.breaks_s[:1] + 0.3)[0])
    assert there.sum() == pytest.approx(150.0, abs=1e-6)


def test_a_site_and_a_body_together_give_the_pose_of_three_links():
    lengths = (0.3, 0.25, 0.1)
    motion = {"start_deg": {"J1": 60.0, "J2": 40.0, "J3": 20.0}, "duration_s": 0.5}
    goal = {"goal_at": {"foot": {"x": 0.35, "z": 0.2}}, "goal_body_deg": {"link3": 10.0}}
    end = site_problem(arm_of(*lengths), motion | goal).motion.goal
    heading = np.cumsum(end)
    assert np.degrees(heading[2]) == pytest.approx(10.0, abs=1e-7)
    assert np.array(lengths) @ np.cos(heading) == pytest.approx(0.35, abs=1e-8)
    assert np.array(lengths) @ np.sin(heading) == pytest.approx(0.2, abs=1e-8)


@pytest.mark.parametrize("from_file", [False, True])
def test_a_reference_of_the_shank_passes_its_rows_by_the_closed_form(from_file, tmp_path):
    time, shank = [0.0, 0.2, 0.5, 0.8, 1.0], [0.0, 15.0, 40.0, 10.0, 0.0]
    reference = {"time_s": time, "body_deg": {"shank": shank}}
    if from_file:
        rows = "".join(f"{t},{angle}\n" for t, angle in zip(time, shank, strict=True))
        (tmp_path / "gait.csv").write_text("time_s,body_shank_deg\n" + rows)
        reference = {"file": str(tmp_path / "gait.csv")}
    problem = Problem.track(load_mechanism(KNEE), reference=reference)
    rear = np.degrees(problem.reference.derivative(np.array(time))[:, 0])
    expected = [scipy.optimize.brentq(lambda c, x=x: float(shank_deg(np.array(c))) - x, -34.0, 30.0) for x in shank]
    np.testing.assert_allclose(rear, expected, atol=1e-6)
    assert list(problem.bodies) == ["shank"]


def test_a_wide_limit_names_a_body_and_limits_nothing():
    problem = site_problem(arm_of(UPPER, LOWER), BENT | {"goal_deg": {"J1": 0.0, "J2": 0.0}, "duration_s": 0.5},
                           limits={"body_deg": {"link2": [-np.inf, np.inf]}})  # fmt: skip
    assert BodyAngleLimit.of(problem) == []
    assert list(problem.bodies) == ["link2"]


def test_relaxing_widens_the_limit_by_shares_of_a_radian():
    problem = site_problem(arm_of(UPPER, LOWER), BENT | {"goal_deg": {"J1": 0.0, "J2": 0.0}, "duration_s": 0.5},
                           limits={"body_deg": {"link2": [-10.0, 120.0]}})  # fmt: skip
    (wider,) = BodyAngleLimit.relaxed(problem, 1.5).limits.body
    assert (wider.low, wider.high) == pytest.approx((np.radians(-10) - 0.5, np.radians(120) + 0.5))
    assert BodyAngleLimit.of(BodyAngleLimit.relaxed(problem, np.inf)) == []


TO = {"goal_deg": {"J1": 0.0, "J2": 0.0}, "duration_s": 0.5}


@pytest.mark.parametrize(
    ("motion", "limits", "words"),
    [
        (BENT | {"goal_body_deg": {"shin": 1.0}}, {}, ["motion.goal_body_deg", "'shin'", "link1, link2"]),
        (BENT | TO | {"goal_body_deg": {"link2": 1.0}}, {}, ["motion.goal_body_deg", "motion.goal_deg", "keep one"]),
        (BENT | {"goal_body_deg": {"link2": "up"}}, {}, ["motion.goal_body_deg.link2", "a number", "'up'"]),
        (BENT | {"goal_body_deg": {"link2": 1.0}, "waypoints": [{"body_deg": {"link2": 2.0}, "at_deg": {"J1": 1.0}}]}, {},
         ["motion.waypoints[0].body_deg", "motion.waypoints[0].at_deg", "keep one"]),
        ({"start_body_deg": {"link2": 5.0}, **TO}, {}, ["motion.start_body_deg", "open", "motion.start_deg"]),
        (BENT | TO, {"body_deg": {"link2": [5.0, -5.0]}}, ["limits.body_deg.link2", "low < high", "[5, -5]"]),
        (BENT | TO, {"body_deg": {"link2": 5.0}}, ["limits.body_deg.link2", "[low, high]", "5.0"]),
        (BENT | {"goal_body_deg": {"link2": 500.0}}, {"range_deg": {"J1": [-90.0, 90.0], "J2": [-90.0, 90.0]}},
         ["motion.goal_body_deg.link2 = 500 deg is out of reach", "comes no nearer than 180 deg, 320 deg away"]),
    ],
)  # fmt: skip
def test_what_a_body_cannot_do_is_refused_in_one_line(motion, limits, words):
    said = refusal(lambda: site_problem(arm_of(UPPER, LOWER), motion, limits=limits), ProblemError)
    assert_names(said, *words)


def test_a_goal_beyond_a_limit_is_named_without_solving():
    motion = BENT | {"goal_body_deg": {"link2": 30.0}, "duration_s": 0.5}
    plan = plan_motion(site_problem(arm_of(UPPER, LOWER), motion, limits={"body_deg": {"link2": [-10.0, 110.0]}}))
    assert plan.passed, plan.message
    plan = plan_motion(site_problem(arm_of(UPPER, LOWER), motion, limits={"body_deg": {"link2": [40.0, 110.0]}}))
    assert not plan.passed
    assert_names(plan.message, "infeasible", "angle of body link2 is 30 deg", "10 deg beyond its limit of 40")
