"""Poses by places of sites, and angles of bodies, against closed forms and MuJoCo."""

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.body_angles import body_index, sum_text, turning, turning_bodies
from linkplan.models.poses.inverse_kinematics import SiteTargets, distance_m, independent_rows_of, places_of, site_pose
from linkplan.models.tree.dynamics import site_index, site_names
from tests.support.arms import LOWER, UPPER, angles_at, arm, foot_of
from tests.support.mechanisms import random_tree
from tests.support.polycentric import KNEE, shank_deg
from tests.support.refusals import assert_names, refusal
from tests.support.tolerances_planner import IK_RAD, OUT_OF_REACH_M, SITE_M

FREE = np.nan


@pytest.fixture(scope="module")
def two_links() -> Mechanism:
    return load_mechanism(arm(UPPER, LOWER))


def ranges(mechanism: Mechanism) -> np.ndarray:
    return np.array([[joint.lower, joint.upper] for joint in mechanism.joints])


def targets(mechanism: Mechanism, **places: list[float]) -> SiteTargets:
    sites = [site_index(mechanism.model, name, "a test") for name in places]
    return SiteTargets(sites=np.array(sites), points=np.array(list(places.values()), dtype=float))


def by_mujoco(mechanism: Mechanism, name: str, q: np.ndarray) -> np.ndarray:
    """Return MuJoCo's place (3,) [m] of a site at a pose."""
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(q)
    mujoco.mj_kinematics(mechanism.model, data)
    return np.array(data.site_xpos[mechanism.model.site(name).id])


@pytest.mark.parametrize("name", ["five-bar", "andrews-squeezer"])
def test_sites_of_closed_loops_are_where_mujoco_has_them(name):
    mechanism, rng = load_mechanism(name), np.random.default_rng(1)
    home = mechanism.home[mechanism.independent]
    poses = np.array([close_at(mechanism, home + 0.2 * rng.uniform(-1, 1, len(home))) for _ in range(5)])
    for site in site_names(mechanism.model):
        places = places_of(mechanism, mechanism.model.site(site).id, poses)
        assert places.shape == (5, 3)
        assert np.abs(places - [by_mujoco(mechanism, site, q) for q in poses]).max() < SITE_M


@pytest.mark.parametrize("seed", range(3))
def test_sites_of_trees_in_space_are_where_mujoco_has_them(seed):
    text = random_tree(seed)
    with_site = text.replace("</body>", '<site name="tip" pos="0.1 -0.2 0.3"/></body>', 1)
    mechanism = load_mechanism(with_site)
    q = np.random.default_rng(seed).uniform(-1, 1, (4, mechanism.n_q))
    places = places_of(mechanism, mechanism.model.site("tip").id, q)
    assert np.abs(places - [by_mujoco(mechanism, "tip", one) for one in q]).max() < SITE_M * 10
    assert np.ptp(places, axis=0).max() > 0.01  # it moves


@pytest.mark.parametrize("bend", [-1.0, 1.0])
def test_the_nearer_of_two_bends_is_taken(two_links, bend):
    wanted = angles_at(0.35, 0.1, bend)
    start = wanted + np.array([0.3, -0.4])
    found = site_pose(two_links, targets(two_links, foot=[0.35, 0.0, 0.1]), start, ranges(two_links))
    assert found.arrived(two_links)
    assert found.pose == pytest.approx(wanted, abs=IK_RAD)
    assert foot_of(found.pose)[0] == pytest.approx([0.35, 0, 0.1], abs=SITE_M * 1e3)


def test_a_range_leaves_the_other_bend_alone(two_links):
    bounds = ranges(two_links)
    bounds[1] = [-np.pi, -0.01]
    start = angles_at(0.35, 0.1, +1.0)
    found = site_pose(two_links, targets(two_links, foot=[0.35, 0.0, 0.1]), start, bounds)
    assert found.pose == pytest.approx(angles_at(0.35, 0.1, -1.0), abs=IK_RAD)


def test_a_pose_that_is_not_preferred_gives_way(two_links):
    start = angles_at(0.35, 0.1, +1.0)
    asked = targets(two_links, foot=[0.35, 0.0, 0.1])
    found = site_pose(two_links, asked, start, ranges(two_links), lambda q: q[1] < 0)
    assert found.pose == pytest.approx(angles_at(0.35, 0.1, -1.0), abs=IK_RAD)


