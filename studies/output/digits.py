"""The number of known digits of a figure, and figures with these digits."""

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
