"""The record of the solves that lead to a plan, and its progress.

A plan is made inside `recording`. Functions that solve call `add_step` and `progress`; the record need not be passed on.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Annotated

from msgspec import Meta, Struct
from msgspec.structs import replace

from linkplan.planner.files.structs import Number
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.collocation import Transcribed

Say = Callable[[str], None]
_Count = Annotated[int, Meta(ge=0)]
_Seconds = Annotated[float, Meta(ge=0)]


def silent(text: str) -> None:
    """Say nothing: the default for progress."""
    del text


class Step(Struct, frozen=True, eq=False, kw_only=True):
    """One solve before a plan: its name, its number of intervals, and its result."""

    what: str
    scheme: str
    intervals: _Count
    segments: _Count
    converged: bool
    solver_status: str
    objective: Number
    integration_error_deg: float | None
    build_s: _Seconds
    solve_s: _Seconds


# The steps of the plan being made in this thread, and the receiver of its progress.
_STEPS: ContextVar[list[Step] | None] = ContextVar("steps", default=None)
_SAY: ContextVar[Say] = ContextVar("say", default=silent)


@contextmanager
def recording(say: Say = silent) -> Iterator[list[Step]]:
    """Record the solves made inside, and call `say` with lines of progress; a recording inside another is separate."""
    steps: list[Step] = []
    before, said_before = _STEPS.set(steps), _SAY.set(say)
    try:
        yield steps
    finally:
        _STEPS.reset(before)
        _SAY.reset(said_before)


def recorded() -> tuple[Step, ...]:
    """Return the steps recorded so far; none outside of `recording`."""
    return tuple(_STEPS.get() or ())


def add_step(step: Step) -> None:
    """Add a step to the record; outside of `recording` it is discarded."""
    steps = _STEPS.get()
    if steps is not None:
        steps.append(step)


def amend_last_step(**values: float | None) -> None:
    """Change values of the last step unless it failed, such as the integration error that its certificate found."""
    steps = _STEPS.get()
    if steps and steps[-1].converged:
        steps[-1] = replace(steps[-1], **values)


def progress(text: str) -> None:
    """Report a line of progress."""
    _SAY.get()(text)


def step_of(what: str, transcribed: Transcribed, solution: Solution) -> Step:
    """Return the record of one solve."""
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
    )
