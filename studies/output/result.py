"""The members of all results: `str(result)` is the text, `to_dict()` the JSON, `save` the folder, `report` the page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from linkplan.models.errors import LinkplanError
from linkplan.models.extras import load_extra
from linkplan.studies.output.paths import check_flags, drawn, path_of

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from msgspec import Struct

    from linkplan.studies.output.document import Block, Report
    from linkplan.studies.output.figure_spec import FigureSpec


class Shown:
    """A struct with blocks, from which its JSON, its text and its display in a notebook follow.

    It is a base class, so that all results are shown in the same way.
    """

    __slots__ = ()

    @property
    def struct(self) -> Struct:
        """The frozen struct, this object itself. Its fields are the JSON, except those of type `Beside`."""
        return cast("Struct", self)

    def to_dict(self) -> dict:
        """Return all values by name, with units in the names, in JSON types."""
        from linkplan.planner.files.folders import plain_record

        return plain_record(self.struct)

    def blocks(self) -> list[Block]:
        """Return the result as a document's blocks."""
        raise NotImplementedError

    def _repr_html_(self) -> str | None:
        from linkplan.studies.output.text import html_of, in_brief

        return html_of(in_brief(self.blocks()))

    def __str__(self) -> str:
        from linkplan.studies.output.text import in_brief, text_of

        return text_of(in_brief(self.blocks()))


class Reported(Shown):
    """An object that also has a report."""

    __slots__ = ()

    def document(self) -> Report:
        """Return the result's report."""
        raise NotImplementedError

    def report(self, path: str | Path) -> Path:
        """Write the report, one HTML file that opens offline, and return its path.

        Raises:
            LinkplanError: if another file exists at the path.
        """
        from linkplan.studies.output.report_file import write_report

        return write_report(self.document(), path_of(path, "path"))


class Result(Reported):
    """The result of a study, a base class of its struct; each has `passed`, `blocks`, `document` and `figure_specs`."""

    __slots__ = ()
    record_name = ""
    """The name of the record in a saved folder, without ".json"; empty for a result that the study's function writes
    itself."""
    has_parquet = False
    """Whether the tables can also be written as Parquet."""

    @property
    def passed(self) -> bool:
        """Whether the result is positive; a command then ends with exit code 0."""
        return True

    def to_frame(self, table: str | int = 0) -> pandas.DataFrame:
        """Return one of the result's tables as a pandas table of numbers, with units in the columns' names.

        Args:
            table: its title or the beginning of the title, or its index among the result's tables.

        Raises:
            MissingPackageError: if pandas is not installed.
            LinkplanError: if the result has no such table; the message lists its tables.
        """
        from linkplan.studies.output.document import NumberText, Table
        from linkplan.studies.output.text import headed

        pandas = load_extra("pandas", f"{type(self).__name__}.to_frame")
        tables = [block for block in self.blocks() if isinstance(block, Table)]
        found = [one for k, one in enumerate(tables) if k == table or (table and one.title.startswith(str(table)))]
        if not found:
            titles = ", ".join(f"{k} '{one.title}'" for k, one in enumerate(tables)) or "none"
            raise LinkplanError(f"unknown table {table!r}; this result has {titles}")
        columns = []
        for k, (head, unit) in enumerate(found[0].columns):
            cells = [row[k] for row in found[0].rows]
            words = dict.fromkeys(word for cell in cells if isinstance(cell, NumberText) for word in cell.numbers)
            for word in words or [""]:
                values = [cell.numbers.get(word) if isinstance(cell, NumberText) else cell for cell in cells]
                columns.append((headed(f"{head} {word}".rstrip(), unit), values))
        frame = pandas.DataFrame({k: values for k, (_, values) in enumerate(columns)})
        return frame.set_axis([head for head, _ in columns], axis="columns")

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield the figures by the names of their files, that of `plot` first; by default there are none."""
        return iter(())

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the result's figure, saved at `path` if it is given.

        Raises:
            LinkplanError: if the result has none, or the file cannot be written.
        """
        return drawn(path, self._first_figure)

    def _first_figure(self) -> FigureSpec:
        for _, spec in self.figure_specs():
            return spec
        raise LinkplanError(f"nothing to draw: this {type(self).__name__} has no figure")

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write tables and other files into an existing folder, with `parquet` as Parquet too; by default there are none."""
        del place, parquet

    def save(self, folder: str | Path, *, report: bool = False, parquet: bool = False) -> Path:
        """Write the record, tables, figures and the document into a folder, completely or not at all, and return its path.

        Each run has its own table: `nominal-pd.csv` and `.npz` have a row for each control instant, with units in the column
        names; `mismatch-pd.csv` is the same for the mismatch.

        Args:
            folder: an older result of the same kind in it is replaced.
            report: whether report.html, an animated page, is written too.
            parquet: whether the tables of `track`, `compare` and `transfer` are written as Parquet too.

        Raises:
            LinkplanError: if the folder has other files, or cannot be written.
        """
        from linkplan.planner.files.folders import write_json, write_whole
        from linkplan.studies.output.figure import save_figures
        from linkplan.studies.output.report_file import save_report

        check_flags(report=report, parquet=parquet)
        if parquet and not self.has_parquet:
            raise LinkplanError(
                f"parquet applies to the tables of track, compare and transfer; a {type(self).__name__} has no such table"
            )
        if not self.record_name:
            raise LinkplanError("this result can only be saved while it is computed: pass a folder to its function")
        target, record = path_of(folder, "folder"), f"{self.record_name}.json"

        def write(place: Path) -> None:
            write_json(place / record, self.to_dict())
            self.write_files(place, parquet=parquet)
            save_figures(self.figure_specs(), place)
            save_report(self.document(), place, page=report)

        write_whole(target, write, record)
        return target


class MechanismResult(Result):
    """The result of a study of a mechanism, with `mechanism_name` and `message`."""

    __slots__ = ()

    def __repr__(self) -> str:
        own = cast("Any", self)
        return f"{type(self).__name__}({own.mechanism_name!r}: {own.message})"
