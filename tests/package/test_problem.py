"""`Problem`: builders mean what a file means, refuse in a file's words, and go back to a file."""

import math
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import AssemblyError, LinkplanError, ModelError, ProblemError
from linkplan.models.library import built_in_text
from linkplan.planner.files.folders import to_json_types
from linkplan.planner.files.tables import BUILT_IN
from linkplan.planner.problem.keys.section import Section
from linkplan.planner.problem.problem import Problem

REACH = {"start_deg": {"O": -49.07}, "goal_deg": {"O": 56.27}, "duration_s": 0.2}
SINE = {"amplitude_deg": {"O": 20.0}, "bias_deg": {"O": 3.6}, "frequency_hz": 4.0}
BUILDERS = {"reach": linkplan.Problem.reach, "periodic": linkplan.Problem.periodic, "track": linkplan.Problem.track}


@pytest.fixture(scope="module")
def knee():
    return linkplan.load_mechanism("optimus-knee")


def differences(one, other, where="problem"):
    """Return where two problems, or what they are made of, are not the same; their sources and models left to others."""
    if (is_dataclass(one) or isinstance(one, Section)) and type(one) is type(other):
        every = one.__struct_fields__ if isinstance(one, Section) else [field.name for field in fields(one)]
        names = [name for name in every if name not in ("mechanism", "name")]
        return [d for name in names for d in differences(getattr(one, name), getattr(other, name), f"{where}.{name}")]
    if isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        return [d for k, (a, b) in pairs for d in differences(a, b, f"{where}[{k}]")]
    same = np.array_equal(one, other, equal_nan=True) if isinstance(one, np.ndarray) else one == other
    return [] if same else [f"{where}: {one!r} and {other!r}"]


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_problem_written_as_toml_is_the_same_problem_again(name, tmp_path):
    problem = linkplan.Problem.from_file(name)
    written = tmp_path / f"{name}.toml"
    written.write_text(problem.to_toml(), encoding="utf-8")
    again = linkplan.Problem.from_file(written)
    assert again.name == name
    assert again.to_dict() == problem.to_dict()
    assert not differences(problem, again)
    assert problem.mechanism.fingerprint() == again.mechanism.fingerprint()


def test_the_comparison_of_two_problems_sees_a_difference(knee):
    one = linkplan.Problem.reach(knee, **REACH)
    assert differences(one, one.replace(duration_s=0.21))
    assert differences(one, one.replace(goal_deg={"O": 56.0}))


def test_a_built_problem_is_what_a_file_says(knee):
    """Tuples and NumPy's numbers and arrays are lists and numbers in a file."""
    waypoints, minimize = [{"at_deg": {"O": 0.0}, "time_s": 0.1}], {"effort": 1.0, "work": 0.5}
    sections = {
        "limits": {"effort": {"act_O": (-80, np.float64(80))}, "speed_deg_s": {"A": 900}, "singular_margin": 0.1},
        "motors": {"act_O": {"torque_constant": 0.5, "resistance_ohm": 0.1}},
        "guess": {"path_deg": {"O": np.linspace(-49.07, 56.27, 3)}},
        "mesh": {"scheme": "gauss-3", "intervals": 20},
        "solver": {"starts": 3},
        "tracking": {"kp": 50, "kd": 2},
    }
    built = linkplan.Problem.reach(knee, **REACH, waypoints=waypoints, minimize=minimize, **sections, name="mine")
    motion = {"kind": "reach", **REACH, "waypoints": waypoints}
    tables = {"mechanism": {"model": "optimus-knee"}, "motion": motion, "objective": {"minimize": minimize}}
    read = Problem.from_tables("mine", tables | to_json_types(sections))
    assert not differences(built, read)
    assert built.motion.start == pytest.approx(np.radians(-49.07))
    assert (built.name, built.limits.effort.tolist(), built.mesh.intervals) == ("mine", [[-80.0, 80.0]], 20)


@pytest.mark.parametrize("kind", ["periodic", "track"])
def test_motions_that_repeat_are_built_about_their_reference(knee, kind):
    problem = BUILDERS[kind](knee, reference=SINE)
    assert problem.motion.kind == kind
    assert problem.objective.name == "tracking"
    assert problem.motion.duration_s == pytest.approx(0.25)


