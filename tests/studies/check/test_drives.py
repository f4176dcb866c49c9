"""What `check` says of actuators, springs and poses in balance."""

import mujoco
import numpy as np
import pytest
import scipy

from linkplan import check
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.selection import Selection
from linkplan.studies.check.drives import feeble_drives, joints_to_drive, pushed_one_way
from linkplan.studies.check.inspection import inspect
from linkplan.studies.check.new.first_motion import first_motion
from linkplan.studies.check.spring_ratios import sprung_tendons
from tests.support.linkages import ROD
from tests.support.mechanisms import replaced

TWO = """<mujoco><option gravity="0 0 0"/><worldbody>
<body><joint name="a" axis="0 1 0"/><geom size="0.1"/></body>
<body pos="1 0 0"><joint name="b" axis="0 1 0" {b}/><geom size="0.1"/></body>
</worldbody><actuator><motor name="on_a" joint="a" ctrlrange="-1 1"/><motor name="on_b" joint="b" ctrlrange="0 2"/>
</actuator></mujoco>"""


def test_the_source_s_linear_actuator_is_told_for_what_it_is():
    mechanism = load_mechanism("optimus-knee-source")
    found = inspect(mechanism, [])
    (on_d,) = (problem for problem in found.problems if problem.startswith("joint D moves freely"))
    assert "no actuator is on it, nothing damps it, no spring or weight returns it" in on_d
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.home
    mujoco.mj_forward(mechanism.model, data)
    moment = np.zeros((mechanism.model.nu, mechanism.model.nv))
    mujoco.mju_sparse2dense(moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    at_most = 0.2 * moment[1, mechanism.model.joint("D").id]
    assert 1e-3 < at_most < 1e-2
    assert f"act_B_to_D, on slider-crank s2-sD, turns it in one direction only, with 0 to {at_most:.3g} N.m at home" in on_d
    assert any(
        "act_B_to_D has almost no effect on joint O" in note and "compared with 100 of act_O" in note for note in found.notes
    )


def test_a_motor_that_only_pushes_says_so_unless_a_spring_brings_its_joint_back():
    loose = pushed_one_way(load_mechanism(TWO.format(b="")), 1)
    assert loose == (
        "joint b moves freely: on_b, on joint b, turns it in one direction only, with 0 to 2 N.m at home, and no spring"
        " or weight returns it"
    )
    assert pushed_one_way(load_mechanism(TWO.format(b='stiffness="1"')), 1) is None
    assert pushed_one_way(load_mechanism(TWO.format(b="")), 0) is None


@pytest.mark.parametrize(("gear", "n_feeble"), [(1.0, 0), (1e-2, 0), (1e-4, 1)])
def test_an_actuator_is_feeble_beside_one_that_is_a_thousand_times_as_strong(gear, n_feeble):
    beside = f'<motor name="weak" joint="a" ctrlrange="-1 1" gear="{gear}"/></actuator>'
    assert len(feeble_drives(load_mechanism(TWO.format(b="").replace("</actuator>", beside)))) == n_feeble


# A driven carriage and a weight on it, [N/m] and [kg].
CARRIED = """<mujoco><option gravity="0 0 0"/><worldbody><body>
<joint name="a" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/>
<body><joint name="b" type="slide" axis="1 0 0" stiffness="{stiffness}"/><geom size="0.1" mass="{mass}"/></body></body>
</worldbody><actuator><motor name="on_a" joint="a" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize("mass", [1, 1e6])
def test_a_spring_steers_even_a_heavy_body_and_without_one_its_momentum_stays(mass):
    sprung, loose = (load_mechanism(CARRIED.format(stiffness=k, mass=mass)) for k in (10, 0))
    assert any("only the other joints move it" in note for note in inspect(sprung, []).notes)
    assert any("joint b moves freely: no actuator drives it" in problem for problem in inspect(loose, []).problems)


# A trolley, and a load on a rope: the weight brings the load back below the trolley; about the rope it spins.
CRANE = """<mujoco><worldbody><body pos="0 0 2"><joint name="trolley" type="slide" axis="1 0 0"/><geom size=".1" mass="5"/>
<site name="top"/></body><body name="load" pos="0 0 1"><freejoint name="load"/><geom type="capsule" size=".02 .1" mass="1"/>
<site name="eye" pos="0 0 .1"/></body></worldbody>
<tendon><spatial name="rope"><site site="top"/><site site="eye"/></spatial></tendon>
<actuator><motor name="drive" joint="trolley" ctrlrange="-9 9"/>
<motor name="hoist" tendon="rope" ctrlrange="-30 0"/></actuator></mujoco>"""


def test_a_load_on_a_rope_is_moved_along_by_the_trolley_and_freely_across():
    """Each freedom is judged alone, and the force of the rope across its line, which is rounding, moves nothing."""
    found = inspect(load_mechanism(CRANE), [])
    swings = [note for note in found.notes if "underactuated" in note]
    assert [note.split()[1] for note in swings] == ["load_x", "load_ry"]
    freely = [problem.partition(":")[0] for problem in found.problems if "moves freely" in problem]
    assert freely == [f"joint load_{name} moves freely" for name in ("y", "rx", "rz")]


COASTS = "; without a goal in the motion, it coasts on its momentum"


@pytest.mark.parametrize(("friction", "said"), [("", f" and nothing damps it{COASTS}"), ('frictionloss="0.1"', "")])
def test_dry_friction_damps_a_joint_that_nothing_drives(friction, said):
    spine = TWO.format(b=friction).replace('<motor name="on_b" joint="b" ctrlrange="0 2"/>', "")
    problems = inspect(load_mechanism(spine), []).problems
    assert f"joint b moves freely: no actuator drives it{said}" in problems


def test_no_motor_is_offered_for_the_spin_of_a_rod_but_one_for_a_wheel():
    ball = '<joint name="ball" type="ball" damping=".01" armature="1e-4" frictionloss=".002"/>'
    hinges = "".join(f'<joint name="{axis}" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    wheel = '<body><joint name="wheel" axis="0 1 0"/><inertial mass=".1" pos="0 0 0" diaginertia="1e-4 1e-4 1e-4"/></body>'
    text = ROD[: ROD.index("<actuator>")] + "</mujoco>"
    rod = load_mechanism(replaced(replaced(text, ball, hinges), "</worldbody>", f"{wheel}</worldbody>"))
    assert (rod.dof, len(rod.passive_dofs)) == (3, 2)  # the rod spins, and so does the wheel
    assert joints_to_drive(rod) == ["drive", "wheel"]


def test_a_motor_is_offered_for_fingers_that_close_without_weight_or_damping():
    fingers = "".join(
        f'<body pos="{x} 0 0"><joint name="{name}" type="slide" axis="{-x} 0 0"/><geom size=".01"/></body>'
        for name, x in (("left", -0.03), ("right", 0.03))
    )
    gripper = load_mechanism(
        f'<mujoco><worldbody>{fingers}</worldbody><equality><joint joint1="right" joint2="left"/></equality></mujoco>'
    )
    assert joints_to_drive(gripper) == ["left"]
    assert 'mechanism.drive = ["left"] puts motors' in str(inspect(gripper, []).problems)


def test_no_motor_is_offered_for_a_base_that_floats_nor_for_a_joint_that_follows_another():
    """A knee rolls: its slide, the first joint of the shank, follows its hinge by a coupling."""
    walker = """<mujoco><worldbody><body name="pelvis"><joint name="x" type="slide" axis="1 0 0"/>
    <joint name="z" type="slide" axis="0 0 1"/><joint name="tilt" axis="0 1 0"/><geom size=".1"/>
    <body name="shank" pos="0 0 -.4"><joint name="roll" type="slide" axis="1 0 0"/><joint name="knee" axis="0 1 0"/>
    <geom size=".05" pos="0 0 -.2"/></body></body></worldbody>
    <equality><joint joint1="roll" joint2="knee" polycoef="0 .02 0 0 0"/></equality></mujoco>"""
    assert joints_to_drive(load_mechanism(walker)) == ["knee"]


def test_a_truss_in_which_a_rod_spins_is_said_to_be_held_still():
    bars = "".join(
        f'<body pos="{x} 0 0"><joint type="{kind}" axis="0 1 0"/><geom type="capsule" size=".01" fromto="0 0 0 {-x} 0 .3"/>'
        f'<site name="tip{number}" pos="{-x} 0 .3"/></body>'
        for number, (x, kind) in enumerate(((-0.2, "hinge"), (0.1, "hinge"), (0.3, "ball")))
    )
    ties = "".join(f'<connect site1="tip0" site2="tip{number}"/>' for number in (1, 2))
    text = f"<mujoco><default><geom contype='0'/></default><worldbody>{bars}</worldbody><equality>{ties}</equality></mujoco>"
    truss = load_mechanism(text)
    assert truss.dof == 1
    assert joints_to_drive(truss) == []
    assert "its loops lock all joints, except rods that spin about their own axes" in str(inspect(truss, []).problems)
    with pytest.raises(ProblemError, match="no degree of freedom but the spins of rods"):
        first_motion({"model": text}, print)


FRAME, SHOCK, WHEEL = np.array([0.1, 0.05]), np.array([0.25, -0.02]), np.array([0.5, 0.0])
STIFFNESS, REST, MASS = 2500.0, 0.1, 6.0
SWINGARM = f"""<mujoco><worldbody><site name="frame" pos="0.1 0 0.05"/><body name="arm">
<joint name="pivot" axis="0 -1 0" range="-25 25"/><geom type="box" size="0.25 0.01 0.01" pos="0.25 0 0" mass="{MASS}"/>
<site name="shock" pos="0.25 0 -0.02"/><site name="wheel" pos="0.5 0 0"/></body></worldbody>
<tendon><spatial name="spring" stiffness="{STIFFNESS}" springlength="{REST}">
<site site="frame"/><site site="shock"/></spatial>
<spatial name="cable"><site site="frame"/><site site="wheel"/></spatial></tendon>
<actuator><motor name="lift" joint="pivot" ctrlrange="-50 50"/></actuator></mujoco>"""
PENDULUM = """<mujoco><option gravity="{gravity} 0 -9.81"/><worldbody><body name="rod"><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/><site name="tip" pos="0 0 -1"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-9 9"/></actuator></mujoco>"""


def turned(angle: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the place (n, 2) of a point of the arm, x and z, at angles (n,) [rad] from x to z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * point[0] - s * point[1], s * point[0] + c * point[1]], axis=-1)


