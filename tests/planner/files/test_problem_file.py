"""Problem files: what they mean, what `--set` changes, and one line for everything that cannot be meant."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.models.payload import SHANK
from linkplan.planner.problem.keys.kinds import MAX_INTERVALS
from linkplan.planner.problem.keys.reading import KEYS
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.transcription.schemes import NAMES
from tests.support.refusals import assert_refused
from tests.support.tolerances_planner import ROUNDING

REACH = "knee-reach"

# Overrides of knee-reach that cannot be used, and words of the answer.
MALFORMED: list[tuple[str | tuple[str, ...], list[str]]] = [
    # the override itself
    ("motion", ["section.key=value", "'motion'"]),
    ("kind=reach", ["section.key=value"]),
    ("=3", ["section.key=value"]),
    ("motion.kind.x=3", ["'motion.kind' is a value, not a table"]),
    ("motion.duration_s=", ["motion.duration_s", "neither TOML nor a bare word"]),
    # unknown names, with the nearest legal one
    ("motin.kind=reach", ["'motin'", "did you mean 'motion'", "objective"]),
    ("motion.goal=3", ["motion.goal", "did you mean 'goal_"]),
    ("objective.minimise=time", ["objective.minimise", "did you mean 'minimize'"]),
    ("limits.efort.act_O=[-1, 1]", ["limits.efort", "did you mean 'effort'"]),
    ("motion.kind=reech", ["motion.kind", "'reech'", "did you mean 'reach'", "periodic"]),
    ("objective.minimize=tim", ["objective.minimize", "did you mean 'time'"]),
    ("mesh.scheme=radau-10", ["mesh.scheme", "radau-1 to radau-9"]),
    ("limits.effort.act_K=[-1, 1]", ["limits.effort", "'act_K'", "did you mean 'act_O'"]),
    ("motion.goal_deg.K=3", ["'K'", "optimus-knee", "O, A, C"]),
    ("limits.range_deg.Q=[-1, 1]", ["'Q'", "O, A, C"]),
    ("mechanism.model=optimus-kne", ["'optimus-kne'", "did you mean 'optimus-knee'"]),
    ("mechanism.payload=shnk", ["'shnk'", "did you mean 'shank'"]),
    ("mechanism.payload.body=thig", ["'thig'", "did you mean 'thigh'"]),
    ("mechanism.home_deg.Z=3", ["'Z'", "O, A, C"]),
    # wrong types
    ("motion.goal_deg.O=true", ["motion.goal", "joint O", "a number", "True"]),
    ("motion.duration_s=fre", ['"free"', "'fre'"]),
    ("motion.duration_s=1979-05-27", ["motion.duration_s", "a positive number"]),
    ("limits.effort=[-1, 1]", ["limits.effort", "table of actuator"]),
    ("limits.effort.act_O=5", ["limits.effort.act_O", "[low, high]", "got 5"]),
    ("mesh.intervals=40.0", ["mesh.intervals", "whole number", "40.0"]),
    ("mesh.scheme=[1, 2]", ["mesh.scheme", "radau-1 to radau-9"]),
    ("mesh.scheme={a=1}", ["mesh.scheme", "radau-1 to radau-9"]),
    ("tracking.delay_periods=1.5", ["tracking.delay_periods", "whole number", "1.5"]),
    ("mechanism.model=3", ["mechanism.model", "got 3"]),
    ("mechanism.payload=3", ["payload", "got 3"]),
    ("mechanism.payload.com_m=5", ["payload.com_m", "three"]),
    ("mechanism.home_deg=3", ["mechanism.home_deg", "table of joint = value"]),
    ("mechanism.home_m.O=0.1", ["O", "hinge", "home_deg"]),
    ("motion.goal_m.O=1", ["joint 'O' is a hinge", "motion.goal_deg"]),
    ("limits.range_m.O=[-1, 1]", ["joint 'O' is a hinge", "limits.range_deg"]),
    # not a number, infinite, negative, too large, empty
    ("motion.goal_deg.O=nan", ["motion.goal", "joint O", "nan"]),
    ("motion.duration_s=1" + "0" * 400, ["motion.duration_s"]),
    ("motion.max_duration_s=-3", ["motion.max_duration_s", "positive", "-3"]),
    ("limits.effort.act_O=[5, 5]", ["limits.effort.act_O", "low < high"]),
    ("limits.effort.act_O=[nan, 5]", ["limits.effort.act_O", "nan"]),
    ("limits.range_deg.O=[-95, 95]", ["limits.range_deg.O", "exceeds", "[-90, 90]"]),
    ("limits.speed_deg_s.O=0", ["limits.speed_deg_s.O", "positive"]),
    ("limits.speed_deg_s.O=[5, 10]", ["limits.speed_deg_s.O", "rest"]),
    ("mesh.intervals=100000", ["mesh.intervals", str(MAX_INTERVALS)]),
    ("tracking.kp=-1", ["tracking.kp", "at least 0", "-1"]),
    # words with a line's end in them
    ('motion.kind="reach\\nx"', ["motion.kind"]),
    ('mechanism.model="a\\nb"', ["a model's name", "cannot be shown"]),
    # values that contradict each other
    ("objective.minimize=time", ["minimize 'time'", '"free"', "0.16"]),
    ("objective.minimize=tracking", ["'tracking'", "[reference]"]),
    ("motion.kind=track", ["'track'", "[reference]"]),
    ("motion.goal_deg={}", ["'reach'", "motion.goal_deg"]),
    ("motion.start_deg.A=20", ["motion.start_deg", "does not close", "106.8", "20"]),
    ("motion.goal_speed_deg_s.A=20", ["joint A", "follows from O"]),
    ("mechanism.home_deg.O=89", ["does not close", "O = 89 deg"]),
    ("reference.frequency_hz=4", ["reference.amplitude_deg", "joint O"]),
    ("reference.amplitude_deg.O=4", ["reference.frequency_hz", "positive"]),
    (("reference.frequency_hz=4", "reference.amplitude_deg.A=4"), ["reference.amplitude", "independent", "A"]),
    (("mechanism.payload=none", "mechanism.payload.mass_kg=1"), ["'mechanism.payload' is a value"]),
]


@pytest.mark.slow
@pytest.mark.parametrize(("overrides", "words"), MALFORMED, ids=lambda value: repr(value)[:40])
def test_a_malformed_setting_is_refused_in_one_line(overrides, words):
    assert_refused(lambda: load_problem(REACH, [overrides] if isinstance(overrides, str) else overrides), *words)


# Files and models that cannot be used: name, content, words of the answer.

FRICTION = """<mujoco><worldbody><body name="arm"><joint name="J" type="hinge" axis="0 1 0" frictionloss="0.5"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody><equality/>
<actuator><motor name="motor" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""
MODELS = {
    "springyield": (
        FRICTION.replace('frictionloss="0.5"', 'stiffness="1" springyield="1"'),
        ["springyield of joint J", "forces that plans neglect"],
    ),
    "no actuator": (
        FRICTION.replace(' frictionloss="0.5"', "").replace('<motor name="motor" joint="J" ctrlrange="-4 4"/>', ""),
        ["no usable actuator", "a motor in mechanism.drive"],
    ),
    "a ball joint": (FRICTION.replace('type="hinge"', 'type="ball"'), ["'J'", "J_rx, J_ry, J_rz"]),
    "a filtered servo": (
        FRICTION.replace(' frictionloss="0.5"', "").replace("<motor", '<position kp="5" timeconst="0.1"'),
        ["actuator motor", "state of its own"],
    ),
}
PROBLEM = '[mechanism]\nmodel = "model.xml"\n[motion]\nkind = "reach"\nstart_deg = { J = 0 }\ngoal_deg = { J = 9 }\n'


