"""Reports on disk: the document `report.json`, in the folder of every result except plans, and optionally the page."""

import json
from pathlib import Path
from typing import Any, get_args

import msgspec
from msgspec import Struct

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.json_record import read_record
from linkplan.studies.output.document import Block, Report, Section
from linkplan.studies.report.render import as_record, write_report

DOCUMENT, PAGE = "report.json", "report.html"
_BLOCKS: dict[str, type[Block]] = {kind.__dataclass_fields__["kind"].default: kind for kind in get_args(Block)}


def save_report(report: Report, place: Path, *, page: bool) -> None:
    """Write a report's document into a folder and read it back; write its page if `page`."""
    said = json.dumps(as_record(report), allow_nan=False, separators=(",", ":"))
    (place / DOCUMENT).write_text(f"{said}\n", encoding="utf-8")
    read_document(place / DOCUMENT)
    if page:
        write_report(report, place / PAGE)


class _SavedSection(Struct):
    """A section whose blocks are not converted yet."""

    title: str
    blocks: list[dict[str, Any]]
    depth: int = 1
    folded: bool = False


class _SavedReport(Struct):
    """A document whose blocks are not converted yet."""

    title: str
    verdict: str
    passed: bool | None
    versions: dict[str, str]
    sections: list[_SavedSection]


def read_document(path: Path) -> Report:
    """Return a saved document.

    Raises:
        PlanFileError: if the file is not a document, or a block lacks a value or has a value of another type.
    """
    said = read_record(path, _SavedReport)
    try:
        sections = [
            Section(title=one.title, blocks=[_block(block) for block in one.blocks], depth=one.depth, folded=one.folded)
            for one in said.sections
        ]
    except ValueError as error:
        raise PlanFileError(f"'{path}' is not a report that linkplan wrote: {error}") from error
    return Report(title=said.title, verdict=said.verdict, passed=said.passed, versions=said.versions, sections=sections)


def _block(said: dict[str, Any]) -> Block:
    """Return a block of a saved document.

    Raises:
        ValueError: if its kind is unknown, or its values do not fit together.
    """
    kind = said.get("kind")
    if not isinstance(kind, str) or kind not in _BLOCKS:
        raise ValueError(f"a block's kind is one of {', '.join(_BLOCKS)}, got {kind!r}")
    try:
        return msgspec.convert(said, _BLOCKS[kind])
    except ValueError as error:
        raise ValueError(f"a block of kind '{kind}': {error}") from error
