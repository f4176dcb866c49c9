"""A site that follows a path exactly: least time and least effort against formulas of a two-link arm of one's own."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy

from linkplan.models.errors import LinkplanError
from linkplan.models.guide.curve import Curve, curve_through
from linkplan.models.guide.guided import guided
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import accelerations, joint_rates, site_motion
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.reach import reach
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.closed_chain.mechanics import NodeTerms, mechanism_system
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.site_path import _in_joints
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.system import build_node
from tests.bench.many_robots import delta
from tests.support.refusals import assert_refused

# Two rods with their mass in the middle, in the vertical plane x-z; the second hinge counts from the first rod.
L1, L2, M1, M2, J1, J2, G, D = 0.4, 0.3, 2.0, 1.0, 0.03, 0.01, 9.81, 0.05
LIMIT = np.array([14.0, 5.0])
ARM = f"""
<mujoco model="arm">
  <compiler angle="radian"/>
  <option gravity="0 0 -{G}"/>
  <worldbody>
    <body name="upper">
      <joint name="q1" axis="0 -1 0" damping="{D}"/>
      <inertial pos="{L1 / 2} 0 0" mass="{M1}" diaginertia="{J1} {J1} {J1}"/>
      <body name="lower" pos="{L1} 0 0">
        <joint name="q2" axis="0 -1 0"/>
        <inertial pos="{L2 / 2} 0 0" mass="{M2}" diaginertia="{J2} {J2} {J2}"/>
        <site name="tip" pos="{L2} 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m1" joint="q1" ctrlrange="-{LIMIT[0]} {LIMIT[0]}" ctrllimited="true"/>
    <motor name="m2" joint="q2" ctrlrange="-{LIMIT[1]} {LIMIT[1]}" ctrllimited="true"/>
  </actuator>
