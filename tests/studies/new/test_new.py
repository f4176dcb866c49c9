"""`new`: problem files that are begun, for the built-in mechanisms and for models of others."""

import re
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.models.library import built_in_text
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import failed
from linkplan.planner.problem.motion import Motion
from linkplan.planner.problem.problem import Problem
from linkplan.studies.check.new.candidates import moves_of
from linkplan.studies.check.new.clear_way import obstacle_on_way
from linkplan.studies.check.new.first_motion import FirstMotion, first_motion
from linkplan.studies.check.new.problem_text import problem_text
from tests.support.data import DATA
from tests.support.drawn_by_others import HOEKEN, MOTOR, ring
from tests.support.refusals import refusal

# Typical mechanisms: each is planned within seconds.
PLANNED = ["optimus-knee", "optimus-knee-linear", "slider-crank", "five-bar", "parallel-gripper", "cart-pole"]
# An arm whose range contains home or not.
ARM = """<mujoco><compiler angle="degree" autolimits="true"/><worldbody><body><joint name="arm" axis="0 1 0"
  range="{range_deg}" ref="20"/><inertial pos="0.5 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody>
  <actuator><motor name="drive" joint="arm" ctrlrange="-{effort} {effort}"/></actuator></mujoco>"""
# An arm that its servo cannot hold anywhere: 10 N.m of weight, and 1 N.m/rad within 0.1 rad.
WEAK_SERVO = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body><joint name="arm" axis="0 1 0"
  range="-0.5 0.5"/><inertial pos="0.5 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody>
  <actuator><position name="drive" joint="arm" kp="1" ctrlrange="-0.1 0.1"/></actuator></mujoco>"""


@cache
def begun(model: str) -> FirstMotion:
    return first_motion({"model": model}, print)


@cache
def text_of(model: str) -> str:
    found = begun(model)
    return problem_text(found.tables, found.description)


@pytest.mark.slow
@pytest.mark.parametrize("model", PLANNED)
def test_a_typical_mechanism_has_a_first_motion_that_passes_its_certificate(model):
    found = begun(model)
    assert found.planned, found.why
    assert found.plan.certificate.passed
    start, goal = (found.plan.problem.motion.start, found.plan.problem.motion.goal)
    assert (start != goal).any()
    assert found.plan.certificate.singularity_ratio > 0.2
    assert not found.plan.certificate.contacts


def test_the_text_is_read_as_the_tables_that_it_was_made_of():
    found = begun("optimus-knee")
    tables = tomllib.loads(text_of("optimus-knee"))
    assert tables.pop("description") == found.description
    assert {name: section for name, section in tables.items() if section} == found.tables
    assert "imperfections" not in tables  # an empty table is that of a perfect machine


@pytest.mark.parametrize("model", ["optimus-knee", "five-bar", "cart-pole"])
def test_the_text_has_at_most_forty_lines_and_a_meaning_beside_every_key(model):
    lines = text_of(model).splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 100
    keys = [k for k, line in enumerate(lines) if re.match(r"\w+ = ", line) and not line.startswith("description")]
    assert keys
    assert all(" # " in lines[k] or lines[k - 1].startswith("# ") for k in keys)


@cache
def tried_of(model: str) -> list[Motion]:
    """Return the motions that are tried of a mechanism none of whose motions is ever found."""
    tried = []

    def nothing(problem: Problem, *_) -> Plan:
        tried.append(problem)
        return Plan(problem=problem, verdict=failed("as told"))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("linkplan.studies.check.new.first_motion.plan_motion", nothing)
        found = first_motion({"model": model}, print)
    assert not found.planned
    assert found.why.startswith("failed: as told")
    assert moves_of(found.tables["motion"])
    return [problem.motion for problem in tried]


def moved(motion) -> int:
    return int(np.sum(motion.start != motion.goal))


def test_every_motion_is_planned_once():
    ways = [(*motion.start, *motion.goal) for motion in tried_of("optimus-knee")]
    assert len(ways) > 2
    assert len(set(ways)) == len(ways)


def test_many_driven_joints_are_tried_together_and_one_alone_the_larger_motions_first():
    motions = tried_of(ring(7, 5))
    assert {moved(motion) for motion in motions} == {1, 5}
    for count in (1, 5):
        way = [np.abs(motion.goal - motion.start).max() for motion in motions if moved(motion) == count]
        assert way[: len(way) // 2] == sorted(way[: len(way) // 2], reverse=True)


@pytest.mark.slow
def test_freedoms_on_springs_are_no_pendulums_whose_swings_a_motion_waits_for():
    motions = tried_of(str(DATA / "sprung_leg.xml"))
    assert max(motion.duration_s for motion in motions) < 1.0
    (cart,) = {motion.duration_s for motion in tried_of("cart-pole")}
    assert cart > 1.0


def test_a_sprung_leg_begins_with_a_small_smooth_motion_of_one_drive():
    first, *others = tried_of(str(DATA / "sprung_leg.xml"))
    assert np.sum(np.abs(first.goal - first.start) > 0.01) == 1, "the springs move less"
    assert max(np.sum(np.abs(motion.goal - motion.start) > 0.01) for motion in others) > 1
    assert np.abs(first.goal - first.start).max() < max(np.abs(motion.goal - motion.start).max() for motion in others)


def test_a_first_problem_is_simulated_with_the_model_s_own_timestep_and_softness(tmp_path, ask):
    (tmp_path / "hoeken.xml").write_text(HOEKEN.format(actuator=MOTOR), encoding="utf-8")
    code, out, _ = ask("new", str(tmp_path / "hoeken.xml"))
    assert code == 0
    assert "solref" not in tomllib.loads(out)["mechanism"]
    (tmp_path / "first.toml").write_text(out, encoding="utf-8")
    run = linkplan.track(linkplan.plan(linkplan.Problem.from_file(tmp_path / "first.toml")), "pd+ff")
    assert run.to_dict()["loop"]["timestep_s"] == 0.002  # MuJoCo's default


def test_links_drawn_on_one_another_pass_through_each_other_in_the_first_problem_and_the_change_is_named(tmp_path):
    text = re.sub(r"<contact>.*?</contact>", "", HOEKEN.format(actuator=MOTOR), flags=re.S)
    (tmp_path / "hoeken.xml").write_text(text, encoding="utf-8")
    found = begun(str(tmp_path / "hoeken.xml"))
    assert ["coupler", "rocker"] in found.tables["mechanism"]["exclude_contacts"]
    assert any("coupler and rocker" in note and "mechanism.exclude_contacts" in note for note in found.notes)
    model = found.plan.problem.mechanism.model
    assert model.nexclude == load_mechanism(str(tmp_path / "hoeken.xml")).model.nexclude + len(
        found.tables["mechanism"]["exclude_contacts"]
    )
    assert not found.plan.certificate.contacts


def test_a_first_motion_is_slow_enough_for_the_model_s_own_timestep_and_soft_closures(tmp_path):
    (tmp_path / "hoeken.xml").write_text(HOEKEN.format(actuator=MOTOR), encoding="utf-8")
    found = begun(str(tmp_path / "hoeken.xml"))
    model = found.mechanism.model
    softest = float(model.eq_solref[:, 0].max())
    assert softest == 0.02  # MuJoCo's default [s]
    # eight cycles at twice the closures' natural frequency, 1 / softest
    assert found.tables["motion"]["duration_s"] >= 0.99 * 8 * 2 * np.pi * softest / 2


def test_a_mechanism_that_nothing_drives_is_refused_with_the_line_that_it_lacks(tmp_path):
    (tmp_path / "hoeken.xml").write_text(HOEKEN.format(actuator=""), encoding="utf-8")
    said = refusal(lambda: first_motion({"model": str(tmp_path / "hoeken.xml")}, print), ProblemError)
    line = re.search(r"<actuator>.*</actuator>", said)[0]
    assert 'joint="O2"' in line
    (tmp_path / "hoeken.xml").write_text(HOEKEN.format(actuator=line), encoding="utf-8")
    assert begun(str(tmp_path / "hoeken.xml")).planned


@pytest.mark.slow
def test_a_stranger_s_file_is_begun_planned_and_never_overwritten(tmp_path, ask, monkeypatch):
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "hoeken.xml").write_text(HOEKEN.format(actuator=MOTOR), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    code, out, _ = ask("new", "models/hoeken.xml", "-o", "leg.toml")
    assert code == 0
    assert "O2 from" in out
    text = Path("leg.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["mechanism"]["model"] == "models/hoeken.xml"
    assert ask("plan", "leg.toml", "-o", "planned")[0] == 0
    code, out, err = ask("new", "models/hoeken.xml", "-o", "leg.toml")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "no file is overwritten" in err
    assert Path("leg.toml").read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ("optimus-kne", "did you mean 'optimus-knee'?"),
        ("knee-reach", "is already a problem"),
        ("no/such.xml", "unknown model"),
        ("", "mechanism.model must be"),
    ],
)
def test_what_is_no_model_is_refused_in_one_line(model, said, ask):
    code, out, err = ask("new", model)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err


def test_where_no_motion_is_found_the_file_is_written_and_what_shuts_every_way_is_named(tmp_path, ask):
    (tmp_path / "arm.xml").write_text(WEAK_SERVO, encoding="utf-8")
    target = tmp_path / "arm.toml"
    code, out, _ = ask("new", str(tmp_path / "arm.xml"), "-o", str(target))
    assert code == 1
    assert "NOT planned" in out
    assert "servo drive cannot hold the weight within its ctrlrange" in out
    assert tomllib.loads(target.read_text(encoding="utf-8"))["motion"]["kind"] == "reach"


def test_a_model_that_does_not_close_is_begun_at_the_pose_that_was_found(tmp_path):
    text = built_in_text("slider-crank")
    opened = re.sub(r"<keyframe>.*?</keyframe>", "", text, flags=re.S)
    (tmp_path / "open.xml").write_text(opened, encoding="utf-8")
    try:
        found = first_motion({"model": str(tmp_path / "open.xml")}, print)
    except LinkplanError as error:
        pytest.fail(f"a model without a keyframe is refused: {error}")
    assert found.planned, found.why


# A finger whose servo cannot pull it down: it holds what pushes it up only far from the lower end of its range.
FINGER = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="hand"><geom size="0.01"/>
  <body name="finger"><joint name="finger" axis="0 1 0" range="0 1.2" damping="0.01" stiffness="0.5" springref="2"/>
  <inertial pos="0.03 0 0" mass="0.02" diaginertia="2e-5 2e-5 2e-5"/></body></body></worldbody>
  <actuator><position name="servo" joint="finger" kp="2" ctrlrange="0 1.2" forcerange="-20 20"/></actuator></mujoco>"""