def test_a_slide_is_stated_in_metres():
    pole = linkplan.load_mechanism("cart-pole")
    problem = linkplan.Problem.reach(
        pole, start_m={"cart": 0}, start_deg={"pole": 0}, goal_m={"cart": 1}, goal_deg={"pole": 180}, duration_s=2
    )
    assert problem.motion.goal == pytest.approx([1.0, np.pi])


def test_a_mechanism_is_assembled_as_it_is_asked(tmp_path):
    payload = {"body": "crank", "mass_kg": 2.0, "com_m": np.array([0.0, 0.0, -0.1])}
    knee = linkplan.load_mechanism("optimus-knee", home_deg={"O": 20.0}, independent=["O"], payload=payload)
    assert np.degrees(knee.home[knee.joint_index("O")]) == pytest.approx(20.0)
    assert knee.payload.mass_kg == 2.0
    problem = linkplan.Problem.reach(knee, **REACH)
    assert problem.to_dict()["mechanism"] == {
        "model": "optimus-knee",
        "home_deg": {"O": 20.0},
        "independent": ["O"],
        "payload": {"body": "crank", "mass_kg": 2.0, "com_m": [0.0, 0.0, -0.1]},
    }
    written = tmp_path / "problem.toml"
    written.write_text(problem.to_toml(), encoding="utf-8")
    assert linkplan.Problem.from_file(written).mechanism.fingerprint() == knee.fingerprint()


def test_a_mechanism_of_mjcf_text_goes_into_the_file_with_its_lines(tmp_path):
    problem = linkplan.Problem.reach(built_in_text("optimus-knee"), **REACH)
    written = tmp_path / "problem.toml"
    written.write_text(problem.to_toml(), encoding="utf-8")
    assert written.read_text(encoding="utf-8").count("\n") > 50
    again = linkplan.Problem.from_file(written)
    assert again.mechanism.fingerprint() == problem.mechanism.fingerprint()


