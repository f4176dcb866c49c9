"""The study of `linkplan compare` and `track`: trackers on one plan, with the modelled and with a changed mechanism."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from msgspec import Struct

from linkplan.controllers.imperfections.imperfections import Imperfections, Start
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.rollout import ControlLoop, Rollout
from linkplan.controllers.simulate import simulate, simulate_one
from linkplan.controllers.trackers.computed_torque import ComputedTorque
from linkplan.controllers.trackers.integral_lqr import IntegralLQR
from linkplan.controllers.trackers.mpc import HORIZON_BLOCKS, MPC
from linkplan.controllers.trackers.names import BUILT_IN, LINEAR, TRACKERS
from linkplan.controllers.trackers.prediction import condensing
from linkplan.controllers.trackers.tracker import AnyTracker, Design, Errors, StateFeedback, steps_of
from linkplan.models.errors import GainError, ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.models.reduction.closing import calls_near
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.limits.actuators import motor_lines
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.default_gains import tracking_of
from linkplan.planner.problem.keys.kinds import Delay
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import Tracking, to_toml_types
from linkplan.planner.search.planning import silent
from linkplan.studies.compare.lqr_weights import scaled, unit_effort
from linkplan.studies.compare.user_tracker import TrackerLike, users_tracker


class RunTime(Struct, frozen=True, kw_only=True):
    """A tracker's cost in a control period; None if unknown, for a tracker that is not built in.

    `remembered`: numbers kept from one period to the next. `stored`: numbers stored for each control instant of the plan
    (reference, gains). `operations`: floating-point operations of the law. `operations_at_limit`: the same if predicted
    efforts reach a limit, without the iterations of the quadratic program. `median_us` and `percentile90_us` [us]: measured
    times of this implementation for one state.
    """

    remembered: int
    stored: int | None
    operations: int | None
    operations_at_limit: int | None
    median_us: float
    percentile90_us: float


def run_time(tracker: AnyTracker, mechanism: Mechanism, rollout: Rollout) -> RunTime:
    """Return a tracker's cost, with the times of a run."""
    stored, free, at_limit = _counted(tracker, mechanism)
    times = 1e6 * rollout.asked_s
    return RunTime(
        remembered=int(steps_of(tracker).start(1).shape[1]),
        stored=stored,
        operations=free,
        operations_at_limit=at_limit,
        median_us=float(np.median(times)),
        percentile90_us=float(np.percentile(times, 90)),
    )


def _counted(tracker: AnyTracker, mechanism: Mechanism) -> tuple[int | None, int | None, int | None]:
    """Return the numbers stored per instant, and the operations of a period without and with a limit reached."""
    n_s, n_u, n_q = mechanism.dof, mechanism.n_u, mechanism.n_q
    state, dynamics = 2 * n_s, mechanism.forced
    if isinstance(tracker, StateFeedback):
        added = n_u if tracker.feedforward else 0
        free = state + n_u * (2 * state - 1) + added
        return state + n_u * state + added, free, free
    if isinstance(tracker, IntegralLQR):
        n_i = len(tracker.integrated)
        free = state + 2 * n_u * (state + n_i) + 2 * n_i + 2 * n_u
        return state + n_u + n_u * (state + n_i), free, free
    closing = sum(calls * _size(function) for function, calls in calls_near(dynamics))
    if isinstance(tracker, ComputedTorque):
        free = 8 * n_s + n_u + closing + _size(dynamics.effort_map) + _size(dynamics.inverse_dynamics) + 4 * n_u * n_s
        return state + n_s + n_q + n_u, free, free
    if isinstance(tracker, MPC):
        m, n, many = len(tracker.kept), HORIZON_BLOCKS, HORIZON_BLOCKS * n_u
        free = state + 2 * n_u * m + many * (2 * m + 1)
        # The Runge-Kutta method evaluates the dynamics four times.
        predicted = closing + n * (4 * _size(dynamics.flow) + _size(dynamics.linearisation))
        stored = state + n_s + 2 * n_q + 2 * n_u + m * m + n_u * m * (1 + n)
        return stored, free, free + predicted + _size(condensing(n, m, n_u))
    return None, None, None


