"""Reports on disk: the document, `report.json`, in every result's folder but a plan's, and the page if it is asked for."""

import json
from collections.abc import Mapping
from pathlib import Path

from linkplan.models.errors import PlanFileError
from linkplan.models.reading import read_file, too_deep
from linkplan.planner.files.folders import plain_record
from linkplan.studies.report.document import Report
from linkplan.studies.report.render import as_record, write_report

DOCUMENT, PAGE = "report.json", "report.html"
# A document has some hundred kilobytes; more than this is something else.
_MOST_BYTES = 64_000_000


def save_report(report: Report, place: Path, *, page: bool) -> None:
    """Write a report's document into a folder, and its page where it is asked for."""
    said = json.dumps(as_record(report), allow_nan=False, separators=(",", ":"))
    (place / DOCUMENT).write_text(f"{said}\n", encoding="utf-8")
    if page:
        write_report(report, place / PAGE)


def read_document(path: Path) -> dict:
    """Return the record of a saved document.

    Raises:
        PlanFileError: when it is none.
    """
    try:
        said = json.loads(read_file(path, f"'{path}'", _MOST_BYTES, PlanFileError).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"'{path}' is no report: {str(error)[:80]}") from error
    if not _is_document(said) or too_deep(said):
        raise PlanFileError(f"'{path}' is no report: it lacks a title, a verdict, versions, or sections of blocks")
    return plain_record(said)  # JSON may hold NaN and 1e999, and a page may not


def _is_document(said: object) -> bool:
    if not isinstance(said, Mapping) or not all(isinstance(said.get(key), str) for key in ("title", "verdict")):
        return False
    sections = said.get("sections")
    if not isinstance(said.get("versions"), Mapping) or not isinstance(sections, list):
        return False
    return said.get("passed") in (True, False, None) and all(_is_section(section) for section in sections)


def _is_section(section: object) -> bool:
    if not isinstance(section, Mapping) or not isinstance(section.get("title"), str):
        return False
    blocks = section.get("blocks")
    return isinstance(blocks, list) and all(isinstance(b, Mapping) and isinstance(b.get("kind"), str) for b in blocks)
