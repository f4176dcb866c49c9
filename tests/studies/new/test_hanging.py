"""`new` of mechanisms with fewer actuators than freedoms: they are begun where the rest of them hangs at rest."""

import tomllib

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import failed
from linkplan.planner.problem.problem import Problem
from linkplan.studies.check.new.changes import changed_mechanism
from linkplan.studies.check.new.first_motion import FirstMotion, first_motion
from linkplan.studies.check.new.hanging import (
    at_gravity_equilibrium,
    hanging_columns,
    hanging_pose,
    is_equilibrium,
    resting_positions,
)
from tests.support.drawn_by_others import arm, ring


def tried_of(text: str, monkeypatch, tmp_path) -> list[Problem]:
    """Return the problems that are tried of a mechanism none of whose motions is ever found."""
    return not_found(text, "as told", monkeypatch, tmp_path)[1]


def not_found(text: str, why: str, monkeypatch, tmp_path, **selected) -> tuple[FirstMotion, list[Problem]]:
    """Return the first motion of a mechanism none of whose motions is ever found, and the problems that are tried."""
    tried = []

    def nothing(problem: Problem, *_) -> Plan:
        tried.append(problem)
        return Plan(problem=problem, verdict=failed(why, out_of_time="ran out of" in why))

    monkeypatch.setattr("linkplan.studies.check.new.first_motion.plan_motion", nothing)
    (tmp_path / "model.xml").write_text(text, encoding="utf-8")
    return first_motion({"model": str(tmp_path / "model.xml"), **selected}, lambda _: None), tried


def held(mechanism: Mechanism, s: np.ndarray) -> bool:
    return is_equilibrium(mechanism, close_at(mechanism, s))


def test_links_that_nothing_drives_hang_straight_down_from_those_that_are_held():
    mechanism = load_mechanism(arm(6, 3))
    pose = hanging_pose(mechanism, mechanism.home, {0: 0.3, 1: -0.1, 2: 0.2})
    assert pose is not None
    absolute = np.cumsum(pose)
    assert absolute[:3] == pytest.approx([0.3, 0.2, 0.4])
    assert absolute[3:] == pytest.approx(np.full(3, np.pi / 2), abs=1e-4)


def test_a_chain_held_at_its_ends_hangs_lower_than_every_closed_pose_about_it():
    mechanism = load_mechanism(ring(7, 1))
    other = at_gravity_equilibrium(mechanism)
    assert other is not None
    assert not is_equilibrium(mechanism, mechanism.home)  # as it is drawn it falls
    assert is_equilibrium(other, other.home)
    height = centre_height(other, other.home)
    random = np.random.default_rng(1)
    s, columns = other.home[other.independent], hanging_columns(other)
    for _ in range(20):
        near = s.copy()
        near[columns] += random.normal(0.0, 0.05, len(columns))
        assert centre_height(other, close_at(other, near)) > height


def centre_height(mechanism: Mechanism, pose: np.ndarray) -> float:
    """Return the height of the centre of mass [m], by MuJoCo."""
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(pose)
    mujoco.mj_forward(mechanism.model, data)
    return float(data.subtree_com[0, 2])


@pytest.mark.parametrize("text", [arm(8, 4), arm(8, 4, down=True), ring(7, 1)], ids=["level arm", "hanging arm", "loop"])
def test_motions_begin_and_end_where_everything_is_at_rest(text, monkeypatch, tmp_path):
    tried = tried_of(text, monkeypatch, tmp_path)
    first = [problem for problem in tried if np.array_equal(problem.mechanism.home, tried[0].mechanism.home)]
    assert len(first) >= 2
    for problem in first:
        assert held(problem.mechanism, problem.motion.start)
        assert held(problem.mechanism, problem.motion.goal)
        assert list(problem.objective.weights) == ["effort_rate"]
    way = [np.abs(problem.motion.goal - problem.motion.start)[0] for problem in first]
    assert way[0] < 0.5 * max(way)  # the shorter way first


def test_what_is_drawn_balanced_is_begun_as_it_is_drawn(monkeypatch, tmp_path):
    upright = arm(2, 1, down=True).replace("0 0 -0.1", "0 0 0.1")
    tried = tried_of(upright, monkeypatch, tmp_path)
    assert np.abs(tried[0].mechanism.home).max() == 0.0
    assert abs(tried[-1].mechanism.home[1]) == pytest.approx(np.pi, abs=0.02)  # half a turn from where it was pushed to


@pytest.mark.slow
def test_an_arm_whose_outer_links_nothing_drives_has_a_first_motion(tmp_path):
    (tmp_path / "arm.xml").write_text(arm(4, 2), encoding="utf-8")
    found = first_motion({"model": str(tmp_path / "arm.xml")}, print)
    assert found.planned, found.why
    assert found.plan.certificate.passed
    assert "least change of effort" in found.description


def test_a_closure_that_takes_no_freedom_does_not_hinder_hanging():
    bodies = "".join(
        f'<body name="{name}"><joint name="{name}_hinge" axis="0 1 0"/><geom size=".03" pos="{at}" contype="0"/></body>'
        for name, at in (("p", ".1 0 0"), ("q", "0 0 .1"))
    )
    pin = '<equality><connect body1="p" body2="q" anchor="0 0 0"/></equality>'
    mechanism = load_mechanism(f"<mujoco><worldbody>{bodies}</worldbody>{pin}</mujoco>")
    assert len(mechanism.dependent) == 0
    pose = hanging_pose(mechanism, mechanism.home + 0.1, {})
    assert pose == pytest.approx([np.pi / 2, np.pi], abs=1e-3)