def test_a_mechanism_from_a_path_is_found_again_from_elsewhere(tmp_path, monkeypatch):
    (tmp_path / "mine.xml").write_text(built_in_text("optimus-knee"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    problem = linkplan.Problem.reach(linkplan.load_mechanism("mine.xml"), **REACH)
    (tmp_path / "else").mkdir()
    monkeypatch.chdir(tmp_path / "else")
    (tmp_path / "else" / "problem.toml").write_text(problem.to_toml(), encoding="utf-8")
    assert linkplan.Problem.from_file("problem.toml").mechanism.fingerprint() == problem.mechanism.fingerprint()


def test_a_varied_problem_keeps_the_rest_and_the_first_one(knee):
    problem = linkplan.Problem.reach(knee, **REACH, limits={"effort": {"act_O": [-80, 80]}})
    other = problem.replace(goal_deg={"O": 40.0}, minimize="effort_rate")
    assert other.mechanism is knee
    assert other.motion.goal == pytest.approx(np.radians(40.0))
    assert other.objective.name == "effort_rate"
    assert other.limits.effort.tolist() == [[-80.0, 80.0]]
    assert problem.motion.goal == pytest.approx(np.radians(56.27))
    assert other.replace(limits=None, minimize=None).limits.effort.tolist() == [[-100.0, 100.0]]


def test_a_payload_is_put_on_and_taken_off(knee):
    problem = linkplan.Problem.reach(knee, **REACH)
    loaded = problem.replace(payload="shank")
    assert loaded.mechanism.payload.mass_kg == 4.0
    assert loaded.replace({"mechanism.payload.mass_kg": 3.0}).mechanism.payload.mass_kg == 3.0
    bare = loaded.replace(payload=None)
    assert bare.mechanism.payload is None
    assert bare.mechanism.fingerprint() == knee.fingerprint()


def test_single_settings_stand_in_for_those_of_a_file():
    problem = linkplan.Problem.from_file(
        "knee-reach", {"motion.duration_s": np.float64(0.2), "limits.effort.act_O": (-90, 90)}
    )
    assert problem.motion.duration_s == 0.2
    assert problem.limits.effort.tolist() == [[-90.0, 90.0]]


# builder, arguments in place of those of a sound problem, and the same as a file's tables
LATE = [{"at_deg": {"O": 0}, "time_s": 0.5}]
WIDE = SINE | {"amplitude_deg": {"O": 200}}
BAD = [
    ("reach", {"start_deg": {"K": 1.0}}, ("motion", "start_deg", {"K": 1.0})),
    ("reach", {"start_deg": {"O": math.nan}}, ("motion", "start_deg", {"O": math.nan})),
    ("reach", {"start_deg": 3.0}, ("motion", "start_deg", 3.0)),
    ("reach", {"start_deg": {"O": -49.07, "A": 0.0}}, ("motion", "start_deg", {"O": -49.07, "A": 0.0})),
    ("reach", {"start_m": {"O": 0.1}}, ("motion", "start_m", {"O": 0.1})),
    ("reach", {"duration_s": "soon"}, ("motion", "duration_s", "soon")),
    ("reach", {"min_duration_s": 0.1}, ("motion", "min_duration_s", 0.1)),
    ("reach", {"waypoints": LATE}, ("motion", "waypoints", LATE)),
    ("reach", {"minimize": "beauty"}, ("objective", "minimize", "beauty")),
    ("reach", {"limits": {"effort": {"act_X": [-1, 1]}}}, ("limits", "effort", {"act_X": [-1, 1]})),
    ("reach", {"limits": {"torque": {"act_O": 5}}}, ("limits", "torque", {"act_O": 5})),
    ("reach", {"limits": 5}, ("limits", None, 5)),
    ("reach", {"motors": {"act_O": {"torque_constant": 0.5}}}, ("motors", "act_O", {"torque_constant": 0.5})),
    ("reach", {"guess": {"plan": "nowhere/at/all"}}, ("guess", "plan", "nowhere/at/all")),
    ("reach", {"goal_deg": {"O": 95.0}}, ("motion", "goal_deg", {"O": 95.0})),
    ("periodic", {"reference": SINE, "duration_s": 0.3}, ("motion", "duration_s", 0.3)),
    ("track", {"reference": None}, ("reference", None, {})),
    ("track", {"reference": WIDE}, ("reference", None, WIDE)),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "argument", "in_file"), BAD, ids=lambda value: str(value)[:50])
def test_a_builder_refuses_in_the_words_in_which_a_file_is_refused(knee, kind, argument, in_file):
    sound = REACH if kind == "reach" else {"reference": SINE}
    tables = {"mechanism": {"model": "optimus-knee"}, "motion": {"kind": kind}}
    if kind == "reach":
        tables["motion"] |= REACH
    else:
        tables["reference"] = dict(SINE)
    section, key, value = in_file
    if key is None:
        tables[section] = value
    else:
        tables.setdefault(section, {})[key] = value
    with pytest.raises(LinkplanError) as from_file:
        Problem.from_tables("mine", tables).start_pose()
    with pytest.raises(type(from_file.value)) as built:
        BUILDERS[kind](knee, **(sound | argument), name="mine")
    assert str(built.value) == str(from_file.value)
    assert "\n" not in str(built.value)


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: linkplan.load_mechanism(5), ProblemError, "mechanism.model must be a built-in name or a path"),
        (lambda: linkplan.load_mechanism("optimus-knee", payload="shin"), ModelError, "shank"),
        (lambda: linkplan.load_mechanism("optimus-knee", home_deg={"O": "up"}), ProblemError, "mechanism.home_deg.O"),
        (lambda: linkplan.load_mechanism("optimus-knee", home_deg={"O": 85}), AssemblyError, "does not close"),
        (lambda: linkplan.load_mechanism("optimus-knee", home_m={"O": 0.1}), ProblemError, "mechanism.home_deg, not home_m"),
        (lambda: linkplan.load_mechanism("optimus-knee", independent=["K"]), ModelError, "joints are O, A, C"),
        (lambda: linkplan.Problem.reach("optimus-knee", **REACH, name=""), ProblemError, "name must have"),
        (lambda: linkplan.Problem.hold("optimus-knee", goal=1), ProblemError, "unknown argument 'goal' of hold"),
        (lambda: linkplan.Problem.from_file("knee-reach", {"duration_s": 1}), ProblemError, "section.key=value"),
        (lambda: linkplan.Problem.from_file("knee-reach", ["a=1"]), ProblemError, "settings must be a table"),
        (lambda: linkplan.Problem.from_file("knee-reach").replace(goal=1), ProblemError, "unknown argument 'goal'"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_in_one_sentence(make, error, words):
    with pytest.raises(error) as refused:
        make()
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
