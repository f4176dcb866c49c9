"""References that are tables: times with positions of joints, places of sites or angles of bodies, and the cubic spline.

The spline goes through independent joints. Places of sites and angles of bodies become poses by inverse kinematics, row by
row, each the nearest to the one before.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.planner.problem.keys.kinds import MAX_INTERVALS
from linkplan.planner.problem.keys.motion import ReferenceSection
from linkplan.planner.problem.settings import frozen, joint_values
from linkplan.planner.problem.sites import AXES, key_of, pose_at, tasks_of

# Ends of a table that differ by less than this share of its span count as equal, because files are rounded.
_EQUAL_ENDS = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Spline:
    """A cubic spline over time for each independent joint, repeated if it is `periodic`, else at rest beyond its ends.

    `knots_s` (n + 1,) [s] begin at 0; `coefficients` (4, n, n_s) multiply (t - knot)^3, ..., 1, in rad or m and seconds.
    Forces over time are such curves too, in N.
    """

    knots_s: np.ndarray
    coefficients: np.ndarray
    periodic: bool

    def __post_init__(self) -> None:
        for name in ("knots_s", "coefficients"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def period_s(self) -> float:
        """The time of its last row, or after which it repeats [s]."""
        return float(self.knots_s[-1])

    def derivative(self, time_s: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the derivative of an order at times (n,), as (n, n_s) [rad/s^order or m/s^order]."""
        time = np.asarray(time_s, dtype=float)
        inside = time % self.period_s if self.periodic else np.clip(time, 0.0, self.period_s)
        k = np.clip(np.searchsorted(self.knots_s, inside, side="right") - 1, 0, len(self.knots_s) - 2)
        after = (inside - self.knots_s[k])[:, None]
        value = np.zeros((len(time), self.coefficients.shape[2]))
        for power in range(3, order - 1, -1):
            factor = np.prod(np.arange(power - order + 1, power + 1))
            value = value * after + factor * self.coefficients[3 - power, k]
        rests = order > 0 and not self.periodic
        return np.where(((time < 0) | (time > self.period_s))[:, None], 0.0, value) if rests else value

    def inner_times(self, duration_s: float) -> np.ndarray:
        """Return the times [s] within a duration at which a derivative jumps."""
        periods = np.arange(np.ceil(duration_s / self.period_s) if self.periodic else 1)
        times = (periods[:, None] * self.period_s + self.knots_s[:-1]).ravel()
        return times[(times > 1e-9 * self.period_s) & (times < duration_s - 1e-9 * self.period_s)]

    def stretched(self, factor: float) -> "Spline":
        """Return the reference that takes `factor` times as long."""
        powers = np.array([3, 2, 1, 0])[:, None, None]
        return Spline(knots_s=factor * self.knots_s, coefficients=self.coefficients / factor**powers, periodic=self.periodic)


def reference_rows(columns: dict[str, np.ndarray], what: str, mechanism: Mechanism) -> dict[str, Any]:
    """Return the keys of [reference] with the columns of a CSV file.

    Raises:
        ProblemError: for a column that is not a time, joint, site or body.
    """
    if "time_s" not in columns:
        raise ProblemError(f"{what} needs a column time_s; its columns are {', '.join(columns)}")
    found: dict[str, Any] = {}
    for head, values in columns.items():
        if head == "time_s":
            found[head] = values.tolist()
            continue
        path = _key_of(head, mechanism)
        if path is None:
            joints = ", ".join(f"{joint.name}_{joint.unit}" for joint in mechanism.joints)
            raise ProblemError(
                f"{what} has columns time_s, of joints ({joints}), or of sites (NAME_x_m, NAME_y_m,"
                f" NAME_z_m) and bodies (body_NAME_deg), got {head}"
            )
        table = found
        for part in path[:-1]:
            table = table.setdefault(part, {})
        table[path[-1]] = values.tolist()
    return found


def _key_of(head: str, mechanism: Mechanism) -> tuple[str, ...] | None:
    """Return the keys in [reference] of a column with a name as in plans: O_deg, slide_m, foot_x_m, body_shank_deg, ..."""
    name, _, unit = head.rpartition("_")
    if unit in ("deg", "m") and name in [joint.name for joint in mechanism.joints]:
        return f"position_{unit}", name
    if unit == "deg" and name.startswith("body_"):
        return "body_deg", name.removeprefix("body_")
    site, _, axis = name.removeprefix("site_").rpartition("_")
    return ("at", site, axis) if unit == "m" and axis in AXES else None


