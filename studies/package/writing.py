"""`report`, `render` and `export`: results as a page, as films and pictures, and as other programs' files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.decompositions import DecompositionResult
from linkplan.experiments import ExperimentResult
from linkplan.loops import BodeResult, TuneResult
from linkplan.mechanisms import CheckResult
from linkplan.models.errors import ProblemError
from linkplan.paths import path_of
from linkplan.planner.plan import Plan
from linkplan.reporting import Progress, listener
from linkplan.subjects import with_motion
from linkplan.tracking import TrackingResult
from linkplan.transfers import TransferResult

if TYPE_CHECKING:
    from linkplan.studies.output.document import Report
    from linkplan.studies.render.render import Rendered

Result = (
    Plan | TrackingResult | BodeResult | TuneResult | ExperimentResult | DecompositionResult | CheckResult | TransferResult
)


def report(result: Result | str | Path, path: str | Path) -> Path:
    """Write a result's report, one HTML file that opens offline, and return its path.

    Args:
        result: of `plan`, `track`, `compare`, `bode`, `tune`, `experiment`, `decompose`, `check` or `transfer`; or a folder
            in which a command or `save` wrote one.
        path: of the file. An older report is replaced, any other file is refused.

    Raises:
        LinkplanError: for anything else, or if the file cannot be written.

    Example::

        linkplan.report(linkplan.plan("knee-reach"), "reach.html")
    """
    from linkplan.studies.report.render import write_report

    place = path_of(path, "path")
    write_report(_document(result), place)
    return place


def _document(result: object) -> Report:
    from linkplan.studies.report import reading, reports

    if isinstance(result, str | Path):
        return reading.folder_report(path_of(result, "result"))
    kinds: list[tuple[type, Callable]] = [
        (Plan, reports.plan_report),
        (TrackingResult, lambda one: reports.comparison_report(one.comparison)),
        (BodeResult, lambda one: reports.bode_report(one.study)),
        (TuneResult, lambda one: reports.tune_report(one.tuning)),
        (ExperimentResult, lambda one: reports.experiment_report(one.outcome)),
        (DecompositionResult, lambda one: reports.decomposition_report(one.decomposition)),
        (CheckResult, lambda one: reports.check_report(one.found)),
        (TransferResult, lambda one: reports.transfer_report(one.found)),
    ]
    for kind, document in kinds:
        if isinstance(result, kind):
            return document(result)
    raise ProblemError(f"a report is on a result of linkplan's, or on the folder of one, got {result!r}")


def render(
    plan: Plan,
    path: str | Path,
    *,
    tracker: str = "pd+ff",
    slow: float | None = None,
    fps: float = 25.0,
    size_px: tuple[int, int] = (800, 600),
    camera: str | None = None,
    at_s: float | None = None,
    instants: int = 7,
    there_and_back: bool = False,
    mujoco_gl: str | None = None,
    progress: Progress | None = None,
) -> Rendered:
    """Write a film or picture of a plan's motion as tracked in MuJoCo, with the plan as a ghost; return what was written.

    Args:
        plan: with a motion.
        path: of the file: .mp4, .gif or .png.
        tracker: a built-in name.
        slow: how many times slower than real; by default a film of a few seconds.
        fps: frames a second.
        size_px: width and height [px].
        camera: the name of a camera of the model, or "azimuth/elevation" in degrees; by default the mechanism's plane.
        at_s: the instant [s] of a picture; by default a picture shows several.
        instants: how many instants a picture shows.
        there_and_back: whether a film is added backwards, so that it repeats without a jump.
        mujoco_gl: "egl", "osmesa" or "glfw"; by default one that works. Without any, Matplotlib draws.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion, or an argument is invalid.

    Example::

        linkplan.render(linkplan.plan("knee-reach"), "reach.png", at_s=0.08)
    """
    from linkplan.studies.render.gl import find_gl
    from linkplan.studies.render.render import render as drawn
    from linkplan.studies.render.settings import SUFFIXES, RenderSettings

    place = path_of(path, "path")
    if place.suffix.lower() not in SUFFIXES:
        raise ProblemError(f"path ends in {', '.join(SUFFIXES)}, got '{place}'")
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
    return drawn(with_motion(plan, "draw"), place, settings, find_gl(mujoco_gl), listener(progress))


def export(plan: Plan, path: str | Path, to: str, *, every_s: float | None = None) -> Path:
    """Write a plan's motion for another program, and return the path.

    Args:
        plan: with a motion.
        path: of the new file.
        to: "keyframes", "mjcf", "ros", "mat", "csv" or "parquet". Angles are in radians, except in "csv" and "parquet",
            whose columns have their units in their heads.
        every_s: the time between samples [s]; by default ten in each interval of the mesh.

    Raises:
        LinkplanError: if the plan has no motion, the format is unknown, or a file exists at the path.

    Example::

        linkplan.export(linkplan.plan("knee-reach"), "reach.yaml", "ros", every_s=0.001)
    """
    from linkplan.planner.files.single_file import write_new
    from linkplan.studies.export.export import exported

    place = path_of(path, "path")
    write_new(place, exported(with_motion(plan, "export"), str(to), every_s))
    return place
