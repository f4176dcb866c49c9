"""The reach: where a coordinate's way ends and why, ranges of ball joints, and after how many turns all is back."""

import mujoco
import numpy as np
import pytest
import scipy.optimize

import linkplan
from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses import reach as reach_file
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.period import travel_scales, turn_of
from linkplan.models.poses.reach import reach, toggles
from linkplan.planner.problem.motion import is_open
from linkplan.studies.check.new.clear_way import obstacle_on_way
from tests.support.four_bars import PLAIN, RANGED, load, random_bars
from tests.support.hexapod import hexapod
from tests.support.linkages import RSSR
from tests.support.mechanisms import (
    CHAINS,
    CRANK_ROCKER,
    FIVE_BAR,
    SLIDER_CRANK,
    TRIPLE_ROCKER,
    numbers,
    replaced,
    slider_crank,
    wrapped,
)
from tests.support.tolerances import BRACKET_RAD, CLOSURE, SINGULAR_RAD


@pytest.mark.slow
@pytest.mark.parametrize("bar", [TRIPLE_ROCKER, *random_bars()], ids=lambda bar: f"crank {bar.crank:.3g}")
def test_the_reach_of_a_four_bar_ends_at_its_singular_poses(bar):
    r = reach(load(bar, 1, aslant=True))
    if not len(bar.singular()):
        assert r.turns_fully
        return
    around = np.sort(np.concatenate([bar.singular() + turn for turn in (-2 * np.pi, 0, 2 * np.pi)]))
    k = np.searchsorted(around, bar.drawn)
    assert (r.lower.reason, r.upper.reason) == ("singular pose", "singular pose")
    assert np.abs(np.array([r.lower.position, r.upper.position]) - around[k - 1 : k + 1]).max() < SINGULAR_RAD
    assert r.singular == (r.lower.position, r.upper.position)


def test_some_of_the_random_four_bars_have_singular_poses_and_some_turn_fully():
    assert {bool(len(bar.singular())) for bar in random_bars()} == {False, True}


def test_the_crank_of_a_grashof_crank_rocker_turns_fully():
    r = reach(load(CRANK_ROCKER))
    assert r.turns_fully
    assert np.abs([r.lower.position + 2 * np.pi - 0.2, r.upper.position - 2 * np.pi - 0.2]).max() < BRACKET_RAD


def test_the_rocker_turns_back_where_crank_and_coupler_are_in_line():
    bar = CRANK_ROCKER
    # |OB| = L2 +- L1, |CB| = L3, |OC| = L4: the law of cosines at O gives OB, and the crank lies along or against it.
    found = np.array([at for joint, at in toggles(load(CRANK_ROCKER)) if joint == 2])
    expected = []
    for reach_OB, against in ((bar.coupler + bar.crank, 0.0), (bar.coupler - bar.crank, np.pi)):
        cosine = (reach_OB**2 + bar.ground**2 - bar.rocker**2) / (2 * reach_OB * bar.ground)
        # The ground OC lies at 90 deg, and on this branch B is above it.
        expected.append(np.pi / 2 - np.arccos(cosine) + against)
    away = np.abs(wrapped(found[:, None] - np.array(expected)))
    assert len(found) == 4, "two in each turn, a turn to either side"
    assert away.min(axis=1).max() < BRACKET_RAD
    assert away.min(axis=0).max() < BRACKET_RAD


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.3, 0.5])
def test_the_reach_ends_where_a_dependent_joint_meets_its_range(limit):
    bar = CRANK_ROCKER
    home_C = bar.pose(bar.drawn)[0, 2]
    ranged = replaced(PLAIN, '<joint name="C"', f'<joint name="C" limited="true" range="{home_C - limit} 3"')
    r = reach(load_mechanism(ranged))

    def excess(q_O: float) -> float:
        return bar.pose(q_O)[0, 2] - (home_C - limit)

    grid = bar.drawn + np.linspace(0, 2 * np.pi, 721)
    values = np.array([excess(x) for x in grid])
    assert values.min() < -0.01, "the range binds"
    up, down = np.argmax(values < 0), len(grid) - 1 - np.argmax(values[::-1] < 0)
    upper = scipy.optimize.brentq(excess, grid[up - 1], grid[up], xtol=1e-14)
    lower = scipy.optimize.brentq(excess, grid[down], grid[down + 1], xtol=1e-14) - 2 * np.pi
    assert [(end.reason, end.joint) for end in (r.lower, r.upper)] == [("range of C", 2)] * 2
    assert np.abs(np.array([r.lower.position, r.upper.position]) - [lower, upper]).max() < BRACKET_RAD


