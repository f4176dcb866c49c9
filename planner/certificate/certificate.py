"""The certificate of a plan: checks between the nodes, where the solver imposes nothing.

On a dense grid of the continuous motion it compares the planned effort and the effort by inverse dynamics with the limits,
and checks the loops' gap, every joint's range and speed, and the distance to a singular pose. It also integrates the reduced
model under the planned effort and compares the state with the planned state.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import UNSET, Struct, UnsetType

from linkplan.models.poses.along import control_excess, whole_turns
from linkplan.models.poses.contacts import Contact
from linkplan.planner.certificate.flow import INTEGRATION_RTOL
from linkplan.planner.certificate.integration import (
    BOUNDARY_SHARE,
    ends_off_m,
    integrate,
    relative_violation,
    waypoint_off_m,
    waypoint_times,
)
from linkplan.planner.files.structs import Beside, InJson
from linkplan.planner.limits.efforts import dead_centre_words, effort_overrun
from linkplan.planner.limits.joints import RANGE_SLACK
from linkplan.planner.limits.kinds import beyond_bounds, margins_along
from linkplan.planner.limits.limit import Margin
from linkplan.planner.limits.samples import Samples, samples_of, singularity_ratios
from linkplan.planner.problem.extra import extras_not_finite, not_finite
from linkplan.planner.problem.keys.kinds import INTEGRATION_DEG
from linkplan.planner.problem.limits import exact_bounds
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.path import Feed
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import VELOCITY_SHARE, Trajectory

# Largest gap of a kinematic loop [m], unless the assembly itself is less exact.
CLOSURE_M = 1e-9
# Largest difference between the planned and the integrated state of slides [m]; `INTEGRATION_DEG` for hinges.
INTEGRATION_M = 1e-5
# Smallest span [rad or m] that errors are related to.
_MIN_SPAN = 1e-9


class Certificate(Struct, frozen=True, eq=False, kw_only=True):
    """Findings on one motion, with a list of failures that is empty if it passes.

    Efforts are in the actuators' units. `worst_time_s` is the time of each finding's worst value.
    """

    inverse_dynamics_excess: float
    dynamics_residual: float
    velocity_residual: float  # largest |s' - v|, as a share of the motion's largest speed
    boundary_error: float  # of the prescribed states at the ends, as a share of the motion's span and largest speed
    site_error_m: float  # of the sites, and of bodies as arcs at the extent, prescribed at start, waypoints and goal
    largest_gap_m: Beside[float]  # of the closures; angles count as the displacement at the mechanism's extent
    closure_gaps: Beside[dict[str, float]]  # largest by unit: "m" of points and slides, "rad" of angles, hinges and tendons
    integration_error_deg: float
    integration_error_m: float
    integration_restarts: int  # restarts of the integration because of an unstable motion; 0 as a rule
    singularity_ratio: float  # least det J_z along the motion, relative to home
    peak_effort: Beside[np.ndarray]  # (n_u,)
    peak_motor_power: Beside[np.ndarray]  # (n_u,) [W], mechanical, that the actuator gives
    peak_brake_power: Beside[np.ndarray]  # (n_u,) [W], mechanical, that the actuator takes
    peak_closure_force: Beside[np.ndarray]  # (n_closures,) [N]
    margins: tuple[Margin, ...]  # of all limits, efforts as planned
    growth: Beside[np.ndarray]  # (n_intervals,) growth of the integration error, as a share of the allowed total
    dynamics_allowed: Beside[float]  # the largest dynamics residual that passes
    residual_share: Beside[np.ndarray]  # (n_intervals,) dynamics residual, as a share of the allowed one
    effort_overrun: Beside[np.ndarray]  # (n_intervals,) overrun of needed efforts, as a share of what a proof allows
    worst_time_s: dict[str, float]
    failures: tuple[str, ...]
    needs_more: Beside[str] = ""  # the failure of an effort by inverse dynamics, empty without one
    # Failures that no other mesh removes: a servo's range, contacts, a rounded loop's gap.
    unrepairable: Beside[tuple[str, ...]] = ()
    contacts: tuple[Contact, ...] = ()  # of geoms along the motion, see linkplan.planner.certificate.further_checks

    @property
    def peak_power(self) -> np.ndarray:
        """The largest mechanical power (n_u,) [W] of each actuator, as motor or as brake."""
        return np.maximum(self.peak_motor_power, self.peak_brake_power)

    @InJson
    def passed(self) -> bool:
        """Whether there is no failure."""
        return not self.failures

    @property
    def is_carried(self) -> bool:
        """Whether there is no failure, or only that of an effort by inverse dynamics, which is an error of the mesh."""
        return not any(failure != self.needs_more for failure in self.failures)

    @InJson
    def closure_gap_m(self) -> float:
        """The largest gap of closures of points and slides [m]."""
        return self.closure_gaps.get("m", 0.0)

    @InJson
    def closure_gap_rad(self) -> float | UnsetType:
        """The largest gap of closures of angles, hinges and their tendons [rad], if there are any."""
        return self.closure_gaps.get("rad", UNSET)

    @InJson
    def effort_excess(self) -> float:
        """The largest overrun of a limit on planned efforts."""
        return max((-one.left for one in self.margins if one.of.facts.of_planned_effort and not one.kept), default=0.0)

    @InJson
    def joint_margin_deg(self) -> dict[str, float]:
        """The distances of hinges from their ranges [deg] by name."""
        return self._left("position", "deg")

    @InJson
    def joint_margin_m(self) -> dict[str, float]:
        """The distances of slides from their ranges [m] by name."""
        return self._left("position", "m")

    @InJson
    def speed_margin_deg_s(self) -> dict[str, float]:
        """The differences of hinges' speeds from their limits [deg/s] by name."""
        return self._left("speed", "deg/s")

    @InJson
    def speed_margin_m_s(self) -> dict[str, float]:
        """The differences of slides' speeds from their limits [m/s] by name."""
        return self._left("speed", "m/s")

    def _left(self, what: str, unit: str) -> dict[str, float]:
        return {margin.name: margin.left for margin in self.margins if (margin.what, margin.unit) == (what, unit)}

    def __repr__(self) -> str:
        said = "passed" if self.passed else f"NOT passed: {self.failures[0]}"
        more = f"; and {len(self.failures) - 1} more" if len(self.failures) > 1 else ""
        return f"Certificate({said}{more}; {len(self.margins)} margins)"

    @property
    def repairable(self) -> bool:
        """Whether another mesh may remove a failure."""
        return any(failure not in self.unrepairable for failure in self.failures)


