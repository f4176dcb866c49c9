"""The command `check`."""

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.models.selection import floating_bodies
from linkplan.studies.check.refused_model import REFUSED, RefusedModel
from linkplan.studies.cli.common import deliver, output_folder, poses_asked, selection_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.output.document import Facts

if TYPE_CHECKING:
    from linkplan.studies.check.whole_check import WholeCheck


def run_check(arguments: argparse.Namespace) -> int:
    """Report on a mechanism and its quantities along a path; 1 if problems are found."""
    from linkplan.studies.check.whole_check import check_whole, mechanism_and_problem

    target = output_folder(arguments)
    name, tables, folder, is_problem = tables_of(arguments.model, arguments.set, selection_asked(arguments))
    try:
        sections = tables if is_problem else {"mechanism": tables["mechanism"]}
        mechanism, problem, notes = mechanism_and_problem(name, sections, folder)
    except REFUSED as error:
        refused = RefusedModel(name=Path(name).stem, error=error)
        blocks = [*refused.blocks(), *_begun_elsewhere(error, arguments)]
        deliver(arguments, target, refused.record(), blocks, lambda reports: reports.check_report(refused))
        return NO  # a problem of the model, not bad input
    whole = check_whole(mechanism, problem, poses_asked(arguments, mechanism), notes)
    found = whole.found

    def draw(place: Path) -> None:
        from linkplan.models.model_text import urdf_root
        from linkplan.models.selected_model import whole_model_text
        from linkplan.studies.check.path_plots import MAX_FIGURES, inspection_figure, path_figure

        inspection_figure(found, place / "mechanism.png")
        for number, path in enumerate(whole.paths if len(whole.along) <= MAX_FIGURES else (), 1):
            path_figure(path, found.reaches, place / f"loop-{number}.png")
        if mechanism.selection or mechanism.shifted or urdf_root(str(mechanism.source["model"])) is not None:
            written = "selected.xml" if mechanism.selection else "model.xml"
            (place / written).write_text(whole_model_text(mechanism), encoding="utf-8")

    summed_up = not (arguments.all or arguments.at_deg)
    blocks = [*whole.summary(), _what_is_next(whole, arguments, is_problem)] if summed_up else whole.blocks()
    said = whole.record() if arguments.json or target is not None else {}
    deliver(arguments, target, said, blocks, lambda reports: reports.check_report(whole), draw)
    return NO if found.problems else DONE


def _what_is_next(whole: "WholeCheck", arguments: argparse.Namespace, is_problem: bool) -> Facts:
    subject = shlex.join([arguments.model, *_selection_options(arguments)])
    from linkplan.studies.check.drives import joints_to_drive

    mechanism = whole.found.mechanism
    if mechanism.n_u == 0 and not joints_to_drive(mechanism):
        further = f"linkplan check {subject}, with an actuator that a plan can use in the model's <actuator>"
    elif mechanism.n_u == 0:
        drive = ",".join(joints_to_drive(mechanism))
        driven = f"{subject} --drive {shlex.quote(drive)}"
        command = f"check {driven}" if is_problem else f"new {driven} -o problem.toml"
        further = f"linkplan {command} puts motors on these joints"
    elif is_problem:
        further = f"linkplan plan {subject} -o planned"
    elif floating_bodies(mechanism.model)[0]:
        further = (
            f"linkplan new {subject} -o problem.toml writes a first motion on the fixed base; --keep NAMES --fix-base takes"
            " one chain with its loops out of the robot"
        )
    else:
        further = f"linkplan new {subject} -o problem.toml writes a first motion and names what it changes"
    return Facts(rows=[("next", further), ("everything", f"linkplan check {subject} --all")])


def _begun_elsewhere(error: Exception, arguments: argparse.Namespace) -> list[Facts]:
    """Return the command to go on with, if a model is refused at its own pose and another one is known."""
    if not getattr(error, "home", None) or arguments.model.endswith(".toml"):
        return []
    subject = shlex.join([arguments.model, *_selection_options(arguments)])
    return [Facts(rows=[("next", f"linkplan new {subject} -o problem.toml begins at that pose")])]


def _selection_options(arguments: argparse.Namespace) -> list[str]:
    """Return the options of this command that select a part of the model or set keys; the next command repeats them."""
    keep = [] if arguments.keep is None else ["--keep", arguments.keep]
    keep += [] if arguments.drive is None else ["--drive", arguments.drive]
    base = ["--fix-base"] if arguments.fix_base else []
    locks = [word for lock in arguments.lock for word in ("--lock", lock)]
    settings = [word for setting in arguments.set for word in ("--set", setting)]
    return [*keep, *base, *locks, *([] if arguments.keyframe is None else ["--keyframe", arguments.keyframe]), *settings]
