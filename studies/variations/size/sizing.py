"""Motors compared on one problem, each behind each of its gears: the study and the result of `size`."""

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct

from linkplan.models.errors import ProblemError, listed
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.files.tables import toml_text
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.motor_list import CandidateMotor
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Say
from linkplan.studies.output.document import Axis, Block, Code, Plane, Report, Section, Series, Table, Text, table_of
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.numbers import drawn_rows, rounded
from linkplan.studies.output.plan_sections import plan_sections
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import Result
from linkplan.studies.variations.size.candidates import gears_of, with_motor
from linkplan.studies.variations.size.sized_motor import SizedMotor, sized_motor, units_behind

# More motors in one chart cannot be distinguished.
_MOST_DRAWN = 4


class Sizing(Result, Struct, frozen=True, kw_only=True, eq=False):
    """The motors of a list on one problem, the best first: the quickest if the duration is free, else the smallest.

    Sizes are rated powers if all motors that suffice have one (`by_power`), or else peak efforts.

    `plan` is that of the best motor.
    """

    record_name = "size"

    problem: str
    actuator: str
    target: str
    target_speed_unit: str
    target_effort_unit: str
    free_duration: bool
    rest_s: float
    by_power: bool
    motors: list[SizedMotor]
    notes: list[str]
    plan: Beside[Plan] = NOT_READ

    @property
    def found(self) -> bool:
        """True if a motor suffices."""
        return self.motors[0].does

    @property
    def passed(self) -> bool:
        """Whether any motor suffices."""
        return self.found

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield size, the chart of efforts over speeds with the motors' limits, if a motion is known."""
        if charts := sizing_charts(self):
            yield "size", FigureSpec(panels=charts, title=answer(self), panel_in=(8.0, 5.0))

    def blocks(self) -> list[Block]:
        """Return the answer, the table, the reasons against motors, the keys of the best one, notes, the chart."""
        reasons = [Text(text=f"{one.title}: {one.reason}") for one in self.motors if not one.does]
        keys = [Code(title=f"Keys of a problem file with {self.motors[0].title}", text=toml_text(self.motors[0].settings))]
        return [
            Text(text=answer(self), tone="good" if self.found else "bad"),
            _table(self),
            *reasons,
            *(keys if self.found else []),
            *(Text(text=note, tone="note") for note in self.notes),
            *sizing_charts(self),
        ]

    def document(self) -> Report:
        """Return the report of the motors, with the plan of the best one."""
        first = Section(title=f"Motors for {self.actuator} in {self.problem}", blocks=self.blocks())
        return report_of(first.title, answer(self), self.found, [first, *plan_sections(self.plan)])

    def __repr__(self) -> str:
        good = sum(one.does for one in self.motors)
        return f"Sizing({self.problem!r}: {good} of {len(self.motors)} do)"


def answer(found: Sizing) -> str:
    """Return a sentence on the number of motors that suffice, and on the best one."""
    best, n, good = found.motors[0], len(found.motors), sum(one.does for one in found.motors)
    if not good:
        return f"none of {n} motors with gears suffices for {found.actuator} in {found.problem}; the nearest is {best.title}"
    left = f"{100 * (best.margin or 0.0):.3g} % of {best.tightest} left"
    size = f"rated {best.rated_power_w:.4g} W" if found.by_power else f"peak {best.peak_limit:.4g} {best.effort_unit}"
    which = (
        f"best: {best.title}, in {best.duration_s:.4g} s"
        if found.free_duration
        else f"smallest: {best.title} ({size}), {left}"
    )
    fast = "" if best.speed_up is None else f", up to {np.floor(1000 * best.speed_up) / 1000:g} times as fast"  # feasible
    counted = f"{good} of {n} motors with gears {'suffices' if good == 1 else 'suffice'}"
    return f"{counted} for {found.actuator}; {which}{fast}"


def _table(found: Sizing) -> Table:
    efforts = " or ".join(dict.fromkeys(one.effort_unit for one in found.motors))
    speeds = " or ".join(dict.fromkeys(one.speed_unit for one in found.motors))
    heads = ["motor", "gear", "does", "margin [%]", "of its", "time [s]" if found.free_duration else "speed-up"]
    heads += [
        f"peak [{efforts}]",
        "share [%]",
        f"rms [{efforts}]",
        "share [%]",
        f"speed [{speeds}]",
        "line [%]",
        "rotor [%]",
    ]
    rows = [_row(one, found.free_duration) for one in found.motors]
    rest = f", with a rest of {found.rest_s:g} s after each motion" if found.rest_s else ""
    return table_of(f"Motors for {found.actuator} on {found.target}{rest}", heads, rows, digits=3)


def _row(one: SizedMotor, free: bool) -> list:
    loads = one.loads
    shown = (
        [None] * 6
        if loads is None
        else [
            loads.peak_effort,
            _percent(loads.peak_share),
            loads.rms_effort,
            _percent(loads.rms_share),
            loads.peak_speed,
            _percent(loads.line_share),
        ]
    )
    last = one.duration_s if free else one.speed_up
    first = [one.motor, one.gear, one.does, _percent(one.margin), one.tightest or None, last]
    return [*first, *shown, _percent(one.rotor_share)]


def _percent(share: float | None) -> float | None:
    return None if share is None else round(100.0 * share, 2)


def sizing_charts(found: Sizing) -> list[Plane]:
    """Return the chart of efforts over speeds behind the gears, for the best gear of each motor, with the motors' limits."""
    drawn: dict[str, SizedMotor] = {}
    for one in found.motors:
        if one.curve is not None and len(drawn) < _MOST_DRAWN:
            drawn.setdefault(one.motor, one)
    if not drawn:
        return []
    speeds = np.concatenate([one.curve[:, 0] for one in drawn.values() if one.curve is not None])
    beside = 0.1 * float(np.ptp(speeds)) or 1.0
    outline = np.linspace(speeds.min() - beside, speeds.max() + beside, 401)
    # Nearly equal curves overlap, so later ones are thinner.
    curves = [one for k, of in enumerate(drawn.values()) for one in _curves(of, outline, k, 1.2 * (len(drawn) - k))]
    return [
        Plane(
            title=f"Effort over speed at {found.target}, and the motors' limits",
            x_axis=Axis(label=f"speed of {found.target}", unit=found.target_speed_unit),
            y_axis=Axis(label="effort behind the gear", unit=found.target_effort_unit),
            curves=curves,
        )
    ]


def _curves(one: SizedMotor, speed: np.ndarray, colour: int, width: float) -> list[Series]:
    """Return a motor's planned efforts, and the least and largest that it gives at speeds (n,)."""
    assert one.curve is not None  # the caller ensures it
    planned = one.curve[drawn_rows(one.curve)]
    name = f"{one.title} (dashed: its limits)"
    curve = Series(name=name, x=rounded(planned[:, 0]), y=rounded(planned[:, 1]), colour=colour, width=width)
    peak = one.gear * one.peak_limit
    low, high = np.full_like(speed, -peak), np.full_like(speed, peak)
    if one.line is not None:
        stall, no_load = one.line
        low, high = np.maximum(low, stall * (-1.0 - speed / no_load)), np.minimum(high, stall * (1.0 - speed / no_load))
    limits = (rounded(np.where(low > high, np.nan, end)) for end in (low, high))
    return [curve, *(Series(name="", x=rounded(speed), y=end, look="dash", colour=colour, width=1.2) for end in limits)]


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