def integration_rtol(problem: Problem) -> float:
    """Return the relative tolerance of a certificate's integration: a millionth of the error that the user allows [rad]."""
    tolerance_deg = problem.mesh.tolerance_deg
    return INTEGRATION_RTOL if tolerance_deg is None else max(INTEGRATION_RTOL, 1e-6 * float(np.radians(tolerance_deg)))


def certify(problem: Problem, trajectory: Trajectory, also: Sequence[float] = ()) -> Certificate:
    """Return the certificate of a motion against its problem's limits.

    Args:
        problem: the problem with its limits.
        trajectory: the motion.
        also: shares of the duration of further samples, see `samples_of`.

    Raises:
        AssemblyError: when the loops cannot close along the motion.
        OutOfTimeError: when the certificate's deadline passes before its poses are known.
    """
    mechanism, until = problem.mechanism, problem.solver.certificate_deadline
    samples = samples_of(problem, trajectory, also)
    time, q, v, u = samples.time, samples.q, samples.v, samples.u
    worst: dict[str, float] = {}

    def peak(name: str, values: np.ndarray) -> float:
        at = int(np.argmax(values))
        worst[name] = float(time[at])
        return float(values[at])

    of_limits = margins_along(samples)
    # A motion at rest counts as having a speed that hardly moves it within its duration.
    speed = max(float(np.abs(v).max()) or INTEGRATION_M / trajectory.duration_s, _MIN_SPAN / trajectory.duration_s)
    velocity_residual = peak("velocity_residual", trajectory.slope_errors(time).max(axis=1)) / speed
    needed, allowed = samples.needed_efforts, samples.lacking_allowed
    inverse_excess = max(0.0, peak("inverse_dynamics_excess", beyond_bounds(problem, needed).max(axis=(0, 2))))
    residual = np.abs(samples.lacking).max(axis=(0, 2))
    dynamics_residual = peak("dynamics_residual", residual)
    closure_gap = peak("closure_gap_m", mechanism.gaps_m(q))
    closure_gaps = {unit: float(gap.max()) for unit, gap in mechanism.gaps_by_unit(q).items()}
    ratio = float(singularity_ratios(problem.mechanism, q).min())
    boundary_error = end_state_error(problem, trajectory, speed)
    if problem.motion.turns is not None:
        boundary_error = max(boundary_error, _turn_error(problem, q))
    site_error, sites_off = ends_off_m(problem, trajectory, time, q)
    hinge = np.array([joint.kind == "hinge" for joint in mechanism.independent_joints])
    allowed_error = np.where(hinge, np.radians(INTEGRATION_DEG), INTEGRATION_M)
    integrated = integrate(mechanism, trajectory, speed, allowed_error, until, integration_rtol(problem))
    in_deg = float(np.degrees(integrated.position[hinge].max(initial=0.0)))
    in_m = float(integrated.position[~hinge].max(initial=0.0))
    velocity_error, growth = integrated.velocity, integrated.growth

    power = u * samples.actuator_speeds
    overrun, needs_more = effort_overrun(samples)
    gaps = " or ".join(f"{gap:.3g} {unit}" for unit, gap in closure_gaps.items())
    rounded = mechanism.closed_m > CLOSURE_M
    accepts = f"; mechanism.closure_tolerance_m = {1.1 * closure_gap:.2g} accepts that of a rounded file" if rounded else ""
    opened = f"a kinematic loop opens by {gaps} at t = {worst['closure_gap_m']:.4g} s{accepts}"
    findings = (
        (
            dynamics_residual > allowed,
            f"between nodes the motion needs {dynamics_residual:.3g} more effort than planned"
            f" at t = {worst['dynamics_residual']:.4g} s (allowed: {allowed:.3g})"
            f"{dead_centre_words(samples, worst['dynamics_residual'])}",
        ),
        (bool(needs_more), needs_more),
        (
            velocity_residual > trajectory.slope_share or not velocity_error <= VELOCITY_SHARE,
            "the planned velocity is not that of the planned position:"
            f" {100 * max(velocity_residual, velocity_error):.3g} % of the largest speed apart",
        ),
        (
            boundary_error > BOUNDARY_SHARE,
            f"the motion misses its boundary conditions by {boundary_error:.3g} of its range or largest speed",
        ),
        *((True, sentence) for sentence in sites_off),
        (closure_gap > max(CLOSURE_M, mechanism.closed_m), opened),
    )
    failures = [sentence for broken, sentence in findings if broken]
    figures = {
        "the effort that the motion needs": np.hstack([*samples.demanded[0], *needed]),
        "a joint's speed": samples.joint_rates,
        "a loop's gap": mechanism.gaps_m(q),
        "a closure's force": samples.closure_forces,
    }
    failures += [sentence for what, values in figures.items() for sentence in not_finite(what, values, time)]
    unknown = extras_not_finite(problem.objective.extra, mechanism, time, q, *samples.motion)
    if not np.all(np.isfinite(integrated.position)) and until.passed:
        left = f"its integration ran out of the plan's time, {problem.solver.max_time_s:g} s (solver.max_time_s)"
        failures.insert(0, left)
    failures += _integration_failures(in_deg, in_m)
    unrepairable = [*unknown, *_ctrl_failures(samples)]
    failures += unrepairable + [margin.sentence() for margin in of_limits if not margin.kept]
    return Certificate(
        inverse_dynamics_excess=inverse_excess,
        dynamics_residual=dynamics_residual,
        velocity_residual=velocity_residual,
        boundary_error=boundary_error,
        site_error_m=site_error,
        largest_gap_m=closure_gap,
        closure_gaps=closure_gaps,
        integration_error_deg=in_deg,
        integration_error_m=in_m,
        integration_restarts=integrated.restarts,
        singularity_ratio=ratio,
        peak_effort=np.abs(u).max(axis=0),
        peak_motor_power=power.max(axis=0, initial=0.0),
        peak_brake_power=(-power).max(axis=0, initial=0.0),
        peak_closure_force=samples.closure_forces.max(axis=0, initial=0.0),
        margins=of_limits,
        growth=growth,
        dynamics_allowed=allowed,
        residual_share=residual.reshape(len(growth), -1).max(axis=1) / allowed,
        effort_overrun=overrun,
        worst_time_s=worst | {margin.bound.removeprefix("the "): margin.time_s for margin in of_limits},
        failures=tuple(failures),
        needs_more=needs_more,
        unrepairable=(*unrepairable, *((opened,) if rounded else ())),
    )