</mujoco>
"""
FROM, TO = np.array([0.55, -0.15]), np.array([0.35, 0.25])
LINE = [[FROM[0], 0.0, FROM[1]], [TO[0], 0.0, TO[1]]]


def joints(p, way, bend):
    """Return q, dq/dx and d2q/dx2 of the arm whose elbow is below, at p(x) with dp/dx and d2p/dx2 (2,); arrays or CasADi."""
    lib = ca if isinstance(p[0], ca.MX) else np
    radius2 = p[0] ** 2 + p[1] ** 2
    q2 = (
        lib.arccos((radius2 - L1**2 - L2**2) / (2 * L1 * L2))
        if lib is np
        else ca.acos((radius2 - L1**2 - L2**2) / (2 * L1 * L2))
    )
    turn = np.arctan2 if lib is np else ca.atan2
    q1 = turn(p[1], p[0]) - turn(L2 * lib.sin(q2), L1 + L2 * lib.cos(q2))
    s1, c1, s12, c12 = lib.sin(q1), lib.cos(q1), lib.sin(q1 + q2), lib.cos(q1 + q2)
    a, b, c, d = -L1 * s1 - L2 * s12, -L2 * s12, L1 * c1 + L2 * c12, L2 * c12
    det = a * d - b * c

    def solved(x, y):
        return (d * x - b * y) / det, (a * y - c * x) / det

    v1, v2 = solved(way[0], way[1])
    x = bend[0] + L1 * c1 * v1**2 + L2 * c12 * (v1 + v2) ** 2
    z = bend[1] + L1 * s1 * v1**2 + L2 * s12 * (v1 + v2) ** 2
    return (q1, q2), (v1, v2), solved(x, z)


def torques(q, v, a):
    """Return the drives' torques of the arm by Lagrange's equations; damping acts on the first hinge."""
    lib = ca if isinstance(q[0], ca.MX) else np
    k = M2 * L1 * L2 / 2
    c2, s2 = lib.cos(q[1]), lib.sin(q[1])
    m22 = J2 + M2 * L2**2 / 4
    m11 = J1 + M1 * L1**2 / 4 + M2 * L1**2 + m22 + 2 * k * c2
    m12 = m22 + k * c2
    g2 = M2 * G * L2 / 2 * lib.cos(q[0] + q[1])
    g1 = (M1 * L1 / 2 + M2 * L1) * G * lib.cos(q[0]) + g2
    first = m11 * a[0] + m12 * a[1] - k * s2 * (2 * v[0] * v[1] + v[1] ** 2) + g1 + D * v[0]
    return first, m12 * a[0] + m22 * a[1] + k * s2 * v[0] ** 2 + g2


def along_line(x):
    """Return q, dq/dx, d2q/dx2 at ways x along the line from FROM to TO."""
    unit = (TO - FROM) / np.linalg.norm(TO - FROM)
    return joints((FROM[0] + unit[0] * x, FROM[1] + unit[1] * x), unit, (0.0, 0.0))


def least_time(n: int) -> float:
    """Return the least time along the line by the phase plane of the way: the highest speed that ends at rest."""
    x = np.linspace(0.0, float(np.linalg.norm(TO - FROM)), n)
    q, slope, bend = along_line(x)
    still = np.zeros_like(x)

    def at(v, a):
        return np.array(torques(q, v, a))

    rest = at((still, still), (still, still))
    inertia = at((still, still), slope) - rest
    ahead, back = at(slope, bend) - rest, at((-slope[0], -slope[1]), bend) - rest
    square, linear = (ahead + back) / 2, (ahead - back) / 2

    def accelerations(k: int, y: float) -> tuple[float, float]:
        given = square[:, k] * y + linear[:, k] * np.sqrt(y) + rest[:, k]
        ends = np.sort(np.array([(-LIMIT - given) / inertia[:, k], (LIMIT - given) / inertia[:, k]]), axis=0)
        return float(ends[0].max()), float(ends[1].min())

    h, y = x[1] - x[0], np.zeros(n)
    for k in range(n - 2, -1, -1):  # backwards from rest, at the greatest deceleration
        low, high = 0.0, 100.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            least, most = accelerations(k, middle)
            low, high = (middle, high) if least <= most and middle + 2 * h * least <= y[k + 1] else (low, middle)
        y[k] = low
    limit = y.copy()
    y[0] = 0.0
    for k in range(n - 1):
        y[k + 1] = min(y[k] + 2 * h * accelerations(k, y[k])[1], limit[k + 1])
    speed = np.sqrt(y)
    return float(np.sum(2 * h / (speed[1:] + speed[:-1])))


def least_effort(duration_s: float, n: int = 60) -> float:
    """Return the least integral of squared torques along the line, by an optimisation of its own: linear accelerations."""
    opti, h, length = ca.Opti(), duration_s / n, float(np.linalg.norm(TO - FROM))
    x, v, a = (opti.variable(n + 1) for _ in range(3))
    cost = ca.MX(0)
    for k in range(n):
        slope = (a[k + 1] - a[k]) / h
        opti.subject_to(x[k + 1] == x[k] + v[k] * h + (2 * a[k] + a[k + 1]) * h**2 / 6)
        opti.subject_to(v[k + 1] == v[k] + (a[k] + a[k + 1]) * h / 2)
        for share, weight in ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6)):
            t = share * h
            x_t, v_t = x[k] + v[k] * t + a[k] * t**2 / 2 + slope * t**3 / 6, v[k] + a[k] * t + slope * t**2 / 2
            q, per, bend = along_line(x_t)
            rates = tuple(p * v_t for p in per)
            bends = tuple(p * (a[k] + slope * t) + b * v_t**2 for p, b in zip(per, bend, strict=True))
            cost += weight * h * sum(torque**2 for torque in torques(q, rates, bends))
    opti.subject_to([x[0] == 0, v[0] == 0, x[n] == length, v[n] == 0])
    opti.minimize(cost)
    share = np.linspace(0.0, 1.0, n + 1)
    opti.set_initial(x, length * (3 * share**2 - 2 * share**3))
    opti.solver("ipopt", {"print_time": False, "expand": True, "ipopt.print_level": 0, "ipopt.sb": "yes"})
    return float(opti.solve().value(cost))


def followed(**changes) -> Problem:
    asked = {"path": {"site": "tip", "points": LINE}, "start_deg": {"q1": -40.0, "q2": 50.0}, "minimize": "time"}
    return Problem.follow(ARM, **(asked | changes))


@pytest.fixture(scope="module")
def quickest():
    return plan_motion(followed())


@pytest.mark.slow
def test_the_least_time_along_a_line_is_that_of_the_phase_plane_of_the_way(quickest):
    coarse, fine = least_time(601), least_time(1201)
    assert quickest.status == "optimal"
    assert quickest.duration_s == pytest.approx(2 * fine - coarse, rel=2e-5)


def test_the_site_stays_on_its_path_and_a_margin_says_so(quickest):
    motion, unit = quickest.trajectory, (TO - FROM) / np.linalg.norm(TO - FROM)
    q1, q2 = motion.position_at(motion.dense_times(30)).T
    place = np.array([L1 * np.cos(q1) + L2 * np.cos(q1 + q2), L1 * np.sin(q1) + L2 * np.sin(q1 + q2)]).T - FROM
    assert np.abs(place @ [-unit[1], unit[0]]).max() < 1e-7
    (margin,) = [one for one in quickest.certificate.margins if one.of.key == "path"]
    assert margin.value < margin.limit == pytest.approx(1e-6 * quickest.problem.mechanism.extent_m)


def test_efforts_are_those_of_the_arm_and_reach_the_limits(quickest):
    motion = quickest.trajectory
    time = motion.dense_times(7)[3::7]
    q, v, a = motion.position_at(time).T, motion.velocity_at(time).T, motion.acceleration_at(time).T
    effort = motion.effort_at(time)
    np.testing.assert_allclose(effort, np.array(torques(q, v, a)).T, atol=2e-3)
    # One drive or the other at every instant; an interval beside a switch may hold the jump.
    share = effort / LIMIT
    binding = np.argmax(np.hstack([share, -share]), axis=1)
    alike = (binding[1:-1] == binding[:-2]) & (binding[1:-1] == binding[2:])
    assert alike.mean() > 0.9
    assert np.abs(share).max(axis=1)[1:-1][alike].min() > 0.999


def test_a_motion_off_its_path_fails_its_certificate_and_its_proof(quickest):
    path = quickest.problem.path
    (piece,) = path.curve.pieces
    moved = replace(
        path, curve=Curve((replace(piece, coefficients=piece.coefficients + np.array([[0, 0, 1e-5], [0, 0, 0]])),))
    )
    problem = quickest.problem.varied(path=moved)
    assert any("distance of site tip from its path" in one for one in certify(problem, quickest.trajectory).failures)
    (finding,) = [one for one in prove(problem, quickest.trajectory, existence=False).findings if "its path" in one.name]
    assert finding.answer == "refuted"


def test_a_constant_feed_needs_the_efforts_of_its_line():
    feed, length = 0.3, float(np.linalg.norm(TO - FROM))
    plan = plan_motion(followed(path={"site": "tip", "points": LINE, "feed_m_s": feed}, minimize="effort"))
    assert plan.passed
    assert plan.duration_s == pytest.approx(length / feed, rel=1e-12)
    time = np.linspace(0.0, plan.duration_s, 50)
    q, slope, bend = along_line(feed * time)
    wanted = torques(q, [feed * of for of in slope], [feed**2 * of for of in bend])
    np.testing.assert_allclose(plan.trajectory.effort_at(time), np.array(wanted).T, atol=1e-6)


CORNER = {"site": "tip", "points": [[0.55, 0.0, -0.15], [0.55, 0.0, 0.0], [0.45, 0.0, 0.1]], "blend_m": 0.03}


def test_a_constant_feed_passes_a_rounded_corner_without_a_change_of_speed():
    mesh = {"mesh": {"intervals": 30}, "minimize": "effort"}
    plan = plan_motion(followed(path=CORNER | {"feed_m_s": 0.3}, **mesh))
    time = np.linspace(0.0, plan.duration_s, 1001)
    places = places_of(plan.problem.mechanism, 0, plan.trajectory.position_at(time))
    np.testing.assert_allclose(np.linalg.norm(np.diff(places, axis=0), axis=1) / time[1], 0.3, rtol=1e-5)
    slower = replace(plan.problem.path, curve=curve_through(LINE, "polyline", 0.0, "path"))
    assert any("misses its boundary" in one for one in certify(plan.problem.varied(path=slower), plan.trajectory).failures)


@pytest.mark.slow
def test_a_limit_on_jerk_holds_along_a_rounded_corner_and_binds():
    limits = {"site_jerk_m_s3": {"tip": 20.0}}
    plan = plan_motion(followed(path=CORNER, minimize="effort", duration_s=1.5, limits=limits, mesh={"intervals": 6}))
    (margin,) = [one for one in plan.certificate.margins if one.of.key == "site_jerk"]
    assert plan.passed
    assert margin.value == pytest.approx(20.0, rel=1e-6)


@pytest.mark.slow
def test_a_feed_that_is_too_fast_is_infeasible_with_the_largest_one():
    problem = followed(path={"site": "tip", "points": LINE, "feed_m_s": 30.0}, minimize="effort", mesh={"intervals": 8})
    plan = plan_motion(problem)
    most = plan.verdict.remedy["path.feed_m_s"]
    assert f"with path.feed_m_s = {most:g} or less it satisfies every limit" in plan.message
    assert plan_motion(problem.replace("path.feed_m_s", most)).passed
    assert not plan_motion(problem.replace("path.feed_m_s", 1.001 * most)).passed


def test_a_path_begun_and_left_at_speed_without_acceleration_takes_the_time_of_segments_of_constant_jerk():
    """From v to the top and back: ways of (v + top) / 2 times 2 sqrt((top - v) / jerk) each."""
    ends, jerk, length = (0.3, 0.4), 40.0, float(np.linalg.norm(TO - FROM))

    def times(top: float) -> list[float]:
        return [2 * np.sqrt((top - v) / jerk) for v in ends]

    top = scipy.optimize.brentq(
        lambda top: sum(0.5 * (v + top) * t for v, t in zip(ends, times(top), strict=True)) - length, 0.4, 9.0
    )
    path = {"site": "tip", "points": LINE, "start_speed_m_s": ends[0], "goal_speed_m_s": ends[1]}
    path |= {"start_acceleration_m_s2": 0.0, "goal_acceleration_m_s2": 0.0}
    plan = plan_motion(followed(path=path, limits={"site_jerk_m_s3": {"tip": jerk}}, mesh={"intervals": 30}))
    assert plan.duration_s == pytest.approx(sum(times(top)), rel=1e-5)


@pytest.fixture(scope="module")
def cheapest():
    return plan_motion(followed(minimize="effort", duration_s=0.6))


def test_the_distance_from_the_path_is_proved(cheapest):
    proof = prove(cheapest.problem, cheapest.trajectory, existence=False)
    (finding,) = [one for one in proof.findings if "from its path" in one.name]
    assert finding.answer == "proved"


def test_the_least_effort_in_a_given_time_is_that_of_an_optimisation_of_the_way(cheapest):
    assert cheapest.status == "optimal"
    assert cheapest.objective == pytest.approx(least_effort(0.6), rel=1e-5)


def test_a_polyline_with_rounded_corners_is_followed_and_saved(tmp_path):
    corner = [[0.55, 0.0, -0.15], [0.55, 0.0, 0.0], [0.45, 0.0, 0.1]]
    path = {"site": "tip", "points": corner, "blend_m": 0.03}
    plan = plan_motion(followed(path=path, minimize="effort", duration_s=1.0, mesh={"intervals": 12}))
    assert plan.status == "optimal"
    write_plan(plan, tmp_path)
    again = read_plan(tmp_path)
    assert again.problem.path.curve.length == plan.problem.path.curve.length
    np.testing.assert_array_equal(again.trajectory.position, plan.trajectory.position)
    np.testing.assert_array_equal(again.trajectory.along, plan.trajectory.along)


def test_motors_too_weak_to_leave_the_beginning_are_named_without_a_search():
    """The least overrun of the limits over all accelerations along the line, by the arm's own formulas on a grid."""
    x, pace = np.zeros(2001), np.linspace(0.0, 20.0, 2001)
    q, slope, _ = along_line(x)
    given = np.array(torques(q, (0 * x, 0 * x), (slope[0] * pace, slope[1] * pace)))
    limit = np.array([[4.0], [1.0]])
    best = int(np.argmin(np.sum((np.maximum(np.abs(given) - limit, 0.0) / limit) ** 2, axis=0)))
    assert np.abs(given[0, best]) > 4.0
    plan = plan_motion(followed(limits={"effort": {"m1": [-4.0, 4.0], "m2": [-1.0, 1.0]}}), methods=())
    assert plan.status == "infeasible"
    assert f"m1 on joint q1 would have to give {given[0, best]:.3g}" in plan.message
    strong = followed(limits={"effort": {"m1": [-13.9, 13.9], "m2": [-4.9, 4.9]}})
    assert plan_motion(strong, methods=()).status != "infeasible"


