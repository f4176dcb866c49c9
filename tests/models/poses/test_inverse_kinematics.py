"""Sites: where they are, against MuJoCo, and the poses that put them there, against trigonometry."""

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.inverse_kinematics import SiteTargets, distance_m, independent_rows_of, places_of, site_pose
from linkplan.models.tree.dynamics import site_index, site_names
from tests.support.arms import LOWER, UPPER, angles_at, arm, foot_of
from tests.support.mechanisms import random_tree
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
