"""Forces over time: rows of times with forces on sites, and the linear or cubic curve between them, repeated or held."""

from typing import Any

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.external_forces import ForcesOverTime
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.dynamics import site_index
from linkplan.planner.problem.keys.kinds import MAX_INTERVALS
from linkplan.planner.problem.keys.motion import ForceSection
from linkplan.planner.problem.motion import Motion
from linkplan.planner.problem.reference import Reference, is_whole, repeats_in
from linkplan.planner.problem.sites import AXES
from linkplan.planner.problem.table_reference import Spline, returns, times_of, with_period

_KEY = "force_over_time"


def force_rows(columns: dict[str, np.ndarray], what: str, _mechanism: Mechanism) -> dict[str, Any]:
    """Return the keys of [force_over_time] with the columns of a CSV file.

    Raises:
        ProblemError: for a column that is neither the time nor a site's force.
    """
    heads = [head.removesuffix("_N").rpartition("_") for head in columns if head != "time_s"]
    legal = all(head == "time_s" or head.endswith("_N") for head in columns) and all(axis in AXES for *_, axis in heads)
    if "time_s" not in columns or not heads or not legal:
        raise ProblemError(f"{what} has columns time_s and SITE_x_N, SITE_y_N or SITE_z_N, got {', '.join(columns)}")
    on: dict[str, dict] = {}
    for site, _, axis in heads:
        on.setdefault(site, {})[axis] = columns[f"{site}_{axis}_N"].tolist()
    return {"time_s": columns["time_s"].tolist(), "on": on}


def forces_of(
    section: ForceSection, mechanism: Mechanism, motion: Motion, reference: Reference | None = None
) -> ForcesOverTime:
    """Return the forces of a [force_over_time] table.

    Args:
        section: the table; its first row is at the motion's start.
        mechanism: with the sites.
        motion: in whose time the table is given.
        reference: of the motion; the table repeats with a motion that repeats, if its last row equals the first.

    Raises:
        ProblemError: for a table that cannot be read, or whose times do not fit the motion's.
    """
    _check_motion(motion)
    if section.time_s is None or not section.on:
        raise ProblemError(f"[{_KEY}] needs {_KEY}.file, or {_KEY}.time_s and {_KEY}.on.SITE")
    time, columns = times_of(section.time_s, _KEY), []
    for name, axes in section.on.items():
        site = site_index(mechanism.model, name, f"{_KEY}.on", ProblemError)
        if mechanism.model.body_weldid[mechanism.model.site_bodyid[site]] == 0:
            raise ProblemError(f"{_KEY}.on.{name}: the site does not move, so a force on it has no effect")
        for axis, values in axes.items():
            if len(values) != len(time):
                raise ProblemError(
                    f"{_KEY} has {len(time)} times in time_s and as many values of {name}.{axis}, got {len(values)}"
                )
        own: dict[str, list[float]] = {axis: [0.0] * len(time) for axis in AXES} | dict(axes)
        columns += [own[axis] for axis in AXES]
    time, rows = with_period(time, np.array(columns).T, section.period_s, _KEY)
    duration, last = motion.duration_s, float(time[-1])
    assert duration is not None  # as checked above
    tracked = motion.kind == "track" and reference is not None and repeats_in(reference, duration)
    again = motion.kind == "periodic" or (tracked and returns(rows))
    repeats = section.period_s is not None or again
    if again and not returns(rows):
        raise ProblemError(
            f"the last row of {_KEY} of a periodic motion must equal the first (or give {_KEY}.period_s), got"
            f" {_shown(rows[0])} first and {_shown(rows[-1])} N last"
        )
    if again and not is_whole(duration / last):
        raise ProblemError(
            f"{_KEY} repeats after {last:g} s; motion.duration_s must be a multiple of this, got {duration:g}"
        )
    if not repeats and last < duration * (1 - 1e-9):
        raise ProblemError(
            f"{_KEY}.time_s ends at {last:g} s from its first row, before the motion's end at {duration:g} s; add rows up"
            f" to the end, or {_KEY}.period_s if it repeats"
        )
    if repeats and duration / last * (len(time) - 1) > MAX_INTERVALS:
        raise ProblemError(
            f"{_KEY} repeats {duration / last:.6g} times in motion.duration_s = {duration:g} s; with {len(time) - 1} rows,"
            f" at most {MAX_INTERVALS // (len(time) - 1)} times are legal"
        )
    if again:
        rows[-1] = rows[0]
    curve = Spline(knots_s=time, coefficients=_coefficients(time, rows, section.interpolation, repeats), periodic=repeats)
    return ForcesOverTime(tuple(section.on), curve)


def force_notes(section: ForceSection) -> list[str]:
    """Return the note on where the forces of a [force_over_time] table act."""
    rows, kind = len(section.time_s), section.interpolation
    acts = f"{_KEY}: {kind} between {rows} rows, on {', '.join(section.on)}, over the motion, not in poses at rest"
    return [f"{acts}; the planner may rest or turn back while they act: forces of a place are a mechanism.load"]


def _check_motion(motion: Motion) -> None:
    """Refuse a motion whose times are not known before it is planned."""
    if motion.duration_s is None:
        raise ProblemError(f"{_KEY} is fixed in time and needs a motion.duration_s in seconds, got 'free'")
    free = [k for k, waypoint in enumerate(motion.waypoints) if waypoint.time_s is None]
    if free:
        raise ProblemError(f"{_KEY} is fixed in time and needs motion.waypoints[{free[0]}].time_s in seconds, got 'free'")
    if motion.kind in ("follow", "hold"):
        raise ProblemError(f"{_KEY} needs motion.kind 'reach', 'periodic' or 'track', got '{motion.kind}'")


def _coefficients(time: np.ndarray, rows: np.ndarray, interpolation: str, repeats: bool) -> np.ndarray:
    """Return the coefficients (4, n, k) of the rows' curve, in the order of `Spline`."""
    import scipy

    if interpolation == "cubic":
        return scipy.interpolate.CubicSpline(time, rows, bc_type="periodic" if repeats else "not-a-knot").c
    slope = np.diff(rows, axis=0) / np.diff(time)[:, None]
    return np.stack([0 * slope, 0 * slope, slope, rows[:-1]])


def _shown(row: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.6g}" for value in row) + "]"
