"""The JSON Schema: takes what the reader takes, refuses every fault of form, and says what each key means."""

import copy
import json
import re
import tomllib
from functools import cache
from pathlib import Path
from typing import get_args

import jsonschema
import msgspec
import pytest

from linkplan.cli.main import main
from linkplan.models.errors import LinkplanError
from linkplan.planner.files.tables import BUILT_IN, apply_override, built_in_text
from linkplan.planner.problem.keys.key_table import json_schema, key_table
from linkplan.planner.problem.keys.kinds import Term
from linkplan.planner.problem.keys.motion import MotionSection
from linkplan.planner.problem.keys.phases import PhasedFile
from linkplan.planner.problem.keys.reading import KEYS, kind_of
from linkplan.planner.problem.keys.sections import ProblemFile
from linkplan.planner.problem.objective import TERMS
from linkplan.planner.problem.problem import Problem

DOCS = Path(__file__).resolve().parents[3] / "docs" / "problem-files.md"
EXAMPLES = re.findall(r"```toml\n(.*?)```", DOCS.read_text(encoding="utf-8"), flags=re.DOTALL)


@cache
def validator(file: str = "problem") -> jsonschema.Draft202012Validator:
    schema = json_schema(file)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def tables(*overrides: str, problem: str = "knee-reach") -> dict:
    found = tomllib.loads(built_in_text(problem))
    for override in overrides:
        apply_override(found, override)
    return found


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_built_in_problem_is_taken(name):
    validator().validate(tables(problem=name))


@pytest.mark.parametrize("text", [text for text in EXAMPLES if "[motion]" in text])
def test_every_problem_of_the_documents_is_taken(text):
    validator().validate(tomllib.loads(text))


@pytest.mark.parametrize("text", [text for text in EXAMPLES if "[sweep]" in text])
def test_every_batch_of_the_documents_is_taken(text):
    validator("batch").validate(tomllib.loads(text))


def test_the_list_of_motors_of_the_documents_is_taken():
    text = (DOCS.parent / "motors.md").read_text(encoding="utf-8")
    (listed,) = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    validator("motors").validate(tomllib.loads(listed))


def test_there_are_examples_of_both():
    assert sum("[motion]" in text for text in EXAMPLES) >= 2
    assert sum("[sweep]" in text for text in EXAMPLES) >= 1


# What the reader takes of knee-reach, beyond what the built-in problems and the documents say.
GOOD = [
    "motion.duration_s=free",
    "motion.waypoints=[{ at_deg = { O = 0 } }, { speed_deg_s = { O = 500.0 }, time_s = 0.1 }]",
    "mechanism.payload={ body = 'rocker', mass_kg = 2, com_m = [0, 0, 0.1] }",
    "mechanism.payload=none",
    "mechanism.independent=['O']",
    "objective.minimize={ effort = 1, work = 0.5 }",
    "limits.effort={ act_O = [-inf, 50] }",
    "limits.speed_deg_s={ A = 900, O = [-1, 2] }",
    "motors.act_O={ torque_constant = 0.5, resistance_ohm = 0.1 }",
    "guess.path_deg={ O = [-49.07, 0, 56.27] }",
    "mesh.breaks=[0, 0.5, 1]",
    "mesh.tolerance_deg=1e-9",
    "tracking.kp={ O = 200 }",
    "tracking.delay_periods=2",
    "robust.viscous_friction={ O = [0, 0.1] }",
    "imperfections.delay_periods={ uniform = [0.5, 1.5] }",
    "imperfections.torque_constant_factor={ normal = [1.0, 0.001] }",
    "imperfections.coulomb_friction={ O = [0, 2], A = 0.05, C = { normal = [1, 0.1] } }",
]


@pytest.mark.parametrize("override", GOOD)
def test_what_the_reader_takes_is_taken(override):
    asked = tables(override)
    validator().validate(asked)
    assert Problem.from_tables("asked", asked).name == "asked"


def test_a_push_is_taken():
    asked = tables(
        "imperfections.push_body=crank", "imperfections.push_force_x_n=[-1, 1]", "imperfections.push_duration_s=1"
    )
    validator().validate(asked)
    assert Problem.from_tables("asked", asked).name == "asked"