# From the arm's reach: a closed spline, a figure of eight, a closed polyline, and a hairpin whose sides are 10 mm apart.
CIRCLE = [[0.5, 0.0, -0.1], [0.55, 0.0, 0.0], [0.5, 0.0, 0.1], [0.45, 0.0, 0.0], [0.5, 0.0, -0.1]]
EIGHT = [[0.5, 0, -0.1], [0.55, 0, -0.05], [0.45, 0, 0.05], [0.5, 0, 0.1], [0.55, 0, 0.05], [0.45, 0, -0.05], [0.5, 0, -0.1]]
SQUARE = [[0.45, 0.0, -0.05], [0.55, 0.0, -0.05], [0.55, 0.0, 0.05], [0.45, 0.0, 0.05], [0.45, 0.0, -0.05]]
HAIRPIN = [[0.45, 0.0, 0.0], [0.55, 0.0, 0.0], [0.55, 0.0, 0.01], [0.45, 0.0, 0.01]]


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [
        {"points": CIRCLE, "shape": "spline"},
        {"points": EIGHT, "shape": "spline"},
        {"points": SQUARE, "blend_m": 0.02},
        {"points": HAIRPIN, "blend_m": 0.004},
    ],
    ids=["circle", "eight", "square", "hairpin"],
)
def test_paths_that_close_cross_or_come_near_themselves_are_followed_and_proved(path):
    problem = followed(path={"site": "tip", **path}, minimize="effort", duration_s=1.5, mesh={"intervals": 12})
    plan = plan_motion(problem)
    assert plan.status == "optimal"
    (finding,) = [one for one in prove(problem, plan.trajectory, existence=False).findings if "its path" in one.name]
    assert finding.answer == "proved"


