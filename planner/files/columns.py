"""Columns of samples as files: CSV for people, Parquet for programs; headers and schema contain units."""

import csv
import io
from collections.abc import Mapping

import numpy as np

from linkplan.models.extras import load_extra

# Column headers end in a unit; the first ending that fits counts.
_UNITS = {
    "_deg_s2": "deg/s2", "_deg_s": "deg/s", "_deg": "deg",
    "_m_s2": "m/s2", "_m_s": "m/s", "_m": "m",
    "_Nm": "N.m", "_N": "N", "time_s": "s",
}  # fmt: skip


def unit_of(head: str) -> str:
    """Return the unit of a column by its header: for "O_deg_s" it is deg/s, for "G_motor_knee [rad/rad]" it is rad/rad."""
    if head.endswith("]"):
        return head.rpartition("[")[2][:-1]
    return next((unit for ending, unit in _UNITS.items() if head.endswith(ending)), "1")


def csv_bytes(columns: Mapping[str, np.ndarray]) -> bytes:
    """Return columns (n,) as CSV with twelve digits, one row per sample."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    # Spreadsheets would read these headers as formulas.
    writer.writerow([f"'{head}" if head[:1] in "=+-@" else head for head in columns])
    writer.writerows([[f"{value:.12g}" for value in row] for row in np.column_stack(list(columns.values()))])
    return text.getvalue().encode("utf-8")


def parquet_bytes(columns: Mapping[str, np.ndarray], about: Mapping[str, str]) -> bytes:
    """Return columns (n,) as Parquet without rounding, with units in the fields' metadata and `about` in the schema's.

    Raises:
        MissingPackageError: when pyarrow is not installed.
    """
    pyarrow, parquet = load_extra("pyarrow", "Parquet"), load_extra("pyarrow.parquet", "Parquet")
    fields = [pyarrow.field(head, pyarrow.float64(), nullable=False, metadata={"unit": unit_of(head)}) for head in columns]
    schema = pyarrow.schema(fields, metadata=dict(about))
    arrays = [pyarrow.array(np.ascontiguousarray(column, dtype=float)) for column in columns.values()]
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), sink)
    return sink.getvalue().to_pybytes()