def _size(function: ca.Function) -> int:
    """Return the number of operations of a CasADi function, and of those that it calls."""
    if function.is_a("SXFunction"):
        return int(function.n_instructions())
    return int(function.n_nodes()) + sum(_size(inner) for inner in function.find_functions(0))


# Fewest control periods in a motion. With fewer, tracking errors depend on sampling more than on the tracker.
_MIN_CONTROL_PERIODS = 10
# Most control instants (a log of a gigabyte) and most simulator steps (an hour).
_MAX_INSTANTS, _MAX_STEPS = 2e6, 1e8
# The least time [s] of the test whether a machine beside a pose returns to it; unstable machines of some metres fall in it.
_LEAST_REST_S = 5.0
# Positions and speeds of a plan that stands still change by less than this, which is rounding [rad, m; per second].
_STANDS_STILL = 1e-9
# The machine's initial offset from the pose [rad; extents on a slide], and the factor by which it has moved away. A stable
# loop may move away by a smaller factor before it returns.
_START_OFFSET, _MOVED_AWAY = 1e-4, 10.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Mismatch:
    """The differences between the simulated machine and the model of the plan and the trackers."""

    name: str
    mass_factor: float
    delay_periods: float  # may be a fraction


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Comparison:
    """Runs of the trackers on one plan: on the nominal model, and with a mismatch.

    `left_out` has a sentence on each tracker without a run.
    """

    plan: Plan
    nominal: dict[str, Rollout]
    mismatch: Mismatch | None = None
    mismatched: dict[str, Rollout] = field(default_factory=dict)
    title: str = "nominal"  # the title of the first group of runs
    stem: str = "nominal"  # the beginning of the first group's file names
    run_time: dict[str, RunTime] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()

    @property
    def cases(self) -> list[tuple[str, dict[str, Rollout]]]:
        """The nominal runs, and those with the mismatch, if there is one, each with its title."""
        mismatched = [] if self.mismatch is None else [(self.mismatch.name, self.mismatched)]
        return [(self.title, self.nominal), *mismatched]


def mismatch_of(plan: Plan, mass_factor: float, delay_periods: float) -> Mismatch | None:
    """Return a mismatch of payload (if there is none, of all moving masses) and delay; None if nothing changes."""
    what = "payload" if plan.problem.mechanism.payload is not None else "moving masses"
    delay = f"{delay_periods:g} control period{'s' if delay_periods != 1 else ''} of delay"
    name = f"{what} {100 * (mass_factor - 1):+.3g} %, {delay}"
    unchanged = mass_factor == 1.0 and delay_periods == 0
    return None if unchanged else Mismatch(name=name, mass_factor=mass_factor, delay_periods=delay_periods)


def delay_of(value: object, key: str) -> float:
    """Return a delay [control periods] after a check; an error names the key."""
    kind: Any = Delay
    return read(kind, to_toml_types(value), key)


def tracking_reference(plan: Plan) -> SampledReference:
    """Return the plan sampled at its problem's control period, over the problem's tracking duration or its own.

    Raises:
        ProblemError: if the control period is too long for the motion, or so short that the run is too long.
    """
    settings, trajectory = plan.problem.tracking, plan.require_motion("track")
    duration = settings.duration_s or trajectory.duration_s
    if trajectory.duration_s < _MIN_CONTROL_PERIODS * settings.period_s:
        raise ProblemError(
            f"tracking.period_s = {settings.period_s:g} s gives fewer than {_MIN_CONTROL_PERIODS} control instants in a"
            f" motion of {trajectory.duration_s:.4g} s; it must be at most"
            f" {trajectory.duration_s / _MIN_CONTROL_PERIODS:.2g} s"
        )
    instants = duration / settings.period_s
    steps = instants * max(1.0, settings.period_s / float(plan.problem.mechanism.model.opt.timestep))
    for many, what, most in ((instants, "control instants", _MAX_INSTANTS), (steps, "simulator steps", _MAX_STEPS)):
        if many > most:
            raise ProblemError(
                f"tracking over {duration:g} s with tracking.period_s = {settings.period_s:g} s has {many:.3g} {what}; the"
                f" limit is {most:g}"
            )
    problem = plan.problem
    return sample(problem.mechanism, trajectory, settings.period_s, duration, problem.limits.actuators_effort)


