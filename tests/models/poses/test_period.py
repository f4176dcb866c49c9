"""The period of a coordinate behind gears and screws: a slider-crank whose crank a motor turns."""

import numpy as np
import pytest

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.period import travel_scales, turn_of
from linkplan.models.poses.reach import reach
from tests.support.linkages import RSSR

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
