"""Models that cannot be used and choices that cannot be made: each refused in one line that names what is wrong."""

import numpy as np
import pytest

import linkplan
from linkplan.models.audit import audit
from linkplan.models.errors import AssemblyError, ModelError
from linkplan.models.mechanism import load_mechanism
from tests.support.linkages import GRIPPER, LEG, LINKAGES, PSSR, RSSR, WELDED
from tests.support.mechanisms import CRANK_ROCKER, FIVE_BAR, SLIDER_CRANK, TRUSS, replaced
from tests.support.refusals import TWO_BODIES, assert_names, refusal

BARE_BAR = CRANK_ROCKER.mjcf(np.random.default_rng(0), bare=True)


def two(element: str) -> str:
    return TWO_BODIES % element


def equality(element: str) -> str:
    return two(f"<equality>{element}</equality>")


# name: (MJCF, words of the refusal)
MODELS = {
    # MuJoCo's own refusals, in one line
    "connect to nothing": (equality('<connect body1="left" anchor="0 0 0" body2="leg"/>'), ["leg"]),
    "coupling of too many coefficients": (equality('<joint joint1="ja" polycoef="1 2 3 4 5 6"/>'), ["polycoef"]),
    "ball joint with a reference": (
        replaced(two(""), 'name="ja" axis="0 1 0"', 'name="ja" type="ball" limited="true" range="1 2"'),
        ["range"],
    ),
    "a hinge on a free body": (
        replaced(two(""), '<joint name="ja" axis="0 1 0"/>', '<joint name="ja" axis="0 1 0"/><joint type="free"/>'),
        ["6 dofs", "left"],
    ),
    # Ours
    "flex equality": (
        two(
            '<deformable><flex name="f" dim="1" body="left right" vertex="0 0 0 0 0 0" element="0 1"/></deformable>'
            '<equality><flex flex="f"/></equality>'
        ),
        ["flex", "connect", "weld"],
    ),
    "locked by a weld": (equality('<weld body1="left"/><weld body1="right"/>'), ["locked", "0 degrees of freedom"]),
    "locked by couplings": (equality('<joint joint1="ja"/><joint joint1="jb"/>'), ["locked", "0 degrees of freedom"]),
    "locked by axes that are not quite parallel": (
        replaced(WELDED, '<joint name="C"/>', '<joint name="C" axis="1e-4 1 0"/>'),
        ["locked", "slightly off"],
    ),
    "locked truss": (TRUSS, ["'truss'", "locked"]),
    "couplings that contradict each other": (
        equality('<joint joint1="ja" polycoef="0.1 0 0 0 0"/><joint joint1="ja" polycoef="0.4 0 0 0 0"/>'),
        ["does not close", "home_deg"],
    ),
    "a weld that cannot be met": (
        equality('<weld body1="left" body2="right" relpose="0 0 0 1 0 0 0"/>'),
        ["does not close", "mm"],
    ),
    "a name that a ball's coordinate has": (
        replaced(RSSR, '<joint name="rocker" ', '<joint name="rod_rx" '),
        ["'rod_rx'", "two coordinates"],
    ),
}


@pytest.mark.parametrize(("text", "words"), MODELS.values(), ids=MODELS)
def test_a_model_that_cannot_be_used_is_refused_in_one_line_with_the_reason(text, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo leaves its log of warnings
    message = refusal(lambda: load_mechanism(text))
    assert_names(message, *words)
    assert len(message) < 400, "it does not repeat the model"


# name: (MJCF, words of what is named; all make plans false)
FALSE = {
    "ball spring": (replaced(RSSR, 'type="ball"', 'type="ball" stiffness="2"'), ["stiffness", "ball", "rod"]),
    "a damped motor on a ball": (
        replaced(RSSR, "<actuator>", '<actuator><motor name="swivel" joint="rod" gear="1 0 0" damping="1"/>'),
        ["damping", "swivel", "joint rod"],
    ),
    "ball damping of higher order": (
        replaced(RSSR, 'type="ball" damping="0.001"', 'type="ball" damping="0.001 0.2"'),
        ["damping", "ball", "rod"],
    ),
    "weight taken off by a motor that is clamped": (
        replaced(
            replaced(LEG, '<joint name="pitch"/>', '<joint name="pitch" actuatorgravcomp="true" actuatorfrcrange="-9 9"/>'),
            '<body name="thigh">',
            '<body name="thigh" gravcomp="1">',
        ),
        ["gravcomp", "thigh"],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(("text", "words"), FALSE.values(), ids=FALSE)
def test_what_would_make_a_plan_false_is_named_in_one_line(text, words):
    (found,) = [item for item in audit(load_mechanism(text).model) if item.falsifies]
    assert len(found.text.splitlines()) == 1
    assert_names(found.text, *words)


@pytest.mark.parametrize("name", [name for name in LINKAGES if name != "gripper"])
def test_nothing_is_named_on_a_linkage_that_is_honoured_whole(name):
    assert audit(load_mechanism(LINKAGES[name]).model) == ()


# Choices of coordinates

CHOICES = {
    "an unknown joint": (WELDED, ["K"], ["'K'", "O, A, C, B"]),
    "more than there are": (WELDED, ["O", "A"], ["degrees of freedom (1)", "got O, A"]),
    "the same twice": (FIVE_BAR, ["left", "left"], ["no joint twice", "got left, left"]),
    "a word for a list": (WELDED, "O", ["list of joint names", "'O'"]),
    "two of one loop": (LEG, ["knee", "rod"], ["singular at home", "knee", "rod"]),
    "both of a coupling": (GRIPPER, ["crank_r", "crank_l"], ["singular at home"]),
    "a ball's name": (RSSR, ["rod"], ["'rod'", "rod_rx"]),
}


@pytest.mark.parametrize(("text", "names", "words"), CHOICES.values(), ids=CHOICES)
def test_a_choice_of_coordinates_that_cannot_be_is_refused_with_the_reason(text, names, words):
    assert_names(refusal(lambda: linkplan.load_mechanism(text, independent=names)), *words)


def test_a_choice_at_its_dead_centre_is_refused():
    # The slider stands at its outer dead centre where crank and rod lie on one line: it cannot lead the crank there.
    straight = replaced(SLIDER_CRANK, 'qpos="0.7 -0.916 0.3685"', 'qpos="0 0 0.4"')
    assert load_mechanism(straight).dof == 1
    message = refusal(lambda: load_mechanism(straight, independent=["slide"]))
    assert_names(message, "'slide'", "singular at home", "another home pose")


def test_a_ball_turned_out_of_its_chart_at_home_is_refused():
    message = refusal(lambda: load_mechanism(PSSR, home={"rod_rx": 6.0}), AssemblyError)
    assert_names(message, "'rod'", "keyframe")


def test_a_scene_that_asks_for_gigabytes_is_read():
    assert load_mechanism(replaced(BARE_BAR, "<worldbody>", '<size memory="900G"/><worldbody>')).model.narena <= 10**9


def test_a_flexible_body_beside_the_mechanism_is_refused_with_its_remedy():
    cloth = '<flexcomp name="cloth" type="grid" count="3 3 1" spacing="1 1 1" dim="2"><edge equality="true"/></flexcomp>'
    with pytest.raises(ModelError, match=r"of kind 'flex'.* mechanism.keep = .NAMES. reads the named chain without"):
        load_mechanism(two("").replace("<worldbody>", f"<worldbody>{cloth}"))
