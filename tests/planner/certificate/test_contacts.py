"""Contacts on the way: a plan whose geoms meet is refused and says where; overlaps by construction are only named."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from msgspec import structs
from scipy.optimize import brentq

from linkplan.cli.main import main
from linkplan.models.errors import CertificateError, ProblemError
from linkplan.models.library import built_in_text
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.contacts import Contact, meetings
from linkplan.planner.certificate import further_checks
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.certificate.further_checks import contact_notes, unavoidable, with_contacts
from linkplan.planner.closed_chain.case import finished
from linkplan.planner.files.folders import plain_record
from linkplan.planner.limits.limit import with_limits
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.plan.plan import Plan, not_honoured
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import body_plan
from tests.support.tolerances_planner import TOUCHING

KNEE = built_in_text("optimus-knee")
# The rod of the rocker, and the ball on its tip, can meet what has bit 2; nothing else does.
HARD_ROCKER = KNEE.replace('<geom name="L3" class="rocker"', '<geom name="L3" class="rocker" conaffinity="2"')
# The scan's step, in seconds, and what the plan's depth between its own instants may miss, in metres.
SCAN_S = 2e-6
DEPTH_M = 2e-5
# A gate of a hundredth of a millimetre across the tip's way, which no sample of 0.1 mm need fall into.
THIN_M = 1e-5


def with_block(*, y: float = 0.0) -> str:
    """Return the knee with a block in the world that the rocker's rod can meet, or passes where it stands aside."""
    block = f'<geom name="block" type="box" pos="0.118 {y} 0.56" size="0.004 0.004 0.01" contype="2"/>'
    return HARD_ROCKER.replace('<body name="thigh"', f'{block}<body name="thigh"')


def problem_with(text: str, *overrides: str) -> Problem:
    problem = load_problem("knee-reach", list(overrides))
    return problem.varied(mechanism=load_mechanism(text, payload="shank"))


@pytest.fixture(scope="module")
def free() -> Plan:
    """Return the plan of the knee that nothing is in the way of."""
    return plan_motion(problem_with(KNEE)).require()


def judged(free: Plan, text: str, *overrides: str) -> Plan:
    """Return the free motion as the plan of another model with the same links."""
    problem = problem_with(text, *overrides)
    assert free.trajectory is not None
    assert free.certificate is not None
    return finished(problem, free.trajectory, certify(problem, free.trajectory), free.objective, None)


def scanned(made: Plan) -> tuple[float, float]:
    """Return the instant of the first contact of a plan's motion, by MuJoCo's own forward pass, and the deepest [m]."""
    model, trajectory = made.problem.mechanism.model, made.trajectory
    time = np.arange(0.0, trajectory.duration_s, SCAN_S)
    poses = follow(made.problem.mechanism, trajectory.position_at(time), trajectory.start_pose)
    data, first, deepest = mujoco.MjData(model), np.inf, 0.0
    for t, pose in zip(time, poses, strict=True):
        data.qpos[:] = pose
        mujoco.mj_fwdPosition(model, data)
        if data.ncon:
            first = min(first, float(t))
            deepest = max(deepest, -float(data.contact.dist.min()))
    return first, deepest


@pytest.mark.slow
def test_a_plan_that_meets_a_block_is_refused_with_the_geoms_the_instant_and_the_depth():
    made = plan_motion(problem_with(with_block()))
    instant, deepest = scanned(made)
    assert 0 < instant < made.trajectory.duration_s
    (met,) = made.certificate.contacts
    assert set(met.geoms) == {"block", "L3"}
    assert met.since_s == pytest.approx(instant, abs=SCAN_S)
    assert met.depth_m == pytest.approx(deepest, abs=DEPTH_M)
    assert met.home_depth_m == 0.0
    assert made.status == "failed"
    assert not made.certificate.passed
    assert "geoms block (world) and L3 (rocker) collide at t = " in made.message
    assert f"t = {instant:.3g}" in made.message.replace(f"{met.since_s:.5g}", f"{met.since_s:.3g}")
    assert "\n" not in made.message


@pytest.mark.slow
def test_the_same_block_out_of_the_way_lets_the_plan_pass(free):
    made = judged(free, with_block(y=0.1))
    assert made.status == "optimal"
    assert made.certificate.contacts == ()