@pytest.mark.slow
def test_a_motion_that_leaves_out_a_part_of_a_crossing_path_is_not_on_it():
    """It follows a path that crosses the long one at its middle, and states the places along the long one."""
    long = [[0.45, 0, -0.1], [0.5, 0, 0.0], [0.55, 0, 0.05], [0.55, 0, -0.05], [0.5, 0, 0.0], [0.45, 0, 0.1]]
    whole = followed(path={"site": "tip", "points": long, "shape": "spline"}, minimize="effort", duration_s=1.0)
    short = {"site": "tip", "points": [long[0], long[0]], "shape": "spline"}
    short["points"] = whole.path.curve.places(np.linspace(0.0, whole.path.curve.starts[1], 9)).tolist()
    part = plan_motion(followed(path=short, minimize="effort", duration_s=1.0, mesh={"intervals": 12}))
    assert part.passed
    failures = certify(whole, part.trajectory).failures
    assert any("boundary conditions" in one for one in failures)
    bare = replace(part.trajectory, along=np.zeros((1, 0, 0)))
    assert any("distance of site tip from its path is not finite" in one for one in certify(part.problem, bare).failures)


@pytest.mark.slow
def test_a_corner_too_tight_to_be_passed_at_speed_is_passed_nearly_at_rest():
    corner = [[0.55, 0.0, -0.15], [0.55, 0.0, 0.0], [0.45, 0.0, 0.1]]
    plan = plan_motion(followed(path={"site": "tip", "points": corner, "blend_m": 1e-6}, solver={"max_time_s": 6.0}))
    assert plan.passed