@pytest.mark.parametrize(
    ("why", "said"),
    [("as told", "failed: as told"), ("the solver ran out of its 1 s (solver.max_time_s)", "no motion was found")],
)
def test_where_no_motion_is_found_the_joints_that_hang_are_named_with_their_locks(why, said, monkeypatch, tmp_path):
    found, tried = not_found(arm(3, 1), why, monkeypatch, tmp_path)
    assert tried
    assert found.why.startswith(said)
    names = [found.mechanism.independent_joints[k].name for k in hanging_columns(found.mechanism)]
    assert len(names) == 2
    given = tomllib.loads(found.why.split("mechanism.")[1].split(" holds them")[0])
    assert list(given["lock"]) == names
    driven, _ = not_found(arm(3, 3), why, monkeypatch, tmp_path)
    assert "lock" not in driven.why


def test_the_locks_of_joints_that_hang_are_named_with_those_that_are_there(monkeypatch, tmp_path):
    joints = [joint.name for joint in load_mechanism(arm(4, 1)).joints]
    found, _ = not_found(arm(4, 1), "as told", monkeypatch, tmp_path, lock={joints[2]: 3.0})
    given = tomllib.loads(found.why.split("mechanism.")[1].split(" holds them")[0])
    assert sorted(given["lock"]) == sorted(joints[1:])
    assert given["lock"][joints[2]] == 3.0


def test_a_joint_that_cannot_hang_at_rest_on_the_way_is_named_with_its_lock():
    mechanism = load_mechanism(
        """<mujoco><compiler angle="radian"/><worldbody><body><joint name="a" axis="0 1 0"/><geom size=".02" pos="0 0 -.3"/>
        <body pos="0 0 -.3"><joint name="b" axis="0 1 0" range="-.1 .1"/><geom size=".02" pos="0 0 -.3"/></body></body>
        </worldbody><actuator><motor joint="a" ctrlrange="-9 9"/></actuator></mujoco>"""
    )
    with pytest.raises(AssemblyError, match=r"on the path; mechanism.lock = \{ b = 0 \} holds them"):
        resting_positions(mechanism, np.array([1.0, 0.0]), mechanism.home)


def test_the_locks_of_joints_that_coast_are_named_too(monkeypatch, tmp_path):
    """A drive on a sledge that nothing holds: the one goes forwards, the other backwards."""
    sledge = """<mujoco><worldbody><body><joint name="free" type="slide" axis="1 0 0"/><geom size=".1"/>
    <body><joint name="driven" type="slide" axis="1 0 0"/><geom size=".1" contype="0"/></body></body></worldbody>
    <actuator><motor joint="driven" ctrlrange="-9 9"/></actuator></mujoco>"""
    found, tried = not_found(sledge, "as told", monkeypatch, tmp_path)
    assert tried
    assert "mechanism.lock = { free = 0 } holds them" in found.why


# A driven arm with an undriven wheel at its end. `off` [m]: from the axle to the centre of mass of the wheel.
IDLE = """<mujoco><worldbody><body><joint name="arm" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>
<body pos=".3 0 0"><joint name="wheel" axis="0 1 0"/>
<inertial pos="{off} 0 0" mass=".09" diaginertia="3e-5 4e-5 3e-5"/></body></body></worldbody>
<actuator><motor joint="arm" ctrlrange="-9 9"/></actuator></mujoco>"""


@pytest.mark.parametrize(("off", "locked"), [(5e-5, ["wheel"]), (5e-3, [])])
def test_an_idle_wheel_that_a_file_rounds_is_locked_and_a_pendulum_is_not(off, locked):
    mechanism, notes = changed_mechanism({"model": IDLE.format(off=off)})
    assert list(mechanism.selection.lock) == locked, notes


# A drone of four rotors, which turn in pairs.
DRONE = """<mujoco><worldbody><body name="frame" pos="0 0 .3"><freejoint name="float"/>
<geom type="box" size=".1 .1 .03" mass="1"/>
<site name="a" pos=".1 .1 0"/><site name="b" pos="-.1 .1 0"/><site name="c" pos="-.1 -.1 0"/><site name="d" pos=".1 -.1 0"/>
</body></worldbody><actuator><motor site="a" ctrlrange="0 9" gear="0 0 1 0 0 .02"/>
<motor site="b" ctrlrange="0 9" gear="0 0 1 0 0 -.02"/><motor site="c" ctrlrange="0 9" gear="0 0 1 0 0 .02"/>
<motor site="d" ctrlrange="0 9" gear="0 0 1 0 0 -.02"/></actuator></mujoco>"""


@pytest.mark.slow
def test_the_first_motion_of_a_drone_lifts_it():
    found = first_motion({"model": DRONE}, lambda _: None)
    assert found.planned, found.why
    assert found.description.startswith("MuJoCo Model: float_z from 0.3 to 0.31 m")
