"""The solves on the way to a plan, one after the other, and the progress that is told of them."""

from collections.abc import Callable
from dataclasses import dataclass

from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.collocation import Transcribed

Say = Callable[[str], None]


def silent(text: str) -> None:
    """Say nothing: the default for progress."""
    del text


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Step:
    """One solve on the way to a plan: what was tried, on how many intervals, and what came of it."""

    what: str
    scheme: str
    intervals: int
    segments: int
    converged: bool
    solver_status: str
    objective: float
    integration_error_deg: float | None
    build_s: float
    solve_s: float
    integration_error: float | None = None  # of a user's differential equation, as a share of its states' sizes
    asked: str = ""  # where it failed, a hash of what was solved: it fails again


def step_of(what: str, transcribed: Transcribed, solution: Solution, asked: str = "") -> Step:
    """Return the record of one solve; `asked` as of `Step`."""
    mesh = transcribed.program.mesh
    return Step(
        what=what,
        scheme=transcribed.scheme.name,
        intervals=mesh.n_intervals,
        segments=mesh.n_segments,
        converged=solution.converged,
        solver_status=solution.status,
        objective=solution.objective,
        integration_error_deg=None,
        build_s=transcribed.build_s + solution.build_s,
        solve_s=solution.solve_s,
        asked=asked,
    )
