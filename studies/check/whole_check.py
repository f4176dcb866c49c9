"""The complete result of `linkplan check`: the inspection of a mechanism, and the loop report along its motion or reach."""

from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path

from msgspec import UNSET, UnsetType
from msgspec.structs import asdict, replace

from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.files.tables import Tables
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.problem import Problem
from linkplan.studies.check.check_report import path_blocks, weight_sentences
from linkplan.studies.check.inspection import Inspection, inspect
from linkplan.studies.check.inspection_blocks import inspection_blocks
from linkplan.studies.check.kinematic_loop_report import (
    KinematicLoopPath,
    Sweep,
    has_whole_records,
    inertia_notes,
    measured,
    motion_path,
    reach_sweeps,
)
from linkplan.studies.check.path_quantities import PathFigures, path_figures
from linkplan.studies.check.refused_model import REFUSED
from linkplan.studies.check.summary import summary_blocks
from linkplan.studies.output.document import Block, Text


class WholeCheck(Inspection, frozen=True, kw_only=True, eq=False, dict=True):
    """An inspection, and the loop report along a problem's motion or, without one, over each coordinate's reach."""

    along: Sequence[PathFigures] | UnsetType = UNSET
    sweeps: Beside[tuple[Sweep, ...]] = NOT_READ

    @property
    def paths(self) -> Iterable[KinematicLoopPath]:
        """The loop report along the motion, or along each sweep; a summary of many coordinates needs none.

        The size of a report grows with the square of the number of coordinates, so reports of many coordinates are not kept.
        """
        return map(measured, self.sweeps) if self.brief else self._few_paths

    @cached_property  # hence dict=True: the paths are measured once, at first use
    def _few_paths(self) -> tuple[KinematicLoopPath, ...]:
        return tuple(map(measured, self.sweeps))

    @property
    def brief(self) -> bool:
        """Tell if there are so many coordinates that each is reported in brief."""
        return len(self.sweeps) > 6

    @property
    def with_paths(self) -> "WholeCheck":
        """The check with the quantities along every path, whose measurement takes time and memory."""
        return replace(self, along=[path_figures(path) for path in self.paths])

    def blocks(self) -> list[Block]:
        """Return the findings as a document, with brief tables for more than six coordinates."""
        brief = self.brief
        paths = [block for path in self.paths for block in path_blocks(path, brief=brief)]
        rest = "all of them" if has_whole_records(self.mechanism) else "every pose"
        left_out = (
            f"the table of each of the {len(self.sweeps)} coordinates above has only its own quantities that change along"
            f" its reach, at rest; the JSON record has {rest}"
        )
        return [*inspection_blocks(self), *paths, *([Text(text=left_out)] if brief else [])]

    def summary(self) -> list[Block]:
        """Return the findings in at most thirty lines; first the notes on actuators too weak for weight and springs."""
        weak = [] if self.brief else [text for path in self.paths for text in weight_sentences(path)]
        return summary_blocks(replace(self, notes=(*weak, *self.notes)))


def mechanism_and_problem(
    name: str, tables: Tables, folder: Path | None
) -> tuple[Mechanism, Problem | None, tuple[str, ...]]:
    """Return the mechanism of a problem file, its problem if it has one, and the reasons why it cannot be planned.

    Raises:
        LinkplanError: if the mechanism itself is invalid; one of REFUSED if its model is refused.
    """
    if "motion" not in tables:
        return mechanism_from_tables(tables, folder), None, ()
    try:
        problem = Problem.from_tables(name, tables, folder)
    except REFUSED:
        raise
    except LinkplanError as error:
        return mechanism_from_tables(tables, folder), None, (f"the problem cannot be planned: {error}",)
    return problem.mechanism, problem, ()


def check_whole(
    mechanism: Mechanism,
    problem: Problem | None,
    poses: Sequence[dict[str, float]] = (),
    notes: Sequence[str] = (),
) -> WholeCheck:
    """Return the check of a mechanism, along its problem's motion if there is a problem.

    Args:
        mechanism: that of the problem, if there is one.
        problem: with the motion and the contact setting.
        poses: joint positions [rad or m] by name, each with a report.
        notes: further sentences for the report.

    Raises:
        ProblemError: if a pose is out of reach or names a dependent joint.
    """
    motion, off_path = _motion(problem)
    found = inspect(mechanism, list(poses), motion=motion, contacts="refuse" if problem is None else problem.limits.contacts)
    along = reach_sweeps(mechanism, found.reaches) if motion is None else (motion,)
    chosen = () if problem is None else problem.notes
    singular = [note for path in along for note in inertia_notes(path)]
    notes = (*found.notes, *singular, *notes, *chosen, *off_path)
    return WholeCheck(**asdict(replace(found, notes=notes)), sweeps=along)


def _motion(problem: Problem | None) -> tuple[KinematicLoopPath | None, tuple[str, ...]]:
    """Return the path of a problem's motion, or None with the reason."""
    if problem is None:
        return None, ()
    try:
        return motion_path(problem), ()
    except LinkplanError as error:
        return None, (f"no path for the problem's motion: {error}",)