@pytest.mark.slow
def test_a_problem_can_ask_for_contacts_to_be_noted_only(free):
    made = judged(free, with_block(), "limits.contacts=note")
    assert made.status == "optimal"
    assert made.certificate.passed
    (text,) = not_honoured(made)
    assert text.startswith("contact of geoms block (world) and L3 (rocker) from t = ")
    (kept,) = plain_record(made.certificate)["contacts"]
    assert kept["geoms"] == ["block", "L3"]
    assert 0 < kept["since_s"] < kept["deepest_at_s"] <= made.trajectory.duration_s


def test_other_words_for_contacts_are_refused():
    with pytest.raises(ProblemError, match=r"limits\.contacts 'ignore'.*legal: refuse, note"):
        load_problem("knee-reach", ["limits.contacts=ignore"])


@pytest.mark.slow
def test_links_that_overlap_on_their_pin_are_named_and_not_refused(free):
    made = judged(free, KNEE.replace('contype="0" conaffinity="0"', 'contype="1" conaffinity="1"'))
    assert made.status == "optimal"
    named = {frozenset(met.geoms) for met in made.certificate.contacts}
    assert frozenset(("L2", "B")) in named
    assert any('["coupler", "rocker"]' in text and "on a pin that they share" in text for text in not_honoured(made))
    assert not_honoured(judged(free, KNEE)) == ()


@pytest.mark.slow
def test_bodies_on_one_pin_that_meet_elsewhere_are_refused(free):
    # A horn on the coupler and one on the rocker: far from pin B, and apart at home.
    horns = KNEE.replace(
        '<site name="B_coupler"',
        '<geom name="horn" type="sphere" pos="0.03 0 0.03" size="0.012" contype="2"/><site name="B_coupler"',
    ).replace('<geom name="L3" class="rocker"', '<geom name="L3" class="rocker" conaffinity="2"')
    made = judged(free, horns)
    instant, _ = scanned(made)
    (met,) = made.certificate.contacts
    assert set(met.geoms) == {"horn", "L3"}
    assert met.since_s == pytest.approx(instant, abs=SCAN_S)
    assert made.status == "failed"


def test_a_gate_thinner_than_a_step_of_the_samples_is_not_jumped():
    """Two samples, one on each side of a thin plate that the rod passes: it is looked for between them."""
    plate = f'<geom name="plate" type="box" pos="0.06 0 0.585" size="{THIN_M} 0.004 0.01" contype="2"/>'
    tip = '<geom name="tip" type="sphere" pos="0 0 0.0855" size="0.001" conaffinity="2"/><site name="B_rocker"'
    text = KNEE.replace('<body name="thigh"', f'{plate}<body name="thigh"').replace('<site name="B_rocker"', tip)
    mechanism = load_mechanism(text)

    def position_at(t: np.ndarray) -> np.ndarray:
        return np.radians(-49.0 + 70.0 * np.asarray(t))[:, None]

    time = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    poses = follow(mechanism, position_at(time))
    data, touched = mujoco.MjData(mechanism.model), []
    for pose in poses:
        data.qpos[:] = pose
        mujoco.mj_fwdPosition(mechanism.model, data)
        touched.append(data.ncon)
    assert touched == [0] * len(time)
    (met,) = meetings(mechanism, time, poses, position_at)
    assert set(met.geoms) == {"plate", "tip"}
    data.qpos[:] = follow(mechanism, position_at(np.array([met.since_s])))[0]
    mujoco.mj_fwdPosition(mechanism.model, data)
    assert data.contact.dist.min() == pytest.approx(0.0, abs=mechanism.extent_m * TOUCHING)


def test_a_body_of_several_geoms_does_not_jump_a_gate():
    """MuJoCo looks at boxes around whole bodies first; neither sample's box of both balls is near the plate."""
    text = """<mujoco><worldbody><geom type="box" size="1e-5 0.01 0.01" pos="0.05 0 0"/>
<body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.001"/><geom size="0.001" pos="0 0.1 0"/></body></worldbody>
<actuator><motor joint="x" ctrlrange="-1 1"/></actuator></mujoco>"""
    time = np.array([0.0, 0.03, 0.06, 0.1])
    (met,) = meetings(load_mechanism(text), time, time[:, None], lambda t: np.asarray(t)[:, None])
    assert met.since_s == pytest.approx(0.05 - 1e-5 - 0.001, abs=TOUCHING)


def test_a_filtered_pair_is_no_contact(free):
    excluded = with_block().replace("<equality>", '<contact><exclude body1="world" body2="rocker"/></contact><equality>')
    assert judged(free, excluded).status == "optimal"