def length(angle: np.ndarray) -> np.ndarray:
    return np.linalg.norm(turned(angle, SHOCK) - FRAME, axis=-1)


def energy(angle: float) -> float:
    return 9.81 * MASS * 0.25 * np.sin(angle) + 0.5 * STIFFNESS * (float(length(np.array(angle))) - REST) ** 2


def along(mechanism):
    """Return what `check` finds along the reach of a mechanism of one degree of freedom."""
    (path,) = check(mechanism).struct.along
    return path


def test_lengths_and_motion_ratios_of_a_spring_are_those_of_the_law_of_cosines():
    path = along(load_mechanism(SWINGARM))
    angle = np.radians(path.q_deg["pivot"])
    np.testing.assert_allclose(path.spring_length_m["spring"], length(angle), rtol=1e-12)
    a, b = np.linalg.norm(SHOCK), np.linalg.norm(FRAME)
    between = angle + np.arctan2(*SHOCK[::-1]) - np.arctan2(*FRAME[::-1])
    ratio = a * b * np.sin(between) / np.sqrt(a**2 + b**2 - 2 * a * b * np.cos(between))
    assert np.ptp(ratio) > 0.05
    np.testing.assert_allclose(path.spring_motion_ratio["spring"]["pivot"], ratio, atol=1e-12)
    assert list(path.spring_length_m) == ["spring"], "a cable without a spring is none"


