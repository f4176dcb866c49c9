"""Reports of folders: what was saved is read, what is lacking is said, what is no result is refused."""

import json

import pytest

from linkplan.models.errors import PlanFileError
from linkplan.studies.cli.main import main
from linkplan.studies.report.document import Checklist, Table, Text
from linkplan.studies.report.reading import folder_report
from linkplan.studies.report.render import write_report
from linkplan.studies.report.reports import plan_report
from linkplan.studies.report.saving import DOCUMENT, save_report
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
    assert folder_report(tmp_path)["title"] == report.title


def test_a_folder_of_an_earlier_version_shows_its_figures_and_says_what_lacks(tmp_path):
    points = [{"position_deg": 10.0, "stable": True}, {"position_deg": 20.0, "stable": False}]
    (tmp_path / "tune.json").write_text(json.dumps({"found": True, "mechanism": "knee", "message": "m", "points": points}))
    report = folder_report(tmp_path)
    assert any("need the command to be run again" in text.text for text in blocks(report, Text))
    (table,) = blocks(report, Table)
    assert table.rows == [[10.0, True], [20.0, False]]


def test_a_folder_of_something_else_is_refused_in_one_line(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(PlanFileError, match="holds no result of linkplan's"):
        folder_report(tmp_path)


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"title": 1}', '{"title": "t", "verdict": "v", "versions": {}, "sections": [1]}']
)
def test_a_damaged_document_is_refused(tmp_path, text):
    (tmp_path / DOCUMENT).write_text(text)
    with pytest.raises(PlanFileError, match="is no report"):
        folder_report(tmp_path)


def test_a_file_that_is_no_report_is_not_replaced(tmp_path):
    mine = tmp_path / "mine.html"
    mine.write_text("<p>mine</p>")
    with pytest.raises(PlanFileError, match="is no report of linkplan's"):
        write_report(plan_report(optimal("knee-reach")), mine)
    assert mine.read_text() == "<p>mine</p>"


def test_an_earlier_report_is_replaced(tmp_path):
    path = tmp_path / "report.html"
    path.write_text('<!doctype html><meta name="generator" content="linkplan">')
    write_report(plan_report(optimal("knee-reach")), path)
    assert "knee-reach" in path.read_text()


def test_a_page_without_a_folder_to_stand_in_is_refused_before_any_work(capsys):
    assert main(["plan", "knee-reach", "--report"]) == 2
    assert "--report writes report.html into the folder of -o, and there is none" in capsys.readouterr().err


def test_the_command_makes_a_page_of_a_plan_s_folder(tmp_path, capsys):
    folder = saved_plan("knee-reach", tmp_path)
    assert main(["report", str(folder), "-o", str(tmp_path / "page.html"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["bytes"] == (tmp_path / "page.html").stat().st_size


@pytest.mark.slow
def test_check_writes_the_page_that_is_asked_for(tmp_path, capsys):
    assert main(["check", "slider-crank", "-o", str(tmp_path / "checked"), "--report"]) == 0
    assert capsys.readouterr().out
    assert {path.name for path in (tmp_path / "checked").iterdir()} >= {"check.json", "report.html", "report.json"}


WITH_MORE = '{"title": "a", "verdict": "b", "versions": {}, "passed": null, "sections": [], "more": %s}'


@pytest.mark.parametrize("value", ["NaN", "1e999", "-Infinity"])
def test_numbers_that_are_none_in_a_record_or_a_document_are_no_fault(value, tmp_path):
    for name, text in (("bode.json", f'{{"points": [{{"gain": {value}}}]}}'), ("report.json", WITH_MORE % value)):
        folder = tmp_path / name.partition(".")[0]
        folder.mkdir()
        (folder / name).write_text(text)
        write_report(folder_report(folder), tmp_path / "report.html")
        assert (tmp_path / "report.html").is_file()


def test_a_document_nested_deeper_than_anything_meant_is_refused(tmp_path):
    (tmp_path / "report.json").write_text(WITH_MORE % ("[" * 900 + "]" * 900))
    with pytest.raises(PlanFileError, match="no report"):
        folder_report(tmp_path)
