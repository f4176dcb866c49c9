"""Small animations for the documents: `python -m docs.tools.draw_animations` plans, tracks and draws each.

Each is a GIF that plays forwards and backwards: knee-reach.gif for the README, and one with the name of each built-in
mechanism for docs/mechanisms.md.
"""

import sys
from pathlib import Path

from docs.tools.draw_gallery import FOLDER, SHOWN
from linkplan.models.errors import LinkplanError
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.render.gl import GL, find_gl
from linkplan.studies.render.motion import tracked_motion
from linkplan.studies.render.render import render
from linkplan.studies.render.settings import RenderSettings

# Size limits of the files: the first picture of the README, and each small picture.
LARGE_BYTES, SMALL_BYTES = 600_000, 300_000
_LARGE, _SMALL = (480, 320), (320, 240)
# PD diverges on the cart; on the other mechanisms its error makes the plan's ghost visible.
_TRACKER = {"cart-pole-swing-up": "lqr", "five-bar-swing-up": "lqr"}


def draw(plan: Plan, path: Path, gl: GL, size: tuple[int, int]) -> None:
    """Draw a plan as a small GIF that plays forwards and backwards, 2.4 s each way."""
    slow = max(1.0, 2.4 / plan.trajectory.duration_s)
    settings = RenderSettings(
        suffix=".gif",
        tracker=_TRACKER.get(plan.problem.name, "pd"),
        slow=float(f"{slow:.2g}"),
        fps=15.0,
        size=size,
        there_and_back=True,
    )
    render(tracked_motion(plan, settings.tracker), path, settings, gl)


def main() -> int:
    """Write every animation of the gallery."""
    gl = find_gl(None)
    if gl.name is None:
        raise LinkplanError(f"MuJoCo draws the gallery, but finds no OpenGL ({gl.why_not})")
    for name in SHOWN:
        plan = plan_motion(load_problem(name)).require()
        drawn = [(FOLDER / f"{plan.problem.mechanism.name}.gif", _SMALL, SMALL_BYTES)]
        if name == "knee-reach":
            drawn.append((FOLDER / "knee-reach.gif", _LARGE, LARGE_BYTES))
        for path, size, most in drawn:
            draw(plan, path, gl, size)
            weight = path.stat().st_size
            print(f"  {path}: {weight / 1000:.0f} kB of {most / 1000:.0f}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
