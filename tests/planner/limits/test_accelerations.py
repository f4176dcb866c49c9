"""Limits on acceleration and jerk, and the cost on jerk, against closed forms of one mass and slopes of sampled motions."""

import functools
from dataclasses import replace

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.limits.jerks import JerkLimit
from linkplan.planner.limits.limit import limit_margin
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion

MASS = """<mujoco><option gravity="0 0 0"/>
  <worldbody><body><joint name="X" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="2"/></body></worldbody>
  <actuator><motor name="F" joint="X" ctrlrange="-100 100"/></actuator>
</mujoco>"""


def mass(way_m: float, minimize: str = "time", duration_s: float | str = "free", **limits) -> Problem:
    """Return the problem of 2 kg on a slide, moved from rest to rest."""
    return Problem.reach(
        load_mechanism(MASS),
        start_m={"X": 0.0},
        goal_m={"X": way_m},
        duration_s=duration_s,
        minimize=minimize,
        limits={name: {"X": value} for name, value in limits.items()},
    )


def seven_segments(way: float, speed: float, acceleration: float, jerk: float) -> float:
    """Return the least time [s] from rest to rest (Biagiotti & Melchiorri, Trajectory Planning, 2008, section 3.4)."""
    if acceleration**2 / jerk > speed:
        acceleration = np.sqrt(speed * jerk)
    if way >= speed * (speed / acceleration + acceleration / jerk):
        return way / speed + speed / acceleration + acceleration / jerk
    if way >= 2 * acceleration**3 / jerk**2:
        return acceleration / jerk + np.sqrt((acceleration / jerk) ** 2 + 4 * way / acceleration)
    return 4 * (way / (2 * jerk)) ** (1 / 3)


@pytest.mark.parametrize("way_m", [1.0, 0.3, 0.02])  # with all seven segments, without the fourth, with four of them
def test_the_least_time_of_a_mass_with_limited_jerk_is_that_of_seven_segments(way_m):
    plan = plan_motion(mass(way_m, speed_m_s=1.0, acceleration_m_s2=4.0, jerk_m_s3=40.0))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(seven_segments(way_m, 1.0, 4.0, 40.0), rel=1e-4)
    assert plan.objective > seven_segments(way_m, 1.0, 4.0, 40.0) * (1 - 1e-9)
    assert plan.prove().passed


def test_the_least_time_of_a_mass_with_limited_acceleration_is_that_of_a_trapezoid():
    plan = plan_motion(mass(0.93, speed_m_s=1.0, acceleration_m_s2=4.0))
    assert plan.objective == pytest.approx(0.93 + 1 / 4, rel=1e-8)


def test_the_least_jerk_is_that_of_the_quintic():
    plan = plan_motion(mass(0.5, "jerk", 0.8))
    assert plan.objective == pytest.approx(720 * 0.5**2 / 0.8**5, rel=1e-5)
    half = plan.trajectory.position_at(np.array([0.2]))
    assert half == pytest.approx(0.5 * (10 * 0.25**3 - 15 * 0.25**4 + 6 * 0.25**5), abs=1e-5)


def test_a_jump_of_acceleration_and_a_start_with_one_are_jerk_beyond_any_limit():
    problem = mass(1.0, speed_m_s=1.0, acceleration_m_s2=4.0)
    plan = plan_motion(problem)
    with_jerk = replace(problem, limits=replace(problem.limits, jerk=np.array([[-1e9, 1e9]])))
    (limit,) = JerkLimit.of(with_jerk)
    margin = limit_margin(limit, samples_of(with_jerk, plan.trajectory))
    assert not margin.kept
    assert margin.time_s == 0.0
    samples = samples_of(problem, plan.trajectory)
    assert np.count_nonzero(samples.acceleration_jumps) == 4  # start, end, and both ends of the cruise


KNEE = {
    "mechanism": {"model": "optimus-knee", "payload": "shank"},
    "motion": {"kind": "reach", "start_deg": {"O": -49.07}, "goal_deg": {"O": 56.27}, "duration_s": 0.16},
}


def slopes(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return second derivatives (n - 2, ...) of values at equal times by central differences."""
    return np.diff(values, 2, axis=0) / (time[1] - time[0]) ** 2


@functools.cache
def limited_knee(key: str, name: str, most: float) -> Plan:
    return plan_motion(Problem.from_tables("knee", {**KNEE, "limits": {key: {name: most}}}))


@pytest.mark.parametrize(
    ("key", "of", "limit"), [("acceleration_deg_s2", "C", 12000.0), ("site_acceleration_m_s2", "B_coupler", 22.0)]
)
def test_accelerations_of_dependent_joints_and_sites_stay_within_their_limits(key, of, limit):
    """The slopes of the sampled pose are a second way to the acceleration."""
    plan = limited_knee(key, of, limit)
    assert plan.status == "optimal"
    assert plan.objective > 382.6  # 382.590 without the limit
    mechanism, motion = plan.problem.mechanism, plan.trajectory
    time = np.linspace(0.0, motion.duration_s, 4001)
    poses = follow(mechanism, motion.position_at(time), motion.start_pose)
    if of == "C":
        found = np.degrees(np.abs(slopes(poses[:, mechanism.joint_index(of)], time)))
    else:
        found = np.linalg.norm(slopes(places_of(mechanism, mechanism.model.site(of).id, poses), time), axis=1)
    assert 0.999 * limit < found.max() < 1.001 * limit


def test_a_user_s_own_limit_reads_accelerations_of_joints_and_sites():
    own = [
        linkplan.ExtraLimit(
            name="acceleration of C",
            expression=lambda at: at.acceleration_rad_s2["C"],
            lower=-np.radians(12000.0),
            upper=np.radians(12000.0),
        )
    ]
    plan = plan_motion(Problem.from_tables("knee", KNEE).replace(extra_limits=own))
    assert plan.objective == pytest.approx(limited_knee("acceleration_deg_s2", "C", 12000.0).objective, rel=1e-5)


@pytest.mark.parametrize(
    ("limits", "mesh", "words"),
    [
        ({"jerk_deg_s3": {"C": 1e5}}, {}, r"limits.jerk_deg_s3 is of independent joints \(O\), got C"),
        ({"jerk_deg_s3": {"O": 1e5}}, {"effort": "constant"}, "limits.jerk needs mesh.effort polynomial, got constant"),
        ({"jerk_deg_s3": {"O": 1e5}}, {"scheme": "radau-1"}, "limits.jerk needs a mesh.scheme with three nodes or more"),
        ({"acceleration_m_s2": {"O": 1.0}}, {}, "use limits.acceleration_deg_s2, not acceleration_m_s2"),
        ({"acceleration_deg_s2": {"O": [1.0, 2.0]}}, {}, "admits rest"),
        ({"site_acceleration_m_s2": {"foot": 1.0}}, {}, "unknown site 'foot' in limits.site_acceleration_m_s2; sites are O"),
    ],
)
def test_limits_that_mean_nothing_are_refused(limits, mesh, words):
    with pytest.raises(ProblemError, match=words):
        Problem.from_tables("knee", {**KNEE, "limits": limits, "mesh": mesh})