@pytest.mark.slow
def test_the_least_time_along_a_spline_is_proved_although_its_third_derivative_jumps_at_its_points():
    points = [[0.55, 0.0, -0.15], [0.52, 0.0, 0.0], [0.42, 0.0, 0.12], [0.35, 0.0, 0.25]]
    plan = plan_motion(followed(path={"site": "tip", "points": points, "shape": "spline"}))
    assert plan.status == "optimal"
    findings = prove(plan.problem, plan.trajectory, existence=False).findings
    answers = [one.answer for one in findings if one.name.startswith(("effort of", "squared distance"))]
    assert answers == ["proved"] * 3


def test_the_start_chooses_among_the_poses_at_the_begin():
    above = followed(start_deg={"q1": 40.0, "q2": -50.0})
    assert np.degrees(followed().motion.start[1]) > 10.0
    assert np.degrees(above.motion.start[1]) < -10.0


def test_a_path_file_is_read_and_kept_in_the_problem(tmp_path):
    (tmp_path / "way.csv").write_text("x_m,y_m,z_m\n" + "\n".join(",".join(map(str, point)) for point in LINE))
    problem = followed(path={"site": "tip", "file": str(tmp_path / "way.csv"), "shape": "spline"})
    assert problem.to_dict()["path"]["points"] == LINE
    (tmp_path / "flat.csv").write_text("x_m,z_m\n0.1,0.2\n0.2,0.2\n")
    with pytest.raises(LinkplanError, match="has columns x_m, y_m, z_m, got x_m, z_m"):
        followed(path={"site": "tip", "file": str(tmp_path / "flat.csv")})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"path": {"site": "tip", "points": [LINE[0], [0.9, 0.0, 0.0]]}}, "path leaves the reach of site tip at"),
        (
            {"path": {"site": "tip", "points": [[0.9, 0.0, 0.0], LINE[1]]}},
            "the beginning of path.tip = [0.9, 0, 0] m is out of reach",
        ),
        ({"path": {"site": "tip", "points": LINE, "shape": "arc"}}, "has three points, got 2"),
        ({"path": {"site": "hand", "points": LINE}}, "unknown site 'hand' in path.site"),
        ({"path": {"site": "tip"}}, "path.points"),
        ({"path": {"site": "tip", "points": LINE, "shape": "spline", "blend_m": 0.01}}, "path.blend_m rounds the corners"),
        ({"path": None}, "motion.kind 'follow' needs a [path]"),
        ({"goal_deg": {"q1": 1.0}}, "motion.goal_deg cannot be set for motion.kind 'follow'"),
        (
            {
                "robust": {"payload_factor": [0.9, 1.1]},
                "payload": {"body": "lower", "mass_kg": 0.1, "com_m": [0, 0, 0], "inertia_kgm2": [0, 0, 0]},
            },
            "cannot be combined with [robust]",
        ),
        ({"minimize": "jerk", "duration_s": 0.6}, "motion.kind 'follow' cannot be combined with minimize 'jerk'"),
        (
            {
                "limits": {"site_jerk_m_s3": {"tip": 40.0}},
                "path": {"site": "tip", "points": [LINE[0], [0.45, 0.0, 0.1], LINE[1]], "shape": "spline"},
            },
            "cannot be combined with a limit on jerk along a spline, or one in Python along rounded corners",
        ),
        (
            {"path": {"site": "tip", "points": LINE, "feed_m_s": 0.1, "goal_speed_m_s": 0.1}},
            "it excludes path.goal_speed_m_s",
        ),
        ({"path": {"site": "tip", "points": LINE, "feed_m_s": 0.1}, "duration_s": 1.0}, "path.feed_m_s gives the duration"),
        (
            {"path": {"site": "tip", "points": LINE, "goal_speed_m_s": 0.1, "goal_acceleration_m_s2": 0.0}},
            "path.goal_acceleration_m_s2: the acceleration may jump there; set limits.site_jerk_m_s3",
        ),
        (
            {"path": {"site": "tip", "points": LINE, "goal_acceleration_m_s2": 1.0}},
            "path.goal_acceleration_m_s2 is 0 without path.goal_speed_m_s, got 1",
        ),
        ({"path": {"site": "tip", "points": [LINE[0], [0.5, 0.1, 0.0]]}}, "path leaves the reach of site tip"),
    ],
)
def test_paths_that_cannot_be_followed_are_refused_in_one_line(changes: dict, said: str):
    assert_refused(lambda: followed(**changes), said)


