"""Summaries of mechanisms with many coordinates."""

import tracemalloc

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.reach import reach
from linkplan.studies.check.drives import _krylov_space
from linkplan.studies.check.inspection_blocks import grouped
from linkplan.studies.check.kinematic_loop_report import measured, reach_sweeps
from linkplan.studies.check.path_quantities import path_figures
from linkplan.studies.check.whole_check import check_whole
from linkplan.studies.output.text import text_of
from tests.support.hexapod import hexapod

SUMMARY_LINES = 30  # what a terminal shows at once
ARM = '<body name="{side} {k}" pos="0.1 0 0"><joint name="{side} joint {k}" axis="0 1 0" range="-90 90"/><geom size="0.06"/>'


def centipede(legs: int, joints: int, *, floating: bool = False) -> str:
    """Return a model of legs on one body, each a chain of joints whose geoms overlap when it folds."""
    chains = [
        f'<body name="hip {leg}" pos="0 {0.1 * leg} 0">'
        + "".join(ARM.format(side=f"leg {leg}", k=k) for k in range(joints))
        + "</body>" * (joints + 1)
        for leg in range(legs)
    ]
    motors = "".join(
        f'<motor name="drive {leg}.{k}" joint="leg {leg} joint {k}" ctrlrange="-9 9"/>'
        for leg in range(legs)
        for k in range(joints)
    )
    free = "<freejoint/>" if floating else ""
    body = f'<body name="trunk" pos="0 0 1">{free}<geom size="0.05"/>{"".join(chains)}</body>'
    head = '<compiler angle="degree" autolimits="true"/>'
    return f"<mujoco>{head}<worldbody>{body}</worldbody><actuator>{motors}</actuator></mujoco>"


@pytest.mark.parametrize("floating", [False, True])
def test_a_robot_of_many_joints_is_summed_up_in_thirty_lines(ask, tmp_path, floating):
    (tmp_path / "robot.xml").write_text(centipede(4, 6, floating=floating), encoding="utf-8")
    code, out, _ = ask("check", str(tmp_path / "robot.xml"))
    assert len(out.splitlines()) <= SUMMARY_LINES
    assert "24 degrees of freedom" in out or "30 degrees of freedom" in out
    assert "more of this kind" in out
    assert f"linkplan check {tmp_path / 'robot.xml'} --all" in out
    assert code == 1
    _, everything, _ = ask("check", str(tmp_path / "robot.xml"), "--all")
    assert len(everything.splitlines()) > 2 * SUMMARY_LINES


def test_a_motor_too_weak_for_the_weight_is_the_first_note(ask, tmp_path):
    mass, arm_m, strongest = 2.0, 0.5, 8.0  # m g l = 9.81 N.m
    body = f'<body><joint name="P" axis="0 -1 0"/><geom size="0.01" mass="{mass}" pos="0 0 -{arm_m}"/></body>'
    motor = f'<motor name="m" joint="P" ctrlrange="-{strongest} {strongest}"/>'
    (tmp_path / "arm.xml").write_text(
        f"<mujoco><worldbody>{body}</worldbody><actuator>{motor}</actuator></mujoco>", encoding="utf-8"
    )
    _, out, _ = ask("check", str(tmp_path / "arm.xml"))
    first = next(line for line in out.splitlines() if line.startswith("note: "))
    assert "at P = 90 deg actuator m would need 9.81 N.m to hold still, beyond its limits -8 to 8 N.m" in first


def test_a_base_that_floats_is_one_problem_with_its_remedy(ask, ask_json, tmp_path):
    (tmp_path / "robot.xml").write_text(centipede(2, 2, floating=True), encoding="utf-8")
    code, found = ask_json("check", str(tmp_path / "robot.xml"))
    (base,) = [problem for problem in found["problems"] if "float" in problem]
    assert code == 1
    assert all(
        word in base
        for word in (
            "trunk",
            "6 degrees of freedom",
            "mechanism.keep = [NAMES] and mechanism.fix_base = true",
            "chains begin at hip 0, hip 1",
        )
    )
    assert not [problem for problem in found["problems"] if "moves freely" in problem]
    code, _, err = ask("check", str(tmp_path / "robot.xml"), "--keep", "hip 1", "--fix-base")
    assert code == 0, err


def test_a_motor_without_limits_is_said_to_have_none(ask, tmp_path):
    (tmp_path / "robot.xml").write_text(centipede(1, 1).replace(' ctrlrange="-9 9"', ""), encoding="utf-8")
    out = ask("check", str(tmp_path / "robot.xml"))[1]
    assert "driven by: drive 0.0 (no limit)" in out


def test_sentences_that_differ_in_names_and_numbers_alone_are_of_one_kind():
    mechanism = load_mechanism("five-bar")
    first, second = (joint.name for joint in mechanism.joints[:2])
    sentences = [f"joint {first} stands at 4 deg", f"joint {second} stands at -1.5e3 deg", "the loop is open"]
    assert grouped(mechanism, sentences) == [f"joint {first} stands at 4 deg (and 1 more of this kind)", "the loop is open"]


