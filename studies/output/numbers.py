"""Numbers as they are shown: figures with their known digits, values rounded to significant digits, and thinned curves."""

import math
from itertools import pairwise

import numpy as np

from linkplan.planner.plan import Plan
from linkplan.planner.problem.problem import Problem

# Solvers stop at a relative 1e-8. A certificate passes at a relative error of about 1e-3 at the most.
_MAX_DIGITS, _MIN_DIGITS = 8, 3


def known_digits(plan: Plan) -> int:
    """Return the number of known digits of a plan's duration and objective, from its integration error.

    The error of the integrated state as a share of the joints' travel is about the relative error of the motion's figures.
    """
    trajectory, certificate = plan.trajectory, plan.certificate
    if trajectory is None or certificate is None:
        return _MIN_DIGITS
    travelled = np.ptp(trajectory.position_at(trajectory.dense_times(4)), axis=0)
    shares, error_rad = [], np.radians(certificate.integration_error_deg)
    for kind, error in (("hinge", error_rad), ("slide", certificate.integration_error_m)):
        of_kind = [x for x, j in zip(travelled, plan.problem.mechanism.independent_joints, strict=True) if j.kind == kind]
        if of_kind and max(of_kind) > 0 and np.isfinite(error):
            shares.append(error / max(of_kind))
    share = max(shares, default=1.0)
    return int(np.clip(np.floor(-np.log10(max(share, 10.0**-_MAX_DIGITS))), _MIN_DIGITS, _MAX_DIGITS))


def figure(value: float, digits: int) -> str:
    """Return a number with `digits` significant digits; positive ones below 1e-14 are rounding errors."""
    return "< 1e-14" if 0 < value < 1e-14 else f"{value:.{digits}g}"


def radius_figure(radius: float | None) -> str:
    """Return the radius of a sampled loop's pole; near the unit circle as the distance from it, such as "1-2.3e-05"."""
    if radius is None:
        return "-"
    beyond = radius - 1.0
    return f"1{beyond:+.1e}" if 0 < abs(beyond) < 5e-4 else figure(radius, 4)


def objective_unit(problem: Problem) -> str:
    """Return the unit of a single term, after a space; an empty string for a sum of terms."""
    terms = list(problem.objective.weights)
    unit, mechanism = problem.objective.unit, problem.mechanism
    if not unit:
        return ""
    units = [unit]
    if terms[0].startswith("effort"):
        of_kind = {"N.m": unit, "N": unit.replace("N2 m2", "N2")}
        units = [of_kind[actuator.unit] for actuator in mechanism.actuators]
    elif terms[0] == "tracking":
        units = [unit if joint.kind == "hinge" else unit.replace("rad2", "m2") for joint in mechanism.independent_joints]
    return f" {' and '.join(dict.fromkeys(units))}"


# Samples of a line: about half the width of a screen in pixels.
MAX_SAMPLES = 800
# A smaller range of values, as a share of the largest, may be rounding errors: it is not resolved.
_LEAST_SPAN_SHARE = 1e-4


def significant(value: float | None, digits: int = 4) -> float | None:
    """Return a number rounded to `digits` significant digits; None for None and for a number that is not finite."""
    return float(f"{value:.{digits}g}") if value is not None and math.isfinite(value) else None


def rounded(values: np.ndarray, *, log: bool = False, digits: int = 5) -> list:
    """Return values (n,) or (n, m) as lists, rounded.

    The digits are counted from the largest value or, of values (n,) that hardly change, from ten times their range. With
    `log`, every value has four significant digits of its own. Values that are not finite or, with `log`, not positive
    become None.
    """
    values = np.asarray(values, dtype=float)
    if values.ndim > 1:
        return _rounded(values, _scale(values), log, digits)
    known = values[np.isfinite(values)]
    span = 10 * float(np.ptp(known)) if len(known) else 0.0
    return _rounded(values, min(_scale(values), max(span, _LEAST_SPAN_SHARE * _scale(values))), log, digits)


def _scale(values: np.ndarray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max(initial=0.0))


def _rounded(values: np.ndarray, scale: float, log: bool, digits: int) -> list:
    if log:
        rows = [[significant(x) if x > 0 else None for x in row] for row in np.atleast_2d(values).tolist()]
    else:
        places = digits - 1 - math.floor(math.log10(scale)) if scale > 0 else 0
        rows = [[_plain(x) for x in row] for row in np.round(np.atleast_2d(values), places).tolist()]
    return rows if values.ndim > 1 else rows[0]


def _plain(value: float) -> float | int | None:
    if value.is_integer():
        return int(value)
    return value if math.isfinite(value) else None


def times(values: np.ndarray) -> list:
    """Return instants (n,) [s] to a millionth of their span, as lists."""
    values = np.asarray(values, dtype=float)
    return rounded(values, digits=7)


def drawn_rows(columns: np.ndarray, most: int = MAX_SAMPLES) -> np.ndarray:
    """Return the indices of the drawn rows of columns (n, k): all up to `most`, else `most / 2` even ones and the peaks.

    Between two even rows, each column keeps the row furthest from the straight line between them if the distance is more
    than 1 % of the column's range. Therefore a peak of one sample is still drawn.
    """
    columns = np.asarray(columns, dtype=float)
    n = len(columns)
    if n <= most:
        return np.arange(n)
    even = np.linspace(0, n - 1, most // 2).astype(int)
    found = set(even.tolist())
    for values in np.nan_to_num(columns.T):
        distance = np.abs(values - np.interp(np.arange(n), even, values[even]))
        visible = 0.01 * float(np.ptp(values))
        for a, b in pairwise(even.tolist()):
            k = a + int(np.argmax(distance[a:b]))
            if distance[k] > visible:
                found.add(k)
    return np.array(sorted(found))