# Faults of form, each refused by the reader too.
FAULTS = [
    "motion.goal=3",
    "objective.minimize={}",
    "objective.minimize={ effort = 0.0 }",
    "mesh.scheme=radu-3",
    "mechanism.payload=shnk",
    "mechanism.model=3",
    "motion.goal_deg=3",
    "motion.goal_deg.O=1e6",
    "motion.duration_s=fre",
    "motion.duration_s=1e6",
    "motion.waypoints={ at_deg = { O = 0 } }",
    "motion.waypoints=[{ by = { O = 0 } }]",
    "motion.goal_at.foot=[0.3, 0.2]",
    "motion.turns.O=0.5",
    "reference.frequency_hz=0",
    "limits.effort.act_O=[1, 2, 3]",
    "limits.power_w=5",
    "limits.singular_margin=1.0",
    "limits.contacts=no",
    "limits.site.foot={ normal = [0, 0, 1] }",
    "limits.site.foot={ normal = [0, 0, 1], at = [0, 0, 0], z = [0, 1] }",
    "limits.site.foot={ along = [[0, 0, 0]], radius_m = 1 }",
    "motors.act_O={ torque_constant = 5 }",
    "guess.path=[1, 2]",
    "guess.path_deg.O=[1]",
    "mesh.intervals=2.5",
    "mesh.breaks=[0, 0.5]",
    "solver.name=ipopt",
    "tracking.delay_periods=1001",
    "robust.payload_factor=1.1",
    "imperfections.delay_periods=[0.5]",
    "imperfections.delay_periods={ O = 1 }",
    "imperfections.delay_periods={ normal = [1, -1] }",
    "imperfections.coulomb_friction={ uniform = [0, 1], normal = [0, 1] }",
    "imperfections.coulomb_friction={ O = [0, 1, 2] }",
]
# Refused by the reader alone: a schema knows no mechanism, not what goes with what, no NaN, and takes 40.0 for whole.
BEYOND = [
    "motion.goal_deg.K=3",
    "limits.effort.act_K=[-1, 1]",
    "mechanism.model=optimus-kne",
    "mechanism.payload.inertia_kgm2=[1, 0, 0]",
    "limits.range_deg.O=[-95, 95]",
    "mesh.breaks=[0, 0.6, 0.4, 1]",
    "objective.minimize=time",
    "motion.goal_deg={}",
    "motion.start_deg.A=20",
    "motors.act_O={ stall_effort = 5 }",
    "tracking.delay_periods=1.5",
    "motion.goal_deg.O=nan",
    "mesh.intervals=40.0",
    "mechanism.closure_tolerance_m=9",
    "robust.payload_factor=[1.2, 0.8]",
    "imperfections.push_body=crank",
]


@pytest.mark.parametrize("override", FAULTS)
def test_a_fault_of_form_is_refused_without_a_mechanism(override):
    assert not validator().is_valid(tables(override))


@pytest.mark.slow
def test_the_faults_of_form_are_the_reader_s_too():
    for override in FAULTS:
        with pytest.raises(LinkplanError):
            Problem.from_tables("asked", tables(override))


@pytest.mark.slow
def test_what_is_beyond_a_schema_is_left_to_the_reader():
    for override in BEYOND:
        assert validator().is_valid(tables(override)), override
        with pytest.raises(LinkplanError):
            Problem.from_tables("asked", tables(override))


def test_its_keys_are_the_reader_s():
    schema = json_schema()
    assert set(schema["properties"]) - {"description"} == set(KEYS)
    for section, keys in KEYS.items():
        if section not in ("motors", "parameters"):  # tables by name
            part = schema["$defs"][schema["properties"][section]["$ref"].rpartition("/")[2]]
            assert tuple(part["properties"]) == keys
            assert part["additionalProperties"] is False


def test_units_words_and_defaults_are_said():
    parts = json_schema()["$defs"]
    assert parts["MotionSection"]["properties"]["start_deg"]["x-unit"] == "deg"
    assert set(parts["MotionSection"]["properties"]["kind"]["enum"]) == {"reach", "hold", "periodic", "track", "follow"}
    assert parts["SolverSection"]["properties"]["starts"]["default"] == 1
    assert "default" not in parts["MotionSection"]["properties"]["start_deg"]


