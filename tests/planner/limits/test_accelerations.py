"""Limits on acceleration and jerk, and the cost on jerk, against closed forms and slopes of sampled motions."""

import functools
import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.extra import ExtraPathLimit
from linkplan.planner.limits.limit import limit_margin
from linkplan.planner.limits.rates import JerkLimit, SiteJerkLimit, smooth_columns
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.search import reasons
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import bernstein_matrix
from tests.support.bodies import body_problem, cart
from tests.support.motions import motion_along
from tests.support.refusals import assert_refused

MASS = """<mujoco><option gravity="0 0 0"/>
  <worldbody><body>
    <joint name="X" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="2"/><site name="tool" pos=".1 0 0"/>
  </body></worldbody>
  <actuator><motor name="F" joint="X" ctrlrange="-100 100"/></actuator>
</mujoco>"""


def mass(way_m: float, minimize: str | dict = "time", duration_s: float | str = "free", **limits) -> Problem:
    """Return the problem of 2 kg on a slide, moved from rest to rest."""
    return Problem.reach(
        load_mechanism(MASS),
        start_m={"X": 0.0},
        goal_m={"X": way_m},
        duration_s=duration_s,
        minimize=minimize,
        limits={name: {"tool" if name.startswith("site") else "X": value} for name, value in limits.items()},
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


@pytest.mark.parametrize("of", ["", "site_"])  # the joint itself, a site on the mass
@pytest.mark.parametrize("way_m", [1.0, 0.3, 0.02])  # with all seven segments, without the fourth, with four of them
def test_the_least_time_of_a_mass_with_limited_jerk_is_that_of_seven_segments(way_m, of):
    plan = plan_motion(mass(way_m, speed_m_s=1.0, **{f"{of}acceleration_m_s2": 4.0, f"{of}jerk_m_s3": 40.0}))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(seven_segments(way_m, 1.0, 4.0, 40.0), rel=1e-6)
    assert plan.objective > seven_segments(way_m, 1.0, 4.0, 40.0) * (1 - 1e-9)
    assert prove(plan.problem, plan.trajectory, existence=False).passed


def to_cruise(v: float, a: float, top: float, most: float, jerk: float) -> tuple[float, float]:
    """Return the time [s] and the way [m] from a speed and an acceleration to a higher speed without acceleration."""
    peak = min(most, np.sqrt(jerk * (top - v) + 0.5 * a**2))
    level = (top - v - (2 * peak**2 - a**2) / (2 * jerk)) / peak
    time, way = 0.0, 0.0
    for lasting, rate in (((peak - a) / jerk, jerk), (level, 0.0), (peak / jerk, -jerk)):
        way += v * lasting + a * lasting**2 / 2 + rate * lasting**3 / 6
        v, a, time = v + a * lasting + rate * lasting**2 / 2, a + rate * lasting, time + lasting
    return time, way


@pytest.mark.parametrize(("first", "last"), [(0.0, 0.0), (2.0, -1.0)])
def test_accelerations_at_moving_ends_are_those_asked_for_in_the_least_time_of_seven_segments(first, last):
    """Six segments: the way is too short for a cruise. Reversed in time, the end is a start that speeds up."""
    ends = (0.2, first), (0.4, -last)
    top = scipy.optimize.brentq(lambda top: sum(to_cruise(*end, top, 4.0, 40.0)[1] for end in ends) - 0.3, 0.5, 5.0)
    problem = mass(0.3, acceleration_m_s2=4.0, jerk_m_s3=40.0).replace(
        start_speed_m_s={"X": 0.2}, goal_speed_m_s={"X": 0.4},
        start_acceleration_m_s2={"X": first}, goal_acceleration_m_s2={"X": last},
    )  # fmt: skip
    plan = plan_motion(problem)
    assert plan.objective == pytest.approx(sum(to_cruise(*end, top, 4.0, 40.0)[0] for end in ends), rel=1e-6)
    other = problem.varied(motion=replace(problem.motion, goal_acceleration=np.array([last + 0.1])))
    assert any("misses its boundary conditions" in one for one in certify(other, plan.trajectory).failures)


@pytest.mark.parametrize(
    ("limits", "first", "said"),
    [({}, 0.0, "may jump there; set limits.jerk_m_s3"), ({"jerk_m_s3": {"X": 9.0}}, 1.0, "is 0 where the joint is at rest")],
)
def test_accelerations_at_ends_that_no_motion_has_are_refused(limits, first, said):
    assert_refused(lambda: mass(0.3).replace(limits=limits, start_acceleration_m_s2={"X": first}), said)


PARALLELOGRAM = """<mujoco><option gravity="0 0 0"/>
  <worldbody>
    <body><joint name="P" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .1" size=".01"/>
      <body name="coupler" pos="0 0 .1"><joint name="Q" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .2 0 0" size=".01"/>
      </body></body>
    <body name="rocker" pos=".2 0 0"><joint name="R" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .1" size=".01"/></body>
  </worldbody>
  <equality><connect body1="coupler" body2="rocker" anchor=".2 0 0"/></equality>
  <actuator><motor name="M" joint="P" ctrlrange="-50 50"/></actuator>
</mujoco>"""


@pytest.mark.slow
def test_the_least_time_with_limited_jerk_of_a_rocker_parallel_to_the_crank_is_that_of_seven_segments():
    """Both turn by the same angle. Rows at nodes would permit an overrun where the jerk reverses inside an interval."""
    problem = Problem.reach(
        load_mechanism(PARALLELOGRAM), start_deg={"P": -50.0}, goal_deg={"P": 50.0}, duration_s="free", minimize="time",
        limits={"acceleration_deg_s2": {"R": 2000.0}, "jerk_deg_s3": {"R": 5e4}},
    )  # fmt: skip
    plan = plan_motion(problem)
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(seven_segments(100.0, 1e9, 2000.0, 5e4), rel=2e-6)


def test_the_least_time_of_a_mass_with_limited_acceleration_is_that_of_a_trapezoid():
    plan = plan_motion(mass(0.93, speed_m_s=1.0, acceleration_m_s2=4.0))
    assert plan.objective == pytest.approx(0.93 + 1 / 4, rel=1e-8)


@pytest.mark.parametrize("own", [False, True])
def test_the_least_jerk_is_that_of_the_quintic(own):
    """A cost of one's own on the jerk of the site is the same: it moves as the joint does."""
    problem = mass(0.5, "jerk", 0.8)
    if own:
        squared = linkplan.ExtraCost(name="jerk of the tool", expression=lambda at: ca.sumsqr(at.site_jerk("tool")))
        problem = mass(0.5, {"effort": 1e-9}, 0.8).replace(extra_costs=[squared])
    plan = plan_motion(problem)
    assert plan.objective == pytest.approx(720 * 0.5**2 / 0.8**5, rel=1e-5)
    half = plan.trajectory.position_at(np.array([0.2]))
    assert half == pytest.approx(0.5 * (10 * 0.25**3 - 15 * 0.25**4 + 6 * 0.25**5), abs=1e-5)


def test_a_jump_of_acceleration_and_a_start_with_one_are_jerk_beyond_any_limit():
    problem = mass(1.0, speed_m_s=1.0, acceleration_m_s2=4.0)
    plan = plan_motion(problem)
    limits = replace(problem.limits, jerk=np.array([[-1e9, 1e9]]), site_jerk={"tool": 1e9})
    own = linkplan.ExtraLimit(name="own", expression=lambda at: at.jerk_rad_s3["X"], lower=-1e9, upper=1e9)
    with_jerk = problem.varied(limits=limits, extra_limits=(own,))
    for kind in (JerkLimit, SiteJerkLimit, ExtraPathLimit):
        (limit,) = kind.of(with_jerk)
        margin = limit_margin(limit, samples_of(with_jerk, plan.trajectory))
        assert not margin.kept
        assert margin.time_s == 0.0
    proof = prove(with_jerk, plan.trajectory, existence=False)
    assert {one.answer for one in proof.findings if "the pieces of acceleration of X join" in one.name} == {"refuted"}
    samples = samples_of(problem, plan.trajectory)
    assert np.count_nonzero(samples.acceleration_jumps) == 4  # start, end, and both ends of the cruise


KNEE = {
    "mechanism": {"model": "optimus-knee", "payload": "shank"},
    "motion": {"kind": "reach", "start_deg": {"O": -49.07}, "goal_deg": {"O": 56.27}, "duration_s": 0.16},
    "mesh": {"intervals": 24},
}


def slopes(values: np.ndarray, time: np.ndarray, order: int) -> np.ndarray:
    """Return second or third derivatives (n - order, ...) of values at equal times by differences."""
    return np.diff(values, order, axis=0) / (time[1] - time[0]) ** order


@functools.cache
def limited_knee(key: str, name: str, most: float) -> Plan:
    return plan_motion(Problem.from_tables("knee", {**KNEE, "limits": {key: {name: most}}}))


@pytest.mark.parametrize(
    ("key", "of", "limit", "order"),
    [
        ("acceleration_deg_s2", "C", 12000.0, 2),
        ("site_acceleration_m_s2", "B_coupler", 22.0, 2),
        ("jerk_deg_s3", "C", 1.5e6, 3),
        ("site_jerk_m_s3", "B_coupler", 4000.0, 3),
    ],
)
def test_accelerations_and_jerks_of_dependent_joints_and_sites_stay_within_their_limits(key, of, limit, order):
    """The slopes of the sampled pose are a second way to them."""
    plan = limited_knee(key, of, limit)
    assert plan.status == "optimal"
    assert plan.objective > 382.6  # 382.590 without the limit
    mechanism, motion = plan.problem.mechanism, plan.trajectory
    time = np.linspace(0.0, motion.duration_s, 4001 if order == 2 else 1001)  # rounding of positions is of their last digits
    poses = follow(mechanism, motion.position_at(time), motion.start_pose)
    if of == "C":
        found = np.degrees(np.abs(slopes(poses[:, mechanism.joint_index(of)], time, order)))
    else:
        found = np.linalg.norm(slopes(places_of(mechanism, mechanism.model.site(of).id, poses), time, order), axis=1)
    assert 0.999 * limit < found.max() < 1.001 * limit


@pytest.mark.parametrize(
    ("key", "of", "limit", "expression", "most"),
    [
        ("acceleration_deg_s2", "C", 12000.0, lambda at: at.acceleration_rad_s2["C"], np.radians(12000.0)),
        ("jerk_deg_s3", "C", 1.5e6, lambda at: at.jerk_rad_s3["C"], np.radians(1.5e6)),
    ],
)
def test_a_user_s_own_limit_reads_accelerations_and_jerks(key, of, limit, expression, most):
    own = [linkplan.ExtraLimit(name=f"{key} of {of}", expression=expression, lower=-most, upper=most)]
    plan = plan_motion(Problem.from_tables("knee", KNEE).replace(extra_limits=own))
    assert plan.objective == pytest.approx(limited_knee(key, of, limit).objective, rel=1e-5)


ARM, RADIUS_M = (
    """<mujoco><option gravity="0 0 0"/>
  <worldbody><body>
    <joint name="J" axis="0 0 1"/><geom type="box" size=".1 .1 .1" mass="1"/><site name="elbow" pos=".5 0 0"/>
    <body pos=".5 0 0">
      <joint name="K" axis="0 0 1"/><geom type="box" size=".1 .1 .1" mass="1"/><site name="tip" pos=".3 0 0"/>
    </body>
  </body></worldbody>
  <actuator><motor name="A" joint="J" ctrlrange="-9 9"/><motor name="B" joint="K" ctrlrange="-9 9"/></actuator>
</mujoco>""",
    0.5,
)


def turning(most: float) -> tuple[Problem, Trajectory]:
    """Return the quintic of the first joint through 3 rad in 1 s in seven intervals, and a limit on the elbow's jerk."""
    ends = {"J": 0.0, "K": 0.0}, {"J": float(np.degrees(3.0)), "K": 0.0}
    limits = {"site_jerk_m_s3": {"elbow": most}}
    problem = Problem.reach(load_mechanism(ARM), start_deg=ends[0], goal_deg=ends[1], duration_s=1.0, limits=limits)
    breaks, shares = np.linspace(0.0, 1.0, 8), np.linspace(0.0, 1.0, 6)
    t = breaks[:-1] + shares[:, None] / 7
    position = np.zeros((6, 7, 2))
    position[:, :, 0] = np.linalg.solve(bernstein_matrix(5, shares), 3 * t**3 * (10 - 15 * t + 6 * t**2))
    motion = motion_along(breaks, position)
    return problem, motion


def test_the_jerk_of_a_turning_site_is_measured_and_proved_between_the_nodes():
    """In polar coordinates r (j - w^3) across and -3 r w a along the arm; here it is largest inside the interval."""
    t = np.linspace(0.0, 1.0, 100_001)
    w, a, j = 90 * t**2 * (1 - t) ** 2, 180 * t * (1 - t) * (1 - 2 * t), 180 * (1 - 6 * t + 6 * t**2)
    size = RADIUS_M * np.hypot(j - w**3, 3 * w * a)
    assert size.max() > 1.02 * size[np.round(np.linspace(0, 100_000, 8)).astype(int)].max()
    for factor, answer in ((1 + 1e-6, "proved"), (1 - 1e-6, "refuted")):
        problem, motion = turning(factor * size.max())
        (limit,) = SiteJerkLimit.of(problem)
        margin = limit_margin(limit, samples_of(problem, motion))
        assert margin.kept == (answer == "proved")
        assert margin.value == pytest.approx(size.max(), rel=1e-7)
        (found,) = [one for one in prove(problem, motion, existence=False).findings if "jerk of site elbow" in one.name]
        assert found.answer == answer, found.sentence()


def test_rounding_of_a_position_far_from_zero_is_no_jerk_in_a_proof():
    """x = 1000 m + 40 m/s3 t^3 / 6 in one millisecond: the last digits of x have a third derivative of about 1e-3 m/s3."""
    problem, h = mass(1.0, "effort", 1.0, jerk_m_s3=40.0 * (1 + 1e-6), site_jerk_m_s3=40.0 * (1 + 1e-6)), 1e-3
    motion = motion_along([0.0, h], 1000.0 + np.array([0.0, 0.0, 0.0, 40 * h**3 / 6]), velocity=[0.0, 0.0, 40 * h**2 / 2])
    found = [one for one in prove(problem, motion, existence=False).findings if "jerk of" in one.name]
    assert [one.answer for one in found] == ["proved", "proved"], [one.sentence() for one in found]


def test_a_limit_on_jerk_forbids_jumps_of_the_joints_that_move_the_site_alone():
    problem, _ = turning(1.0)
    of_tip = problem.varied(limits=replace(problem.limits, site_jerk={"tip": 1.0}))
    assert [smooth_columns(one) for one in (problem, of_tip)] == [(0,), (0, 1)]


def test_a_limit_on_the_jerk_of_a_site_at_rest_forbids_no_jump():
    """C is a pin of the frame."""
    problem = Problem.from_tables("knee", {**KNEE, "limits": {"site_jerk_m_s3": {"C": 1.0}}})
    assert smooth_columns(problem) == ()
    plan = plan_motion(problem)
    assert plan.status == "optimal"
    assert [margin.left for margin in plan.certificate.margins if margin.of.key == "site_jerk"] == [1.0]


@pytest.mark.slow
def test_a_limit_on_the_jerk_of_a_site_that_forbids_a_motion_is_named():
    problem = mass(1.0, "effort", 0.9, site_jerk_m_s3=40.0).replace(mesh={"intervals": 10})
    plan = plan_motion(problem)  # the least time is 0.928 s
    assert plan.status == "infeasible"
    assert "the jerk of site tool" in plan.message


@pytest.mark.slow
def test_a_limit_on_the_jerk_of_a_joint_that_forbids_a_motion_is_stated():
    plan = plan_motion(Problem.from_tables("knee", {**KNEE, "limits": {"jerk_deg_s3": {"O": 1e5}}}))
    assert plan.status == "infeasible"
    needed = float(plan.message.split("would have to be ")[1].split(" deg/s3")[0])
    assert needed == pytest.approx(32 * 105.34 / 0.16**3, rel=0.05)  # of a motion from rest to rest without a jump
    assert "beyond its limit of 1e+05 deg/s3; the shortest feasible duration is 0.32303 s" in plan.message


def test_an_own_limit_on_jerk_needs_accelerations_that_change_within_intervals():
    own = [linkplan.ExtraLimit(name="own", expression=lambda at: at.site_jerk("B_coupler")[0], upper=1.0)]
    problem = Problem.from_tables("knee", {**KNEE, "mesh": {"effort": "constant"}})
    with pytest.raises(ProblemError, match="'own' has a jerk, which needs mesh\\.effort polynomial"):
        problem.replace(extra_limits=own)


@pytest.mark.parametrize(
    ("limits", "mesh", "words"),
    [
        ({"jerk_deg_s3": {"O": 1e5}}, {"effort": "constant"}, "limits.jerk needs mesh.effort polynomial, got constant"),
        ({"jerk_deg_s3": {"O": 1e5}}, {"scheme": "radau-1"}, "limits.jerk needs a mesh.scheme with three nodes or more"),
        (
            {"site_jerk_m_s3": {"C": 1e5}},
            {"scheme": "radau-2"},
            "limits.site_jerk needs a mesh.scheme with three nodes or more",
        ),
        ({"site_jerk_m_s3": {"foot": 1.0}}, {}, "unknown site 'foot' in limits.site_jerk_m_s3; sites are O"),
        ({"site_jerk_m_s3": {"C": -1.0}}, {}, "limits.site_jerk_m_s3.C"),
        ({"acceleration_m_s2": {"O": 1.0}}, {}, "use limits.acceleration_deg_s2, not acceleration_m_s2"),
        ({"acceleration_deg_s2": {"O": [1.0, 2.0]}}, {}, "must admit rest"),
        ({"site_acceleration_m_s2": {"foot": 1.0}}, {}, "unknown site 'foot' in limits.site_acceleration_m_s2; sites are O"),
    ],
)
def test_limits_that_mean_nothing_are_refused(limits, mesh, words):
    with pytest.raises(ProblemError, match=words):
        Problem.from_tables("knee", {**KNEE, "limits": limits, "mesh": mesh})


def test_the_least_jerk_of_a_motion_in_too_little_time_is_named_and_not_an_infinite_one(monkeypatch):
    """A way d takes 32 d / T^3 in the time T. Without a limit, accelerations jump, and the jerk is infinite."""
    reach = 'kind = "reach"\nstart_m = { x = 0.0 }\ngoal_m = { x = 0.3 }\nduration_s = 1.0\n'
    monkeypatch.setattr(reasons, "shortest_motion", lambda _: None)
    problem = body_problem(cart("-60 60"), reach, "limits.jerk_m_s3.x=2", 'objective.minimize="effort"')
    plan = plan_motion(problem, methods=(), diagnoses=(reasons.one_limit, reasons.nothing_found))
    assert plan.status == "infeasible"
    named = re.search(r"jerk of joint x would have to be (-?[\d.]+) m/s3 at .* beyond its limit of -?2 m/s3", plan.message)
    assert abs(float(named[1])) == pytest.approx(32 * 0.3, rel=2e-4), plan.message
