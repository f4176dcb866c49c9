"""What a certificate leaves to whoever made the motion, judged again where a plan is read.

Its duration, its reference, the pose in the middle of a periodic motion, and the objective's value as an integral.
"""

import casadi as ca
import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.boundary import exactly, missed
from linkplan.planner.limits.effort_rate import effort_rates
from linkplan.planner.problem.instant import free_instant
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.problem.scales import Scales
from linkplan.planner.problem.terms import motor_losses
from linkplan.planner.trajectory import Trajectory

# Durations are numbers of a program, found to rounding and kept in full.
_DURATION_SHARE = 1e-8
# States in the middle of a periodic motion are bounds of the program; a reference that is followed exactly is a polynomial
# through it: measured below 1e-8 of its span with forty intervals a period.
_STATE_SHARE = 1e-6
# An integral by ten points an interval against the program's own quadrature at its nodes: the coarsest mesh and scheme that
# pass a certificate differ by some thousandths, positive work, which has kinks, by a few hundredths.
_OBJECTIVE_SHARE, _KINKED_SHARE = 0.01, 0.05
# A term that makes efforts smooth may stand in the objective of tracking and of work: its own integral is no less than this.
_SMOOTHED_SHARE = 0.5
# What a term integrates counts as none below this share of its natural scale: a hundred times the solver's tolerance.
_NEGLIGIBLE_SHARE = 1e-6
_POINTS = 10


def disagreements(problem: PlanningProblem, trajectory: Trajectory, objective: float | None) -> tuple[str, ...]:
    """Return the sentences on where a motion is not what its problem asks, or not what was said of it; empty where all fits.

    `objective` is the value that was saved with the motion; None, as of plans that have none, is not judged.
    """
    motion, lasts = problem.motion, trajectory.duration_s
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
    if not low * (1 - _DURATION_SHARE) <= lasts <= high * (1 + _DURATION_SHARE):
        asked = f"{low:.9g} s" if low == high else f"{low:.9g} to {high:.9g} s"
        found.append(f"the motion lasts {lasts:.9g} s, asked for was {asked}")
    found += _off_states(problem, trajectory)
    if objective is not None:
        found += _off_objective(problem, trajectory, objective)
    return tuple(found)


def _off_states(problem: PlanningProblem, trajectory: Trajectory) -> list[str]:
    motion, span = problem.motion, max(float(np.ptp(trajectory.position)), 1e-9)
    if motion.kind == "track" and problem.reference is not None:
        time = trajectory.dense_times(_POINTS)
        off = np.abs(trajectory.position_at(time) - problem.reference.derivative(time - trajectory.breaks_s[0])).max()
        return [f"the reference is missed by {off / span:.3g} of its range"] if not off <= _STATE_SHARE * span else []
    if motion.kind != "periodic":
        return []
    found = []
    middle = trajectory.breaks_s[0] + 0.5 * trajectory.duration_s
    for what, asked, time in (("start", motion.start, trajectory.breaks_s[0]), ("goal", motion.goal, middle)):
        if asked is None or (what == "goal" and motion.waypoints):
            continue
        off = missed(trajectory.position_at(np.array([time])), *exactly(asked), span)
        if not off <= _STATE_SHARE:
            found.append(f"the periodic motion misses its {what} by {off:.3g} of its range")
    return found


def _off_objective(problem: PlanningProblem, trajectory: Trajectory, said: float) -> list[str]:
    try:
        value, size = objective_value(problem, trajectory)
    except AssemblyError:  # a motion off its loops has failed its certificate already
        return []
    objective, size = problem.objective, max(abs(said), size)
    share = _KINKED_SHARE if any(term.positive_power for term in objective.terms.values()) else _OBJECTIVE_SHARE
    nothing = negligible_objective(problem, trajectory)
    below = (_SMOOTHED_SHARE if objective.is_smoothed else share) * size + nothing
    if said - below <= value <= said + share * size + nothing:
        return []
    return [f"its objective is said to be {said:.6g}, and that of the motion is {value:.6g}"]


@np.errstate(all="ignore")  # a motion that was changed on disk may last 1e200 s
def negligible_objective(problem: PlanningProblem, trajectory: Trajectory) -> float:
    """Return the objective [SI] that counts as none: a motion that needs no work has what the solver's rounding leaves.

    It is the same share of every term's quantity on its natural scale: a radian, or the mechanism's extent, of each joint;
    the actuator's effort limit, or where there is none the largest effort of the motion and the inertia's over its duration.
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
        problem.objective.weight(name) * _NEGLIGIBLE_SHARE**term.order * np.sum(term.size(natural, problem.motors))
        for name, term in problem.objective.terms.items()
        if term.order
    ]
    return float(sum(floors))


def objective_value(problem: PlanningProblem, trajectory: Trajectory) -> tuple[float, float]:
    """Return the integrals of a motion's objective and of its terms' absolute values [SI], by Gauss-Legendre quadrature.

    Raises:
        AssemblyError: when the motion leaves what the loops allow.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
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
    wanted = s if reference is None else reference.derivative(time)
    values = sampled(ca.Function("objective", symbols, [ca.densify(integrands)]), q, v, a, u, rate, wanted)[:, :, 0]
    return float(width @ values.sum(axis=1)), float(width @ np.abs(values).sum(axis=1))