def test_every_key_of_the_table_is_described_and_has_a_default_where_it_may_be_left_out():
    rows = (*key_table(), *key_table(PhasedFile))
    assert {row.section for row in rows} >= {
        "",
        "motion",
        "motion.waypoints[]",
        "motors.NAME",
        "mechanism.payload",
        "phases[]",
    }
    for row in rows:
        assert row.doc, row.name
        assert row.type, row.name
        assert bool(row.default_words) != row.required, row.name
        assert "None" not in row.default_words, row.name


def test_every_key_stands_in_the_documents_itself_or_as_its_twin_or_along_x():
    pages = "".join(
        (DOCS.parent / f"{name}.md").read_text(encoding="utf-8") for name in ("mechanisms", "experiments", "phases")
    )
    named = set(re.findall(r"\w+", DOCS.read_text(encoding="utf-8") + pages))
    twins = {re.sub("_deg", "_m", name) for name in named} | {
        re.sub("_x_", axis, name) for name in named for axis in ("_y_", "_z_")
    }
    assert not {row.name for kind in (ProblemFile, PhasedFile) for row in key_table(kind)} - named - twins


def test_the_table_s_defaults_are_what_the_reader_puts_in():
    for row in key_table():
        if row.section in KEYS and row.default is not None:
            required = {"path": {"site": "foot"}, "mechanism": {"model": "m.xml"}}.get(row.section, {})
            section = msgspec.convert(required, kind_of(row.section))
            assert getattr(section, row.name) == row.default


def test_no_word_of_a_message_is_missing():
    """Every kind has words of its own: those of a default that is left out are no kind's."""
    assert all(row.type not in ("a table", "a list") for row in key_table() if row.section)
    assert msgspec.convert({"kind": "reach"}, MotionSection).duration_s is None


def test_the_objective_s_terms_are_those_that_have_words():
    assert set(get_args(Term)) == set(TERMS)


@pytest.mark.parametrize(
    ("override", "meant"),
    [
        ("limits.torque=3", "effort"),
        ("motion.time=3", "duration_s"),
        ("objective.cost=3", "minimize"),
        ("robot.model=3", "mechanism"),
    ],
)
def test_a_synonym_is_answered_with_the_key_that_it_means(override, meant):
    with pytest.raises(LinkplanError, match=f"did you mean '{meant}'"):
        Problem.from_tables("asked", tables(override))


def test_reading_changes_no_table():
    asked = tables("limits.effort={ act_O = [-50, 50] }")
    before = copy.deepcopy(asked)
    msgspec.convert(asked, ProblemFile)
    assert asked == before


def test_the_command_writes_what_it_prints(tmp_path, capsys):
    assert main(["schema"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert main(["schema", "-o", str(tmp_path / "linkplan.json")]) == 0
    assert capsys.readouterr().out == ""
    assert json.loads((tmp_path / "linkplan.json").read_text(encoding="utf-8")) == printed == json_schema()
    assert [path.name for path in tmp_path.iterdir()] == ["linkplan.json"]


def test_an_earlier_schema_is_replaced_and_no_other_file(tmp_path, capsys):
    earlier, others = tmp_path / "linkplan.json", [tmp_path / "notes.txt", tmp_path / "others.json"]
    for place, text in zip(others, ("mine", '{"$schema": "of others"}'), strict=True):
        place.write_text(text, encoding="utf-8")
        assert main(["schema", "-o", str(place)]) == 2
        assert "exists and was not written by linkplan" in capsys.readouterr().err
        assert place.read_text(encoding="utf-8") == text
    assert main(["schema", "-o", str(tmp_path)]) == 2
    assert "is a folder; the result must be a file" in capsys.readouterr().err
    assert main(["schema", "batches"]) == 2
    assert "did you mean 'batch'" in capsys.readouterr().err
    assert main(["schema", "batch", "-o", str(earlier)]) == 0
    assert main(["schema", "-o", str(earlier)]) == 0
    assert json.loads(earlier.read_text(encoding="utf-8"))["title"] == "linkplan problem file"