@pytest.mark.parametrize(("key", "of", "most"), [("site_jerk_m_s3", "tip", 40.0), ("jerk_deg_s3", "q2", 9e3)])
def test_jerks_along_a_line_stay_within_their_limits(key, of, most):
    """The third differences of the sampled joints and places are a second way to them."""
    plan = plan_motion(followed(minimize="effort", duration_s=0.9, mesh={"intervals": 20}, limits={key: {of: most}}))
    assert plan.status == "optimal", plan.message
    time = np.linspace(0.0, 0.9, 601)
    q = plan.trajectory.position_at(time)
    values = places_of(plan.problem.mechanism, 0, q) if of == "tip" else np.degrees(q[:, 1:])
    found = np.linalg.norm(np.diff(values, 3, axis=0), axis=1) / (time[1] - time[0]) ** 3
    assert 0.99 * most < found.max() < 1.0001 * most


def test_a_path_belongs_to_its_kind_of_motion():
    with pytest.raises(LinkplanError, match=r"belongs to motion.kind 'follow', got 'reach'"):
        Problem.reach(
            ARM, start_deg={"q1": 0, "q2": 50}, goal_deg={"q1": 10, "q2": 50}, path={"site": "tip", "points": LINE}
        )


def test_a_mechanism_with_more_freedoms_than_the_path_decides_is_refused():
    longer = ARM.replace(
        '<site name="tip"',
        '<body name="hand"><joint name="q3" axis="0 -1 0"/><inertial pos="0.05 0 0"'
        ' mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body><site name="tip"',
    )
    longer = longer.replace("</actuator>", '<motor name="m3" joint="q3" ctrlrange="-1 1" ctrllimited="true"/></actuator>')
    with pytest.raises(LinkplanError, match="does not determine 1 of the 3 degrees of freedom of 'arm'"):
        Problem.follow(longer, path={"site": "tip", "points": LINE})


