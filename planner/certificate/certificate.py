"""The certificate of a plan: what holds between the nodes, where the solver imposes nothing.

On a dense grid of the continuous motion: the carried effort and the effort by inverse dynamics against the limits, the
loops' gap, every joint's range and speed, the distance to a singular pose; and the state reached when the reduced model
is integrated under the carried effort, against the planned state.
"""

from dataclasses import dataclass

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import demanded, joint_rates, least_effort, sampled
from linkplan.models.poses.contacts import Meeting
from linkplan.models.poses.controls import control_excess
from linkplan.models.poses.turning import whole_turns
from linkplan.planner.certificate.boundary import exactly, missed
from linkplan.planner.certificate.integration import integrate
from linkplan.planner.certificate.site_ends import ends_off_m, waypoint_off_m, waypoint_times
from linkplan.planner.keys.kinds import INTEGRATION_DEG
from linkplan.planner.limits.kinds import margins
from linkplan.planner.limits.path_limit import Margin
from linkplan.planner.limits.samples import Samples, least_between, samples_of, singularity_ratios
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.trajectory import Trajectory

# What a certificate must show. Closure: what DESIGN promises. Integration: `INTEGRATION_DEG`, or this. Dynamics: between
# nodes, efforts that differ from the carried ones by more than this share of the largest carried effort are another
# motion's. Ranges and speeds: rounding of degrees and no more.
CLOSURE_M = 1e-9
INTEGRATION_M = 1e-5
# A motion over less than this [rad or m] stands still: its errors are shares of that.
_STILL = 1e-9
DYNAMICS_SHARE = 0.02
# The planned velocity against the planned position's slope and the integrated model's: first-order schemes differ by
# their own order, a plan that is put together wrongly by more. Boundary states are bounds of the program: rounding.
VELOCITY_SHARE = 0.02
BOUNDARY_SHARE = 1e-6
RANGE_SLACK = 1e-9

# A plan that carries no effort at all may miss this much [N.m or N], against rounding, or this share of what its inertia
# takes: a crank that turns freely for ever, its energy kept. Measured 1e-7.
_NO_EFFORT, _NO_EFFORT_SHARE = 1e-12, 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Certificate:
    """Findings on one motion; a list of reasons why it fails, empty where it passes.

    Efforts in the actuators' units; margins are negative outside, infinite where nothing limits; `worst_time_s` says
    where each finding is worst.
    """

    effort_excess: float
    inverse_dynamics_excess: float
    dynamics_residual: float
    velocity_residual: float  # largest |s' - v|, of the motion's largest speed
    boundary_error: float  # of the states asked at the ends, of the motion's span and largest speed
    site_error_m: float  # of sites from where start, waypoints and goal ask them
    closure_gap_m: float  # largest, an angle by what it moves at the mechanism's extent: what is judged
    closure_gaps: dict[str, float]  # largest by unit: "m" of points and slides, "rad" of angles, hinges and their tendons
    integration_error_deg: float
    integration_error_m: float
    integration_restarts: int  # how often the integration was restarted, the motion being unstable; 0 as a rule
    position_margin: np.ndarray  # (n_q,) [rad or m]
    speed_margin: np.ndarray  # (n_q,)
    singularity_ratio: float  # least det J_z along the motion, of that at home
    peak_effort: np.ndarray  # (n_u,)
    peak_power: np.ndarray  # (n_u,) [W], mechanical
    peak_closure_force: np.ndarray  # (n_closures,) [N]
    margins: tuple[Margin, ...]  # of the limits beyond effort, range and speed
    speed_overrun: np.ndarray  # (n_q, n_intervals) by how much of itself a joint's speed limit is overrun in each
    position_overrun: np.ndarray  # (n_q, n_intervals) by how much of its span a joint's range is left in each
    growth: np.ndarray  # (n_intervals,) of the integration error, in shares of what is allowed in all
    residual_share: np.ndarray  # (n_intervals,) of the dynamics residual, in shares of what is allowed
    worst_time_s: dict[str, float]
    failures: tuple[str, ...]
    unmendable: tuple[str, ...] = ()  # those of the failures that no other mesh mends: a servo's range, contacts
    contacts: tuple[Meeting, ...] = ()  # of geoms along the motion, see linkplan.planner.certificate.collisions

    @property
    def passed(self) -> bool:
        """Whether everything holds."""
        return not self.failures

    @property
    def mendable(self) -> bool:
        """Whether there are failures that another mesh may mend."""
        return any(failure not in self.unmendable for failure in self.failures)