def test_where_a_servo_cannot_hold_home_the_motion_begins_in_the_middle_of_where_it_can():
    """Its ctrl is q - 0.5 (2 - q) / 2 but for the small weight: at least 0 from q = 0.4 to the end of the range, 1.2."""
    found = begun(FINGER)
    assert found.planned, found.why
    start, goal = (found.plan.problem.motion.start, found.plan.problem.motion.goal)
    assert start[0] == pytest.approx(0.8, abs=0.03)
    assert any("another home than the model's" in note for note in found.notes)
    assert start[0] != goal[0]


# A leg whose servo has no forcerange, with a toe on a spring.
SPRUNG_TOE = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="leg">
  <joint name="hip" axis="0 1 0" range="-0.5 0.5" damping="1"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02"/>
  <body name="toe" pos="0 0 -.4"><joint name="toe" axis="0 1 0" range="-0.5 0.5" stiffness="5" damping="2"/>
  <geom type="capsule" fromto="0 0 0 .1 0 0" size=".01"/></body></body></worldbody>
  <actuator><position name="servo" joint="hip" kp="14"/></actuator></mujoco>"""


def test_a_servo_without_limits_is_not_too_weak_for_a_weight_that_a_spring_holds():
    leg = load_mechanism(SPRUNG_TOE)
    assert not np.isfinite(leg.effort_limit).any()
    lift = Problem.reach(leg, start_deg={"hip": 0.0}, goal_deg={"hip": 10.0})
    assert obstacle_on_way(lift) is None


def test_a_dependent_joint_that_stands_outside_its_range_is_named_with_it():
    text = built_in_text("slider-crank").replace('ref="0.2"', 'ref="0.2" range="0.3 0.4" limited="true"')
    assert "joint B is at 0.2 m at home, outside its range [0.3, 0.4] m; set another pose by" in begun(text).why


def test_a_joint_outside_its_range_at_home_begins_inside():
    found = begun(ARM.format(range_deg="40 100", effort=30))
    assert found.planned, found.why
    for place in (found.plan.problem.motion.start, found.plan.problem.motion.goal):
        assert 40 < np.degrees(place[0]) < 100


# An arm of one joint, without a name, and without a motor.
NAMELESS_ARM = """<mujoco><worldbody><body><joint axis="0 1 0"/>
  <inertial pos="0.5 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody></mujoco>"""