@pytest.mark.parametrize("point", [[0.6, 0.0, 0.3], [0.0, 0.0, 0.02], [0.6, 0.1, 0.3]])
def test_out_of_reach_is_answered_with_the_least_distance(two_links, point):
    """Beyond the stretched arm, within the folded one, and off its plane."""
    found = site_pose(two_links, targets(two_links, foot=point), two_links.home, ranges(two_links))
    x, y, z = point
    planar = np.hypot(x, z)
    least = np.hypot(max(planar - UPPER - LOWER, UPPER - LOWER - planar, 0.0), y)
    assert least > 0.01
    assert not found.arrived(two_links)
    assert found.distance_m[0] == pytest.approx(least, abs=OUT_OF_REACH_M)


def test_the_stretched_arm_arrives_at_the_border_of_its_reach(two_links):
    found = site_pose(two_links, targets(two_links, foot=[0.0, 0.0, UPPER + LOWER]), two_links.home, ranges(two_links))
    assert found.arrived(two_links)
    rows = independent_rows_of(two_links, targets(two_links, foot=[0, 0, UPPER + LOWER]), found.pose, ranges(two_links))
    assert rows == (0, 2)  # both freedoms are given there, though the Jacobian has lost a rank in that pose


@pytest.mark.parametrize(
    ("point", "rows"),
    [([0.3, 0.0, 0.2], (0, 2)), ([0.3, FREE, 0.2], (0, 2)), ([FREE, FREE, 0.2], (2,)), ([FREE, 0.0, FREE], ())],
)
def test_coordinates_that_say_nothing_are_left_out(two_links, point, rows):
    asked = targets(two_links, foot=point)
    found = site_pose(two_links, asked, two_links.home, ranges(two_links))
    assert independent_rows_of(two_links, asked, found.pose, ranges(two_links)) == rows


def test_a_pose_that_is_there_already_is_kept_to_the_last_digit(two_links):
    start = np.array([0.3, 0.7])
    asked = targets(two_links, foot=foot_of(start)[0].tolist())
    assert np.array_equal(site_pose(two_links, asked, start, ranges(two_links)).pose, start)


def test_a_closed_loop_stays_closed_and_on_its_branch():
    mechanism = load_mechanism("five-bar")
    asked = targets(mechanism, P=[0.1, 0.0, -0.25])
    found = site_pose(mechanism, asked, mechanism.home, ranges(mechanism))
    assert found.arrived(mechanism)
    assert distance_m(mechanism, asked, found.pose).max() < SITE_M * 1e3
    assert mechanism.gap_m(found.pose) < mechanism.closed_m
    assert close_at(mechanism, found.pose[mechanism.independent]) == pytest.approx(found.pose, abs=IK_RAD)


@pytest.mark.slow
def test_dependent_ranges_are_kept():
    """The pin's angle stops at 10 deg: the chain cannot be stretched out, and comes less far down."""
    mechanism = load_mechanism("five-bar")
    bounds = ranges(mechanism)
    pin = mechanism.joint_index("P")
    assert pin in mechanism.dependent
    free = site_pose(mechanism, targets(mechanism, P=[0.06, FREE, -0.9]), mechanism.home, bounds)
    bounds[pin, 0] = np.radians(60)
    held = site_pose(mechanism, targets(mechanism, P=[0.06, FREE, -0.9]), mechanism.home, bounds)
    assert held.distance_m[0] > free.distance_m[0] + 0.001
    assert held.pose[pin] >= np.radians(60) - 1e-4


def test_unknown_sites_are_refused_by_name(two_links):
    said = refusal(lambda: site_index(two_links.model, "fot", "motion.goal_at"), ModelError)
    assert_names(said, "'fot'", "motion.goal_at", "did you mean 'foot'", "base, foot")
    bare = load_mechanism(arm(UPPER).replace('<site name="foot"', "<site").replace('<site name="base"/>', ""))
    assert_names(refusal(lambda: site_index(bare.model, "foot", "limits.site")), "the model names none", "<site name=")


