"""The HTML file of a report: template, style and program of `page/`, uPlot and the document, all in one file.

The page fetches nothing: its content security policy allows its own scripts by their hashes, and no network address.
"""

import base64
import hashlib
import html
import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import msgspec

from linkplan.models.reading import MAX_FILE_BYTES
from linkplan.planner.files.manifest import read_record
from linkplan.planner.files.single_file import write_file_whole
from linkplan.planner.plan.folder import versions
from linkplan.studies.output.document import Report, Section

# Each script uses only those before it.
_PROGRAM = ("dom", "cursor", "theme", "plot", "plane", "bars", "shapes", "animation", "player", "blocks", "main")
# A file with these words is a report, and a new report may replace it.
PAGE_MARK = '<meta name="generator" content="linkplan">'
# The height of a page in a notebook.
_SHOWN_HEIGHT_PX = 640


def document_json(report: Report) -> bytes:
    """Return a document as JSON."""
    # numpy's numbers, and texts of numbers
    return msgspec.json.encode(report, enc_hook=lambda value: str(value) if isinstance(value, str) else value.item())


def report_html(report: Report, served: str = "") -> str:
    """Return the HTML of a report; `served` is an additional program for a page with its own server.

    The page contains the document as JSON with "<" escaped, so that no name can end a script. The page shows it as text.
    """
    said = document_json(report).decode()
    program = '"use strict";\n' + "\n".join(_resource(f"{name}.js") for name in _PROGRAM) + served
    uplot = _resource("locale.js") + _resource("uplot.min.js")
    scripts = {"uplot": uplot, "program": program}
    allowed = " ".join(f"'sha256-{_hash(f'{chr(10)}{text}{chr(10)}')}'" for text in scripts.values())
    allowed += "; connect-src 'self'" if served else ""
    parts = {
        "allowed": allowed,
        "title": html.escape(report.title),
        "style": f"{_resource('uplot.min.css')}\n{_resource('style.css')}",
        "document": said.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"),
        **scripts,
    }
    page = _resource("template.html")
    pieces = page.split("{{")
    return pieces[0] + "".join(parts[name] + rest for name, rest in (piece.split("}}", 1) for piece in pieces[1:]))


def _resource(name: str) -> str:
    return resources.files("linkplan.studies.output").joinpath("page").joinpath(name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")


class WrittenPage(type(Path())):
    """The path of a report; a notebook shows its page."""

    __slots__ = ()

    def _repr_html_(self) -> str | None:
        if self.suffix != ".html" or not self.is_file():  # derived paths such as parents, or a page that was moved
            return None
        text = html.escape(self.read_text(encoding="utf-8"))
        return f'<iframe srcdoc="{text}" title="{html.escape(self.name)}" width="100%" height="{_SHOWN_HEIGHT_PX}"></iframe>'


def write_report(report: Report, path: Path) -> WrittenPage:
    """Write a report's HTML file and return its path. An earlier report there is replaced, any other file is refused.

    Raises:
        PlanFileError: for a name of another format, if another file exists at this path, or if it cannot be written.
    """
    write_file_whole(
        path, lambda place: place.write_bytes(report_html(report).encode("utf-8", "replace")), SUFFIXES, PAGE_MARK
    )
    return WrittenPage(path)


DOCUMENT, PAGE = "report.json", "report.html"
# The suffixes of a page's name.
SUFFIXES = (".html", ".htm")


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
    return read_record(path, Report, MAX_FILE_BYTES)  # the document of a robot with forty joints has ten megabytes


def report_of(title: str, verdict: str, passed: bool | None, sections: Sequence[Section]) -> Report:
    """Return a report with the versions of this installation."""
    first = verdict.split(maxsplit=1)[0] if verdict.strip() else ""
    if re.fullmatch(r"[a-z]+[,:;]?", first):  # not the name of an actuator, a joint or a problem
        verdict = verdict[:1].upper() + verdict[1:]
    return Report(title=title, verdict=verdict, passed=passed, versions=versions(), sections=list(sections))
