"""A user's initial guess: positions at equidistant times, or a saved plan's motion."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from linkplan.models.catalogue import is_folder
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.tables import path_beside
from linkplan.planner.files.trajectory_file import read_trajectory
from linkplan.planner.keys.sections import GuessSection
from linkplan.planner.problem.joint_values import joint_values
from linkplan.planner.problem.values import frozen
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class GuessedPath:
    """A user's initial guess: independent positions (n, n_s) [rad or m] at equidistant times; duration [s] or None."""

    path: np.ndarray
    duration_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", frozen(self.path))


def guess_place(section: GuessSection, folder: Path | None) -> Path | None:
    """Return the folder of the saved plan whose motion is the guess; None if no plan is named."""
    if section.plan is None:
        return None
    if section.path_deg or section.path_m:
        raise ProblemError("guess.plan and guess.path_deg are two guesses; keep one")
    place = path_beside(section.plan, folder)
    if not is_folder(place):
        where = "the working folder" if folder is None else f"'{folder}', the problem file's, or the working folder"
        raise ProblemError(f"guess.plan '{section.plan}' is not a folder in {where}; it is where a plan was saved")
    return place


def guess_of(section: GuessSection, mechanism: Mechanism, place: Path | None) -> GuessedPath | Trajectory | None:
    """Return the guess of a [guess] table; None without a guess. `place` is the folder of the plan that it names."""
    if place is not None:
        return read_trajectory(place / "trajectory.npz")
    paths = joint_values(section, "path", "guess", mechanism)
    if not paths:
        return None
    columns = []
    for index, joint in zip(mechanism.independent.tolist(), mechanism.independent_joints, strict=True):
        if index not in paths:
            raise ProblemError(f"guess.path_{joint.unit} names no list of positions for joint {joint.name}")
        columns.append([joint.read(value) for value in paths[index]])
    if len({len(column) for column in columns}) > 1:
        raise ProblemError("guess.path_deg has equally many positions for every independent joint")
    return GuessedPath(path=np.array(columns).T, duration_s=section.duration_s)
