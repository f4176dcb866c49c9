"""`report`, `render` and `export`: results as a page, as films and pictures, and as other programs' files."""

from __future__ import annotations

import functools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from msgspec import structs

from linkplan.api.command import command
from linkplan.api.inputs import (
    AnyPlan,
    PlanLike,
    Source,
    Subject,
    any_plan_of,
    note_forces,
    plan_of,
    source_of,
    subject_of,
)
from linkplan.api.names import CLaw, ExportFormat, TrackerName
from linkplan.api.reporting import Listener, Progress, listener
from linkplan.api.typed_commands import sample_again
from linkplan.models.errors import ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.planner.plan.plan import Plan
from linkplan.studies.output.paths import check_flags, file_to_write, folder_to_write, path_of
from linkplan.studies.output.result import Result

if TYPE_CHECKING:
    from linkplan.studies.handover.export.exported import Exported
    from linkplan.studies.output.document import Report
    from linkplan.studies.render.render import RenderedFile


@command("make one HTML file of a saved folder: animation, plots, certificate; it opens offline")
def report(
    result: Result | Plan | str | Path, path: str | Path = "report.html", *, progress: Progress | None = None
) -> Path:
    """Write a result's report, one HTML file that opens offline, and return its path.

    Args:
        result: of `plan`, `prove`, `track`, `compare`, `bode`, `tune`, `experiment`, `decompose`, `batch`, `check` or
            `transfer`; or a folder in which a command or `save` wrote one.
        path: the file to write. An older report is replaced, any other file is refused.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: for anything else, or if the file cannot be written.

    Example::

        linkplan.report(linkplan.plan("knee-reach"), "reach.html")
    """
    from linkplan.planner.files.single_file import check_file_target
    from linkplan.studies.output.report_file import PAGE_MARK, SUFFIXES, write_report

    place, say = path_of(path, "path"), listener(progress)
    check_file_target(place, SUFFIXES, PAGE_MARK)
    say(f"reading {result}" if isinstance(result, str | Path) else "writing the report")
    return write_report(_document(result), place)


def _document(result: object) -> Report:
    from linkplan.studies.output.plan_sections import plan_report
    from linkplan.studies.report import reading

    if isinstance(result, str | Path):
        return reading.folder_report(path_of(result, "result"), sample_again)
    if isinstance(result, Result):
        return result.document()
    if isinstance(result, Plan):
        return plan_report(result)
    raise ProblemError(f"a report takes a result of linkplan, or the folder of one, got {result!r}")


@command("draw a tracked plan as a film (.mp4, .gif) or a picture (.png), without a screen")
def render(
    plan: AnyPlan,
    path: str | Path,
    *,
    tracker: TrackerName = "pd+ff",
    slow: float | None = None,
    fps: float = 25.0,
    size_px: tuple[int, int] = (800, 600),
    camera: str | None = None,
    at_s: float | None = None,
    instants: int = 7,
    there_and_back: bool = False,
    mujoco_gl: str | None = None,
    progress: Progress | None = None,
) -> RenderedFile:
    """Write a film or picture of a plan's motion as tracked in MuJoCo, with the plan as a ghost; return what was written.

    Args:
        plan: a plan with a motion, a problem, or the name or path of either.
        path: the file to write: .mp4, .gif or .png; a file that linkplan did not write is not replaced.
        tracker: a built-in name.
        slow: how many times slower than real time; by default the film lasts a few seconds.
        fps: frames per second.
        size_px: width and height [px].
        camera: the name of a camera of the model, or "azimuth/elevation" in degrees; by default facing the mechanism's
            plane.
        at_s: the instant [s] of a picture; by default a picture shows several.
        instants: how many instants a picture shows.
        there_and_back: whether the film then plays backwards, so that it repeats without a jump.
        mujoco_gl: "egl", "osmesa" or "glfw"; by default one that works. Without any, Matplotlib draws.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion, or an argument is invalid.

    Example::

        linkplan.render(linkplan.plan("knee-reach"), "reach.png", at_s=0.08)
    """
    from linkplan.controllers.trackers.names import TRACKERS
    from linkplan.planner.files.single_file import check_file_target
    from linkplan.studies.render.gl import find_gl
    from linkplan.studies.render.motion import motion_on_ground, tracked_motion
    from linkplan.studies.render.render import render as drawn
    from linkplan.studies.render.settings import SUFFIXES, RenderSettings

    choose("tracker", tracker, TRACKERS, ProblemError)
    check_flags(there_and_back=there_and_back)
    place, say = path_of(path, "path"), listener(progress)
    check_file_target(place, SUFFIXES)
    settings = RenderSettings(
        suffix=place.suffix.lower(),
        tracker=tracker,
        slow=slow,
        fps=fps,
        size=size_px,
        camera=camera,
        at_s=at_s,
        instants=instants,
        there_and_back=there_and_back,
    )
    gl = find_gl(mujoco_gl)
    answer = any_plan_of(plan, say, "draw")
    motion = tracked_motion(answer, tracker) if isinstance(answer, Plan) else motion_on_ground(answer, tracker)
    return drawn(motion, place, settings, gl, say)


