"""Motors compared on one problem: each motor of a list behind each of its gears, the best first."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import ProblemError, listed
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.motor_list import CandidateMotor
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Say
from linkplan.studies.variations.size.candidates import gears_of, with_motor
from linkplan.studies.variations.size.sized_motor import SizedMotor, sized_motor, units_behind
from linkplan.studies.variations.size.sizing_blocks import Sizing

# More plans are probably a typing error: at a second each they take a quarter of an hour.
MAX_PLANS = 1000


def size_motors(problem: Problem, index: int, motors: Sequence[CandidateMotor], rest_s: float, say: Say) -> Sizing:
    """Return the motors on a problem's actuator `index`, each behind each of its gears, with the plan of the best.

    Args:
        problem: whose actuator gets the motors.
        index: of the actuator.
        motors: each is tried behind each of its gears.
        rest_s: the rest without effort after each motion [s]; the rms effort is taken over motion and rest.
        say: receives progress.

    Raises:
        LinkplanError: if a motor cannot drive the actuator, before anything is planned; or as for planning.
    """
    cases = [(motor, gear) for motor in motors for gear in gears_of(problem, index, motor)]
    if len(cases) > MAX_PLANS:
        raise ProblemError(f"at most {MAX_PLANS} motors with gears can be compared; the list has {len(cases)}")
    firsts = [with_motor(problem, index, motor, gears_of(problem, index, motor)[0]) for motor in motors]
    free = problem.motion.duration_s is None
    best: dict[bool, tuple[SizedMotor, Plan]] = {}  # by rated power, and by peak effort
    rows: list[SizedMotor] = []
    for number, (motor, gear) in enumerate(cases):
        say(f"{number + 1} of {len(cases)}: {motor.name}, gear {gear:g}")
        one, plan = sized_motor(problem, index, motor, gear, rest_s, say)
        rows.append(one)
        for by in (True, False):
            if by not in best or place_of(one, free=free, by_power=by) < place_of(best[by][0], free=free, by_power=by):
                best[by] = one, plan
    by_power = all(one.rated_power_w is not None for one in rows if one.does)
    actuator, (_, speed_unit, effort_unit) = problem.mechanism.actuators[index], units_behind(problem, index)
    return Sizing(
        problem=problem.name,
        actuator=actuator.name,
        target=actuator.target,
        target_speed_unit=speed_unit,
        target_effort_unit=effort_unit,
        free_duration=free,
        rest_s=rest_s,
        by_power=by_power,
        motors=sorted(rows, key=lambda one: place_of(one, free=free, by_power=by_power)),  # equals stay in the list's order
        notes=_notes(problem, index, motors, firsts[0]),
        plan=best[by_power][1],
    )


def place_of(one: SizedMotor, *, free: bool, by_power: bool) -> tuple[bool, float, float, float]:
    """Return a motor's sort key: motors that suffice first, the quickest if the duration is free, else the smallest.

    The smallest has the least rated power if all that suffice have one, or else the least peak effort. Equal ones, and those
    that do not suffice, are sorted by margin.
    """
    duration_s = one.duration_s if one.duration_s is not None else np.inf
    sizes = (one.rated_power_w or 0.0 if by_power else 0.0, one.peak_limit) if one.does and not free else (0.0, 0.0)
    return not one.does, duration_s if free else sizes[0], sizes[1], np.inf if one.margin is None else -one.margin


def _notes(problem: Problem, index: int, motors: Sequence[CandidateMotor], first: Problem) -> list[str]:
    """Return notes on missing values of the list, and on replaced values of the problem and the model."""
    name, tables = problem.mechanism.actuators[index].name, problem.to_dict()
    weightless = [motor.name for motor in motors if motor.rotor_inertia is None]
    unlimited = [motor.name for motor in motors if motor.rms_effort is None]
    replaced = [f"limits.effort.{name}"] if name in tables.get("limits", {}).get("effort", {}) else []
    replaced += [f"motors.{name}"] if name in tables.get("motors", {}) else []
    said = [f"motors without rotor_inertia have a rotor inertia of 0: {listed(weightless, 12)}"] if weightless else []
    said += [f"motors without rms_effort have no limit on the rms effort: {listed(unlimited, 12)}"] if unlimited else []
    said += [f"the list replaces {' and '.join(replaced)}"] if replaced else []
    return said + [note for note in first.mechanism.notes if note not in problem.mechanism.notes]
