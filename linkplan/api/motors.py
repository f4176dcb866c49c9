"""`size`: which motors of a list, behind which gears, can drive a problem's motion, and with what margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from linkplan.api.command import command
from linkplan.api.inputs import ProblemLike, given_problem
from linkplan.api.reporting import Progress, listener
from linkplan.models.errors import ProblemError
from linkplan.planner.problem.settings import number
from linkplan.studies.output.paths import path_of
from linkplan.studies.variations.size.candidates import actuator_of, motors_from, read_motors
from linkplan.studies.variations.size.sizing import Sizing, size_motors


@command(
    "find which motors of a list, behind which gears, can drive a problem's motion, and their margins",
    saved=True,
    showing=("report",),
)
def size(
    problem: ProblemLike,
    motors: str | Path | Sequence[Mapping],
    *,
    actuator: str | None = None,
    rest_s: float = 0.0,
    progress: Progress | None = None,
) -> Sizing:
    """Return the margins of each motor of a list, with each of its gears, for a problem's motion; the best comes first.

    The problem is planned with each motor and gear: its peak effort, torque-speed line and rotor replace those of the
    actuator (docs/motors.md). A motor suffices if the plan passes its certificate and the rms effort is within its limit.

    Args:
        problem: a problem, or the name or path of one.
        motors: the path of a TOML file with [[motor]] tables, or of a CSV file with one motor per row; or a list of tables
            with `name`, `peak_effort` [N.m or N], `rms_effort`, `stall_effort` and `no_load_speed_deg_s` or `_m_s`,
            `rotor_inertia` [kg m2 or kg], `gears`, a list of ratios, or `leads_m` of ball screws, `torque_constant` and
            `resistance_ohm`.
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
    return size_motors(asked, actuator_of(asked, actuator), listed, rest, listener(progress))