def test_an_explicit_pair_with_a_margin_meets_at_its_margin(free):
    block = '<geom name="block" type="box" pos="0.118 0 0.56" size="0.004 0.004 0.01"/>'
    pair = '<contact><pair geom1="block" geom2="L3" margin="0.003"/></contact><equality>'
    made = judged(free, KNEE.replace('<body name="thigh"', f'{block}<body name="thigh"').replace("<equality>", pair))
    (met,) = made.certificate.contacts
    bare = judged(free, with_block()).certificate.contacts[0]
    assert met.depth_m - bare.depth_m == pytest.approx(0.003, abs=DEPTH_M)
    assert met.since_s < bare.since_s


@pytest.mark.slow
def test_a_saved_plan_is_judged_by_its_contacts_too(free, tmp_path):
    model = tmp_path / "blocked.xml"
    model.write_text(with_block(y=0.1), encoding="utf-8")
    made = judged(free, with_block(y=0.1))
    made = replace(made, problem=load_problem("knee-reach", [f"mechanism.model={model}"]))
    folder = tmp_path / "saved"
    folder.mkdir()
    write_plan(made, folder)
    assert read_plan(folder).status == "optimal"
    model.write_text(with_block(), encoding="utf-8")
    with pytest.raises(CertificateError, match="geoms block"):
        read_plan(folder)
    again = read_plan(folder, anyway=True)
    assert again.status == "failed"
    assert "geoms block (world) and L3 (rocker) collide" in again.message


@pytest.mark.slow
def test_check_of_the_problem_says_it_before_any_solving(tmp_path, capsys):
    def ask_json(*arguments: str) -> tuple[int, dict]:
        code = main([*arguments, "--json"])
        return code, json.loads(capsys.readouterr().out)

    model = tmp_path / "blocked.xml"
    model.write_text(with_block(), encoding="utf-8")
    asked = ("check", "knee-reach", "--set", f"mechanism.model={model}")
    code, said = ask_json(*asked)
    assert code == 1
    (problem,) = said["problems"]
    assert problem.startswith("geoms block (world) and L3 (rocker) collide at O = ")
    code, said = ask_json(*asked, "--set", "limits.contacts=note")
    assert code == 0
    assert any("geoms block (world) and L3 (rocker) collide at O = " in note for note in said["notes"])
    code, said = ask_json(*asked, "--set", "motion.goal_deg.O=20")
    assert code == 0
    assert any("but not along the smooth path of knee-reach" in note for note in said["notes"])


# A foot on a vertical slide over a floor, drawn 2 mm deep in it.
FOOT = """
<mujoco><option gravity="0 0 0"/><worldbody>
  <geom name="floor" type="plane" size="1 1 0.1"/>
  <body name="foot" pos="0 0 0.018"><joint name="z" type="slide" axis="0 0 1" range="-0.1 0.1"/>
    <geom name="sole" type="sphere" size="0.02" mass="1"/></body></worldbody>
  <actuator><motor name="lift" joint="z" ctrlrange="-10 10"/></actuator></mujoco>
"""


def met_by_the_foot(*heights: float) -> tuple[float | None, float]:
    """Return when the foot collides on its way through heights [m] at 0, 1, 2 ... s, if so, and how deep it gets [m]."""
    mechanism, time = load_mechanism(FOOT), np.arange(float(len(heights)))

    def position_at(t: np.ndarray) -> np.ndarray:
        return np.interp(t, time, heights)[:, None]

    (met,) = meetings(mechanism, time, follow(mechanism, position_at(time)), position_at)
    assert set(met.geoms) == {"floor", "sole"}
    return met.since_s, met.depth_m


@pytest.mark.parametrize(
    ("heights", "deepest", "collides"),
    [
        ((0.0, 0.01, 0.0), 0.002, "never"),
        ((0.0, -0.0018, 0.0), 0.0038, "on the way"),
        ((-0.02, -0.03, -0.02), 0.032, "at once"),
    ],
    ids=["as deep as at home", "less than twice as deep", "a start and a goal deeper than at home"],
)
def test_an_overlap_at_home_is_accepted_as_deep_as_it_is_there(heights, deepest, collides):
    since, depth = met_by_the_foot(*heights)
    assert depth == pytest.approx(deepest)
    assert collides == ("never" if since is None else "at once" if since == 0.0 else "on the way")
    assert since is None or 0.0 <= since < 1.0


def meeting(since: float | None, depth_m: float = 1e-3, home_depth_m: float = 0.0, first: str = "a") -> Contact:
    depths = {"depth_m": depth_m, "home_depth_m": home_depth_m}
    return Contact(geoms=(first, "b"), bodies=("A", "B"), since_s=since, deepest_at_s=since or 0.0, **depths)


