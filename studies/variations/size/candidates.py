"""A list of motors, from a TOML or CSV file or from tables, and a problem with one of them behind an actuator."""

import csv
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from linkplan.models.catalogue import nearest_source
from linkplan.models.errors import ModelError, ProblemError, choose, shown
from linkplan.models.reading import MOST_TOML_BYTES, read_file, read_toml
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.problem.keys.limits import Motor
from linkplan.planner.problem.keys.motor_list import CandidateMotor, MotorsFile
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import to_toml_types

_LEGAL = "a list of motors must be a TOML file with [[motor]] tables, or a CSV file with a column for each key of a motor"


def read_motors(path: Path) -> list[CandidateMotor]:
    """Return the motors in a TOML file, or in a CSV file with one motor per row.

    Raises:
        ProblemError: if it cannot be read, or has an invalid value.
    """
    if os.path.isdir(path):
        raise ProblemError(f"motors '{path}' is a folder; {_LEGAL}")
    if not os.path.exists(path):
        raise ProblemError(f"motors '{path}'{nearest_source(str(path), ())} is not a file; {_LEGAL}")
    what = f"motors '{path}'"
    if path.suffix.lower() == ".csv":
        return motors_from({"motor": _rows(path, what)})
    tables = read_toml(path, what)
    if "motor" not in tables and "mechanism" in tables:
        raise ProblemError(f"{what} is a problem file; {_LEGAL}")
    return motors_from(tables)


def motors_from(tables: Mapping[str, object]) -> list[CandidateMotor]:
    """Return the motors in the tables of a file.

    Raises:
        ProblemError: for an invalid value, a motor without a peak effort, or two motors with the same name.
    """
    tables = to_toml_types(tables)
    listed = tables.get("motor")
    for k, one in enumerate(listed if isinstance(listed, list) else []):
        if not isinstance(one, dict):
            raise ProblemError(f"motor[{k}] must be a table ([[motor]]), got {shown(repr(one), 60)}")
        named = isinstance(one.get("name"), str)
        found = read(CandidateMotor, one, f"motor.{one['name'][:99]}" if named else f"motor[{k}]")
        if found.peak_effort is None and found.stall_effort is None:
            raise ProblemError(f"motor '{found.name}' needs a peak_effort or a stall_effort; got neither")
    motors = read(MotorsFile, tables, "").motor
    twice = [name for name, count in Counter(one.name for one in motors).items() if count > 1]
    if twice:
        raise ProblemError(f"motors must have different names (use `gears` for several gears); repeated: {', '.join(twice)}")
    return motors


def _rows(path: Path, what: str) -> list[dict[str, object]]:
    """Return the rows of a CSV file as tables without empty cells; `gears` and `leads_m` have blanks between numbers."""
    try:
        text = read_file(path, what, MOST_TOML_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ProblemError(f"{what} is not UTF-8 text") from error
    reader = csv.DictReader(text.splitlines(), skipinitialspace=True)
    try:
        rows, heads = list(reader), [head.strip() for head in reader.fieldnames or ()]
    except csv.Error as error:  # a cell of more than 131,072 characters
        raise ProblemError(f"{what} is not CSV: {error}") from error
    twice = [head for head, count in Counter(heads).items() if count > 1]
    if twice:
        raise ProblemError(f"{what} must have different keys in its first row, got '{twice[0]}' twice")
    if any(None in row for row in rows):
        raise ProblemError(f"{what} has a row with more cells than its first row has keys")
    filled = [{key.strip(): cell.strip() for key, cell in row.items() if cell and cell.strip()} for row in rows]
    return [{key: _value(key, cell) for key, cell in row.items()} for row in filled if row]


def _value(key: str, cell: str) -> object:
    """Return a cell as a number, or for `gears` and `leads_m` as numbers; other text stays and is refused later."""
    try:
        return (
            cell if key == "name" else [float(one) for one in cell.split()] if key in ("gears", "leads_m") else float(cell)
        )
    except ValueError:
        return cell


def actuator_of(problem: Problem, asked: str | None) -> int:
    """Return the index of the actuator to size: the given one, or the only one.

    Raises:
        ProblemError: for an unknown name, for several actuators without a name, or for a servo with a ctrlrange, which
            another motor would not have.
    """
    actuators = problem.mechanism.actuators
    names = [one.name for one in actuators]
    if asked is None and len(names) > 1:
        raise ProblemError(f"actuator must be one of {', '.join(names)}: name the one to size")
    index = 0 if asked is None else names.index(choose("actuator", asked, names, ProblemError))
    if actuators[index].limits_control:
        raise ProblemError(
            f"actuator '{names[index]}' is a servo, whose ctrlrange also limits its effort: use a model in which it is a"
            " motor"
        )
    return index


def gears_of(problem: Problem, index: int, motor: CandidateMotor) -> Sequence[float]:
    """Return the gears to try with a motor: its own list, those of its screws' leads, or the actuator's gear.

    Raises:
        ProblemError: for gears and leads together, or leads at an actuator that moves no slide.
    """
    actuator = problem.mechanism.actuators[index]
    if motor.leads_m:
        joint = None if actuator.joint is None else problem.mechanism.joints[actuator.joint]
        if motor.gears or joint is None or joint.kind != "slide":
            why = (
                "not beside gears"
                if motor.gears
                else f"for an actuator on a slide, and {actuator.name} is on {actuator.target}"
            )
            raise ProblemError(f"motor.{motor.name}.leads_m is {why}")
        return [2 * np.pi / lead for lead in motor.leads_m]
    return motor.gears or [abs(actuator.gear)]


def with_motor(problem: Problem, index: int, motor: CandidateMotor, gear: float) -> Problem:
    """Return a problem with a motor behind a gear at actuator `index`, in place of the actuator's own limits and motor.

    If the actuator's effort has only one sign (a cable that pulls), so has the motor's.

    Raises:
        LinkplanError: if the actuator cannot have such a motor.
    """
    actuator, tables = problem.mechanism.actuators[index], problem.to_dict()
    name, limits, mechanism = actuator.name, tables.get("limits", {}), tables["mechanism"]
    changes = {"gear": mechanism.get("gear", {}) | {name: float(np.copysign(gear, actuator.gear))}}
    if motor.rotor_inertia or problem.mechanism.model.actuator_armature[actuator.index]:
        changes["rotor_inertia"] = mechanism.get("rotor_inertia", {}) | {name: motor.rotor_inertia or 0.0}
    peak, (low, high) = motor.peak_effort or motor.stall_effort, effort_bounds(problem)[index]
    ends = [0.0 if low >= 0 else -peak, 0.0 if high <= 0 else peak]
    given = {key: value for key in Motor.__struct_fields__ if (value := getattr(motor, key)) is not None}
    others = {key: one for key, one in tables.get("motors", {}).items() if key != name}
    try:
        return problem.replace(
            **changes,
            limits=limits | {"effort": limits.get("effort", {}) | {name: ends}},
            motors=others | ({name: given} if given else {}),
            name=f"{problem.name} with {motor.name}, gear {gear:g}",
        )
    except (ProblemError, ModelError) as error:
        raise type(error)(f"motor '{motor.name}': {error}") from error
