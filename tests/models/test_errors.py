"""Bad input to the models package: refused in one line that names what was asked and what is legal."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import linkplan
from linkplan.models.audit import audit
from linkplan.models.catalogue import MODELS
from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.errors import AssemblyError, LinkplanError, ProblemError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.payload import SHANK
from linkplan.models.poses.assembly import close_at
from tests.support.mechanisms import CRANK_ROCKER, PENDULUM, TRUSS, replaced, simulated
from tests.support.refusals import TWO_BODIES, assert_names, refusal
from tests.support.tolerances import TREE_ACCELERATION, relative_error

FOUR_BAR = CRANK_ROCKER.mjcf(np.random.default_rng(0), bare=True)


# Sources


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("optimus-kne", ["'optimus-kne'", "did you mean 'optimus-knee'?", *MODELS]),
        ("Optimus-Knee", ["did you mean 'optimus-knee'?"]),
        ("optimus-knee-sauce", ["did you mean 'optimus-knee-source'?"]),
        ("qqq", ["'qqq'", "built-in name"]),
        ("", ["''", "built-in name"]),
        ("None", ["'None'", "built-in name"]),
        ("two\nlines", ["model"]),
        ("words before\n<mujoco/>", ["model"]),
        ("x" * 5000, ["model"]),
        ("nul\0byte", ["model"]),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_a_model_that_is_nowhere_is_refused_in_one_line(asked, words):
    assert_names(refusal(lambda: load_mechanism(asked)), *words)


def test_a_file_that_is_nowhere_is_refused_without_a_list_of_names():
    said = refusal(lambda: load_mechanism("no/such/folder/model.urdf"))
    assert_names(said, "'no/such/folder/model.urdf'", "there is no such file")
    assert "five-bar" not in said


FILES = {
    "empty": (b"", "is empty"),
    "binary": (bytes(range(256)), "does not parse"),
    "cut short": (FOUR_BAR.encode()[:400], "does not parse"),
    "another root": (b"<html></html>", "html"),
    "a missing mesh": (
        b'<mujoco><asset><mesh file="no.stl"/></asset><worldbody><body><joint/><geom type="mesh" mesh="no"/></body>'
        b"</worldbody></mujoco>",
        "no.stl",
    ),
    "a part of a model": (b"<!-- arm --><mujocoinclude><worldbody/></mujocoinclude>", "take a file that includes it"),
    "a missing include": (b'<mujoco><include file="no.xml"/></mujoco>', "no.xml"),
}


@pytest.mark.parametrize(("content", "reason"), FILES.values(), ids=FILES)
def test_a_bad_file_is_refused_with_its_name_and_the_reason(tmp_path, content, reason):
    path = tmp_path / "leg.xml"
    path.write_bytes(content)
    assert_names(refusal(lambda: load_mechanism(path)), "leg", reason)


def test_a_good_file_is_a_model_of_its_own_name(tmp_path):
    path = tmp_path / "leg.xml"
    path.write_text(FOUR_BAR)
    assert load_mechanism(path).name == load_mechanism(str(path)).name == "leg"


TEXTS = {
    "unknown element": (TWO_BODIES % "<gearbox/>", "gearbox"),
    "no mass": (replaced(TWO_BODIES % "", '<geom size="0.1" pos="0.3 0 0"/><site', "<site"), "left"),
    "negative mass": (replaced(PENDULUM, 'mass="2"', 'mass="-2"'), "rod"),
    "range upside down": (replaced(PENDULUM, 'range="-1 2"', 'limited="true" range="2 -1"'), "range"),
    "no joint": ("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", "no joint"),
    "nothing": ("<mujoco/>", "no joint"),
}


@pytest.mark.parametrize(("text", "word"), TEXTS.values(), ids=TEXTS)
def test_bad_mjcf_is_refused_with_the_reason(text, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo leaves its log of warnings
    assert_names(refusal(lambda: load_mechanism(text)), word)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(at=st.integers(0, len(FOUR_BAR) - 1), n_lost=st.integers(1, 60), put=st.text('<>/="0 a\n', max_size=3))
def test_mjcf_with_a_hole_in_it_loads_or_is_refused_in_one_line(at, n_lost, put):
    text = FOUR_BAR[:at] + put + FOUR_BAR[at + n_lost :]
    message, gap = "", 0.0
    try:
        mechanism = load_mechanism(text)
        gap = mechanism.gap_m(mechanism.home)
    except LinkplanError as error:
        message = str(error)
    assert len(message.splitlines()) <= 1
    assert gap < CLOSED_M


# Elements


def test_an_inactive_weld_is_no_reason_to_refuse():
    text = TWO_BODIES % '<equality><weld body1="left" body2="right" active="false"/></equality>'
    assert load_mechanism(text).dof == 2


def test_a_loop_that_cannot_close_is_refused_with_its_gap():
    far = replaced(TRUSS, '<body name="right" pos="0.2 0 0">', '<body name="right" pos="2 0 0">')
    message = refusal(lambda: load_mechanism(far), AssemblyError)
    assert_names(message, "'truss'", "does not close", " mm", "home_deg")


# Payloads

CUBE = {"body": "crank", "mass_kg": 1.0, "com_m": [0.0, 0.0, 0.0], "inertia_kgm2": [1.0, 1.0, 1.0]}

PAYLOADS = {
    "unknown body": ({"body": "cranc"}, ["'cranc'", "did you mean 'crank'?", "coupler", "rocker"]),
    "body of two lines": ({"body": "a\nb"}, ["payload.body", "crank"]),
    "negative mass": ({"mass_kg": -1.0}, ["payload.mass_kg", "positive", "-1"]),
    "no mass": ({"mass_kg": 0}, ["payload.mass_kg", "positive", "0"]),
    "mass beyond floats": ({"mass_kg": 10**400}, ["payload.mass_kg"]),
    "com nan": ({"com_m": [0.0, np.nan, 0.0]}, ["payload.com_m[1]", "a number", "nan"]),
    "inertia negative": ({"inertia_kgm2": [1.0, 1.0, -0.1]}, ["payload.inertia_kgm2[2]", "at least 0", "-0.1"]),
    "inertia of no body": ({"inertia_kgm2": [1.0, 1.0, 2.5]}, ["payload.inertia_kgm2", "not that of a rigid body", "2.5"]),
    "unknown key": ({"mass": 1.0}, ["'mechanism.payload.mass'", "did you mean 'mass_kg'?", *CUBE]),
    "key of two lines": ({"mass\nkg": 1.0}, ["payload.", *CUBE]),
}


@pytest.mark.parametrize(("change", "words"), PAYLOADS.values(), ids=PAYLOADS)
def test_a_bad_payload_is_refused_by_key_and_value(change, words):
    assert_names(refusal(lambda: linkplan.load_mechanism("optimus-knee", payload=CUBE | change)), *words)


def test_a_payload_on_a_model_without_its_body_is_refused():
    assert_names(refusal(lambda: load_mechanism(TWO_BODIES % "", payload=SHANK)), "'crank'", "left", "right")


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan])
def test_a_payload_is_not_scaled_away(factor):
    refusal(lambda: SHANK.scaled(factor))


# Names and positions


def test_a_misspelt_joint_is_refused_with_the_joints():
    mechanism = load_mechanism(FOUR_BAR)
    assert_names(refusal(lambda: mechanism.joint_index("o")), "'o'", "'four-bar'", "O, A, C")


def test_a_home_with_an_unknown_joint_is_refused_with_the_joints():
    assert_names(refusal(lambda: load_mechanism(FOUR_BAR, home={"K": 0.0})), "'K'", "'four-bar'", "O, A, C")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e15, "upright", None], ids=str)
def test_a_home_that_is_no_position_is_refused_by_joint(value):
    assert_names(refusal(lambda: linkplan.load_mechanism(FOUR_BAR, home_deg={"O": value}), ProblemError), "O")


@pytest.mark.parametrize("position", [np.nan, 1.5])
def test_a_position_out_of_reach_is_refused_by_joint(position):
    mechanism = load_mechanism("optimus-knee")
    message = refusal(lambda: close_at(mechanism, np.array([position])), AssemblyError)
    assert_names(message, "'optimus-knee'", f"O = {np.degrees(position):.6g} deg", "does not close")


# What the reduced dynamics leave out is named

LEFT_OUT = {
    "springyield": ('name="ja"', 'name="ja" stiffness="1" springyield="1"', ["springyield", "ja"], True),
    "tendon armature": ('name="cable"', 'name="cable" armature="3"', ["armature", "cable"], True),
    "fluid": ("<worldbody>", '<option density="1.2"/><worldbody>', ["fluid"], True),
    "servo": ("</tendon>", '</tendon><actuator><position name="servo" joint="ja"/></actuator>', ["servo"], False),
    "inactive weld": (
        "</tendon>",
        '</tendon><equality><weld name="glue" body1="left" body2="right" active="false"/></equality>',
        ["glue", "inactive"],
        False,
    ),
}


@pytest.mark.parametrize(("old", "new", "words", "falsifies"), LEFT_OUT.values(), ids=LEFT_OUT)
def test_what_is_left_out_is_reported_by_name(old, new, words, falsifies):
    (found,) = audit(load_mechanism(replaced(TWO_BODIES % "", old, new)).model)
    assert_names(found.text, *words)
    assert found.falsifies is falsifies


def test_nothing_is_reported_on_a_model_that_is_honoured_whole():
    assert audit(load_mechanism(TWO_BODIES % "").model) == ()


@pytest.mark.parametrize(
    ("motor", "option", "why"),
    [
        ("<motor", '<flag actuation="disable"/>', "switched off"),
        ('<motor group="2"', "", "switched off"),
        ('<motor delay="0.01" nsample="4"', "", "delayed"),
    ],
    ids=["actuation disabled", "group disabled", "delayed"],
)
def test_a_motor_that_does_not_act_at_once_is_no_motor_and_is_reported(motor, option, why):
    text = replaced(FOUR_BAR, "<motor", motor)
    text = replaced(text, "/>\n  <worldbody>", f' actuatorgroupdisable="2">{option}</option>\n  <worldbody>')
    model = load_mechanism(text).model
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_step(model, data)
    assert not np.any(data.qfrc_actuator), "the motor does not act in MuJoCo"
    assert load_mechanism(text).n_u == 0
    (found,) = audit(model)
    assert_names(found.text, "actuator 0", "joint O", why)
    assert not found.falsifies


def test_disabled_constraints_open_the_loop():
    text = replaced(FOUR_BAR, "/>\n  <worldbody>", '><flag constraint="disable"/></option>\n  <worldbody>')
    mechanism = load_mechanism(text)
    assert not len(simulated(mechanism.model, mechanism.home, np.zeros(3)).rows), "the loop is open in MuJoCo"
    assert (mechanism.dof, mechanism.n_closure_rows) == (3, 0)
    assert load_mechanism(FOUR_BAR).dof == 1


def winched(attribute: str) -> tuple[Mechanism, np.ndarray, np.ndarray]:
    """Return two bodies with a motor on their tendon, their accelerations without control: the model's and MuJoCo's."""
    motor = f'<actuator><motor name="winch" tendon="cable" {attribute}/></actuator>'
    mechanism = load_mechanism(TWO_BODIES % motor)
    q, v = np.array([0.1, 0.2]), np.array([1.0, -2.0])
    expected, plain = (simulated(load_mechanism(TWO_BODIES % m).model, q, v).acceleration for m in (motor, ""))
    assert np.abs(expected - plain).max() > 0.01, "it acts, though no control does"
    return mechanism, np.array(mechanism.dynamics.acceleration(q, v, np.zeros(mechanism.n_u))).ravel(), expected


def test_the_damping_of_a_motor_on_a_tendon_is_honoured():
    mechanism, actual, expected = winched('damping="1"')
    assert relative_error(actual, expected) < TREE_ACCELERATION
    assert audit(mechanism.model) == ()


def test_the_armature_of_a_motor_on_a_tendon_between_branches_falsifies_and_is_named():
    mechanism, actual, expected = winched('armature="2"')
    assert relative_error(actual, expected) > 0.1, "the simulator leaves out how it couples them"
    (found,) = audit(mechanism.model)
    assert_names(found.text, "armature", "cable")
    assert found.falsifies