GRIPPER = """
<mujoco>
  <compiler angle="degree" autolimits="true"/>
  <worldbody>
    <body name="left" pos="-0.05 0 0">
      <joint name="left" axis="0 1 0" range="-30 60"/>
      <geom name="left pad" type="capsule" fromto="0 0 0 0 0 0.1" size="0.01"/>
    </body>
    <body name="right" pos="0.05 0 0">
      <joint name="right" axis="0 -1 0" range="-30 60"/>
      <geom name="right pad" type="capsule" fromto="0 0 0 0 0 0.1" size="0.01"/>
    </body>
  </worldbody>
  <equality><joint joint1="right" joint2="left"/></equality>
  <actuator><motor name="grip" joint="left" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def test_pads_that_meet_when_the_gripper_closes_are_no_error(ask_json, tmp_path):
    (tmp_path / "gripper.xml").write_text(GRIPPER, encoding="utf-8")
    code, found = ask_json("check", str(tmp_path / "gripper.xml"))
    assert (code, found["problems"]) == (0, [])
    assert any("left pad and right pad touch near an end of the reach" in note for note in found["notes"])


@pytest.mark.slow
def test_a_platform_that_loops_hold_does_not_float(ask_json, tmp_path):
    """A hexapod's platform is a free body, which six rods hold and move."""
    (tmp_path / "hexapod.xml").write_text(hexapod(), encoding="utf-8")
    code, found = ask_json("check", str(tmp_path / "hexapod.xml"))
    assert not found["problems"], found["problems"]
    assert code == 0


def test_a_model_without_a_motor_is_told_how_it_gets_one(ask, tmp_path):
    arm = '<body name="arm"><joint name="J" axis="0 1 0"/><geom size="0.05" pos="0.1 0 0"/></body>'
    path = tmp_path / "arm.xml"
    path.write_text(f"<mujoco><worldbody>{arm}</worldbody></mujoco>", encoding="utf-8")
    _, out, _ = ask("check", str(path))
    assert "1 degree of freedom (J independent of 1 joint)" in out
    for command in (["bode", str(path)], ["tune", str(path), "--bandwidth-hz", "3"]):
        code, _, said = ask(*command)
        assert code == 2
        assert "'arm' has no motor on a hinge or slide: mechanism.drive = [\"J\"] puts motors on joints" in said


def chain(n):
    joints = range(n)
    opened = "".join(
        f"<body name='b{i}' pos='0 0 -0.2'><joint name='j{i}' axis='{1 - i % 2} {i % 2} 0' range='-60 60'/>"
        "<geom type='capsule' fromto='0 0 0 0 0 -0.2' size='0.02' contype='0' conaffinity='0'/>"
        for i in joints
    )
    motors = "".join(f"<motor name='m{i}' joint='j{i}' ctrlrange='-50 50'/>" for i in joints)
    return f"<mujoco><worldbody>{opened}{'</body>' * n}</worldbody><actuator>{motors}</actuator></mujoco>"


@pytest.fixture(scope="module")
def wholes():
    return {n: check_whole(load_mechanism(chain(n)), None) for n in (3, 9)}


def test_of_few_coordinates_all_quantities_are_said(wholes):
    text = text_of(wholes[3].blocks())
    assert text.count("the same at every pose") == 3
    assert "the JSON record has all of them" not in text


def test_of_many_each_has_its_own(wholes):
    text = text_of(wholes[9].blocks())
    assert "the same at every pose" not in text
    assert "the table of each of the 9 coordinates above has only its own quantities" in text
    own = next(part for part in text.split("\n\n") if part.startswith("along the reach of j7"))
    head = own.splitlines()[1]
    assert "weight alone j7 [N.m]" in head
    assert "hold m7 [N.m]" in head
    assert "j6" not in head
    assert "m6" not in head


def test_records_of_very_many_coordinates_have_those_of_their_own_only(wholes):
    assert list(path_figures(measured(wholes[9].sweeps[7])).joint_rate["j0"]) == [f"j{i}" for i in range(9)]
    mechanism = load_mechanism(chain(30))
    (sweep,) = reach_sweeps(mechanism, [reach(mechanism, 7)])
    path = measured(sweep)
    figures = path_figures(path)
    assert figures.coordinate == "j7"
    assert list(figures.joint_rate["j0"]) == list(figures.gravity_effort) == ["j7"]
    np.testing.assert_array_equal(figures.reduced_inertia[:, 0, 0], path.reduced_inertia[:, 7, 7])


def test_a_summary_of_many_coordinates_measures_no_path():
    whole = check_whole(load_mechanism(chain(7)), None)
    assert whole.summary()
    assert "paths" not in vars(whole)
    assert len(list(whole.paths)) == 7


def largest_arrays(work) -> int:
    """Return the most bytes of arrays that are alive at once while `work` runs."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_memory_grows_with_the_square_of_the_coordinates():
    """Twice the coordinates take at most four times the memory; with the cube of them it was eight times."""
    peaks = []
    for n in (24, 48):
        mechanism = load_mechanism(chain(n))
        check_whole(mechanism, None).summary()  # modules and compiled functions are loaded
        reach.cache_clear()
        peaks.append(largest_arrays(lambda of=mechanism: check_whole(of, None).summary()))
    assert peaks[0] > 1e6
    assert peaks[1] < 4.5 * peaks[0], peaks


@pytest.mark.parametrize(("n", "m"), [(6, 1), (6, 2), (7, 3), (5, 5)])
@pytest.mark.parametrize("idle", [0, 2])
def test_the_controllable_space_is_that_of_the_whole_matrix(n, m, idle):
    """The singular values and the projector onto the space are those of [B, A B, ...] in one piece."""
    random = np.random.default_rng(n + 10 * m + 100 * idle)
    A, B = random.normal(size=(n, n)) / n, random.normal(size=(n, m))
    A[n - idle :, : n - idle], B[n - idle :] = 0, 0  # the last coordinates move by themselves
    whole = np.hstack([np.linalg.matrix_power(A, k) @ B for k in range(n)])
    space, sizes = _krylov_space(A, B, 1e-9)
    expected = np.linalg.matrix_rank(whole, tol=1e-9)
    assert np.count_nonzero(sizes > 1e-9) == expected == n - idle
    basis, exact = space[:, sizes > 1e-9], np.linalg.svd(whole)[0][:, :expected]
    np.testing.assert_allclose(basis @ basis.T, exact @ exact.T, atol=1e-9)