def certify(problem: PlanningProblem, trajectory: Trajectory) -> Certificate:
    """Return the certificate of a motion against its problem's limits.

    Raises:
        AssemblyError: when the motion leaves what the loops allow.
        OutOfTimeError: when the deadline of judging passes before its poses are known.
    """
    mechanism, limits, until = problem.mechanism, problem.limits, problem.solver.certificate_deadline
    samples = samples_of(problem, trajectory)
    time, q, v, a, u = samples.time, samples.q, samples.v, samples.a, samples.u
    worst: dict[str, float] = {}

    def peak(name: str, values: np.ndarray) -> float:
        at = int(np.argmax(values))
        worst[name] = float(time[at])
        return float(values[at])

    over = np.maximum(u - limits.effort[:, 1], limits.effort[:, 0] - u).max(axis=1)
    effort_excess = max(0.0, peak("effort_excess", over))
    tau, maps = demanded(mechanism, q, v, a)
    needed, carried = least_effort(tau, maps), np.einsum("ksu,ku->ks", maps, u)
    needed_over = np.maximum(needed - limits.effort[:, 1], limits.effort[:, 0] - needed).max(axis=1)
    inverse_excess = max(0.0, peak("inverse_dynamics_excess", needed_over))
    residual = np.abs(tau - carried).max(axis=1)
    dynamics_residual = peak("dynamics_residual", residual)
    closure_gap = peak("closure_gap_m", mechanism.gaps_m(q))
    closure_gaps = {unit: float(gap.max()) for unit, gap in mechanism.gaps_by_unit(q).items()}
    (position_margin, position_overrun), (speed_margin, speed_overrun) = _margins(
        mechanism, limits, trajectory, samples.points, q, v, time, worst
    )
    ratio = float(singularity_ratios(problem, q).min())
    others = margins(samples)
    speed = max(float(np.abs(v).max()), _STILL / trajectory.duration_s)
    velocity_residual = peak("velocity_residual", np.abs(trajectory.slope_at(time) - v).max(axis=1)) / speed
    boundary_error = _boundary_error(problem, trajectory, speed)
    if problem.motion.turns is not None:
        boundary_error = max(boundary_error, _turn_error(problem, q))
    site_error, sites_off = ends_off_m(problem, trajectory, time, q)
    hinge = np.array([joint.kind == "hinge" for joint in mechanism.independent_joints])
    allowed_error = np.where(hinge, np.radians(INTEGRATION_DEG), INTEGRATION_M)
    integrated = integrate(mechanism, trajectory, speed, allowed_error, until)
    in_deg = float(np.degrees(integrated.position[hinge].max(initial=0.0)))
    in_m = float(integrated.position[~hinge].max(initial=0.0))
    velocity_error, growth = integrated.velocity, integrated.growth

    failures = []
    if not np.all(np.isfinite(integrated.position)) and until.passed:
        failures.append(f"its integration ran out of the plan's {problem.solver.max_time_s:g} s (solver.max_time_s)")
    if effort_excess > 0:
        failures.append(f"the effort exceeds its limit by {effort_excess:.3g} at t = {worst['effort_excess']:.4g} s")
    inertial = np.abs(np.einsum("kst,kt->ks", sampled(mechanism.dynamics.reduced_inertia, q), a)).max()
    allowed = max(DYNAMICS_SHARE * float(np.abs(carried).max()), _NO_EFFORT, _NO_EFFORT_SHARE * float(inertial))
    if dynamics_residual > allowed:
        failures.append(
            f"between nodes the motion needs {dynamics_residual:.3g} more effort than planned"
            f" at t = {worst['dynamics_residual']:.4g} s (allowed: {allowed:.3g})"
        )
    if velocity_residual > VELOCITY_SHARE or not velocity_error <= VELOCITY_SHARE:
        failures.append(
            f"the planned velocity is not that of the planned position: {100 * max(velocity_residual, velocity_error):.3g} %"
            " of the largest speed apart"
        )
    if boundary_error > BOUNDARY_SHARE:
        failures.append(f"the motion misses its boundary conditions by {boundary_error:.3g} of its range or largest speed")
    failures += sites_off
    if closure_gap > max(CLOSURE_M, mechanism.closed_m):
        gaps = " or ".join(f"{gap:.3g} {unit}" for unit, gap in closure_gaps.items())
        failures.append(f"a kinematic loop opens by {gaps} at t = {worst['closure_gap_m']:.4g} s")
    if not in_deg <= INTEGRATION_DEG or not in_m <= INTEGRATION_M:
        apart = f"{in_m:.3g} m (allowed: {INTEGRATION_M:g} m)" if in_m > INTEGRATION_M else ""
        apart = f"{in_deg:.3g} deg (allowed: {INTEGRATION_DEG:g} deg)" if not in_deg <= INTEGRATION_DEG else apart
        failures.append(f"the state integrated under the planned effort ends {apart} from the planned state")
    for what, margin in (("range", position_margin), ("speed limit", speed_margin)):
        for joint, value in zip(mechanism.joints, margin, strict=True):
            if value < -RANGE_SLACK:
                failures.append(
                    f"joint {joint.name} leaves its {what} by {-joint.shown(value):.3g} {joint.unit}"
                    f"{'/s' if 'speed' in what else ''} at t = {worst[f'{what} of {joint.name}']:.4g} s"
                )
    unmendable = _ctrl_failures(samples)
    failures += unmendable + [margin.sentence() for margin in others if not margin.kept]
    return Certificate(
        effort_excess=effort_excess,
        inverse_dynamics_excess=inverse_excess,
        dynamics_residual=dynamics_residual,
        velocity_residual=velocity_residual,
        boundary_error=boundary_error,
        site_error_m=site_error,
        closure_gap_m=closure_gap,
        closure_gaps=closure_gaps,
        integration_error_deg=in_deg,
        integration_error_m=in_m,
        integration_restarts=integrated.restarts,
        position_margin=position_margin,
        speed_margin=speed_margin,
        singularity_ratio=ratio,
        peak_effort=np.abs(u).max(axis=0),
        peak_power=np.abs(u * samples.actuator_speeds).max(axis=0),
        peak_closure_force=samples.closure_forces.max(axis=0, initial=0.0),
        margins=others,
        speed_overrun=speed_overrun,
        position_overrun=position_overrun,
        growth=growth,
        residual_share=residual.reshape(len(growth), -1).max(axis=1) / allowed,
        worst_time_s=worst,
        failures=tuple(failures),
        unmendable=tuple(unmendable),
    )


