"""Checks of a motion that is read from a file, beyond the certificate.

The checks compare its duration, its reference, the pose in the middle of a periodic motion, and its objective as an
integral.
"""

import casadi as ca
import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.integration import BOUNDARY_SHARE, exact_bounds, relative_violation
from linkplan.planner.limits.actuators import effort_rates
from linkplan.planner.problem.instant import Scales, free_instant
from linkplan.planner.problem.objective import motor_losses
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory

# Gauss-Legendre points per interval.
_QUADRATURE_POINTS = 10


def disagreements(problem: Problem, trajectory: Trajectory, objective: float | None) -> tuple[str, ...]:
    """Return sentences on the differences between a motion and its problem or its saved objective; empty if there are none.

    `objective` is the saved value; None is not checked.
    """
    motion, duration = problem.motion, trajectory.duration_s
    found = []
    if trajectory.periodic and motion.kind == "reach":
        found.append("a reach does not repeat, and the motion is marked as periodic")
    if not trajectory.periodic and motion.kind == "periodic":
        found.append("a periodic motion repeats, and the motion is not marked as periodic")
    longest = problem.motion.max_duration_s or np.inf
    low, high = motion.min_duration_s or 0.0, longest
    if motion.duration_s is not None:
        low = high = motion.duration_s
    elif motion.kind == "track" and problem.reference is not None:
        low = high = problem.reference.period_s
    rounding = 1e-8  # durations are unknowns of the program, found to rounding and saved in full
    if not low * (1 - rounding) <= duration <= high * (1 + rounding):
        asked = f"{low:.9g} s" if low == high else f"{low:.9g} to {high:.9g} s"
        found.append(f"the motion lasts {duration:.9g} s, asked for was {asked}")
    found += _off_states(problem, trajectory)
    if objective is not None:
        found += _off_objective(problem, trajectory, objective)
    return tuple(found)


def _off_states(problem: Problem, trajectory: Trajectory) -> list[str]:
    motion, span = problem.motion, max(float(np.ptp(trajectory.position)), 1e-9)
    if motion.kind == "track" and problem.reference is not None:
        time = trajectory.dense_times(_QUADRATURE_POINTS)
        off = np.abs(trajectory.position_at(time) - problem.reference.derivative(time - trajectory.breaks_s[0])).max()
        # The polynomials of an exactly followed reference miss it by less than 1e-8 of its span, with forty in a period.
        return [f"the reference is missed by {off / span:.3g} of its range"] if not off <= BOUNDARY_SHARE * span else []
    if motion.kind != "periodic":
        return []
    found = []
    middle = trajectory.breaks_s[0] + 0.5 * trajectory.duration_s
    for what, asked, time in (("start", motion.start, trajectory.breaks_s[0]), ("goal", motion.goal, middle)):
        if asked is None or (what == "goal" and motion.waypoints):
            continue
        off = relative_violation(trajectory.position_at(np.array([time])), exact_bounds(asked), span)
        if not off <= BOUNDARY_SHARE:
            found.append(f"the periodic motion misses its {what} by {off:.3g} of its range")
    return found


def _off_objective(problem: Problem, trajectory: Trajectory, saved: float) -> list[str]:
    try:
        value, size = objective_value(problem, trajectory)
    except AssemblyError:  # the certificate already reports a motion off its loops
        return []
    objective, size = problem.objective, max(abs(saved), size)
    # The program's quadrature differs by some thousandths on the coarsest meshes, for positive work with its kinks by some
    # hundredths. A smoothing term in the program may explain up to half of the saved value.
    share = 0.05 if any(term.positive_power for term in objective.terms.values()) else 0.01
    negligible = negligible_objective(problem, trajectory)
    below = (0.5 if objective.is_smoothed else share) * size + negligible
    if saved - below <= value <= saved + share * size + negligible:
        return []
    return [f"its saved objective is {saved:.6g}, and that of its motion is {value:.6g}"]


@np.errstate(all="ignore")  # the duration in an edited file may be 1e200 s
def negligible_objective(problem: Problem, trajectory: Trajectory) -> float:
    """Return the objective [SI] that counts as zero: a motion without work still has the solver's rounding.

    The value is 1e-6 of every term's quantity on its natural scale, a hundred times the solver's tolerance. The scales are a
    radian or the mechanism's extent for each joint, and the effort limit; without a limit, the motion's largest effort or,
    if larger, the effort that accelerates the inertia within the duration.
    """
    mechanism, T = problem.mechanism, np.float64(trajectory.duration_s)
    unit = np.array([1.0 if joint.kind == "hinge" else mechanism.extent_m for joint in mechanism.independent_joints])
    pose = trajectory.start_pose
    maps = np.abs(np.array(mechanism.dynamics.effort_map(pose)))
    inertial = (np.abs(np.array(mechanism.dynamics.reduced_inertia(pose))) @ unit).max(initial=0.0) / T**2
    largest = np.abs(problem.limits.effort).max(axis=1)
    asked = np.maximum(np.abs(trajectory.effort).max(axis=(0, 1)), inertial / max(maps.max(initial=0.0), 1e-300))
    effort = np.where(np.isfinite(largest), largest, asked)
    natural = Scales(time_s=T, position=unit, effort=effort, residual=maps @ effort, length_m=mechanism.extent_m)
    floors = [
        problem.objective.weight(name) * 1e-6**term.order * np.sum(term.size(natural, problem.motors))
        for name, term in problem.objective.terms.items()
        if term.order
    ]
    return float(sum(floors))


def objective_value(problem: Problem, trajectory: Trajectory) -> tuple[float, float]:
    """Return the integrals of a motion's objective and of its terms' absolute values [SI], by Gauss-Legendre quadrature.

    Raises:
        AssemblyError: when the loops cannot close along the motion.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_QUADRATURE_POINTS)
    time = trajectory.times_at(0.5 + 0.5 * nodes)
    width = (np.diff(trajectory.breaks_s)[:, None] * 0.5 * weights).ravel()
    objective, reference = problem.objective, problem.reference
    at, symbols = free_instant(problem.mechanism, motor_losses(problem.motors))
    integrands = ca.vertcat(*(objective.weight(name) * term.integrand(at) for name, term in objective.terms.items()))
    s, v, a, u = (
        f(time) for f in (trajectory.position_at, trajectory.velocity_at, trajectory.acceleration_at, trajectory.effort_at)
    )
    q = follow(problem.mechanism, s, trajectory.start_pose)
    rate, _ = effort_rates(trajectory, time)
    wanted = s if reference is None else reference.derivative(time - trajectory.breaks_s[0])
    values = sampled(ca.Function("objective", symbols, [ca.densify(integrands)]), q, v, a, u, rate, wanted)[:, :, 0]
    return float(width @ values.sum(axis=1)), float(width @ np.abs(values).sum(axis=1))
