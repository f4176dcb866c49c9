"""Experiments' folders whose files were changed: each is refused in one line that names the file, before it is decoded."""

import json
import re
import shutil

import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.folders import plain_record
from linkplan.planner.search.planning import silent
from linkplan.studies.variations.experiment.experiment import Settings, request_of
from linkplan.studies.variations.experiment.study import (
    RECORD,
    RESULTS,
    conduct,
    read_results,
    run_experiment,
    saved_experiment,
    saved_outcome,
)
from linkplan.studies.variations.tasks import unfinished as parts
from linkplan.studies.variations.tasks.engine import serial
from tests.support.plans import optimal
from tests.support.refusals import assert_refused

SETTINGS = Settings(trackers=("pd", "pd+ff"), samples=6)
ROWS = 12


def plan():
    return optimal("knee-reach", "tracking.duration_s=0.01")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the folder of an experiment on the first hundredth of a second of the knee's reach."""
    target = tmp_path_factory.mktemp("experiment") / "tried"
    run_experiment({"name": "knee-reach"}, None, plan, SETTINGS, target, silent)
    return target


@pytest.fixture
def folder(whole, tmp_path):
    """Return a copy of the folder that may be changed."""
    return shutil.copytree(whole, tmp_path / "tried")


def column(name, change):
    """Return what changes the values of a column."""

    def act(table):
        place = table.schema.get_field_index(name)
        values = change(table[name].to_pylist())
        kind = table.schema.field(name).type
        return table.set_column(place, name, pa.array(values, kind))

    return act


def first(value):
    return lambda values: [value, *values[1:]]


def retyped(name, kind):
    return lambda table: table.set_column(table.schema.get_field_index(name), name, table[name].cast(kind))


def renamed(table):
    return table.rename_columns([name.replace("rms_error", "mean_error") for name in table.column_names])


DAMAGED = {
    "a column renamed": (renamed, "has other columns than the 26 of this table: mean_error_deg, rms_error_deg"),
    "columns in another order": (lambda table: table.select(table.column_names[::-1]), "their order"),
    "numbers in single precision": (retyped("chatter", pa.float32()), "chatter of type float; it is of type double"),
    "samples as numbers": (retyped("sample", pa.float64()), "sample of type double; it is of type int64"),
    "a row less": (lambda table: table.slice(1), "has 11 rows; 12 were expected"),
    "rows in another order": (lambda table: table.take(list(range(ROWS))[::-1]), "column sample is the experiment's"),
    "an unknown tracker": (column("tracker", first("lqr")), "column tracker is pd, pd+ff in turn; row 0 has lqr"),
    "a number that is missing": (column("rms_error_deg", first(None)), "column rms_error_deg lacks 1 values"),
    "a success that failed": (column("failure", first("it fell")), "column success is false where a run failed"),
    "another machine": (column("imperfection.delay_periods", first(1.1)), "the value by the experiment's seed"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_results_that_are_not_those_of_the_experiment_are_refused(case, folder):
    change, words = DAMAGED[case]
    parquet.write_table(change(parquet.read_table(folder / RESULTS)), folder / RESULTS)
    with pytest.raises(PlanFileError, match=re.escape(words)) as raised:
        saved_outcome(folder)
    assert str(folder / RESULTS) in str(raised.value)


def test_rows_beyond_those_asked_for_are_refused_before_a_column_is_decoded(folder, monkeypatch):
    """Run-length encoding makes 30 million rows of 3 MB."""
    table = parquet.read_table(folder / RESULTS).slice(0, 1).take([0] * 100_000)
    parquet.write_table(table, folder / RESULTS)
    assert (folder / RESULTS).stat().st_size < 100_000
    monkeypatch.setattr(parquet.ParquetFile, "read", lambda *_, **__: pytest.fail("a column was decoded"))
    assert_refused(lambda: saved_outcome(folder), "has 100000 rows; 12 were expected", kind=PlanFileError)


def test_texts_larger_than_rows_may_be_are_refused(folder):
    table = column("failure", lambda values: ["x" * 5_000_000 for _ in values])(parquet.read_table(folder / RESULTS))
    parquet.write_table(table, folder / RESULTS)
    with pytest.raises(PlanFileError, match=r"would take \d+ bytes; at most \d+ are read"):
        saved_outcome(folder)


def test_a_byte_of_the_results_that_was_flipped_is_refused_or_changes_nothing(folder, whole):
    content, experiment = (folder / RESULTS).read_bytes(), saved_experiment(whole)
    before = read_results(whole / RESULTS, experiment)
    for place in range(4, len(content), len(content) // 40):
        (folder / RESULTS).write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        try:
            now = read_results(folder / RESULTS, experiment)
        except PlanFileError:
            continue
        assert list(now) == list(before)
        assert all(len(now[name]) == ROWS for name in now)


def asked(change):
    def act(said):
        change(said["asked"])

    return act


RECORDS = {
    "nothing asked": (lambda said: said.pop("asked"), "missing required field `asked`"),
    "another format": (asked(lambda said: said.update(format=2)), "at `$.asked.format`"),
    "an unknown tracker": (asked(lambda said: said["settings"].update(trackers=["pid"])), "'pid'"),
    "other samples": (asked(lambda said: said["settings"].update(samples=7)), "has 12 rows; 14 were expected"),
    "another seed": (asked(lambda said: said["settings"].update(seed=1)), "the value by the experiment's seed"),
    "another design": (asked(lambda said: said["settings"].update(design="random")), "design"),
}


@pytest.mark.parametrize("case", RECORDS)
def test_a_record_that_is_not_that_of_the_results_is_refused(case, folder):
    change, words = RECORDS[case]
    said = json.loads((folder / RECORD).read_text())
    change(said)
    (folder / RECORD).write_text(json.dumps(said))
    with pytest.raises(PlanFileError, match=re.escape(words)) as raised:
        saved_outcome(folder)
    assert str(folder) in str(raised.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"asked": NaN}', "[" * 100_000])
def test_a_damaged_record_is_refused_and_nothing_is_lost(text, folder):
    (folder / RECORD).write_text(text)
    assert_refused(lambda: saved_experiment(folder), "experiment.json' is", kind=PlanFileError)
    with pytest.raises(PlanFileError, match=r"'experiment\.json', which is not as linkplan wrote"):
        run_experiment({"name": "knee-reach"}, None, plan, SETTINGS, folder, silent)
    assert (folder / RECORD).read_text() == text
    assert (folder / RESULTS).is_file()


def test_a_part_of_other_machines_is_refused_and_the_parts_are_kept(whole, tmp_path):
    target = tmp_path / "new"
    left = parts.unfinished(target)
    source = {"name": "knee-reach"}
    with parts.working(left, plain_record(request_of(source, None, SETTINGS, {})), "an experiment"):
        conduct(left, SETTINGS, {}, {}, plan, serial, silent)
    one = parts.part(left, 0, "parquet")
    parquet.write_table(column("sample", first(5))(parquet.read_table(one)), one)
    with pytest.raises(PlanFileError, match=r"part-00000\.parquet' holds no results of this experiment"):
        run_experiment(source, None, plan, SETTINGS, target, silent)
    assert one.is_file()
    assert not target.exists()
    one.unlink()
    run_experiment(source, None, plan, SETTINGS, target, silent)
    assert (target / RESULTS).read_bytes() == (whole / RESULTS).read_bytes()
