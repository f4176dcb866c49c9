"""Reports on disk: the document `report.json`, in the folder of every result except plans, and optionally the page."""

from pathlib import Path

from linkplan.models.reading import MAX_FILE_BYTES
from linkplan.planner.files.json_record import read_record
from linkplan.studies.output.document import Report
from linkplan.studies.report.render import document_json, write_report

DOCUMENT, PAGE = "report.json", "report.html"


def save_report(report: Report, place: Path, *, page: bool) -> None:
    """Write a report's document into a folder and read it back; write its page if `page`."""
    (place / DOCUMENT).write_bytes(document_json(report) + b"\n")
    read_document(place / DOCUMENT)
    if page:
        write_report(report, place / PAGE)


def read_document(path: Path) -> Report:
    """Return a saved document.

    Raises:
        PlanFileError: if the file is not a document, or a block lacks a value or has a value of another type.
    """
    return read_record(path, Report, MAX_FILE_BYTES)  # a robot with forty joints has ten megabytes