def _integration_failures(in_deg: float, in_m: float) -> list[str]:
    """Return the sentence on an integrated state that is too far from the planned state, if it is."""
    apart = f"{in_m:.3g} m (allowed: {INTEGRATION_M:g} m)" if not in_m <= INTEGRATION_M else ""
    apart = f"{in_deg:.3g} deg (allowed: {INTEGRATION_DEG:g} deg)" if not in_deg <= INTEGRATION_DEG else apart
    return [f"the state integrated under the planned effort ends {apart} from the planned state"] if apart else []


def _turn_error(problem: Problem, q: np.ndarray) -> float:
    """Return the largest deviation of poses (n, n_q) from whole turns at their end, as a share of their range."""
    mechanism, moved_by = problem.mechanism, q[-1] - q[0]
    spins = np.abs(np.array(mechanism.dynamics.velocity_map(q[0]))[:, problem.free_spins]).max(axis=1, initial=0.0) > 0
    error = np.where(spins, 0.0, moved_by - whole_turns(mechanism, moved_by))
    return float(np.abs(error).max()) / max(float(np.ptp(q)), _MIN_SPAN)


def _ctrl_failures(samples: Samples) -> list[str]:
    """Return a sentence for each servo whose ctrl would exceed a range that the program does not impose."""
    actuators, failures = samples.problem.mechanism.actuators, []
    if not any(actuator.is_servo for actuator in actuators):
        return failures
    excess = control_excess(samples.problem.mechanism, samples.q, samples.v, samples.u)
    for j in np.flatnonzero(excess.max(axis=0) > RANGE_SLACK):
        if actuators[j].limits_control or not actuators[j].is_servo:  # of a motor, limits.effort may exceed the ctrlrange
            continue
        k = int(np.argmax(excess[:, j]))
        failures.append(
            f"{actuators[j].name} would need a ctrl {excess[k, j]:.3g} beyond its range at t = {samples.time[k]:.4g} s to"
            " give the planned effort"
        )
    return failures


