"""`size`: which motors of a list, behind which gears, can drive a problem's motion, and with what margins."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from linkplan.api.command import command
from linkplan.api.inputs import ProblemLike, given_problem
from linkplan.api.reporting import Progress, listener
from linkplan.models.errors import ProblemError
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.settings import number
from linkplan.studies.output.document import Block, Report
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.paths import path_of
from linkplan.studies.output.result import Result
from linkplan.studies.variations.size.candidates import actuator_of, motors_from, read_motors
from linkplan.studies.variations.size.sizing import Sizing, size_motors
from linkplan.studies.variations.size.sizing_blocks import sizing_blocks, sizing_figure, sizing_report


@command(
    "find which motors of a list, behind which gears, can drive a problem's motion, and their margins",
    record="size",
    showing=("report",),
)
def size(
    problem: ProblemLike,
    motors: str | Path | Sequence[Mapping],
    *,
    actuator: str | None = None,
    rest_s: float = 0.0,
    progress: Progress | None = None,
) -> SizeResult:
    """Return the margins of each motor of a list, with each of its gears, for a problem's motion; the best comes first.

    The problem is planned with each motor and gear: its peak effort, torque-speed line and rotor replace those of the
    actuator (docs/motors.md). A motor suffices if the plan passes its certificate and the rms effort is within its limit.

    Args:
        problem: a problem, or the name or path of one.
        motors: the path of a TOML file with [[motor]] tables, or of a CSV file with one motor per row; or a list of tables
            with `name`, `peak_effort` [N.m or N], `rms_effort`, `stall_effort` and `no_load_speed_deg_s` or `_m_s`,
            `rotor_inertia` [kg m2 or kg], `gears`, a list of ratios, `torque_constant` and `resistance_ohm`.
        actuator: the actuator to size; needed if there are several. The others keep their limits.
        rest_s: the rest without effort after each motion [s]; the rms effort is taken over motion and rest.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: for an invalid motor, before anything is planned, or an actuator that cannot have one.

    Example::

        motors = [{"name": "M90", "peak_effort": 15.0, "rotor_inertia": 1e-4, "gears": [6, 9]}]
        print(linkplan.size("knee-reach", motors))
    """
    asked = given_problem(problem)
    if isinstance(motors, Sequence) and not isinstance(motors, str):
        listed = motors_from({"motor": motors})
    else:
        listed = read_motors(path_of(motors, "motors"))
    rest = number(rest_s, "rest_s", at_least_zero=True)
    if rest and (asked.motion.kind == "periodic" or (asked.reference is not None and asked.reference.periodic)):
        raise ProblemError(f"rest_s must be 0 for a periodic motion such as {asked.name}, got {rest:g} s")
    sizing, plan = size_motors(asked, actuator_of(asked, actuator), listed, rest, listener(progress))
    return SizeResult(sizing=sizing, plan=plan)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class SizeResult(Result):
    """The sized motors, the best first.

    `str(result)` is the table; `to_dict()` has every value; `plan` is that of the best motor.
    """

    record_name = "size"

    sizing: Sizing
    plan: Plan

    @property
    def passed(self) -> bool:
        """Whether any motor suffices."""
        return self.sizing.found

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield size, the chart of efforts over speeds with the motors' limits, if a motion is known."""
        if any(one.curve is not None for one in self.sizing.motors):
            yield "size", sizing_figure(self.sizing)

    def blocks(self) -> list[Block]:
        """Return the answer, the table and the chart."""
        return sizing_blocks(self.sizing)

    def document(self) -> Report:
        """Return the report."""
        return sizing_report(self.sizing, self.plan)

    def __repr__(self) -> str:
        good = sum(one.does for one in self.sizing.motors)
        return f"SizeResult({self.sizing.problem!r}: {good} of {len(self.sizing.motors)} do)"