def test_the_reach_ends_at_the_first_of_two_ranges_met_in_one_step():
    bar = CRANK_ROCKER
    home, at_C, at_A = bar.pose(bar.drawn + np.array([0.0, 0.5, 0.5001]))
    text = PLAIN
    for joint, index, end in (("A", 1, at_A), ("C", 2, at_C)):
        bounds = sorted([end[index], 2 * home[index] - end[index]])
        text = replaced(text, f'name="{joint}"', f'name="{joint}" limited="true" range="{numbers(bounds)}"')
    upper = reach(load_mechanism(text)).upper
    assert upper.reason == "range of C"
    assert abs(upper.position - bar.drawn - 0.5) < BRACKET_RAD


def test_the_reach_of_a_joint_ends_at_its_own_range():
    r = reach(load_mechanism(RANGED))
    assert [(end.reason, end.joint) for end in (r.lower, r.upper)] == [("range of O", 0)] * 2
    assert [r.lower.position, r.upper.position] == [-1.0, 2.0]


@pytest.mark.slow
def test_nothing_ends_the_reach_of_a_slide_without_a_range_which_makes_no_turn():
    ball = '<body><joint name="s" type="slide"/><geom size="0.1"/></body>'
    mechanism = load_mechanism(f"<mujoco><worldbody>{ball}</worldbody></mujoco>")
    can = reach(mechanism)
    assert {can.lower.reason, can.upper.reason} == {"no end found"}
    assert can.turns_fully
    assert (can.lower.position, can.upper.position) == pytest.approx((-20 * mechanism.extent_m, 20 * mechanism.extent_m))


def test_a_disabled_limit_ends_no_reach():
    free = replaced(RANGED, "/>\n  <worldbody>", '><flag limit="disable"/></option>\n  <worldbody>')
    assert reach(load_mechanism(free)).turns_fully


@pytest.mark.parametrize("size", [0.05, 1.0, 30.0])
def test_a_driven_slider_of_any_size_reaches_from_dead_centre_to_dead_centre(size):
    mechanism = load_mechanism(replaced(slider_crank(size), '<motor joint="crank"', '<motor joint="slide"'))
    r = reach(mechanism)
    assert (mechanism.independent_joints[0].name, r.lower.reason, r.upper.reason) == ("slide", *["singular pose"] * 2)
    ends = np.array([r.lower.position, r.upper.position]) / size
    assert np.abs(ends - [0.3 - 0.1, 0.3 + 0.1]).max() < SINGULAR_RAD


def test_the_slider_turns_back_at_every_half_turn_of_the_crank():
    found = np.array([at for joint, at in toggles(load_mechanism(SLIDER_CRANK)) if joint == 2])
    assert np.abs(found - np.pi * np.array([-1, 0, 1, 2])).max() < BRACKET_RAD


@pytest.mark.parametrize(
    ("text", "once"),
    [
        (SLIDER_CRANK, True),
        (replaced(SLIDER_CRANK, '<joint name="crank"', '<joint name="crank" limited="true" range="-5 20"'), False),
    ],
)
def test_a_turn_that_leads_back_home_is_walked_once(text, once, monkeypatch):
    walked, walk = [], reach_file._walk
    monkeypatch.setattr(reach_file, "_walk", lambda *of: walked.append(of[-1]) or walk(*of))
    mechanism = load_mechanism(text)
    r = reach.__wrapped__(mechanism)
    assert (walked, r.repeats) == ([1], True) if once else ([1, -1], False)
    assert max(mechanism.gap_m(q) for q in r.poses) < CLOSURE + CLOSED_M
    assert np.all(np.diff(r.poses[:, mechanism.independent[0]]) > 0)
    assert len(r.poses_once) == (len(r.poses) + 1) // 2 if once else len(r.poses)


@pytest.mark.slow
@pytest.mark.parametrize("coordinate", [0, 1])
def test_the_other_motor_of_a_five_bar_stays_at_home_over_the_reach(coordinate):
    mechanism = load_mechanism(FIVE_BAR)
    r = reach(mechanism, coordinate)
    moving, still = mechanism.independent[coordinate], mechanism.independent[1 - coordinate]
    assert np.ptp(r.poses[:, moving]) > 1
    assert not np.ptp(r.poses[:, still])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["optimus-knee", "optimus-knee-source", *CHAINS])
def test_the_poses_of_a_reach_are_closed_and_in_order(name):
    mechanism = load_mechanism(CHAINS.get(name, name))
    r = reach(mechanism)
    assert max(mechanism.gap_m(q) for q in r.poses) < 10 * CLOSURE + CLOSED_M
    assert np.all(np.diff(r.poses[:, mechanism.independent[0]]) > 0)
    assert list(toggles(mechanism)) == sorted(toggles(mechanism), key=lambda toggle: toggle[1])