def spline_of(section: ReferenceSection, mechanism: Mechanism, ranges: np.ndarray) -> tuple[Spline, str]:
    """Return the reference of a [reference] table with rows, and the kind of its spline.

    Args:
        section: with `time_s`.
        mechanism: whose independent joints the rows determine.
        ranges: of all joints (n_q, 2), which poses from sites' places satisfy.

    Raises:
        ProblemError: for times that do not increase, a different number of rows, or ends that are not those of a period.
    """
    import scipy

    time = times_of(section.time_s, "reference")
    s = _positions(section, mechanism, ranges, len(time))
    time, s = with_period(time, s, section.period_s, "reference")
    ends = section.spline or ("periodic" if returns(s) else "clamped")
    if ends == "periodic" and not returns(s):
        worst = int(np.argmax(np.abs(s[-1] - s[0])))
        joint = mechanism.independent_joints[worst]
        raise ProblemError(
            f"reference.spline 'periodic' must end where it begins (or give reference.period_s), got {joint.name} ="
            f" {joint.text(s[0, worst], 6)} first and {joint.text(s[-1, worst], 6)} {joint.unit} last"
        )
    if ends == "periodic":
        s[-1] = s[0]
    through = scipy.interpolate.CubicSpline(time, s, bc_type=ends)
    return Spline(knots_s=through.x, coefficients=through.c, periodic=ends == "periodic"), ends


def times_of(time_s: Sequence[float], where: str) -> np.ndarray:
    """Return the times (n,) [s] of a table's rows, from the first.

    Raises:
        ProblemError: if there are too many rows, or the times do not increase.
    """
    time = np.array(time_s, dtype=float)
    if len(time) > MAX_INTERVALS:
        raise ProblemError(f"{where}.time_s must have at most {MAX_INTERVALS} rows, got {len(time)}")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        k = int(back[0])
        raise ProblemError(f"{where}.time_s must increase from row to row, got {time[k + 1]:g} after {time[k]:g} s")
    return time - time[0]


def with_period(time: np.ndarray, rows: np.ndarray, period_s: float | None, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,) [s] and rows (n, k), with the first row again after the period, if there is one.

    Raises:
        ProblemError: if the period ends before the last row.
    """
    if period_s is None:
        return time, rows
    if not period_s > time[-1]:
        raise ProblemError(
            f"{where}.period_s must be larger than the last row's time, {time[-1]:g} s from the first, got {period_s:g}"
        )
    return np.append(time, period_s), np.vstack([rows, rows[:1]])


def returns(rows: np.ndarray) -> bool:
    """Return True if the last of rows (n, k) equals the first, except for the rounding of files."""
    return bool(np.all(np.abs(rows[-1] - rows[0]) <= _EQUAL_ENDS * np.ptp(rows, axis=0)))


def _positions(section: ReferenceSection, mechanism: Mechanism, ranges: np.ndarray, n_rows: int) -> np.ndarray:
    """Return the independent joints' positions (n_rows, n_s) [rad or m]."""
    rows = joint_values(section, "position", "reference", mechanism)
    named = {mechanism.joints[index].name: values for index, values in rows.items()}
    named |= section.body_deg | {
        f"{site}.{axis}": values for site, places in section.at.items() for axis, values in places.items()
    }
    for name, values in named.items():
        if len(values) != n_rows:
            raise ProblemError(f"reference has {n_rows} times in time_s and as many values of {name}, got {len(values)}")
    if rows and (section.at or section.body_deg):
        one = "at" if section.at else "body_deg"
        raise ProblemError(f"reference.{one} and reference.position_deg both give the motion; keep one")
    if section.at or section.body_deg:
        return _poses(section, mechanism, ranges, n_rows)
    independent = ", ".join(joint.name for joint in mechanism.independent_joints)
    for index in mechanism.independent.tolist():
        if index not in rows:
            joint = mechanism.joints[index]
            raise ProblemError(
                f"reference.position_{joint.unit} must name every independent joint ({independent}); {joint.name} is"
                " missing; or use reference.at for sites, reference.body_deg for bodies"
            )
    others = [mechanism.joints[index].name for index in rows if index not in mechanism.independent]
    if others:
        raise ProblemError(f"reference.position_deg of joint {others[0]}: it follows from {independent}; name only these")
    pairs = zip(mechanism.independent.tolist(), mechanism.independent_joints, strict=True)
    return np.array([[joint.read(value) for value in rows[index]] for index, joint in pairs]).T


def _poses(section: ReferenceSection, mechanism: Mechanism, ranges: np.ndarray, n_rows: int) -> np.ndarray:
    """Return the independent joints' positions (n_rows, n_s) with sites at their places and bodies at their angles."""
    begin, found = np.array(mechanism.home), []
    for k in range(n_rows):
        places = {name: [of[axis][k] if axis in of else np.nan for axis in AXES] for name, of in section.at.items()}
        angles = {name: values[k] for name, values in section.body_deg.items()}
        tasks = tasks_of(places, angles, "reference.{}", mechanism)
        s, open_rows = pose_at(tasks, f"reference.{{}} (row {k + 1})", mechanism, ranges, (), begin)
        if open_rows:
            raise ProblemError(
                f"{key_of(tasks, 'reference.{}')} leaves some of the {mechanism.dof} degrees of freedom of"
                f" '{mechanism.name}' open: name more coordinates"
            )
        begin = close_at(mechanism, s)
        found.append(s)
    return np.array(found)