@pytest.mark.parametrize("case", MODELS)
def test_a_model_that_cannot_be_planned_truly_is_refused_in_one_line(case, tmp_path):
    (tmp_path / "model.xml").write_text(MODELS[case][0], encoding="utf-8")
    (tmp_path / "problem.toml").write_text(PROBLEM + "duration_s = 1.0\n", encoding="utf-8")
    assert_refused(lambda: load_problem(tmp_path / "problem.toml"), *MODELS[case][1])


def write(content: bytes) -> Callable[[Path], Path]:
    def prepare(folder: Path) -> Path:
        path = folder / "problem.toml"
        path.write_bytes(content)
        return path

    return prepare


FILES: dict[str, tuple[Callable[[Path], str | Path], list[str]]] = {
    "malformed TOML": (write(b"[motion\nkind = 1"), ["is not TOML"]),
    "a key twice": (write(b"[motion]\nkind = 'reach'\nkind = 'track'"), ["is not TOML", "a key is given twice"]),
    "a key without its table": (write(b"model = 'optimus-knee'"), ["'model': it belongs to [mechanism]"]),
    "not UTF-8": (write(b"description = '\xff\xfe'"), ["not UTF-8"]),
    "an empty file": (write(b""), ["mechanism.model"]),
    "no kind": (write(b"[mechanism]\nmodel = 'optimus-knee'"), ["motion.kind is missing", "reach, hold, periodic, track"]),
    "a table that is a number": (write(b"motion = 3"), ["'motion' must be a table", "got 3"]),
    "a description that is a number": (write(b"description = 3"), ["description"]),
    "an unknown table": (write(b"[motoin]\nkind = 'reach'"), ["'motoin'", "did you mean 'motion'"]),
    "a name with a line's end": (write(b'"mo\\ntion" = 3'), ["unknown table or key"]),
    "a folder": (lambda folder: folder, ["is a folder", "knee-reach"]),
    "a missing file": (lambda folder: folder / "nowhere.toml", ["nowhere.toml", "there is no such file"]),
    "a slip in a name": (lambda _: "knee-reech", ["'knee-reech'", "did you mean 'knee-reach'"]),
    "no name": (lambda _: "", ["problem"]),
    "a name too long for a file": (lambda _: "k" * 5000, ["unknown problem"]),
}


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_cannot_be_read_is_refused_in_one_line(case, tmp_path):
    prepare, words = FILES[case]
    assert_refused(lambda: load_problem(prepare(tmp_path)), *words)


