"""The report of an experiment: its figures are the results', its commands run its samples again."""

import json

import numpy as np
import pytest

from linkplan.planner.search.planning import silent
from linkplan.studies.cli.main import main
from linkplan.studies.output.document import Code, Plot, Table
from linkplan.studies.report.reading import folder_report
from linkplan.studies.variations.experiment.experiment import Settings
from linkplan.studies.variations.experiment.experiment_blocks import estimated
from linkplan.studies.variations.experiment.experiment_sections import experiment_report
from linkplan.studies.variations.experiment.study import RESULTS, run_experiment
from tests.support.plans import optimal
from tests.support.reports import blocks

pytestmark = pytest.mark.slow
SETTINGS = Settings(trackers=("pd", "pd+ff"), samples=40, tube_deg=0.5)
# Rounding of a page's numbers, of the largest of their kind.
SHOWN = 1e-3


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of an experiment on the first hundredth of a second of the knee's reach."""
    target = tmp_path_factory.mktemp("experiment") / "tried"
    plan = optimal("knee-reach", "tracking.duration_s=0.01")
    run_experiment({"name": "knee-reach"}, None, lambda: plan, SETTINGS, target, silent)
    return target


@pytest.fixture(scope="module")
def outcome(folder):
    from linkplan.studies.variations.experiment.study import saved_outcome

    return saved_outcome(folder)


def test_the_trackers_table_has_the_means_and_their_intervals(outcome):
    table = next(table for table in blocks(experiment_report(outcome), Table) if table.title.startswith("Trackers"))
    heads = [head for head, _ in table.columns]
    for row, (name, one) in zip(table.rows, outcome.trackers.items(), strict=True):
        assert row[0] == name
        assert row[heads.index("rms error")] == estimated(one.means["rms_error_deg"])
        assert row[heads.index("success")] == pytest.approx(100 * one.success.value, rel=1e-2)
    assert len({row[heads.index("rms error")] for row in table.rows}) == 2


def test_a_distribution_s_line_is_the_share_of_machines_below(outcome):
    plot = next(plot for plot in blocks(experiment_report(outcome), Plot) if plot.title == "Rms error")
    assert plot.x_axis.unit == "deg"
    results = outcome.results
    for line in plot.series:
        values = results["rms_error_deg"][results["tracker"] == line.name].astype(float)
        for x, share in zip(line.x, line.y, strict=True):
            below, above = (100 * np.mean(values <= x * (1 + room)) for room in (-SHOWN, SHOWN))
            assert below - SHOWN <= share <= above + SHOWN
        assert line.y[-1] == 100


def test_the_worst_machines_are_those_of_the_largest_error_and_each_has_its_command(outcome):
    report = experiment_report(outcome, lambda tracker, sample: f"again {tracker} {sample}")
    table = next(table for table in blocks(report, Table) if table.title.startswith("Each tracker's worst"))
    commands = next(code.text.splitlines() for code in blocks(report, Code) if code.title.startswith("Commands that repeat"))
    results = outcome.results
    for name in SETTINGS.trackers:
        rows = [row for row in table.rows if row[0] == name]
        errors = np.sort(results["max_error_deg"][results["tracker"] == name].astype(float))[::-1]
        assert [row[2] for row in rows] == pytest.approx(errors[: len(rows)], rel=1e-3)
    assert commands == [f"again {row[0]} {row[1]}" for row in table.rows]


def test_a_page_of_a_folder_has_the_same_figures_and_leaves_the_results_alone(folder, outcome, tmp_path, capsys):
    before = (folder / RESULTS).read_bytes()
    assert main(["report", str(folder), "-o", str(tmp_path / "page.html"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["report"].endswith("page.html")
    page = (tmp_path / "page.html").read_text()
    assert f"linkplan track {folder} --sample {outcome.trackers['pd'].worst[0]} --tracker pd --report" in page
    assert (folder / RESULTS).read_bytes() == before
    titles = [section.title for section in folder_report(folder).sections]
    assert titles == [section.title for section in experiment_report(outcome).sections]


def test_a_sample_that_is_run_again_has_a_page_with_what_was_wrong_with_its_machine(folder, outcome, tmp_path, capsys):
    target = tmp_path / "again"
    main(["track", str(folder), "--sample", "3", "--tracker", "pd+ff", "-o", str(target), "--report"])
    assert capsys.readouterr().out
    document = json.loads((target / "report.json").read_text())
    table = next(block for section in document["sections"] for block in section["blocks"] if block["kind"] == "table")
    drawn = {row[0]: row[1] for row in table["rows"]}
    assert drawn["payload_mass_factor"] == pytest.approx(outcome.results["imperfection.payload_mass_factor"][6], rel=1e-5)
    assert (target / "report.html").is_file()