def _turn_error(problem: PlanningProblem, q: np.ndarray) -> float:
    """Return by how much poses (n, n_q) of whole turns end beside their start, as a share of their range."""
    mechanism, moved_by = problem.mechanism, q[-1] - q[0]
    spins = np.abs(np.array(mechanism.dynamics.velocity_map(q[0]))[:, problem.goes_on]).max(axis=1, initial=0.0) > 0
    error = np.where(spins, 0.0, moved_by - whole_turns(mechanism, moved_by))
    return float(np.abs(error).max()) / max(float(np.ptp(q)), _STILL)


def _ctrl_failures(samples: Samples) -> list[str]:
    """Return a sentence for each servo that would need a ctrl beyond a range that is no limit of the program."""
    actuators, failures = samples.problem.mechanism.actuators, []
    if not any(actuator.is_servo for actuator in actuators):
        return failures
    excess = control_excess(samples.problem.mechanism, samples.q, samples.v, samples.u)
    for j in np.flatnonzero(excess.max(axis=0) > RANGE_SLACK):
        if actuators[j].limits_control:
            continue
        k = int(np.argmax(excess[:, j]))
        failures.append(
            f"{actuators[j].name} would need a ctrl {excess[k, j]:.3g} beyond its range at t = {samples.time[k]:.4g} s to"
            " give the planned effort"
        )
    return failures