@command("write a plan, or a model in C, for other programs")
def export(
    plan: PlanLike | Subject,
    path: str | Path,
    to: ExportFormat,
    *,
    joints: Sequence[str] = (),
    tracker: CLaw = "pd+ff",
    sizes: bool = False,
    tolerance: float | None = None,
    every_s: float | None = None,
    progress: Progress | None = None,
) -> Exported:
    """Write a plan, or a model in C, for other programs.

    Args:
        plan: with a motion; or its problem, or the name or path of either; for "c" also a model.
        path: the file to write, which must not exist yet; for "c" a folder, whose older code is replaced.
        to: "keyframes", "mjcf", "ros", "mat", "csv", "parquet" or "c". Angles are in radians, except in "csv" and "parquet",
            whose column names state the units.
        joints: for "ros", and for a model in C: the output joints as coordinates; by default the independent joints.
        tracker: for "c": the law of a plan: "pd", "pd+ff", "lqr" or "gs-pd+ff".
        sizes: for a model in C: whether flash and stack are measured even if the code is long and compiles for minutes.
        tolerance: for the law of a plan in C: rows of its tables are omitted where interpolation changes efforts and gains
            by at most this share of their largest values; by default there is a row at every control instant.
        every_s: the time between samples [s]; by default ten in each interval of the mesh.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion, the format is unknown, or a file exists at the path.

    Example::

        linkplan.export(linkplan.plan("knee-reach"), "reach.yaml", "ros", every_s=0.001)
    """
    from linkplan.studies.handover.export.formats import FOLDER_FORMATS, FORMATS

    choose("format", str(to), (*FORMATS, *FOLDER_FORMATS), ProblemError)
    check_flags(sizes=sizes)
    say, names = listener(progress), list(joints)
    if to in FOLDER_FORMATS:
        if every_s is not None:
            raise ProblemError("every_s applies to files of samples; a law in C has a row at every tracking.period_s")
        return _exported_c(plan, path, names, tracker, sizes, tolerance, say)
    for key, given in (("tolerance", tolerance), ("sizes", sizes)):
        if given:
            raise ProblemError(f"{key} applies to C code only, got to = '{to}'")
    from linkplan.planner.files.single_file import write_new
    from linkplan.studies.handover.export.export import FileRecord, exported

    place = file_to_write(path)
    if isinstance(plan, Mechanism):
        raise ProblemError(f"'{to}' needs a plan; a model can only be exported as 'c'")
    answer = plan_of(plan, say, "export")
    if to in ("keyframes", "mjcf"):
        note_forces(answer.problem.mechanism, say)
    content = exported(answer, str(to), every_s, names)
    write_new(place, content)
    written = {"format": to, "bytes": len(content), "plan": answer.problem.name}
    return FileRecord(file=str(place), **written, path=place, passed=answer.passed)


def _exported_c(
    subject: PlanLike | Subject,
    path: str | Path,
    joints: Sequence[str],
    tracker: str,
    sizes: bool,
    tolerance: float | None,
    say: Listener,
) -> Exported:
    """Write a model's dynamics or a plan's control law as C into a folder."""
    from linkplan.planner.files.folders import write_json, write_whole
    from linkplan.studies.handover.export.formats import C_TRACKERS

    choose("tracker for C", tracker, C_TRACKERS, ProblemError)
    target, records, passed = folder_to_write(path, "export.json"), [], True
    asked = _plan_in(subject)
    if asked is not None:
        from linkplan.studies.handover.export.c_law import write_law
        from linkplan.studies.handover.export.law_tables import law_tables

        if joints:
            raise ProblemError("joints applies to ros and to a model in C; a plan's law has the plan's coordinates")
        if sizes:
            raise ProblemError("sizes applies to a model in C; flash and stack of a law are always measured")
        plan = plan_of(asked, say, "export")
        tables, passed = law_tables(plan, tracker, tolerance or 0.0), plan.passed
        made = functools.partial(write_law, tables, plan=plan.problem.name)
    else:
        from linkplan.studies.handover.export.c_files import write_model
        from linkplan.studies.handover.export.c_model import model_code
        from linkplan.studies.handover.export.output_joints import with_outputs

        if tolerance is not None:
            raise ProblemError("tolerance applies to the tables of a plan's law in C; a model's code has no tables")
        mechanism, _ = subject_of(cast(Subject, subject))
        note_forces(mechanism, say)
        code = model_code(with_outputs(mechanism, joints) if joints else mechanism)
        say(f"{code.mechanism.name}: C code")
        made = functools.partial(write_model, code, compiled=sizes or None)

    def write(place: Path) -> None:
        records.append(made(place))
        write_json(place / "export.json", records[0])

    write_whole(target, write, "export.json")
    return structs.replace(records[0], path=target, passed=passed)


def _plan_in(subject: PlanLike | Subject) -> PlanLike | None:
    """Return the plan of a subject, read or computed; None for a model."""
    if isinstance(subject, Source | str | Path):
        source = source_of(subject)
        return source if source.is_problem or os.path.isdir(source.name) else None
    return None if isinstance(subject, Mechanism) else subject
