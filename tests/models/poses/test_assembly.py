"""Assembly: rank and rows of the closure, branches, paths and the reach, against the closed forms of planar linkages."""

import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.errors import AssemblyError, LinkplanError, ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.reach import reach
from tests.support.four_bars import PLAIN, load, random_bars
from tests.support.mechanisms import (
    CHAINS,
    CRANK_ROCKER,
    FLAT_PARALLELOGRAM,
    PENDULUM,
    SLIDER_CRANK,
    TRIPLE_ROCKER,
    TRUSS,
    FourBar,
    doubled_pin,
    off_axis,
    random_quaternion,
    random_tree,
    replaced,
    wrapped,
)
from tests.support.refusals import assert_refused
from tests.support.tolerances import ANGLE_RAD, APART_DEG, PRINTED_GAP, REDUCED, relative_error

lengths = dict.fromkeys(("crank", "coupler", "rocker", "ground"), st.floats(0.3, 1.0))
four_bars = st.builds(FourBar, **lengths, branch=st.sampled_from([-1, 1]), drawn=st.floats(-3, 3))
seeds = st.integers(0, 2**32 - 1)
deterministic = settings(max_examples=40, deadline=None, derandomize=True, database=None)


# Rank and rows


@pytest.mark.slow
@deterministic
@given(bar=four_bars, seed=seeds)
def test_any_four_bar_in_any_plane_has_three_rows_of_rank_two(bar, seed):
    assume(np.nan_to_num(bar.transmission(bar.drawn)) > 0.2)
    rng = np.random.default_rng(seed)
    mechanism = load_mechanism(bar.mjcf(rng, quaternion=random_quaternion(rng), anchor_form=bool(seed % 2)))
    assert mechanism.dynamics.closure.size1_out(0) == 3
    assert (len(mechanism.closure_rows), len(mechanism.dependent), mechanism.dof) == (2, 2, 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_the_rows_kept_span_all_rows(seed):
    bar = random_bars()[seed]
    mechanism = load(bar, seed, aslant=True)
    for q in bar.samples(np.random.default_rng(seed), 5):
        jacobian = np.array(mechanism.dynamics.closure_jacobian(q))
        kept = jacobian[mechanism.closure_rows]
        assert np.linalg.cond(kept) < 1e3, "the rows kept are independent"
        combination = np.linalg.lstsq(kept.T, jacobian.T)[0]
        assert relative_error(combination.T @ kept, jacobian) < REDUCED


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_second_connect_on_the_same_pin_changes_no_motion(seed):
    bar, quaternion = random_bars()[seed], random_quaternion(np.random.default_rng(seed))
    once = load_mechanism(bar.mjcf(np.random.default_rng(0), quaternion=quaternion))
    twice = load_mechanism(doubled_pin(bar, quaternion))
    for q in bar.samples(np.random.default_rng(seed), 3):
        arguments = q, [0.7], [0.3]
        assert relative_error(twice.dynamics.acceleration(*arguments), once.dynamics.acceleration(*arguments)) < REDUCED


@pytest.mark.parametrize(
    ("name", "expected"), [("six-bar", (6, 4, 1)), ("spatial-loop", (3, 3, 1)), ("five-bar", (3, 2, 2))]
)
def test_rank_and_degrees_of_freedom_of_other_loops(name, expected):
    mechanism = load_mechanism(CHAINS[name])
    assert (mechanism.dynamics.closure.size1_out(0), len(mechanism.closure_rows), mechanism.dof) == expected


@pytest.mark.slow
@pytest.mark.parametrize("joint", ["O", "A", "C"])
@pytest.mark.parametrize("seed", range(3))
def test_the_actuated_joint_is_the_independent_one(joint, seed):
    mechanism = load_mechanism(random_bars()[seed].mjcf(np.random.default_rng(seed), motors=(joint,)))
    assert [j.name for j in mechanism.independent_joints] == [joint]


@pytest.mark.parametrize("source", [random_tree(1), PENDULUM], ids=["many joints", "one joint"])
def test_an_open_tree_is_its_own_reduction(source):
    mechanism = load_mechanism(source)
    q = mechanism.home + 0.1
    assert (len(mechanism.closure_rows), mechanism.dof) == (0, mechanism.n_q)
    assert np.array_equal(np.array(mechanism.dynamics.velocity_map(q)), np.eye(mechanism.n_q))
    assert np.array_equal(np.array(mechanism.dynamics.reduced_inertia(q)), np.array(mechanism.dynamics.mass_matrix(q)))


def test_an_inactive_connect_closes_nothing():
    assert load_mechanism(replaced(PLAIN, '<connect name="B"', '<connect name="B" active="false"')).dof == 3


def test_disabled_equalities_close_nothing():
    text = replaced(PLAIN, "/>\n  <worldbody>", '><flag equality="disable"/></option>\n  <worldbody>')
    assert load_mechanism(text).dof == 3


def test_a_connect_to_the_world_closes_a_loop():
    rod = '<body name="rod"><joint name="O" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/><body name="tip" pos=".2 0 0">'
    tip = '<joint name="A" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/>%s</body></body>'
    slide = '<body name="end" pos=".1 0 .1"><joint name="x" type="slide" axis="1 0 0"/><geom size=".01"/></body>'
    loop = '<equality><connect body1="end" anchor="0 0 0"/></equality>'
    text = f"<mujoco><worldbody>{rod}{tip % slide}</worldbody>{loop}</mujoco>"
    mechanism = load_mechanism(text)
    assert (mechanism.n_q, mechanism.dof, mechanism.home_gap_m) == (3, 1, 0.0)


def test_a_truss_is_refused_as_locked():
    with pytest.raises(ModelError, match=r"'truss' is locked: 2 joints .* 2 independent .* 0 degrees of freedom"):
        load_mechanism(TRUSS)


@pytest.mark.parametrize(
    ("text", "dof"), [(FLAT_PARALLELOGRAM, 1), (replaced(TRUSS, "0.1 0 0.1", "0.1 0 0"), 0)], ids=["parallelogram", "truss"]
)
def test_a_loop_drawn_flat_keeps_its_degrees_of_freedom_or_is_refused(text, dof):
    try:
        found = load_mechanism(text).dof
    except LinkplanError:
        found = "refused"
    assert found in (dof, "refused")


@pytest.mark.parametrize("aslant", [False, True], ids=["upright", "aslant"])
@pytest.mark.parametrize("offset_mm", [5e-4, 2e-3, 1.0, 20.0])
def test_a_gap_across_the_plane_is_closed_by_a_shift_of_the_anchor_that_is_said(offset_mm, aslant):
    text = off_axis(CRANK_ROCKER, offset_mm * 1e-3, random_quaternion(np.random.default_rng(5)) if aslant else None)
    mechanism, plain = load_mechanism(text), load_mechanism(off_axis(CRANK_ROCKER, 0.0, None))
    assert mechanism.gap_m(mechanism.home) < 1e-14
    assert np.abs(close_at(mechanism, np.array([0.6])) - close_at(plain, np.array([0.6]))).max() < ANGLE_RAD
    (note,) = [note for note in mechanism.notes if "moved by" in note]
    assert relative_error(float(note.split("moved by ")[1].split()[0]), offset_mm) < PRINTED_GAP


@pytest.mark.parametrize("aslant", [False, True], ids=["upright", "aslant"])
def test_a_wide_gap_across_the_plane_is_refused_with_its_size(aslant):
    text = off_axis(CRANK_ROCKER, 0.2, random_quaternion(np.random.default_rng(5)) if aslant else None)
    assert_refused(lambda: load_mechanism(text), "open by 200 mm along its hinge's axis", kind=AssemblyError)


# Home


@pytest.mark.slow
@deterministic
@given(bar=four_bars, seed=seeds, ahead=st.floats(-0.2, 0.2))
def test_any_four_bar_assembles_where_two_circles_meet(bar, seed, ahead):
    way = bar.drawn + np.linspace(0, ahead, 9)
    assume(np.nan_to_num(bar.transmission(way)).min() > 0.2)
    rng = np.random.default_rng(seed)
    mechanism = load_mechanism(bar.mjcf(rng, quaternion=random_quaternion(rng), anchor_form=bool(seed % 2)))
    poses = np.array([mechanism.home, close_at(mechanism, way[-1:])])
    assert np.abs(wrapped(poses - bar.pose(way[[0, -1]]))).max() < ANGLE_RAD


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_home_at_an_asked_angle_is_on_the_drawn_branch(seed):
    bar = random_bars()[seed]
    asked = bar.drawn + 0.02
    home = load_mechanism(bar.mjcf(np.random.default_rng(seed)), home={"O": asked}).home
    assert home[0] == asked
    assert np.abs(wrapped(home - bar.pose(asked)[0])).max() < ANGLE_RAD


@pytest.mark.slow
@pytest.mark.parametrize("named", ["A", "C", "AC"])
@pytest.mark.parametrize("seed", range(6))
def test_dependent_angles_in_home_choose_the_other_branch(seed, named):
    bar = random_bars()[seed]
    pose = dict(zip("OAC", bar.mirrored().pose(bar.drawn)[0], strict=True))
    assert abs(wrapped(pose["A"] - bar.pose(bar.drawn)[0, 1])) > 0.2, "the branches differ"
    asked = {"O": bar.drawn} | {name: pose[name] + 0.02 for name in named}
    home = load_mechanism(bar.mjcf(np.random.default_rng(seed)), home=asked).home
    assert np.abs(wrapped(home - list(pose.values()))).max() < ANGLE_RAD


def test_the_keyframe_named_home_is_where_assembly_starts():
    mechanism = load_mechanism(SLIDER_CRANK)
    assert np.abs(mechanism.reference - [0.7, -0.916, 0.3685]).max() == 0
    assert 0 < np.abs(mechanism.home - mechanism.reference).max() < 0.01
    assert mechanism.gap_m(mechanism.home) < CLOSED_M


# Paths


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_path_stays_on_the_closed_forms_branch(seed):
    bar = random_bars()[seed]
    mechanism = load(bar, seed, aslant=True)
    r = reach(mechanism)
    q_O = np.linspace(r.lower.position, r.upper.position, 60)[2:-2]
    poses = follow(mechanism, q_O[:, None])
    assert np.ptp(q_O) > 0.5, "the path goes somewhere"
    assert np.abs(wrapped(poses - bar.pose(q_O))).max() < ANGLE_RAD


@pytest.mark.slow
@pytest.mark.parametrize("name", CHAINS)
def test_a_path_there_and_back_ends_where_it_began(name):
    mechanism = load_mechanism(CHAINS[name])
    s = mechanism.home[mechanism.independent] + np.linspace(0, 0.5, 10)[:, None]
    poses = follow(mechanism, np.concatenate([s, s[::-1]]))
    assert np.abs(poses[9] - poses[0]).max() > 0.4, "the path goes somewhere"
    assert np.abs(poses[-1] - mechanism.home).max() < ANGLE_RAD


def test_a_far_position_is_reached_on_the_branch_without_a_path():
    far = CRANK_ROCKER.drawn + 3.0
    assert np.abs(wrapped(close_at(load(CRANK_ROCKER), np.array([far])) - CRANK_ROCKER.pose(far)[0])).max() < ANGLE_RAD


def test_a_path_may_start_on_another_branch_than_home():
    other = CRANK_ROCKER.mirrored()
    q_O = np.linspace(0.2, 2.0, 20)
    poses = follow(load(CRANK_ROCKER), q_O[:, None], start=other.pose(0.2)[0])
    assert np.abs(wrapped(poses - other.pose(q_O))).max() < ANGLE_RAD


@pytest.mark.parametrize("turns", [1, -1])
def test_a_path_stops_at_a_singular_pose_though_the_loop_closes_beyond(turns):
    mechanism = load(TRIPLE_ROCKER)
    lower, upper = TRIPLE_ROCKER.singular()
    singular = upper if turns > 0 else lower
    with pytest.raises(AssemblyError) as refused:
        close_at(mechanism, np.array([TRIPLE_ROCKER.drawn + turns * 2 * np.pi]))
    (at,) = re.findall(r"opens at O = (\S+) deg", str(refused.value))
    assert abs(float(at) - np.degrees(singular)) < APART_DEG


def test_a_parallelogram_is_not_led_through_its_flat_pose_where_two_branches_cross():
    bar = FourBar(crank=0.1, coupler=0.2, rocker=0.1, ground=0.2, branch=1, drawn=0.3)
    with pytest.raises(AssemblyError) as refused:
        close_at(load(bar), np.array([2.0]))
    (at,) = re.findall(r"opens at O = (\S+) deg", str(refused.value))
    assert abs(float(at) - 90) < APART_DEG


def test_a_path_with_a_leap_beyond_any_motion_is_refused_before_memory_is_asked_for():
    mechanism = load_mechanism("optimus-knee")
    path = np.full((200, 1), mechanism.home[mechanism.independent[0]])
    path[100:] += 1e12
    assert_refused(lambda: follow(mechanism, path, mechanism.home), "further away than any motion goes", kind=AssemblyError)