def build_tracker(asked: TrackerLike, plan: Plan, reference: SampledReference) -> AnyTracker:
    """Return a tracker for a plan: a built-in one by its name, or a user's own.

    Raises:
        ProblemError: for an unknown name, or an object that is not a tracker.
    """
    if not isinstance(asked, str):
        return users_tracker(asked, plan.problem.mechanism, reference)
    return BUILT_IN[choose("tracker", asked, TRACKERS, ProblemError)].build(design_of(plan, reference))


def design_of(plan: Plan, reference: SampledReference) -> Design:
    """Return what a built-in tracker of a plan is built from."""
    mechanism = plan.problem.mechanism

    def errors() -> Errors:
        position, velocity = lqr_settings(plan, reference).lqr_errors(mechanism.independent_joints)
        return Errors(position=position, velocity=velocity, effort=_unit_effort(plan))

    return Design(
        mechanism=mechanism,
        reference=reference,
        settings=tracking_of(plan.problem),
        errors=errors,
        effort_limit=np.array(plan.problem.limits.actuators_effort),
        compile_mode=plan.problem.solver.compile,
    )


def lqr_settings(plan: Plan, reference: SampledReference) -> Tracking:
    """Return the settings of tracking with every gain and LQR error set for a plan's machine and motion."""
    return scaled(tracking_of(plan.problem), plan.problem.mechanism, reference.pose_rad, _unit_effort(plan))


def _unit_effort(plan: Plan) -> np.ndarray:
    return unit_effort(plan.problem.limits.actuators_effort, plan.certificate.peak_effort)


def track(
    plan: Plan, asked: TrackerLike, mismatch: Mismatch | None = None, reference: SampledReference | None = None
) -> Rollout:
    """Return one tracker's run on a plan, optionally with a mismatch; `reference` is the sampled plan, if available."""
    reference = tracking_reference(plan) if reference is None else reference
    plant = _plant(plan, mismatch)
    rollout = simulate_one(plant, build_tracker(asked, plan, reference), reference)
    return replace(rollout, returns=_returns_to_rest(plant, asked, plan, reference))


