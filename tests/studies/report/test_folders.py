"""Reports of folders: what was saved is read, what is lacking is said, what is no result is refused."""

import json
import re
import tomllib

import numpy as np
import pytest

import linkplan
from linkplan.cli.main import main
from linkplan.models.errors import PlanFileError
from linkplan.models.library import built_in_text
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import failed
from linkplan.studies.output.document import Checklist, Code, Report, Table
from linkplan.studies.output.plan_sections import plan_report
from linkplan.studies.output.report_file import DOCUMENT, document_json, save_report, write_report
from linkplan.studies.report.reading import folder_report
from tests.support.plans import optimal, saved_plan
from tests.support.reports import blocks


def test_a_saved_plan_s_report_is_the_plan_s(tmp_path):
    here, there = plan_report(optimal("knee-reach")), folder_report(saved_plan("knee-reach", tmp_path))
    assert [section.title for section in there.sections] == [section.title for section in here.sections]
    assert blocks(there, Table)[0].rows == blocks(here, Table)[0].rows  # the solves
    assert [item.passed for item in blocks(there, Checklist)[0].items] == [
        i.passed for i in blocks(here, Checklist)[0].items
    ]


def test_a_saved_document_is_read_again(tmp_path):
    report = plan_report(optimal("knee-reach"))
    save_report(report, tmp_path, page=True)
    assert (tmp_path / "report.html").is_file()
    again = folder_report(tmp_path)
    assert isinstance(again, Report)
    assert json.loads(document_json(again)) == json.loads(document_json(report))


@pytest.mark.slow
def test_the_problem_of_a_page_plans_for_its_receiver_who_has_the_model_beside_it(tmp_path):
    sender, receiver = tmp_path / "sender", tmp_path / "receiver"
    sender.mkdir()
    receiver.mkdir()
    model = built_in_text("optimus-knee")
    (sender / "leg.xml").write_text(model)
    problem = linkplan.Problem.reach(str(sender / "leg.xml"), start_deg={"O": -10}, goal_deg={"O": 10}, duration_s=0.2)
    (code,) = [one for one in blocks(plan_report(linkplan.plan(problem)), Code) if "problem" in one.title]
    assert "# Needs leg.xml in its folder." in code.text
    assert str(tmp_path) not in code.text
    (receiver / "leg.xml").write_text(model)
    (receiver / "received.toml").write_text(code.text)
    (sender / "leg.xml").unlink()
    assert linkplan.plan(linkplan.Problem.from_file(receiver / "received.toml")).status == "optimal"


@pytest.mark.parametrize("name", ["notes.txt", "tune.json"])
def test_a_folder_of_something_else_or_of_version_1_0_is_refused_in_one_line(name, tmp_path):
    (tmp_path / name).write_text("{}")
    with pytest.raises(PlanFileError, match=r"has no report\.json of a linkplan result; version 1\.0 did not write"):
        folder_report(tmp_path)


WITH_SECTIONS = '{"title": "t", "verdict": "v", "versions": {}, "passed": null, "sections": %s}'
WITH_BLOCK = WITH_SECTIONS % '[{"title": "s", "blocks": [%s]}]'
LONG_LINE = '{"kind": "plane", "title": "", "x_axis": %s, "y_axis": %s, "curves": [{"name": "", "x": [1], "y": [1, 2]}]}'
AXIS = '{"label": "", "unit": "1"}'
DAMAGED = {
    "cut off": ("{", "truncated or not JSON"),
    "a list": ("[]", "Expected `object`, got `array`"),
    "a title that is a number": ('{"title": 1}', "at `$.title`"),
    "a section that is a number": (WITH_SECTIONS % "[1]", "at `$.sections[0]`"),
    "a block without a kind": (WITH_BLOCK % "{}", "missing required field `kind`"),
    "a block of another kind": (WITH_BLOCK % '{"kind": "film"}', "Invalid value 'film'"),
    "a text that is a number": (WITH_BLOCK % '{"kind": "text", "text": 1}', "Expected `str`, got `int`"),
    "a cell that is a list": (WITH_BLOCK % '{"kind": "table", "title": "", "columns": [], "rows": [[[]]]}', "got `array`"),
    "a row that is too short": (
        WITH_BLOCK % '{"kind": "table", "title": "", "columns": [["a", ""]], "rows": [[]]}',
        "0 values",
    ),
    "a line that is too long": (WITH_BLOCK % (LONG_LINE % (AXIS, AXIS)), "2 values for 1 places"),
    "nested without end": (WITH_SECTIONS % ("[" * 900 + "]" * 900), "Expected `object`, got `array`"),
    "a number that is none": (WITH_BLOCK % '{"kind": "text", "text": NaN}', "truncated or not JSON"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_damaged_document_is_refused(case, tmp_path):
    text, words = DAMAGED[case]
    (tmp_path / DOCUMENT).write_text(text)
    with pytest.raises(PlanFileError, match=re.escape(words)):
        folder_report(tmp_path)


def test_a_file_that_is_no_report_is_not_replaced(tmp_path):
    mine = tmp_path / "mine.html"
    mine.write_text("<p>mine</p>")
    with pytest.raises(PlanFileError, match="exists and was not written by linkplan"):
        write_report(plan_report(optimal("knee-reach")), mine)
    assert mine.read_text() == "<p>mine</p>"


def test_an_earlier_report_is_replaced(tmp_path):
    path = tmp_path / "report.html"
    path.write_text('<!doctype html><meta name="generator" content="linkplan">')
    write_report(plan_report(optimal("knee-reach")), path)
    assert "knee-reach" in path.read_text()


def test_a_page_without_a_folder_to_stand_in_is_refused_before_any_work(capsys):
    assert main(["plan", "knee-reach", "--report"]) == 2
    assert "--report writes report.html into the folder of -o; add -o DIR" in capsys.readouterr().err


def test_the_command_makes_a_page_of_a_plan_s_folder(tmp_path, capsys):
    folder = saved_plan("knee-reach", tmp_path)
    assert main(["report", str(folder), "-o", str(tmp_path / "page.html"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["bytes"] == (tmp_path / "page.html").stat().st_size


@pytest.mark.slow
def test_check_writes_the_page_that_is_asked_for(tmp_path, capsys):
    assert main(["check", "slider-crank", "-o", str(tmp_path / "checked"), "--report"]) == 0
    assert capsys.readouterr().out
    assert {path.name for path in (tmp_path / "checked").iterdir()} >= {"check.json", "report.html", "report.json"}


@pytest.mark.parametrize("name", ["plan.json", "report.json", "experiment.json"])
def test_a_record_that_is_too_large_is_refused_before_it_is_decoded(name, tmp_path):
    (tmp_path / name).write_text("{}" + " " * 65_000_000)
    with pytest.raises(PlanFileError, match=r"has 65000002 bytes; at most \d+ are read"):
        folder_report(tmp_path)


def test_the_problem_of_a_page_has_its_infinite_limits():
    limits = {"site": {"C": {"z": [-9.0, np.inf]}}, "effort": {"act_O": [-np.inf, 90.0]}}
    ends = {"start_deg": {"O": -10}, "goal_deg": {"O": 10}, "duration_s": 0.2}
    problem = linkplan.Problem.reach("optimus-knee", **ends, limits=limits)
    plan = Plan(problem=problem, verdict=failed("there is none"))
    (code,) = [one for one in blocks(plan_report(plan), Code) if "problem" in one.title]
    assert tomllib.loads(code.text)["limits"] == limits
