"""The study of `linkplan transfer`: a mechanism in the coordinates of its output joints, and its transfer table."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.transfer.output_map import OutputMap, Transmission, output_map, transmission
from linkplan.models.transfer.polytope import joint_gains, motor_gains
from linkplan.models.transfer.table import REFINED, TransferTable, transfer_table
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import number
from linkplan.planner.search.planning import silent
from linkplan.studies.handover.export.output_joints import with_outputs
from linkplan.studies.handover.transfer.serial_study import Serial, motion_of_plan, serial_of

# The sentence on the direction of the map, for every result.
CONVENTION = "motor velocity = G joint velocity; joint effort = G^T motor effort; so motor power = joint power"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Transfer:
    """A transfer table, the linkage at home, the motors' effort limits (n_m, 2), and the converted gains.

    `motor_speed` are the motors' top speeds (n_m,), `motor_stall` their stall efforts, or None. `gains` have names of
    `GAINS`, in SI: gains of joints (n_o,) are converted to the motors, gains of motors (n_m,) to the joints. `serial` is the
    serial equivalent; None if the linkage has none, with the reason in `serial_note`.
    """

    table: TransferTable
    home: Transmission
    effort_limit: np.ndarray
    motor_speed: np.ndarray | None
    motor_stall: np.ndarray | None
    gains: Mapping[str, np.ndarray]
    serial: Serial | None
    serial_note: str

    @property
    def outputs(self) -> OutputMap:
        """The output joints and their motors."""
        return self.table.outputs

    @property
    def error(self) -> float:
        """The largest interpolation error of the refined quantities, as a share of each quantity's largest size."""
        return max(self.table.grid.errors[name] for name in REFINED)

    @property
    def kept(self) -> bool:
        """True if the table's interpolation error is within the tolerance."""
        return self.error <= self.table.tolerance

    @property
    def message(self) -> str:
        """The verdict in a sentence."""
        grid, outputs = self.table.grid, self.outputs
        size = " x ".join(str(len(axis)) for axis in grid.axes)
        motors, joints = (", ".join(one.name for one in of) for of in (outputs.actuators, outputs.joints))
        text = f"{motors} to {joints}: {size} nodes, interpolation error {self.error:.2g} of each quantity's largest size"
        if self.kept:
            return text
        return (
            f"{text}, above the tolerance of {self.table.tolerance:g} in the largest table: use a larger tolerance, or a"
            " range without dead centres"
        )


def transfer_study(
    mechanism: Mechanism,
    names: Sequence[str],
    *,
    tolerance: float = 1e-3,
    ends: Mapping[str, tuple[float, float]] | None = None,
    problem: Problem | None = None,
    motor_speeds: Sequence[float] = (),
    gains: Mapping[str, Sequence[float]] | None = None,
    along: Plan | None = None,
    say: Callable[[str], None] = silent,
) -> Transfer:
    """Return the transfer table of output joints.

    Args:
        mechanism: in any coordinates.
        names: of the output joints.
        tolerance: interpolation error allowed, as a share of each quantity's largest size.
        ends: positions [rad or m] between which the table lies, by joint; by default the reach.
        problem: gives effort limits and the motors' top speeds; by default the model's limits.
        motor_speeds: top speeds of the table's motors, in the actuators' units; one for all, or one each.
        gains: by their name in `GAINS`, in SI; one for all, or one each.
        along: a plan of the same model; the serial equivalent's errors are computed along its motion.
        say: called with lines on the progress.

    Raises:
        LinkplanError: if the joints cannot be the mechanism's coordinates, or a value is invalid.
    """
    tolerance = number(tolerance, "tolerance", positive=True)
    inside = with_outputs(mechanism, names)
    outputs = output_map(inside, names)
    motors, n_o, n_m = list(outputs.motors), len(names), len(outputs.motors)
    carried = {}
    for name, values in (gains or {}).items():
        carried[name] = each(values, name, n_o if name.startswith("joint") else n_m)
    limit, speed, stall = outputs.effort_limit, None, None
    if problem is not None:
        limit, known = np.array(problem.limits.actuators_effort)[motors], no_load_speeds(problem)[motors]
        speed = None if np.isnan(known).any() else known
        lines = [None if (motor := problem.motors[j]) is None else motor.line for j in motors]
        stall = None if None in lines else np.array([line[0] for line in lines if line is not None])
    if len(motor_speeds):
        speed = each(motor_speeds, "motor_speed", n_m)
    for name in ends or {}:
        if name not in names:
            raise ProblemError(f"a range is given for '{name}'; output joints are {', '.join(names)}")
    spans = [(ends or {}).get(name) for name in names]
    say(f"{', '.join(names)}: tables of {', '.join(one.name for one in outputs.actuators)}")
    motion = None if along is None else motion_of_plan(along, outputs)
    table = transfer_table(outputs, tolerance, spans)
    serial, note = serial_of(table, limit, motion)
    return Transfer(
        table=table,
        home=transmission(outputs, inside.home[None]),
        effort_limit=limit,
        motor_speed=speed,
        motor_stall=stall,
        gains=carried,
        serial=serial,
        serial_note=note,
    )


def carried_gains(transfer: Transfer, ratio: np.ndarray) -> dict[str, np.ndarray]:
    """Return the gains converted by G (n, n_m, n_o), by name: "motor_kp" (n, n_m, n_m), "joint_kp" (n, n_o, n_o), ..."""
    found = {}
    for name, gains in transfer.gains.items():
        side, _, letter = name.partition("_")
        across, other = (motor_gains, "motor") if side == "joint" else (joint_gains, "joint")
        found[f"{other}_{letter}"] = across(ratio, np.diag(gains))
    return found


def no_load_speeds(problem: Problem) -> np.ndarray:
    """Return the motors' no-load speeds (n_u,) [rad/s or m/s] of a problem, NaN where unknown."""
    speeds = [None if motor is None else motor.no_load_speed for motor in problem.motors]
    return np.array([np.nan if speed is None else speed for speed in speeds], dtype=float)


def each(values: Sequence[float], name: str, n: int) -> np.ndarray:
    """Return values (n,), one for all or one each, of at least zero.

    Raises:
        ProblemError: for another number of values, or an invalid one.
    """
    found = np.array([number(value, name, at_least_zero=True) for value in values])
    if len(found) not in (1, n):
        raise ProblemError(f"{name} has one value{f' for all or {n}' if n > 1 else ''}, got {len(found)}")
    return np.broadcast_to(found, (n,)).astype(float)