# A ball on a hinge of 0.5 m that swings towards a wall, 0.05 m beyond the goal or 0.1 m before it.
SWING = """<mujoco><option gravity="0 0 0"/><worldbody><geom name="wall" type="box" size="0.01 0.2 0.2" pos="{wall} 0 -0.5"/>
<body name="arm"><joint name="J" axis="0 -1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<geom name="ball" type="sphere" size="0.02" pos="0 0 -0.5"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-9 9"/></actuator></mujoco>"""
MOTION = 'kind = "reach"\nstart_deg = { J = -30.0 }\ngoal_deg = { J = 20.0 }\nduration_s = 1.0\n'
GOAL_M = 0.5 * np.sin(np.radians(20.0))


@pytest.fixture(scope="module")
def swing():
    """Return the problem with a wall in the way, or not, and a motion that ignores it."""
    return {
        beyond: body_plan(SWING.format(wall=GOAL_M + 0.03 + beyond), MOTION, "limits.contacts=note")
        for beyond in (0.05, -0.1)
    }


@pytest.mark.parametrize(("start", "goal"), [(-10.0, 10.0), (10.0, -10.0)])
@pytest.mark.parametrize(("pose", "expected"), [(-10.1, False), (-9.9, True), (0.0, True), (9.9, True), (10.1, False)])
def test_a_collision_is_unavoidable_at_a_pose_between_start_and_goal(swing, start, goal, pose, expected):
    """The swing from -30 to 20 deg stands for a motion between -10 and 10 deg that goes beyond both ends."""
    plan = swing[0.05]
    motion = replace(plan.problem.motion, start=np.radians([start]), goal=np.radians([goal]))
    problem, trajectory = with_limits(plan.problem, contacts="refuse").varied(motion=motion), plan.trajectory
    since = brentq(lambda t: float(trajectory.position_at(np.array([t]))[0, 0]) - np.radians(pose), 0, trajectory.duration_s)
    certificate = structs.replace(plan.certificate, contacts=(meeting(since),))
    assert unavoidable(problem, trajectory, certificate) is expected
    assert not unavoidable(with_limits(problem, contacts="note"), trajectory, certificate)
    assert not unavoidable(problem, trajectory, structs.replace(certificate, contacts=(meeting(None),)))


@pytest.mark.parametrize("beyond", [0.05, -0.1])
def test_a_collision_is_found_where_the_ball_reaches_the_wall_and_refused_unless_contacts_are_noted(swing, beyond):
    plan = swing[beyond]
    certificate = structs.replace(plan.certificate, contacts=())
    noted = with_contacts(plan.problem, plan.trajectory, certificate)
    refused = with_contacts(with_limits(plan.problem, contacts="refuse"), plan.trajectory, certificate)
    assert noted.failures == certificate.failures
    assert bool(noted.contacts) is bool(refused.failures) is (beyond < 0)
    if beyond < 0:
        (found,) = noted.contacts
        place = 0.5 * np.sin(plan.trajectory.position_at(np.array([found.since_s]))[0, 0])
        assert place == pytest.approx(GOAL_M + beyond, abs=1e-5)
        assert refused.unrepairable == refused.failures
        assert f"collide at t = {found.since_s:.5g} s" in refused.failures[0]


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ([meeting(0.25)], "penetrate by up to 1 mm, at t = 0.25 s; plans"),
        ([meeting(0.25, home_depth_m=2e-3)], "at t = 0.25 s, 2 mm at home; plans"),
        ([meeting(0.25), meeting(0.5)], "s, and 1 more pair of geoms after them;"),
        ([meeting(0.25), meeting(0.5), meeting(0.7)], "s, and 2 more pairs of geoms after them;"),
    ],
)
def test_the_first_collision_is_told_and_the_others_are_counted(found, words):
    assert words in further_checks._failure(tuple(found))


def test_contacts_that_begin_are_noted_one_by_one_and_constant_ones_together_with_the_deepest():
    begun, constant = meeting(0.25), [meeting(None, 2e-3), meeting(None, 5e-3, first="c")]
    assert len(contact_notes((begun,))) == 1
    first, rest = contact_notes((begun, *constant))
    assert "from t = 0.25 s on, up to 1 mm deep" in first
    assert "contact of 2 pairs of geoms" in rest
    assert "up to 5 mm deep" in rest