def _margins(mechanism: Mechanism, limits, trajectory: Trajectory, points, q, v, time, worst):
    """Return, of positions and of speeds, the least distances (n_q,) of every joint to its limits, negative outside.

    And by how much (n_q, n_intervals) they are overrun in each interval: a share of the range's span, of the speed limit.
    Between samples, independent joints are no further out than their polynomials' Bernstein coefficients.
    """
    rates = joint_rates(mechanism, q, v)
    found = []
    position, speed = (q, limits.position, trajectory.position), (rates, limits.speed, trajectory.velocity)
    for what, (values, bounds, coefficients) in (("range", position), ("speed limit", speed)):
        inside = np.minimum(values - bounds[:, 0], bounds[:, 1] - values)
        for joint, column in zip(mechanism.joints, inside.T, strict=True):
            worst[f"{what} of {joint.name}"] = float(time[int(np.argmin(column))])
        least = least_between(inside.T, points).reshape(inside.shape[1], -1)
        of = list(mechanism.independent)
        hull = np.minimum(coefficients - bounds[of, 0], bounds[of, 1] - coefficients).min(axis=0).T
        least[of] = np.maximum(least[of], hull)
        if what == "range":
            size = np.where(np.isfinite(bounds).all(axis=1), bounds[:, 1] - bounds[:, 0], 0.0)
        else:
            size = np.where(np.isfinite(bounds), np.abs(bounds), 0.0).max(axis=1)
        found.append((least.min(axis=1), np.maximum(0.0, -least) / np.where(size > 0, size, 1.0)[:, None]))
    return found


def _boundary_error(problem: PlanningProblem, trajectory: Trajectory, speed: float) -> float:
    """Return how far the motion's ends are from the states asked, positions by its span and speeds by its largest."""
    motion = problem.motion
    ends = np.stack([trajectory.position[0, 0], trajectory.position[-1, -1]])
    speeds = np.stack([trajectory.velocity[0, 0], trajectory.velocity[-1, -1]])
    span = max(float(np.ptp(trajectory.position)), _STILL)
    if motion.kind == "reach":
        rest = np.zeros(trajectory.n_s)
        asked = np.stack([motion.start, motion.goal])
        wanted = np.stack([rest if x is None else x for x in (motion.start_speed, motion.goal_speed)])
        free = np.zeros_like(ends, dtype=bool)
        free[1] = problem.adrift | motion.goal_is_free  # its end is where the sites are asked to be
    elif trajectory.periodic:
        gone = np.stack([-1.0 * np.ones(trajectory.n_s), np.ones(trajectory.n_s)]) * motion.advance
        asked, wanted, free = ends[::-1] + gone, speeds[::-1], np.tile(problem.goes_on, (2, 1))
    else:
        return 0.0
    still = free & (motion.kind == "reach")  # a spin's speed may be any at the end, and returns with a period
    apart = [missed(ends, *exactly(asked, free), span), missed(speeds, *exactly(wanted, still), speed)]
    return max(*apart, *(_passed_by(problem, trajectory, waypoint, span, speed) for waypoint in motion.waypoints))


def _passed_by(problem: PlanningProblem, trajectory: Trajectory, waypoint: Waypoint, span: float, speed: float) -> float:
    """Return how far a motion passes a waypoint by, at its instant or at the break that comes nearest.

    Positions by the motion's span, speeds by its largest, sites by the mechanism's extent.
    """
    time = waypoint_times(trajectory, waypoint)
    position, rate = exactly(waypoint.position), exactly(waypoint.speed)
    off = waypoint_off_m(problem, trajectory, waypoint, time).max(axis=1) / problem.mechanism.extent_m
    states = zip(trajectory.position_at(time), trajectory.velocity_at(time), off, strict=True)
    return min(max(missed(s, *position, span), missed(v, *rate, speed), x) for s, v, x in states)