def test_a_motion_with_time_to_spare_stays_between_the_ends_of_its_path():
    plan = plan_motion(
        Problem.follow(
            "five-bar",
            path={"site": "P", "points": [[0.06, 0.0, -0.33], [0.045, 0.0, -0.31]]},
            duration_s=0.4,
            minimize="effort",
            limits={"effort": {"act_O1": [-3, 3], "act_O2": [-3, 3]}},
        )
    )  # its weight would help if it fell first: without ends it goes back by 16 mm
    assert plan.status == "optimal"


def test_a_path_does_not_push_a_mechanism():
    mechanism = load_mechanism(delta().text)
    site = mechanism.model.site("at_0").id
    place = places_of(mechanism, site, mechanism.home)[0]
    curve = curve_through([place, place + np.array([0.05, 0.03, -0.02])], "polyline", 0.0, "path")
    guide = guided(mechanism, site, curve, mechanism.home)
    # The residual is that of the free mechanism, along the same velocity and acceleration.
    v, a, u = np.array([0.3]), np.array([-2.0]), np.array([1.0, -2.0, 3.0])
    free = mechanism.independent
    rates = joint_rates(guide, guide.home[None], v[None])[0, free]
    bent = accelerations(guide, guide.home[None], v[None], a[None])[0, free]
    expected = np.array(mechanism.dynamics.residual(mechanism.home, rates, bent, u)).ravel()
    np.testing.assert_allclose(np.array(guide.dynamics.residual(guide.home, v, a, u)).ravel(), expected, atol=1e-9)
    system = mechanism_system(guide, NodeTerms())
    xi, units = np.concatenate([[0.0], v, a, guide.home[:-1], u]), np.ones(system.n_theta)
    rows = np.array(build_node(system).node_value(xi, units)).ravel()
    np.testing.assert_allclose(rows[-len(expected) :], expected, atol=1e-9)
    np.testing.assert_allclose(
        site_motion(mechanism, 2)(mechanism.home, rates, bent).full()[:, site], curve_motion(curve, v, a), atol=1e-9
    )


