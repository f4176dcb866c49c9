"""Tables of columns in Parquet: read back as they were written, and refused where they are others."""

import numpy as np
import pytest

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.columns import read_table, schema_of

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
    with pytest.raises(PlanFileError, match="2 rows; 3 were asked for"):
        read_table(written(tmp_path / "short.parquet", rows=2), KINDS, 3)
    with pytest.raises(PlanFileError, match="encoded by GZIP, which linkplan does not write"):
        read_table(written(tmp_path / "other.parquet", compression="gzip"), KINDS, 3)
    assert np.isfinite(read_table(written(tmp_path / "plain.parquet", compression="none"), KINDS, 3)["x"]).all()
