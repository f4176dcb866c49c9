"""The command `view`."""

import argparse
import os

from linkplan.controllers.controls import Controls, keys_said
from linkplan.controllers.playback import has_screen, play
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import ProblemError, choose
from linkplan.planner.problem.settings import number
from linkplan.studies.cli.common import plan_asked
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress, show
from linkplan.studies.render.gl import find_gl

_ALTERNATIVES = "render writes the same motion as a film or a picture, report as a page"


def run_view(arguments: argparse.Namespace) -> int:
    """Play a tracked plan in the viewer; 1 if the plan has no motion."""
    choose("tracker", arguments.tracker, TRACKERS, ProblemError)
    for name in ("slow", "seconds"):
        if (value := getattr(arguments, name)) is not None:
            number(value, f"--{name}", positive=True)
    _refuse_without_screen()
    say = progress(arguments)
    plan = plan_asked(arguments, say)
    from linkplan.studies.render.live import aim, run_maker

    say.keep(f"{plan.problem.name} tracked by {arguments.tracker}, {arguments.slow:g} times slower; close the window to end")
    say.keep(f"keys: {keys_said()}")
    mechanism = plan.problem.mechanism
    begin = Controls(tracker=arguments.tracker, slowness=arguments.slow)
    make = run_maker(plan)
    last = play(mechanism, begin, make, seconds=arguments.seconds, camera=aim(plan, arguments.tracker))
    if arguments.json:
        gains = {"kp_factor": last.kp_factor, "kd_factor": last.kd_factor}
        said = {"plan": plan.problem.name, "tracker": last.tracker, **gains, "stable": make(last).stable}
        show(arguments, said, "")
    return DONE if plan.passed else NO


def _refuse_without_screen() -> None:
    """Refuse if no window can be opened, before a plan that may take minutes."""
    if not has_screen():
        raise ProblemError(f"view needs a screen: neither DISPLAY nor WAYLAND_DISPLAY is set; {_ALTERNATIVES}")
    gl = find_gl("glfw", os.environ)
    if gl.name is None:
        raise ProblemError(f"view needs a screen, and none can be opened ({gl.why_not}); {_ALTERNATIVES}")