@pytest.mark.parametrize(("range_deg", "ends_deg"), [((40, 100), (40, 100)), ((-100, -40), (-100, -40))])
def test_the_reach_of_a_joint_that_stands_outside_its_range_is_its_range(range_deg, ends_deg):
    low, high = range_deg
    arm = load_mechanism(
        f"""<mujoco><compiler autolimits="true"/><worldbody><body><joint name="arm" axis="0 1 0" range="{low} {high}"/>
        <inertial pos="0.5 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody></mujoco>"""
    )
    can = reach(arm)
    assert np.degrees([can.lower.position, can.upper.position]) == pytest.approx(ends_deg)
    assert can.lower.reason == can.upper.reason == "range of arm"


LARGEST_DEG = 25.0


def ranged(text: str, largest_deg: float) -> linkplan.Mechanism:
    """Return a model's mechanism with a range on every ball joint."""
    largest = np.radians(largest_deg) if 'angle="radian"' in text else largest_deg
    return linkplan.load_mechanism(text.replace('type="ball"', f'type="ball" limited="true" range="0 {largest}"'))


def limits_in_mujoco(mechanism: linkplan.Mechanism, pose: np.ndarray) -> list[float]:
    """Return the distances [rad or m] of MuJoCo's active limits of joints at a pose."""
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(pose)
    mujoco.mj_forward(mechanism.model, data)
    limit = mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
    return [float(data.efc_pos[k]) for k in range(data.nefc) if data.efc_type[k] == limit]


def test_a_reach_ends_where_mujoco_s_limit_of_a_ball_joint_acts():
    mechanism, free = ranged(RSSR, LARGEST_DEG), linkplan.load_mechanism(RSSR)
    ball, wide = reach(mechanism), reach(free)
    assert ball.upper.reason == "range of ball joint rod"
    assert ball.upper.position < wide.upper.position - 0.1
    end = ball.poses[-1][mechanism.independent]
    last, beyond = (close_at(mechanism, end + np.array([d, 0.0]), ball.poses[-1]) for d in (-1e-7, 1e-7))
    assert limits_in_mujoco(mechanism, last) == []
    (distance,) = limits_in_mujoco(mechanism, beyond)
    assert -1e-6 < distance < 0
    assert is_open(mechanism, 0.9 * end)
    assert not is_open(mechanism, 1.1 * end)
    assert is_open(free, 1.1 * end)


def test_a_ball_joint_beyond_its_range_at_home_is_a_problem():
    mechanism = ranged(RSSR, LARGEST_DEG)
    beyond = np.degrees(1.2 * reach(mechanism).upper.position)
    text = RSSR.replace('type="ball"', f'type="ball" limited="true" range="0 {np.radians(LARGEST_DEG)}"')
    found = linkplan.check(linkplan.load_mechanism(text, home_deg={"crank": beyond}))
    (problem,) = [line for line in found.problems if "ball joint rod is turned by" in line]
    assert "at home, beyond its range of 25 deg" in problem
    assert not [line for line in linkplan.check(mechanism).problems if "ball joint" in line]


def test_a_first_motion_of_a_stewart_platform_keeps_its_ball_joints_ranges():
    mechanism = ranged(hexapod(), 3.0)
    slides = [f"s{k}" for k in range(6)]

    def lift(names: list[str]) -> linkplan.Problem:
        return linkplan.Problem.reach(
            mechanism, start_m=dict.fromkeys(slides, 0.0), goal_m=dict.fromkeys(slides, 0.0) | dict.fromkeys(names, 0.02)
        )

    obstacle = obstacle_on_way(lift(["s0"]))
    assert "ball joint b0" in obstacle
    assert "on the straight path" in obstacle
    assert "beyond its limit of 3 deg" in obstacle
    assert obstacle_on_way(lift(slides)) is None


CRANK_M, ROD_M = 0.1, 0.3


def geared(ratio: float, *, crank_range: str = "", unbalanced_m: float = 0.0) -> Mechanism:
    """Return a slider-crank whose motor turns `ratio` times as fast as the crank; its rotor may be out of balance."""
    return load_mechanism(f"""<mujoco><compiler angle="degree"/><default><joint axis="0 -1 0"/>
      <geom type="capsule" size="0.01" contype="0" conaffinity="0"/></default><worldbody>
      <body pos="0 0.1 0"><joint name="motor"/>
        <inertial mass="0.1" pos="{unbalanced_m} 0 0" diaginertia="2e-5 2e-5 2e-5"/></body>
      <body><joint name="crank" {crank_range}/><geom fromto="0 0 0 {CRANK_M} 0 0"/>
        <body name="rod" pos="{CRANK_M} 0 0"><joint name="rod"/><geom fromto="0 0 0 {ROD_M} 0 0"/></body></body>
      <body name="ram" pos="{CRANK_M + ROD_M} 0 0"><joint name="ram" type="slide" axis="1 0 0"/>
        <geom fromto="0 0 0 0 0 0.1"/>
      </body></worldbody><equality><connect body1="rod" body2="ram" anchor="{ROD_M} 0 0"/>
      <joint joint1="motor" joint2="crank" polycoef="0 {ratio} 0 0 0"/></equality>
      <actuator><motor name="m" joint="motor" ctrlrange="-2 2"/></actuator></mujoco>""")


