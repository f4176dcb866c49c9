"""`new`: a first motion of a mechanism, as a problem file and a plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from linkplan.api.command import command
from linkplan.api.inputs import Source, source_of
from linkplan.api.plans import Plan
from linkplan.api.reporting import Progress, listener
from linkplan.api.typed_commands import first_steps
from linkplan.models.errors import ProblemError
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import to_toml_types
from linkplan.studies.output.paths import check_flags, file_to_write
from linkplan.studies.output.result import Shown

if TYPE_CHECKING:
    from linkplan.studies.output.document import Block


@command("write a first problem file for a mechanism, with a feasible motion")
def new(
    model: str | Path | Source,
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
        path: the new problem file, which must not exist yet; without it none is written, and the command prints it.
        keep: names of the only bodies or joints of a larger robot to read, with everything attached to them and their loops.
            This and the next four are keys of [mechanism], as in `load_mechanism`.
        fix_base: whether the joints between the world and the kept bodies, and a base without actuators, are locked.
        lock: joints to lock at an angle [deg], or slides at a position [m], in addition to a file's locks.
        keyframe: the model's keyframe that gives the home pose; by default "home".
        drive: names of joints that get a motor, within their effort limits, if the model has no actuators.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the model cannot be used, no actuator drives it, or a file exists at the path.

    Example::

        first = linkplan.new("five-bar", "problem.toml")
        print(first.text)
    """
    from linkplan.planner.files.single_file import write_new
    from linkplan.studies.check.new.first_motion import first_motion
    from linkplan.studies.check.new.problem_text import file_tables, first_text

    check_flags(fix_base=fix_base)
    source = source_of(model)
    target = None if path is None else file_to_write(path)
    if source.is_problem:
        raise ProblemError(f"'{source.name}' is already a problem; new takes the model of a mechanism")
    asked = {"keep": keep, "fix_base": fix_base, "lock": lock, "keyframe": keyframe, "drive": drive}
    selected = {key: to_toml_types(value) for key, value in asked.items() if value}
    _, sections, _ = replace(source, selection={**source.selection, **selected}).tables()
    if further := sections.keys() - {"mechanism"}:
        raise ProblemError(
            f"new takes settings of [mechanism] only, because it writes the other sections; got {', '.join(further)}"
        )
    found = first_motion(sections["mechanism"], listener(progress))
    tables = file_tables(found, source.name, target)
    text = first_text(found, tables, first_steps("problem.toml" if target is None else target.name))
    if target is not None:
        write_new(target, text.encode("utf-8"))
    folder = None if target is None else target.parent
    return NewProblem(
        problem=Problem.from_tables(f"{found.mechanism.name}-first", tables, folder, found.mechanism),
        plan=None if found.plan is None else Plan.of(found.plan),
        text=text,
        description=found.description,
        file=None if target is None else str(target),
        planned=found.plan is not None and found.plan.passed,
        why=found.why,
        tables=tables,
        notes=tuple(found.notes),
    )


class NewProblem(Shown, Struct, frozen=True, eq=False, kw_only=True):
    """A first problem: its `file` or None and its `tables`, `notes` on the model, and in `why` the reason for no motion.

    `problem`, its `plan` or None, and the `text` of its file are not in the JSON.
    """

    file: str | None
    planned: bool  # a certified motion was found
    why: str
    tables: dict[str, Any]
    notes: tuple[str, ...]
    problem: Beside[Problem] = NOT_READ
    plan: Beside[Plan | None] = NOT_READ
    text: Beside[str] = NOT_READ
    description: Beside[str] = NOT_READ

    @property
    def message(self) -> str:
        """The reason if no motion was found, else what the mechanism does."""
        return self.why or self.description

    @property
    def verdict(self) -> str:
        """The status of the plan, or the reason why there is none."""
        return "planned" if self.planned else f"NOT planned: {self.why}"

    def blocks(self) -> list[Block]:
        """Return the verdict, the notes and the file as a document's blocks."""
        from linkplan.studies.output.document import Code, Text

        said = Text(text=f"{self.description}: {self.verdict}", tone="good" if self.planned else "bad")
        notes = [Text(text=note, tone="note") for note in self.notes]
        return [said, *notes, Code(title=self.file or "problem.toml", text=self.text)]

    def __repr__(self) -> str:
        return f"NewProblem({self.problem.name!r}: {self.message})"