def test_a_periodic_motion_lasts_whole_periods_of_its_reference():
    with pytest.raises(ProblemError, match=r"whole number of the reference's periods of 0.25 s, got 0.3"):
        load_problem("knee-sine-shank", ["motion.duration_s=0.3"])


@pytest.mark.slow
@settings(derandomize=True, deadline=None, max_examples=15)
@given(st.sampled_from([f"{table}.{key}" for table, keys in KEYS.items() for key in keys]), st.text(max_size=12))
def test_no_text_whatever_gets_past_the_reader_as_another_error(key, text):
    try:
        answer = load_problem(REACH, [f"{key}={text}"])
    except LinkplanError as error:
        answer = str(error)
    assert isinstance(answer, Problem) or len(answer.splitlines()) == 1


# Settings, the quantity of the problem that each one changes, and the new value of this quantity.
SETTINGS = [
    ("mesh.scheme=radau-2", lambda problem: problem.mesh.scheme, "radau-2"),
    ('mesh.scheme = "radau-2"', lambda problem: problem.mesh.scheme, "radau-2"),
    ("tracking.kp=1e3", lambda problem: problem.tracking.kp, 1000.0),
    ("limits.effort.act_O=[-50, inf]", lambda problem: problem.limits.effort.tolist(), [[-50.0, np.inf]]),
    ("motion.goal_deg={O = 10}", lambda problem: problem.motion.goal, pytest.approx(np.radians(10))),
    ("motion.duration_s=free", lambda problem: problem.motion.duration_s, None),
    ("mechanism.payload=none", lambda problem: problem.mechanism.payload, None),
    ('mechanism.payload={body="rocker", mass_kg=2, com_m=[0, 0, 1]}', lambda p: p.mechanism.payload.body, "rocker"),
]


@pytest.mark.parametrize(("override", "read", "value"), SETTINGS)
def test_a_setting_is_what_the_problem_has(override, read, value):
    assert read(load_problem(REACH, [override])) == value
    assert read(load_problem(REACH)) != value


def test_a_key_of_a_built_in_payload_keeps_its_other_values():
    payload = load_problem(REACH, ["mechanism.payload.mass_kg=5.5"]).mechanism.payload
    assert payload.mass_kg == 5.5
    assert payload.body == SHANK.body
    np.testing.assert_array_equal(payload.com_m, SHANK.com_m)
    np.testing.assert_array_equal(payload.inertia_kgm2, SHANK.inertia_kgm2)


def test_an_override_does_not_outlive_its_problem():
    load_problem(REACH, ["motion.goal_deg.O=10", "mechanism.payload.mass_kg=9"])
    problem = load_problem(REACH)
    assert np.degrees(problem.motion.goal[0]) == pytest.approx(56.27)
    assert problem.mechanism.payload.mass_kg == SHANK.mass_kg


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_scheme_can_be_named(name):
    assert load_problem(REACH, [f"mesh.scheme={name}"]).mesh.scheme == name


# What files mean.


def test_degrees_become_radians_and_the_model_s_ranges_become_limits():
    problem = load_problem(REACH, ["limits.speed_deg_s.A=180"])
    np.testing.assert_allclose(problem.limits.position, np.radians([[-90, 90], [-150, 150], [-120, 120]]))
    np.testing.assert_allclose(problem.limits.speed[1], [-np.pi, np.pi])
    assert np.all(np.isinf(problem.limits.speed[[0, 2]]))


def test_a_start_that_names_a_dependent_joint_where_it_is_may_do_so():
    problem = load_problem(REACH, ["motion.start_deg.A=106.817"])
    assert problem.motion.start.shape == (1,)


def test_the_independent_joint_can_be_named():
    problem = load_problem(REACH, ['mechanism.independent=["A"]', "motion.start_deg={A=10}", "motion.goal_deg={A=40}"])
    assert [joint.name for joint in problem.mechanism.independent_joints] == ["A"]
    assert problem.motion.start is not None
    assert abs(float(problem.motion.start[0]) - np.radians(10)) < ROUNDING
