"""`new`: a first motion of a mechanism, as a problem file and a plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from linkplan.models.errors import ProblemError
from linkplan.paths import path_of
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import plain
from linkplan.plans import Plan
from linkplan.reporting import Progress, listener


def new(
    model: str | Path,
    path: str | Path | None = None,
    *,
    keep: Sequence[str] | None = None,
    fix_base: bool = False,
    lock: Mapping[str, float] | None = None,
    keyframe: str | None = None,
    drive: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> NewProblem:
    """Return a first motion that a mechanism can make, as a problem with a plan; write its problem file if a path is given.

    Args:
        model: a built-in name, or the path of an MJCF or URDF file.
        path: of the new problem file; no file is written without it.
        keep: of a larger robot, names of the bodies or joints that are read, see `load_mechanism`; likewise the next three.
        fix_base: whether what lies between the world and the kept bodies is locked.
        lock: positions of joints that do not move, in degrees on hinges and in metres on slides.
        keyframe: the model's keyframe that gives the home pose.
        drive: names of joints that get a motor, within their effort limits, where the model has no actuators.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the model cannot be used, no actuator drives it, or a file exists at the path.

    Example::

        first = linkplan.new("five-bar", "problem.toml")
        print(first.text)
    """
    from linkplan.planner.files.single_file import check_new, write_new
    from linkplan.studies.new.first_motion import first_motion
    from linkplan.studies.new.problem_text import file_tables, first_text

    name = str(model)
    target = None if path is None else path_of(path, "path")
    if name in PROBLEMS or name.endswith(".toml"):
        raise ProblemError(f"'{name}' is already a problem; new takes the model of a mechanism")
    if target is not None:
        check_new(target)
    asked = {"keep": keep, "fix_base": fix_base, "lock": lock, "keyframe": keyframe, "drive": drive}
    selected = {key: plain(value) for key, value in asked.items() if value}
    found = first_motion({"model": name} | selected, listener(progress))
    tables = file_tables(found, name, target)
    file = "problem.toml" if target is None else target.name
    text = first_text(found, tables, (f'plan = linkplan.plan("{file}")', "linkplan.compare(plan)"))
    if target is not None:
        write_new(target, text.encode("utf-8"))
    folder = None if target is None else target.parent
    problem = Problem.from_tables(f"{found.mechanism.name}-first", tables, folder)
    plan = None if found.plan is None else Plan.of(found.plan)
    return NewProblem(
        problem=problem, plan=plan, text=text, message=found.why or found.description, notes=tuple(found.notes)
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class NewProblem:
    """A first problem: `problem`, its `plan` or None, the `text` of its file, a `message`, and `notes` on the model."""

    problem: Problem
    plan: Plan | None
    text: str
    message: str
    notes: tuple[str, ...]

    @property
    def planned(self) -> bool:
        """Whether a certified motion was found."""
        return self.plan is not None and self.plan.passed

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"NewProblem({self.problem.name!r}: {self.message})"