def ram_m(crank: np.ndarray) -> np.ndarray:
    """Return the ram's travel from the drawn pose, in closed form."""
    return CRANK_M * np.cos(crank) + np.sqrt(ROD_M**2 - (CRANK_M * np.sin(crank)) ** 2) - CRANK_M - ROD_M


@pytest.mark.parametrize(
    ("ratio", "unbalanced_m", "turns"),
    [
        (1.0, 0.0, 1.0),
        (20.0, 0.0, 20.0),
        (-3.0, 0.0, 3.0),
        (20.0, 0.01, 20.0),
        (2.5, 0.0, 2.5),
        (2.5, 0.01, 5.0),
        (0.5, 0.01, 1.0),
    ],
)
def test_a_motor_is_back_when_all_joints_that_matter_are(ratio, unbalanced_m, turns):
    mechanism = geared(ratio, unbalanced_m=unbalanced_m)
    can = reach(mechanism)
    assert can.turns_fully
    assert can.period == pytest.approx(2 * np.pi * turns, rel=1e-12)
    assert [can.lower.position, can.upper.position] == pytest.approx([-can.period, can.period])
    # The poses cover the whole turn of the crank, as densely as those of a crank without a gear.
    crank = can.poses[:, mechanism.joint_index("crank")]
    assert np.ptp(crank) == pytest.approx(2 * 2 * np.pi * turns / abs(ratio))
    assert np.abs(np.diff(crank)).max() < np.radians(2.01)
    assert can.poses[:, mechanism.joint_index("ram")] == pytest.approx(ram_m(crank), abs=1e-9)


def test_the_range_of_what_a_gear_drives_ends_the_motors_reach():
    can = reach(geared(20.0, crank_range='range="-170 170"'))
    assert not can.turns_fully
    assert can.period is None
    assert np.degrees([can.lower.position, can.upper.position]) == pytest.approx([-3400.0, 3400.0])
    assert {can.lower.reason, can.upper.reason} == {"range of crank"}


def test_an_unbalanced_rotor_behind_an_irrational_gear_never_comes_back():
    can = reach(geared(np.pi, unbalanced_m=0.01))
    assert can.turns_fully
    assert can.period is None
    assert {can.lower.reason, can.upper.reason} == {"no end found"}


def test_a_lead_screw_reaches_over_the_whole_travel_of_its_nut():
    mechanism = load_mechanism("""<mujoco><worldbody>
      <body><joint name="motor" axis="0 0 1"/><inertial mass="1" pos="0 0 0" diaginertia="2e-5 2e-5 3e-5"/></body>
      <body><joint name="nut" type="slide" axis="0 0 1" range="-0.05 0.25"/><geom size="0.05"/></body></worldbody>
      <equality><joint joint1="nut" joint2="motor" polycoef="0 0.0016 0 0 0"/></equality>
      <actuator><motor joint="motor" ctrlrange="-1 1"/></actuator></mujoco>""")
    can = reach(mechanism)
    assert [can.lower.position, can.upper.position] == pytest.approx([-0.05 / 0.0016, 0.25 / 0.0016])
    assert turn_of(mechanism, 0) > 2 * np.pi
    assert len(can.poses) < 400


def test_studies_examine_a_geared_crank_over_its_whole_turn():
    from linkplan.studies.check.kinematic_loop_report import swept
    from linkplan.studies.feedback.bode.poses import loop_poses

    mechanism = geared(20.0)
    crank = mechanism.joint_index("crank")
    assert np.ptp(swept(mechanism, reach(mechanism))[:, crank]) == pytest.approx(2 * np.pi)
    looked = loop_poses(mechanism, None, mechanism.effort_limit)
    assert np.ptp(looked.positions) == pytest.approx(20 * 2 * np.pi * 6 / 7)  # seven poses evenly over the period
    assert looked.line is not None
    assert looked.line.high - looked.line.low == pytest.approx(20 * 2 * np.pi)


def test_a_rod_s_spin_about_its_axis_goes_no_further_than_other_hinges():
    """Its rates of the other joints are zero but for rounding."""
    mechanism = load_mechanism(RSSR)
    spin = [joint.name for joint in mechanism.independent_joints].index("rod_rx")
    rates = np.array(mechanism.dynamics.velocity_map(mechanism.home))[mechanism.dependent, spin]
    assert np.abs(rates).max() < 1e-12
    assert travel_scales(mechanism)[spin] == 1.0
    assert reach(mechanism, spin).upper.reason == "full turn"
