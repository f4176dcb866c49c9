"""Pages on experiments and on causes of errors."""

import json

import msgspec
import numpy as np
import pytest

from linkplan.cli.main import main
from linkplan.planner.files.structs import read_value
from linkplan.planner.search.planning import silent
from linkplan.studies.output.document import Bars, Code, Plot, Table
from linkplan.studies.output.text import text_of
from linkplan.studies.report.reading import folder_report
from linkplan.studies.variations.decompose.decomposition import Decomposition, decomposition_charts
from linkplan.studies.variations.experiment.experiment import Settings
from linkplan.studies.variations.experiment.experiment_blocks import estimated
from linkplan.studies.variations.experiment.sensitivity import Sensitivity, sensitivity_blocks, sensitivity_charts
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
    table = next(table for table in blocks(outcome.document(), Table) if table.title.startswith("Trackers"))
    heads = [head for head, _ in table.columns]
    for row, (name, one) in zip(table.rows, outcome.trackers.items(), strict=True):
        assert row[0] == name
        assert row[heads.index("rms error")] == estimated(one.means["rms_error_deg"])
        assert row[heads.index("success")] == pytest.approx(100 * one.success.value, rel=1e-2)
    assert len({row[heads.index("rms error")] for row in table.rows}) == 2


def test_a_distribution_s_line_is_the_share_of_machines_below(outcome):
    plot = next(plot for plot in blocks(outcome.document(), Plot) if plot.title == "Rms error")
    assert plot.x_axis.unit == "deg"
    results = outcome.results
    for line in plot.series:
        values = results["rms_error_deg"][results["tracker"] == line.name].astype(float)
        for x, share in zip(line.x, line.y, strict=True):
            below, above = (100 * np.mean(values <= x * (1 + room)) for room in (-SHOWN, SHOWN))
            assert below - SHOWN <= share <= above + SHOWN
        assert line.y[-1] == 100


def test_the_worst_machines_are_those_of_the_largest_error_and_each_has_its_command(outcome):
    report = msgspec.structs.replace(outcome, again=lambda tracker, sample: f"again {tracker} {sample}").document()
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
    assert titles == [section.title for section in outcome.document().sections]


def test_a_sample_that_is_run_again_has_a_page_with_what_was_wrong_with_its_machine(folder, outcome, tmp_path, capsys):
    target = tmp_path / "again"
    main(["track", str(folder), "--sample", "3", "--tracker", "pd+ff", "-o", str(target), "--report"])
    assert capsys.readouterr().out
    document = json.loads((target / "report.json").read_text())
    table = next(block for section in document["sections"] for block in section["blocks"] if block["kind"] == "table")
    drawn = {row[0]: row[1] for row in table["rows"]}
    assert drawn["payload_mass_factor"] == pytest.approx(outcome.results["imperfection.payload_mass_factor"][6], rel=1e-5)
    assert (target / "report.html").is_file()


PARTS = {"plan": "discretisation of the plan", "sampling": "sampling and delay", "model": "model error: masses, lengths"}
SHARES = {"rms_error": 0.5, "parts": {"plan": 0.1, "sampling": -0.05, "model": 0.45}}
DECOMPOSED = msgspec.convert(
    {
        "decomposition": "reach",
        "machines": 4,
        "seed": 0,
        "imperfections": {},
        "control_period_s": 1e-3,
        "delay_periods": 0.0,
        "timestep_s": 1e-3,
        "duration_s": 0.2,
        "parts": PARTS,
        "trackers": {
            "lqr": {
                "machines": 4,
                "failures": {},
                "deg": {**SHARES, "parts_of_joints": {}, "rms_of_increment": {}, "rms_error_on_rung": {}},
            }
        },
    },
    Decomposition,
)


def record(by_value: tuple[float, float, float], by_distance: tuple[float, float, float]) -> Sensitivity:
    """Return a sensitivity of one tracker and metric to friction; value, low and high of each coefficient."""
    parts = zip(("by_value", "by_distance"), (by_value, by_distance), strict=True)
    effect = {name: {"value": value, "interval95": [low, high], "n": 30} for name, (value, low, high) in parts}
    one = {"explained": 0.9, "ranking": ["friction"], "effects": {"friction": effect}}
    said = {
        "imperfections": {"friction": {"unit": "N.m", "range": [0.0, 2.0]}},
        "metrics": {"rms_error_deg": {"text": "rms error", "unit": "deg"}},
        "trackers": {"lqr": {"rms_error_deg": one}},
    }
    return msgspec.convert(said, Sensitivity, dec_hook=read_value)


def chart(said: Sensitivity) -> Bars:
    (found,) = sensitivity_charts(said, "rms_error_deg")
    return found


def test_each_part_of_an_error_begins_where_the_one_before_ends_and_the_last_at_the_whole():
    (found,) = decomposition_charts(DECOMPOSED)
    parts = [row.spans[0] for row in found.rows[:-1]]
    assert [span.end - span.start for span in parts] == pytest.approx([0.1, -0.05, 0.45])
    assert [span.start for span in parts[1:]] == [span.end for span in parts[:-1]]
    assert parts[-1].end == pytest.approx(found.rows[-1].spans[0].end) == pytest.approx(0.5)
    assert found.axis.unit == "deg"
    assert [row.label for row in found.rows] == [
        "discretisation of the plan",
        "sampling and delay",
        "model error",
        "rms error",
    ]


def test_bars_of_an_influence_are_its_coefficients_with_their_intervals():
    (row,) = chart(record((-0.4, -0.5, -0.3), (0.6, 0.55, 0.7))).rows
    assert [(span.start, span.end, span.low, span.high) for span in row.spans] == [
        (0.0, -0.4, -0.5, -0.3),
        (0.0, 0.6, 0.55, 0.7),
    ]
    assert row.label == "friction, 0 to 2 N.m"


@pytest.mark.parametrize(
    ("by_value", "by_distance", "cell"),
    [
        ((-0.4, -0.5, -0.3), (0.1, 0.0, 0.2), "-0.40 ± 0.10"),
        ((-0.4, -0.5, -0.3), (0.6, 0.5, 0.7), "+0.60 ± 0.10 both"),
        ((0.4, -0.1, 0.9), (0.1, 0.05, 0.2), "-"),
    ],
)
def test_the_table_has_the_larger_coefficient_if_it_is_significant(by_value, by_distance, cell):
    lines = text_of(sensitivity_blocks(record(by_value, by_distance))).splitlines()
    (line,) = [line for line in lines if line.startswith("friction") and "rms" not in line]
    assert line.removeprefix("friction").strip() == cell