def _returns_to_rest(plant: MujocoPlant, asked: TrackerLike, plan: Plan, reference: SampledReference) -> bool:
    """Return False if a machine that starts beside a pose at rest moves away from one that starts in it.

    Without a disturbance, a machine would stay in an unstable equilibrium, too. The runs last at least `_LEAST_REST_S`.
    """
    if max(np.ptp(reference.position_rad, axis=0).max(), np.abs(reference.velocity_rad_s).max()) > _STANDS_STILL:
        return True
    at = np.minimum(np.arange(max(reference.n, round(_LEAST_REST_S / reference.period_s))), reference.n - 1)
    longer = replace(reference.part(at), time_s=reference.period_s * np.arange(len(at)))
    unit = unit_steps(plan.problem.mechanism.independent_joints, plan.problem.mechanism.extent_m)
    beside = Imperfections(start=Start(position_error=_START_OFFSET * unit))
    logs = simulate(plant, build_tracker(asked, plan, longer), longer, [Imperfections(), beside])
    if any(logs.failure):
        return logs.failure[0] is not None  # only the second one ended early
    apart = np.linalg.norm(np.diff(logs.pose[:, :, plan.problem.mechanism.independent], axis=1)[:, 0] / unit, axis=1)
    return bool(apart[len(apart) // 2 :].max() <= _MOVED_AWAY * apart[0])


def compare(
    plan: Plan, mismatch: Mismatch | None, say: Callable[[str], None] = silent, asked: Sequence[TrackerLike] = LINEAR
) -> Comparison:
    """Return several trackers' runs on a plan, with the nominal model and with a mismatch.

    A tracker that has no gain for the mechanism is omitted, if another tracker has one.

    Raises:
        ProblemError: for an unknown tracker, equal names, or no tracker.
        GainError: if no tracker has a gain.
    """
    reference = tracking_reference(plan)
    built, missing, given = [], [], {}
    for one in asked:
        try:
            built.append(build_tracker(one, plan, reference))
            given[built[-1].name] = one
        except GainError as error:
            missing.append((one, error))
    if missing and not built:
        raise missing[0][1]
    trackers = {tracker.name: tracker for tracker in built}
    if len(trackers) < max(1, len(built)):
        names = ", ".join(tracker.name for tracker in built)
        raise ProblemError(f"a comparison needs one or more trackers with different names, got {names or 'none'}")
    cases = [None] if mismatch is None else [None, mismatch]
    runs: list[dict[str, Rollout]] = [{}, {}]
    for case, results in zip(cases, runs, strict=False):
        plant = _plant(plan, case)  # built once, for all trackers
        for name, tracker in trackers.items():
            say(f"{name}, {'nominal' if case is None else case.name}: {reference.n} control periods")
            rollout = simulate_one(plant, tracker, reference)
            results[name] = replace(rollout, returns=_returns_to_rest(plant, given[name], plan, reference))
    needs = {name: run_time(trackers[name], plan.problem.mechanism, rollout) for name, rollout in runs[0].items()}
    left_out = tuple(f"{name} is left out: {error}" for name, error in missing)
    return Comparison(plan=plan, nominal=runs[0], mismatch=mismatch, mismatched=runs[1], run_time=needs, left_out=left_out)


def _plant(plan: Plan, mismatch: Mismatch | None) -> MujocoPlant:
    return MujocoPlant(mechanism=plan.problem.mechanism, loop=control_loop(plan.problem, mismatch))


def control_loop(problem: Problem, mismatch: Mismatch | None = None) -> ControlLoop:
    """Return a problem's drives, perhaps with a mismatch: limits on effort and its rate, motors' torque-speed lines."""
    return ControlLoop(
        effort_limit=np.array(problem.limits.actuators_effort),
        motor_line=motor_lines(problem),
        rate_limit=np.abs(problem.limits.effort_rate).max(axis=1),
        initial_effort=problem.limits.initial_effort[:, 0],
        delay_periods=int(problem.tracking.delay_periods) + (mismatch.delay_periods if mismatch else 0),
        mass_factor=mismatch.mass_factor if mismatch else 1.0,
    )


# The errors of a run: their words by the beginning of their names.
ERRORS = {"rms": "rms error", "max": "largest error", "final": "final error"}


@np.errstate(over="ignore", invalid="ignore")  # a diverged run has infinite errors
def run_figures(plan: Plan, rollout: Rollout) -> dict:
    """Return a run's metrics; the names contain the units."""
    names = [actuator.name for actuator in plan.problem.mechanism.actuators]
    return error_figures(plan.problem.mechanism, rollout.error_rad) | {
        "peak_effort": dict(zip(names, np.abs(rollout.applied).max(axis=0), strict=True)),
        "rms_effort": dict(zip(names, np.sqrt(np.mean(rollout.applied**2, axis=0)), strict=True)),
        "saturated_fraction": rollout.saturated_fraction,
        "loop_gap_max_m": float(rollout.gap_m.max()),
        **({"loop_gap_max_rad": float(rollout.gap_rad.max())} if len(rollout.gap_rad) else {}),
        "contacts": rollout.contacts,
        "stable": rollout.stable,
    }


def error_figures(mechanism: Mechanism, error: np.ndarray) -> dict[str, float]:
    """Return the rms, largest and final value of errors (n, n_s) [rad or m], in degrees for hinges, in metres for slides."""
    record = {}
    for unit, (which, factor) in actuated_by_unit(mechanism).items():
        size = factor * np.linalg.norm(error[:, which], axis=1)
        figures = (np.sqrt(np.mean(size**2)), size.max(), size[-1])
        record |= {f"{name}_error_{unit}": float(value) for name, value in zip(ERRORS, figures, strict=True)}
    return record


def actuated_by_unit(mechanism: Mechanism) -> dict[str, tuple[np.ndarray, float]]:
    """Return for each unit its factor from SI and the mask (n_s,) of the controllable independent joints with this unit."""
    hinge = np.array([joint.kind == "hinge" for joint in mechanism.independent_joints])
    units = {"deg": (hinge & mechanism.actuated, 180 / np.pi), "m": (~hinge & mechanism.actuated, 1.0)}
    return {unit: found for unit, found in units.items() if np.any(found[0])}


def gap_units(plan: Plan) -> tuple[bool, bool]:
    """Return (True if some closure gap is a length, True if some is an angle); (True, False) without closures."""
    units = {closure.unit for closure in plan.problem.mechanism.closures}
    return units != {"rad"}, "rad" in units
