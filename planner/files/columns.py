"""Columns of samples as files: CSV for people, Parquet for programs, with units in the names; and `trajectory.npz`.

Run-length and dictionary encodings of Parquet can expand 3 MB to 30 million rows. The metadata of a file that is read back
(schema, rows, bytes, encodings) are therefore checked before a column is decoded, and texts stay dictionary-encoded until
rows are read.

Members of zip archives are read only up to their declared size, because 8 MB can hold 8 GB of zeros.
"""

import csv
import io
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from linkplan.models.errors import PlanFileError, ProblemError, one_line, shown
from linkplan.models.extras import load_extra
from linkplan.models.reading import MAX_FILE_BYTES, read_file
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.scheme_names import MAX_INTERVALS

ARRAYS, ALONG = ("breaks_s", "position", "velocity", "effort", "start_pose"), "along"
# Twice the coefficients of the highest degree: on the largest mesh, more would need gigabytes.
_MAX_COEFFICIENTS = 24
# The units in which column headers end; the first one that fits counts.
_UNITS = ("deg/s3", "deg/s2", "deg/s", "deg", "m/s3", "m/s2", "m/s", "m", "N.m", "N")
Kind = Literal["number", "count", "flag", "word"]
# The encodings of pyarrow's defaults. Others can expand to sizes that the metadata do not state.
_ENCODINGS, _COMPRESSIONS = {"PLAIN", "RLE", "RLE_DICTIONARY", "PLAIN_DICTIONARY"}, {"SNAPPY", "UNCOMPRESSED"}