def end_state_error(problem: Problem, trajectory: Trajectory, speed: float) -> float:
    """Return the largest error of the states at both ends, relative to the motion's span, largest speed and acceleration."""
    motion = problem.motion
    ends = np.stack([trajectory.position[0, 0], trajectory.position[-1, -1]])
    speeds = np.stack([trajectory.velocity[0, 0], trajectory.velocity[-1, -1]])
    span = max(float(np.ptp(trajectory.position)), _MIN_SPAN)
    if motion.ends_at_goal:
        rest = np.zeros(trajectory.n_s)
        assert motion.start is not None  # a reach and a hold have both
        assert motion.goal is not None
        asked = np.stack([motion.start, motion.goal])
        wanted = np.stack([rest if x is None else x for x in (motion.start_speed, motion.goal_speed)])
        free = np.zeros_like(ends, dtype=bool)
        free[1] = problem.free_at_end | motion.goal_is_free  # a free goal pose is checked by its sites
    elif trajectory.periodic:
        gone = np.stack([-1.0 * np.ones(trajectory.n_s), np.ones(trajectory.n_s)]) * motion.advance
        asked, wanted, free = ends[::-1] + gone, speeds[::-1], np.tile(problem.free_spins, (2, 1))
    else:
        return 0.0
    still = free & motion.ends_at_goal  # a spin's final speed is free in a reach and periodic in a periodic motion
    apart = [
        relative_violation(ends, exact_bounds(asked, free), span),
        relative_violation(speeds, exact_bounds(wanted, still | np.isnan(wanted)), speed),
    ]
    accelerations = motion.end_accelerations(trajectory.n_s)
    if motion.ends_at_goal and np.any(np.isfinite(accelerations)):
        every = trajectory.acceleration_at(trajectory.dense_times(4))
        largest = max(float(np.abs(every).max()), float(np.finfo(float).tiny))
        apart.append(relative_violation(every[[0, -1]], exact_bounds(accelerations), largest))
    apart += [_waypoint_error(problem, trajectory, waypoint, span, speed) for waypoint in motion.waypoints]
    return max(*apart, _path_error(problem, trajectory))


def _path_error(problem: Problem, trajectory: Trajectory) -> float:
    """Return the largest error of the path's parameter at both ends and where intervals join, relative to its length.

    Along a constant feed the error at every instant counts.
    """
    path = problem.path
    if path is None:
        return 0.0
    if not trajectory.along.size:
        return np.inf
    of, length, time = trajectory.along[:, :, 0], path.curve.length, trajectory.dense_times(4)
    apart = [of[0, 0], of[-1, -1] - length, *(of[0, 1:] - of[-1, :-1])]
    if path.feed:
        asked = Feed(curve=path.curve, period_s=trajectory.duration_s).derivative(time - trajectory.breaks_s[0])[:, 0]
        apart += [*(trajectory.along_at(time) - asked)]
    return float(np.abs(apart).max()) / length


def _waypoint_error(problem: Problem, trajectory: Trajectory, waypoint: Waypoint, span: float, speed: float) -> float:
    """Return a motion's error at a waypoint, at its time or at the nearest break.

    Errors are relative: positions to the motion's span, speeds to its largest speed, sites and bodies to the mechanism's
    extent.
    """
    time = waypoint_times(trajectory, waypoint)
    position, rate = exact_bounds(waypoint.position), exact_bounds(waypoint.speed)
    off = waypoint_off_m(problem, trajectory, waypoint, time).max(axis=1) / problem.mechanism.extent_m
    states = zip(trajectory.position_at(time), trajectory.velocity_at(time), off, strict=True)
    return min(max(relative_violation(s, position, span), relative_violation(v, rate, speed), x) for s, v, x in states)
