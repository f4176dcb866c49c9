"""The command `render`."""

import argparse
import dataclasses
from pathlib import Path

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import ProblemError, choose
from linkplan.planner.files.single_file import check_file_target
from linkplan.studies.cli.common import naming, plan_asked
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress, show
from linkplan.studies.render.gl import find_gl
from linkplan.studies.render.settings import SUFFIXES, RenderSettings, size_from


def run_render(arguments: argparse.Namespace) -> int:
    """Draw a tracked plan as a film or a picture; 1 if the plan has no motion."""
    choose("tracker", arguments.tracker, TRACKERS, ProblemError)
    target, say = Path(arguments.output), progress(arguments)
    with naming("-o"):
        check_file_target(target, SUFFIXES)
    settings = RenderSettings(
        suffix=target.suffix.lower(),
        tracker=arguments.tracker,
        slow=arguments.slow,
        fps=arguments.fps,
        size=size_from(arguments.size),
        camera=arguments.camera,
        at_s=arguments.at_s,
        instants=arguments.instants,
        there_and_back=arguments.there_and_back,
    )
    gl = find_gl(arguments.mujoco_gl)
    plan = plan_asked(arguments, say)
    from linkplan.studies.render.render import render

    done = render(plan, target, settings, gl, say)
    width, height = done.size
    text = f"{done.file}: {width}x{height}, drawn by {done.drawn_by}"
    if done.length_s is not None:
        text = (
            f"{done.file}: {done.frames} frames of {width}x{height}, {done.length_s:.3g} s at {done.fps:g} frames/s, the"
            f" motion's {done.motion_s:.4g} s {done.slow:g} times slower, drawn by {done.drawn_by}"
        )
    unstable = "" if done.stable else f"; the run with {done.tracker} is unstable"
    show(arguments, dataclasses.asdict(done) | {"plan": plan.problem.name}, text + unstable)
    return DONE if plan.passed else NO
