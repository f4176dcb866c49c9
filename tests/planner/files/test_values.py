"""Values in TOML's syntax, trajectories and tables of columns: read back as they were written, or refused."""

import math
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkplan.models.errors import PlanFileError, ProblemError
from linkplan.planner.files.columns import read_table, read_trajectory, schema_of
from linkplan.planner.files.tables import inline, parse_value, toml_text


@pytest.mark.parametrize("value", [1.5, -2, True, math.inf, -math.inf, [1.0, -math.inf], "two words"])
def test_a_value_is_read_back_from_one_line(value):
    assert parse_value(inline(value), "key") == value


def test_no_number_is_read_back_as_none():
    assert inline(math.nan) == "nan"
    assert math.isnan(parse_value("nan", "key"))


def test_a_setting_is_one_value_and_no_further_line():
    assert parse_value("[1, 2]", "key") == [1, 2]
    assert parse_value("bare", "key") == "bare"
    with pytest.raises(ProblemError):
        parse_value("1\nother = 2", "key")


@pytest.mark.parametrize("name", ["position", "velocity", "effort"])
@pytest.mark.parametrize(("coefficients", "intervals", "legal"), [(24, 20_000, True), (25, 1, False), (2, 20_001, False)])
def test_at_most_20000_polynomials_of_24_coefficients_are_read(tmp_path, name, coefficients, intervals, legal):
    arrays = {key: np.zeros((2, intervals, 1)) for key in ("position", "velocity", "effort")}
    arrays[name] = np.zeros((coefficients, intervals, 1))
    path = tmp_path / "trajectory.npz"
    np.savez(path, breaks_s=np.arange(intervals + 1.0), start_pose=np.zeros(1), periodic=False, **arrays)
    if legal:
        assert len(getattr(read_trajectory(path), name)) == coefficients
    else:
        with pytest.raises(
            PlanFileError, match=f"{intervals} intervals of {coefficients} coefficients; at most 20000 of 24"
        ):
            read_trajectory(path)


pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

KINDS = {"x": "number", "k": "count", "passed": "flag", "why": "word"}
VALUES = {"x": [1.5, -2.25, 1e-300], "k": [3, 0, -7], "passed": [True, False, True], "why": ["late", None, "late"]}


def written(path, *, compression: str = "snappy", rows: int = 3):
    table = pa.table({name: values[:rows] for name, values in VALUES.items()}, schema=schema_of(KINDS))
    parquet.write_table(table, path, compression=compression)
    return path


def test_columns_are_read_back_and_missing_words_are_none(tmp_path):
    found = read_table(written(tmp_path / "table.parquet"), KINDS, 3)
    assert {name: values.tolist() for name, values in found.items()} == VALUES


def test_a_table_of_other_rows_or_encodings_is_refused(tmp_path):
    with pytest.raises(PlanFileError, match="2 rows; 3 were expected"):
        read_table(written(tmp_path / "short.parquet", rows=2), KINDS, 3)
    with pytest.raises(PlanFileError, match="encoded by GZIP, which linkplan does not write"):
        read_table(written(tmp_path / "other.parquet", compression="gzip"), KINDS, 3)
    assert np.isfinite(read_table(written(tmp_path / "plain.parquet", compression="none"), KINDS, 3)["x"]).all()


WORDS = st.text(st.characters(exclude_categories=("Cs",)), max_size=12)
NUMBERS = st.one_of(st.booleans(), st.integers(-(2**62), 2**62), st.floats(allow_nan=False))
TOML_VALUES = st.recursive(
    st.one_of(NUMBERS, WORDS),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(WORDS, inner, max_size=3)),
    max_leaves=8,
)


@given(st.dictionaries(WORDS, st.one_of(NUMBERS, WORDS, st.dictionaries(WORDS, TOML_VALUES, max_size=4)), max_size=4))
def test_any_tables_are_read_back_as_they_were(tables):
    assert tomllib.loads(toml_text(tables)) == tables


def test_not_a_number_is_written_too():
    assert math.isnan(tomllib.loads(f"x = {inline(math.nan)}")["x"])


def test_a_text_of_several_lines_keeps_its_lines():
    model = "<mujoco>\n  <worldbody/>\n</mujoco>\n"
    text = toml_text({"mechanism": {"model": model}})
    assert "\n  <worldbody/>\n" in text
    assert tomllib.loads(text)["mechanism"]["model"] == model


def test_what_toml_has_no_form_for_is_refused_by_its_key():
    with pytest.raises(ProblemError, match=r"motion\.start_deg\.O must be numbers, words, lists or tables, got None"):
        toml_text({"motion": {"start_deg": {"O": None}}})