def curve_motion(curve: Curve, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return the acceleration (3,) of a point at the begin of a curve."""
    _, slope, bend = (np.array(one).ravel() for one in curve.function(0.0))
    return slope * a + bend * v**2


def test_a_freedom_without_its_own_drive_is_refused():
    one = ARM.replace('<motor name="m2" joint="q2"', '<motor name="m2" joint="q1"')
    with pytest.raises(LinkplanError, match="got 2 drives that move 1 of them"):
        Problem.follow(one, path={"site": "tip", "points": LINE}, start_deg={"q1": -40.0, "q2": 50.0})


def test_the_linearisation_along_a_path_is_the_slope_of_its_acceleration(quickest):
    guide = quickest.problem.path.guided(quickest.problem.mechanism, quickest.trajectory.start_pose)
    x, v, step = 0.2, np.array([0.7]), 1e-5

    def acceleration(x: float, v: np.ndarray, u: np.ndarray) -> float:
        pose = follow(guide, np.array([[x]]))[0]
        return float(guide.dynamics.acceleration(pose, v, u))

    # Off the path's own efforts a residual across the path remains, which the linearisation leaves out.
    pose = follow(guide, np.array([[x]]))[0]
    a = np.array([3.0])
    q, rates = pose[:-1], joint_rates(guide, pose[None], v[None])[0, :-1]
    u = quickest.problem.mechanism.dynamics.inverse_dynamics(
        q, rates, accelerations(guide, pose[None], v[None], a[None])[0, :-1]
    )
    u = np.array(u).ravel()
    assert acceleration(x, v, u) == pytest.approx(3.0, abs=1e-9)
    by_x, by_v, by_u = (np.array(one) for one in guide.dynamics.linearisation(pose, v, u))
    assert by_x[0, 0] == pytest.approx((acceleration(x + step, v, u) - acceleration(x - step, v, u)) / (2 * step), rel=1e-6)
    assert by_v[0, 0] == pytest.approx((acceleration(x, v + step, u) - acceleration(x, v - step, u)) / (2 * step), rel=1e-6)
    for j, unit in enumerate(np.eye(2)):
        slope = (acceleration(x, v, u + step * unit) - acceleration(x, v, u - step * unit)) / (2 * step)
        assert by_u[0, j] == pytest.approx(slope, rel=1e-6)


def test_a_motor_that_is_too_weak_in_the_middle_of_a_path_is_named_with_what_it_lacks_there():
    """A spring of 100 N/m and 100 mm pushes with 5 N across the path where it is 50 mm long, and pulls at both ends."""
    gantry = """<mujoco><option gravity="0 0 0"/><worldbody><site name="below" pos="0.1 0 -0.05"/>
    <body><joint name="x" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body><joint name="z" type="slide" axis="0 0 1" damping="1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <site name="pen"/></body></body></worldbody><tendon><spatial stiffness="100" springlength="0.1"><site site="below"/>
    <site site="pen"/></spatial></tendon><actuator><motor name="mx" joint="x" ctrlrange="-9 9"/>
    <motor name="mz" joint="z" ctrlrange="-4 4"/></actuator></mujoco>"""
    line = {"site": "pen", "points": [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]}
    plan = plan_motion(Problem.follow(gantry, path=line, start_m={"x": 0.0, "z": 0.0}, minimize="time"))
    lacks = "50% along the path, mz on joint z would have to give -5 N, 1 N beyond its limit of -4 N"
    assert plan.message == f"infeasible: {lacks}, to keep its site on the path"


def test_efforts_along_a_path_are_those_of_the_joints_where_coefficients_lie_beyond_a_limit_that_no_effort_exceeds():
    problem = Problem.follow(ARM, path={"site": "tip", "points": LINE}, start_deg={"q1": -60, "q2": 90}, duration_s=1.0)
    start = close_at(problem.mechanism, problem.motion.start)
    guide = problem.path.guided(problem.mechanism, start)
    x = np.linspace(0.0, guide.curve.length, 4)[:, None, None]
    effort = np.array([[-0.5, 0.3], [1.72, 0.4], [0.6, -0.2]])[:, None] * LIMIT
    along = Trajectory(
        breaks_s=np.array([0.0, 1.0]), position=x, velocity=np.ones((1, 1, 1)) * guide.curve.length, effort=effort,
        start_pose=guide.home, periodic=False,
    )  # fmt: skip
    time = np.linspace(0.0, 1.0, 21)
    assert np.all(np.abs(along.effort_at(time)) < LIMIT)
    np.testing.assert_allclose(_in_joints(problem, guide, along).effort_at(time), along.effort_at(time), atol=1e-9)


def test_a_corner_rounded_within_a_micrometre_is_in_reach():
    leg = """<mujoco><worldbody><body pos="0 0 .5"><joint name="hip" axis="0 -1 0"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
    <body pos=".3 0 0"><joint name="knee" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 .25 0 0" size=".015"/>
    <site name="foot" pos=".25 0 0"/></body></body></worldbody><actuator><motor name="hip" joint="hip" ctrlrange="-20 20"/>
    <motor name="knee" joint="knee" ctrlrange="-20 20"/></actuator></mujoco>"""
    path = {"site": "foot", "points": [[0.25, 0, 0.1], [0.25, 0, 0.3], [0.4, 0, 0.3]], "blend_m": 1e-6}
    start = {"hip": -60.0, "knee": 60.0}
    tables = {"mechanism": {"model": leg}, "path": path, "objective": {"minimize": "time"}}
    motion = {"kind": "follow", "start_deg": start, "duration_s": "free"}
    asked = Problem.from_tables("tight", tables | {"motion": motion})
    along = asked.path.guided(asked.mechanism, asked.start_pose())
    assert reach(along, along.dof - 1).upper.position > 0.35  # of 0.2 + 0.15 m