# Hinges about one line, both ways, with a slide between them; and a base that is not at the reference pose at zero.
MASS = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
BOTH_WAYS = f"""<mujoco><option gravity="0 0 0"/><worldbody>
<body name="thigh" quat="0.8 0 0.6 0"><joint name="hip" axis="0 1 0" ref="10"/>{MASS}
<body name="tube" pos="0 0 -0.4"><joint name="s" type="slide" axis="0 0 1"/>{MASS}
<body name="shank" pos="0 0 -0.4" quat="0.6 0 0.8 0"><joint name="knee" axis="0 -2 0"/>{MASS}
<body name="shoe" pos="0 0 1">{MASS}</body></body></body></body></worldbody>
<actuator><motor joint="hip"/><motor joint="knee"/><motor joint="s"/></actuator></mujoco>"""
PAIR = f"""<mujoco><worldbody><body name="a"><joint name="one" %s/>{MASS}
<body name="b"><joint name="two" %s/>{MASS}</body></body></worldbody><actuator><motor joint="one"/></actuator></mujoco>"""
ABOUT_Y, ALONG_Y = 'axis="0 1 0"', 'type="slide" axis="0 1 0"'


def turned_by_mujoco(mechanism, body: str, q: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) [rad] of a body from its orientation at q = 0, by MuJoCo."""
    model, data = mechanism.model, mujoco.MjData(mechanism.model)
    frames = []
    for pose in (np.zeros(mechanism.n_q), q):
        data.qpos[:] = mechanism.qpos_of(pose)
        mujoco.mj_kinematics(model, data)
        frames.append(np.array(data.xmat[model.body(body).id]).reshape(3, 3))
    quaternion, found = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, (frames[1] @ frames[0].T).ravel())
    mujoco.mju_quat2Vel(found, quaternion, 1.0)
    return found


@pytest.mark.parametrize("body", ["thigh", "tube", "shank", "shoe"])
def test_the_angle_is_mujocos_turn_of_the_body_about_its_first_hinge(body):
    mechanism = load_mechanism(BOTH_WAYS)
    q = np.array([0.4, 0.1, -0.9])
    angle = turning(mechanism, mechanism.model.body(body).id, "the angle") @ q
    assert abs(angle) > 0.3
    np.testing.assert_allclose(turned_by_mujoco(mechanism, body, q), [0.0, angle, 0.0], atol=1e-12)


def test_a_hinge_about_the_opposite_axis_counts_backwards():
    mechanism = load_mechanism(BOTH_WAYS)
    assert {name: sum_text(mechanism, sigma) for name, sigma in turning_bodies(mechanism).items()} == {"shank": "hip - knee"}


@pytest.mark.parametrize("rear_deg", [-30.0, -10.0, 20.0, 35.0])
def test_the_shank_of_a_polycentric_knee_turns_as_the_closed_form_of_its_four_bar(rear_deg):
    mechanism = load_mechanism(KNEE)
    q = close_at(mechanism, np.radians([rear_deg]))
    expected = float(shank_deg(np.array(rear_deg)))
    assert abs(expected) > 5, "not a parallelogram"
    assert np.degrees(turning_bodies(mechanism)["shank"] @ q) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(
    ("joints", "body", "words"),
    [
        ((ABOUT_Y, 'axis="0 1 0.1"'), "b", ["'b'", "no single angle", "'one'", "'two'", "not parallel"]),
        ((ABOUT_Y, 'type="ball"'), "b", ["'b'", "no single angle", "ball joint 'two'"]),
        ((ALONG_Y, ABOUT_Y), "a", ["'a'", "no hinge"]),
        ((ABOUT_Y, ABOUT_Y), "d", ["'d'", "legal: a, b"]),
    ],
    ids=["skew", "ball", "slide", "unknown"],
)
def test_a_body_without_a_single_angle_is_refused_in_one_line(joints, body, words):
    mechanism, what = load_mechanism(PAIR % joints), "limits.body_deg"
    said = refusal(lambda: turning(mechanism, body_index(mechanism.model, body, what), what), ModelError)
    assert_names(said, what, *words)


def test_axes_that_differ_by_the_rounding_of_a_file_are_parallel():
    mechanism = load_mechanism(PAIR % (ABOUT_Y, 'axis="0 1 1e-7"'))
    assert np.array_equal(turning(mechanism, mechanism.model.body("b").id, "the angle"), [1.0, 1.0])
