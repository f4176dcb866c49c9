"""The command `check`."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.studies.check.refused_model import REFUSED, RefusedModel
from linkplan.studies.cli.common import deliver, output_folder, poses_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO

if TYPE_CHECKING:
    from linkplan.studies.check.whole_check import WholeCheck
    from linkplan.studies.output.document import Report


def run_check(arguments: argparse.Namespace) -> int:
    """Report on a mechanism and its quantities along a path; 1 if problems are found."""
    from linkplan.studies.check.whole_check import check_whole, mechanism_and_problem

    target = output_folder(arguments)
    name, tables, folder, is_problem = tables_of(arguments)
    try:
        sections = tables if is_problem else {"mechanism": tables["mechanism"]}
        mechanism, problem, notes = mechanism_and_problem(name, sections, folder)
    except REFUSED as error:
        refused = RefusedModel(name=Path(name).stem, error=error)
        deliver(arguments, target, refused.record(), refused.blocks(), lambda: _report(refused))
        return NO  # a problem of the model, not bad input
    whole = check_whole(mechanism, problem, poses_asked(arguments, mechanism), notes)
    found = whole.found

    def draw(place: Path) -> None:
        from linkplan.models.selected_model import whole_model_text
        from linkplan.studies.check.path_plots import inspection_figure, path_figure

        inspection_figure(found, place / "mechanism.png")
        for number, path in enumerate(whole.paths, 1):
            path_figure(path, found.reaches, place / f"loop-{number}.png")
        if mechanism.selection:
            (place / "selected.xml").write_text(whole_model_text(mechanism), encoding="utf-8")

    deliver(arguments, target, whole.record(), whole.blocks(), lambda: _report(whole), draw)
    return NO if found.problems else DONE


def _report(found: "WholeCheck | RefusedModel") -> "Report":
    from linkplan.studies.report.reports import check_report

    return check_report(found)
