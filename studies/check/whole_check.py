"""All that `linkplan check` finds: the inspection of a mechanism, and the loop report along its motion or its reach."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.problem_file import mechanism_from_tables, problem_from_tables
from linkplan.planner.files.tables import Tables
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.studies.check.check_report import path_text
from linkplan.studies.check.inspection import Inspection, inspect, inspection_record
from linkplan.studies.check.inspection_text import inspection_text
from linkplan.studies.check.kinematic_loop_report import (
    KinematicLoopPath,
    inertia_notes,
    motion_path,
    path_record,
    reach_paths,
)
from linkplan.studies.check.refused_model import REFUSED

# Tables of more coordinates than this, each with the quantities of all of them, are read by nobody: half a megabyte of 42.
_MANY = 6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class WholeCheck:
    """An inspection, and the loop report along a problem's motion or, without one, over each coordinate's reach."""

    found: Inspection
    paths: tuple[KinematicLoopPath, ...]

    @property
    def name(self) -> str:
        """The mechanism's."""
        return self.found.mechanism.name

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong, each in a sentence."""
        return self.found.problems

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth knowing but no fault, each in a sentence."""
        return self.found.notes

    def record(self) -> dict:
        """Return the findings by name, units in the names."""
        return inspection_record(self.found) | {"along": [path_record(path) for path in self.paths]}

    def text(self) -> str:
        """Return the findings for people."""
        brief = len(self.paths) > _MANY
        paths = [text for path in self.paths if (text := path_text(path, brief=brief))]
        left_out = [
            f"of {len(self.paths)} coordinates each has its own quantities above, at rest, where they change along its"
            " reach; the JSON record has all of them"
        ]
        return "\n\n".join([inspection_text(self.found), *paths, *(left_out if brief else [])])


def mechanism_and_problem(
    name: str, tables: Tables, folder: Path | None
) -> tuple[Mechanism, PlanningProblem | None, tuple[str, ...]]:
    """Return a problem file's mechanism, its problem where there is one, and why a problem that there is cannot be planned.

    Raises:
        LinkplanError: when the mechanism itself cannot be, or is one of REFUSED.
    """
    if "motion" not in tables:
        return mechanism_from_tables(tables, folder), None, ()
    try:
        problem = problem_from_tables(name, tables, folder)
    except REFUSED:
        raise
    except LinkplanError as error:
        return mechanism_from_tables(tables, folder), None, (f"the problem cannot be planned: {error}",)
    return problem.mechanism, problem, ()


def check_whole(
    mechanism: Mechanism,
    problem: PlanningProblem | None,
    poses: Sequence[dict[str, float]] = (),
    notes: Sequence[str] = (),
) -> WholeCheck:
    """Return what is found about a mechanism, along its problem's motion where there is one.

    Args:
        mechanism: the problem's, where there is one.
        problem: whose motion is looked along, and whose contacts are judged.
        poses: joint positions [rad or m] by name, each reported on.
        notes: further sentences for the report.

    Raises:
        ProblemError: for a pose that is beyond reach, or that names a joint that follows from others.
    """
    motion, off_path = _motion(problem)
    found = inspect(mechanism, list(poses), motion=motion, contacts="refuse" if problem is None else problem.contacts)
    paths = reach_paths(mechanism, found.reaches) if motion is None else (motion,)
    chosen = () if problem is None else problem.notes
    singular = [note for path in paths for note in inertia_notes(path)]
    return WholeCheck(found=replace(found, notes=(*found.notes, *singular, *notes, *chosen, *off_path)), paths=paths)


def _motion(problem: PlanningProblem | None) -> tuple[KinematicLoopPath | None, tuple[str, ...]]:
    """Return the path of a problem's motion, or None, and why there is none, if there is a problem."""
    if problem is None:
        return None, ()
    try:
        return motion_path(problem), ()
    except LinkplanError as error:
        return None, (f"no path for the problem's motion: {error}",)