def test_a_pose_in_balance_is_where_the_energy_has_no_slope():
    (one,) = along(load_mechanism(SWINGARM)).balance
    found = scipy.optimize.minimize_scalar(energy, bounds=np.radians([-25, 25]), method="bounded", options={"xatol": 1e-12})
    assert one["stable"]
    assert one["unit"] == "deg"
    assert one["position"] == pytest.approx(np.degrees(found.x), abs=1e-4)


def test_a_pendulum_hangs_stably_and_stands_unstably():
    path = along(load_mechanism(PENDULUM.format(gravity=0.0)))
    found = {round(one["position"] % 360, 6): one["stable"] for one in path.balance}
    assert found == {0.0: True, 180.0: False}


def test_a_constant_force_moves_the_balance_to_the_direction_of_the_whole_load():
    """The rod points along the sum of its weight at half its length and the force at its end."""
    push = 3.0
    path = along(load_mechanism(PENDULUM.format(gravity=0.0), selection=Selection(force={"tip": (push, 0.0, 0.0)})))
    stable = [one["position"] for one in path.balance if one["stable"]]
    lean = np.degrees(np.arctan2(push, 0.5 * 9.81))
    assert stable[0] % 360 == pytest.approx(360 - lean, abs=1e-6), "turning from z to x carries the tip to -x"


def test_where_nothing_pulls_no_pose_is_in_balance():
    flat = PENDULUM.format(gravity=0.0).replace('axis="0 1 0"', 'axis="0 0 1"')
    assert along(load_mechanism(flat)).balance == []


def test_the_report_names_them():
    text = str(check(load_mechanism(SWINGARM)))
    for words in ("length spring [m]", "spring per pivot [m]", "wheel z [m]", "pivot is in balance, without effort"):
        assert words in text
    assert list(sprung_tendons(load_mechanism(SWINGARM).model)) == ["spring"]
