"""Motions stated in other joints than the driven ones, planned there; durations and efforts of which nothing is said."""

import json

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.files.tables import read_tables
from linkplan.planner.plan.folder import record_of
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.batch import plan_cases
from linkplan.planner.search.batch_file import read_batch
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.output.plan_blocks import plan_blocks
from linkplan.studies.output.text import text_of
from tests.support.refusals import assert_refused

# The knee's reach said of the rocker C, whose motor is at O.
AT_C = {"kind": "reach", "start_deg": {"C": -20.0}, "goal_deg": {"C": 40.0}, "duration_s": 0.3}


def problem(motion: dict, model: str = "optimus-knee", **tables: dict) -> Problem:
    return Problem.from_tables("mine", {"mechanism": {"model": model}, "motion": motion} | tables)


def names(asked: Problem) -> list[str]:
    return [joint.name for joint in asked.mechanism.independent_joints]


def plan(asked: Problem) -> Plan:
    return plan_motion(asked).require()


def test_a_motion_of_a_joint_that_is_not_driven_is_planned_in_it_and_says_so():
    asked = problem(AT_C)
    assert names(problem(AT_C | {"start_deg": {"O": 0.0}, "goal_deg": {"O": 9.0}})) == ["O"]
    assert names(asked) == ["C"]
    (note,) = asked.notes
    assert "names C and not O" in note
    assert 'mechanism.independent = ["C"]' in note
    found = plan(asked)
    by_hand = plan(problem(AT_C, mechanism={"model": "optimus-knee", "independent": ["C"]}))
    assert found.objective == pytest.approx(by_hand.objective, rel=1e-9)
    assert f"note: {note}" in text_of(plan_blocks(found))
    assert record_of(found).notes == (note,)
    assert record_of(found).problem["mechanism"]["independent"] == ["C"]


def test_of_two_freedoms_one_may_be_named_by_a_dependent_joint():
    home = problem(
        {"kind": "reach", "start_deg": {"O1": -90.0, "O2": -90.0}, "goal_deg": {"O1": -90.0, "O2": -91.0}}, "five-bar"
    )
    P = np.degrees(home.mechanism.home[home.mechanism.joint_index("P")])
    asked = problem({"kind": "reach", "start_deg": {"O1": -90.0, "P": P}, "goal_deg": {"O1": -95.0, "P": P}}, "five-bar")
    assert names(asked) == ["O1", "P"]
    assert "not O2" in asked.notes[0]


def test_a_reference_of_another_joint_is_followed_there():
    sine = {"amplitude_deg": {"C": 10.0}, "bias_deg": {"C": 10.0}, "frequency_hz": 2.0}
    assert names(problem({"kind": "track"}, reference=sine)) == ["C"]


@pytest.mark.parametrize(
    ("motion", "mechanism", "words"),
    [
        (AT_C | {"goal_deg": {"O": 40.0}}, {}, ["has no value for the independent joint O"]),
        (AT_C, {"independent": ["O"]}, ["has no value for the independent joint O", 'mechanism.independent = ["C"]']),
        (AT_C, {"home_deg": {"O": 61.43327954622908}}, ["names C", "name O instead", "singular at home"]),
    ],
    ids=["start and goal of two joints", "coordinates named by hand", "a dead centre of the joint at home"],
)
def test_coordinates_that_are_not_plain_are_refused(motion, mechanism, words):
    assert_refused(lambda: problem(motion, mechanism={"model": "optimus-knee"} | mechanism), *words, kind=ProblemError)


def test_a_batch_whose_cases_name_different_joints_plans_each_in_its_own(tmp_path):
    first = {"start_deg": {"C": -20.0}, "goal_deg": {"C": 0.0}}
    toml = "\n".join(f"{key} = {{ C = {value['C']} }}" for key, value in first.items())
    (tmp_path / "reach.toml").write_text(
        f'[mechanism]\nmodel = "optimus-knee"\n[motion]\nkind = "reach"\nduration_s = 0.3\n{toml}\n', encoding="utf-8"
    )
    cases = (
        '[[case]]\nname = "c"\n[[case]]\nname = "o"\nset = ["motion.start_deg={ O = 0.0 }", "motion.goal_deg={ O = 9.0 }"]\n'
    )
    (tmp_path / "batch.toml").write_text(f'problem = "reach.toml"\n{cases}', encoding="utf-8")
    batch = read_batch(tmp_path / "batch.toml")
    plans = [found for _, found in plan_cases(batch, batch.case)]
    assert [found.status for found in plans] == ["optimal", "optimal"]
    assert [names(found.problem) for found in plans] == [["C"], ["O"]]


def test_a_duration_of_which_nothing_is_said_is_said_to_be_free():
    open_end = {key: value for key, value in AT_C.items() if key != "duration_s"}
    notes = problem(open_end).notes
    assert any("the duration is free (motion.duration_s sets it)" in note for note in notes)
    for said in ({"max_duration_s": 1.0}, {"duration_s": 0.3}):
        assert not any("duration_s" in note for note in problem(open_end | said).notes)
    assert not any("duration_s" in note for note in problem(open_end, objective={"minimize": "time"}).notes)
    for name in ("knee-reach", "knee-sine", "five-bar-swing-up"):
        assert load_problem(name).notes == ()


def test_the_notes_are_printed_where_there_is_no_motion_too():
    free = {key: value for key, value in AT_C.items() if key != "duration_s"}
    none = plan_motion(problem(free | {"max_duration_s": 1e-3, "start_speed_deg_s": {"C": 0.0}}))
    assert none.trajectory is None
    assert "note: the motion names C" in text_of(plan_blocks(none))
    assert json.dumps(record_of(none).notes)


def test_work_with_a_limit_on_the_effort_rate_needs_no_word_on_the_mesh():
    rated = ["objective.minimize=work", "limits.effort_rate.act_O=10000"]
    assert load_problem("knee-reach", rated[:1]).mesh.effort == "constant"
    asked = load_problem("knee-reach", rated)
    assert asked.mesh.effort == "linear"
    found = plan(asked)
    assert min(margin.left for margin in found.certificate.margins if margin.what == "effort_rate") >= 0
    assert found.objective > plan(load_problem("knee-reach", rated[:1])).objective  # the limit costs something
    assert_refused(lambda: load_problem("knee-reach", [*rated, "mesh.effort=constant"]), "got constant", kind=ProblemError)


def test_tables_are_not_changed_by_what_is_chosen():
    name, tables, _ = read_tables("knee-reach")
    tables["motion"] |= {"start_deg": {"C": -20.0}, "goal_deg": {"C": 40.0}}
    Problem.from_tables(name, tables)
    assert "independent" not in tables["mechanism"]