def test_an_actuator_is_offered_with_a_name_for_a_joint_that_has_none(tmp_path, ask):
    (tmp_path / "arm.xml").write_text(NAMELESS_ARM, encoding="utf-8")
    code, _, err = ask("new", str(tmp_path / "arm.xml"), "-o", str(tmp_path / "first.toml"))
    assert code == 2
    assert (
        'add for example name="joint0" to its first joint, which has no name, and <actuator><motor name="act_joint0"' in err
    )
    assert 'mechanism.drive = ["joint0"] puts motors' in err
    code, found, _ = ask("new", str(tmp_path / "arm.xml"), "--drive", "joint0", "-o", str(tmp_path / "first.toml"))
    assert (code, found.splitlines()[-1]) == (0, "Planned")


def test_actuators_that_no_plan_can_use_are_counted_and_not_listed(tmp_path, ask):
    links = "".join(f'<body><joint name="j{k}" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body>' for k in range(6))
    muscles = "".join(f'<muscle name="m{k}" joint="j{k}" lengthrange="0 1"/>' for k in range(6))
    model = f"<mujoco><worldbody>{links}</worldbody><actuator>{muscles}</actuator></mujoco>"
    (tmp_path / "pulled.xml").write_text(model, encoding="utf-8")
    code, _, err = ask("new", str(tmp_path / "pulled.xml"))
    assert code == 2
    assert "actuator m0 on joint j0" in err
    assert "(and 5 more of this kind)" in err
    assert "m1" not in err