def read_member(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """Return the bytes of an archive's member.

    Raises:
        ValueError: if it declares more than `max_bytes`, or its number of bytes differs from the declared one.
    """
    declared = archive.getinfo(name).file_size
    if declared > max_bytes:
        raise ValueError(f"{name} would take {declared} bytes; at most {max_bytes} are read")
    with archive.open(name) as file:
        content = file.read(declared)
    if len(content) != declared:
        raise ValueError(f"{name} holds {len(content)} bytes and declares {declared}")
    return content


def read_trajectory(path: Path) -> Trajectory:
    """Return the trajectory in a file.

    Raises:
        PlanFileError: if the file is missing, truncated or not a trajectory.
    """
    try:
        content = read_file(path, f"'{path}'", MAX_FILE_BYTES, PlanFileError)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            held = archive.namelist()
            lacking = [name for name in (*ARRAYS, "periodic") if f"{name}.npy" not in held]
            if lacking:
                raise PlanFileError(f"'{path}' lacks an array: {lacking[0]}")
            periodic = _array(archive, "periodic", bool)
            if periodic.size != 1:
                raise ValueError(f"periodic must be one word, got {periodic.size}")
            arrays = {name: _array(archive, name, float) for name in (*ARRAYS, ALONG) if f"{name}.npy" in held}
            trajectory = Trajectory(**arrays, periodic=bool(periodic.ravel()[0]))
            n, most = len(trajectory.breaks_s) - 1, max(len(of) for of in arrays.values() if of.ndim == 3)
            if n > MAX_INTERVALS or most > _MAX_COEFFICIENTS:
                raise ValueError(
                    f"it has {n} intervals of {most} coefficients; at most {MAX_INTERVALS} of {_MAX_COEFFICIENTS} are read"
                )
            if trajectory.breaks_s[0] != 0:
                raise ValueError(f"its breaks_s begin at {trajectory.breaks_s[0]:.9g} s, and a saved motion begins at 0")
            return trajectory
    except PlanFileError:
        raise
    except Exception as error:  # the parsers of zip files and headers raise about fifteen types of errors on damaged bytes
        why = one_line(error) or type(error).__name__
        raise PlanFileError(f"'{path}' is truncated or not a trajectory: {why}") from error


def _array(archive: zipfile.ZipFile, name: str, wanted: type) -> np.ndarray:
    """Return an array of an npz file.

    Raises:
        ValueError: when it has another type, or its header does not match its length.
    """
    content = read_member(archive, f"{name}.npy", MAX_FILE_BYTES)
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if read_header is None:
        raise ValueError(f"{name} has a header of version {version}")
    shape, fortran, kind = read_header(file)
    if kind != np.dtype(wanted):
        raise ValueError(f"{name} holds {kind}, not {np.dtype(wanted)}")
    size = math.prod(int(length) for length in shape) * kind.itemsize
    if any(length < 0 for length in shape) or size != len(content) - file.tell():
        raise ValueError(f"{name} is of shape {shape}, {size} bytes, and holds {len(content) - file.tell()}")
    return np.frombuffer(content, dtype=kind, offset=file.tell()).reshape(shape, order="F" if fortran else "C")


def head_of(name: str, unit: str) -> str:
    """Return the header of a column: "O_deg_s" for O in deg/s, "act_O_Nm" for act_O in N.m."""
    return f"{name}_{unit.replace('.', '').replace('/', '_')}"


def unit_of(head: str) -> str:
    """Return the unit of a column by its header: for "O_deg_s" it is deg/s, for "G_motor_knee [rad/rad]" it is rad/rad."""
    if head.endswith("]"):
        return head.rpartition("[")[2][:-1]
    ends = (unit for unit in _UNITS if head.endswith(head_of("", unit)))
    return "s" if head.endswith("time_s") else next(ends, "1")


def csv_bytes(columns: Mapping[str, np.ndarray]) -> bytes:
    """Return columns (n,) as CSV with twelve digits, one row per sample."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    # Spreadsheets would read these headers as formulas.
    writer.writerow([f"'{head}" if head[:1] in "=+-@" else head for head in columns])
    writer.writerows([[f"{value:.12g}" for value in row] for row in np.column_stack(list(columns.values()))])
    return text.getvalue().encode("utf-8")


def _cells(line: str, where: str) -> list[str]:
    """Return the cells of a line of CSV."""
    try:
        return next(csv.reader([line]))
    except csv.Error as error:  # a cell of more than 131,072 characters
        raise ProblemError(f"{where} is not CSV: {error}") from error


def read_csv(path: Path, what: str) -> dict[str, np.ndarray]:
    """Return the columns (n,) of a CSV file of numbers by their heads; empty lines and lines from # on are skipped.

    Raises:
        ProblemError: if it cannot be read, or a row does not have one number per column, with the line's number.
    """
    try:
        text = read_file(path, what, MAX_FILE_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ProblemError(f"{what} is not UTF-8 text") from error
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")]
    heads = [head.strip() for head in _cells(lines[0][1], f"{what}, line {lines[0][0]},")] if lines else []
    if len(heads) < 2 or len(set(heads)) < len(heads) or len(lines) < 3:
        raise ProblemError(
            f"{what} must have a line of different column names, separated by commas, and two or more rows of numbers; got"
            f" {shown(', '.join(heads) or 'nothing')} and {max(0, len(lines) - 1)} rows"
        )
    rows = []
    for number, line in lines[1:]:
        cells = _cells(line, f"{what}, line {number},")
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = []
        if len(row) != len(heads) or not np.all(np.isfinite(row)):
            raise ProblemError(f"{what}, line {number}, must have {len(heads)} finite numbers, got '{shown(line)}'")
        rows.append(row)
    return dict(zip(heads, np.array(rows).T, strict=True))


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


def schema_of(kinds: Mapping[str, Kind]) -> Any:
    """Return the Arrow schema of columns by name and kind."""
    import pyarrow as pa

    types = {"number": pa.float64(), "count": pa.int64(), "flag": pa.bool_(), "word": pa.string()}
    return pa.schema([(name, types[kind]) for name, kind in kinds.items()])


def read_table(path: Path, kinds: Mapping[str, Kind], rows: int) -> dict[str, np.ndarray]:
    """Return the columns of a Parquet file by name, as arrays (n,); texts are objects, and missing texts None.

    Args:
        path: the file.
        kinds: kinds of its columns by name, in order.
        rows: the expected number of rows.

    Raises:
        PlanFileError: when the file is missing, truncated, too large, or has other columns, types or rows.
    """
    import pyarrow.parquet as parquet
    from pyarrow import BufferReader

    # A number takes eight bytes, the texts of a row about a hundred, the metadata of a block of rows some kilobytes.
    max_bytes = rows * (16 * len(kinds) + 1000) + 4_000_000
    content = read_file(path, f"'{path}'", max_bytes, PlanFileError)
    words = [name for name, kind in kinds.items() if kind == "word"]
    try:
        _refuse_other(parquet.ParquetFile(BufferReader(content)), path, kinds, rows, max_bytes)
        table = parquet.ParquetFile(BufferReader(content), read_dictionary=words).read()
        table.validate(full=True)
        return {name: _values(table[name], name, kind) for name, kind in kinds.items()}
    except PlanFileError:
        raise
    except Exception as error:  # Arrow's parsers raise a dozen types of errors on damaged bytes
        why = one_line(error) or type(error).__name__
        raise PlanFileError(f"'{path}' is truncated or not a Parquet table: {why[:200]}") from error


def _refuse_other(file: Any, path: Path, kinds: Mapping[str, Kind], rows: int, max_bytes: int) -> None:
    """Refuse a file whose metadata differ from the expected table, before a column is decoded."""
    found, wanted = file.metadata, schema_of(kinds)
    if found.num_columns != len(kinds) or file.schema_arrow.names != wanted.names:
        other = sorted(set(wanted.names) ^ set(file.schema_arrow.names))[:3]
        raise PlanFileError(
            f"'{path}' has other columns than the {len(kinds)} of this table: {', '.join(other) or 'their order'}"
        )
    for field, have in zip(wanted, file.schema_arrow, strict=True):
        if have.type != field.type:
            raise PlanFileError(f"'{path}' has a column {field.name} of type {have.type}; it is of type {field.type}")
    groups = [found.row_group(k) for k in range(found.num_row_groups)]
    if found.num_rows != rows or sum(group.num_rows for group in groups) != rows:
        raise PlanFileError(f"'{path}' has {found.num_rows} rows; {rows} were expected")
    chunks = [group.column(k) for group in groups for k in range(len(kinds))]
    size = sum(chunk.total_uncompressed_size for chunk in chunks)
    if size > max_bytes:
        raise PlanFileError(f"'{path}' would take {size} bytes; at most {max_bytes} are read")
    used = {one for chunk in chunks for one in (chunk.compression, *chunk.encodings)} - _ENCODINGS - _COMPRESSIONS
    if used:
        raise PlanFileError(f"'{path}' is encoded by {', '.join(sorted(used))}, which linkplan does not write")


def _values(column: Any, name: str, kind: Kind) -> np.ndarray:
    """Return a column's values.

    Raises:
        ValueError: when values other than texts are missing.
    """
    if kind == "word":
        parts = []
        for chunk in column.chunks:
            texts = np.array([*chunk.dictionary.to_pylist(), None], dtype=object)
            parts.append(texts[chunk.indices.fill_null(len(texts) - 1).to_numpy(zero_copy_only=False)])
        return np.concatenate(parts) if parts else np.zeros(0, dtype=object)
    if column.null_count:
        raise ValueError(f"column {name} lacks {column.null_count} values")
    return column.to_numpy()
