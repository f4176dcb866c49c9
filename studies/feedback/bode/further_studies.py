"""The further studies of a feedback loop: beyond its effort limit, along a plan, and a map of stable gains.

They are `linkplan bode --large`, `--along` and `--map`.
"""

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from msgspec import structs

from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.sampling import Sampling, sampling
from linkplan.models.errors import LinkplanError
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.limits import Limits
from linkplan.planner.problem.settings import Tracking
from linkplan.planner.search.planning import silent
from linkplan.studies.compare.compare import build_tracker
from linkplan.studies.feedback.bode.bode_report import BodeStudy
from linkplan.studies.feedback.bode.bode_result import TRIAL_GAIN_SHARE, AlongMotion, FrozenMargins, MapStudy
from linkplan.studies.feedback.bode.scan import stability
from linkplan.studies.feedback.frequency.describing import LargeSignals, default_large_frequencies, large_signals
from linkplan.studies.feedback.frequency.feasible import curve_rows, default_amplitudes, feasible_curve
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop, OperatingPoint, feedback_loop, operating_point
from linkplan.studies.feedback.frequency.floquet import floquet, frozen_radii, linear_law
from linkplan.studies.feedback.frequency.margins import Margins, margins
from linkplan.studies.feedback.frequency.simulated_loops import settle_trials
from linkplan.studies.feedback.frequency.stability_map import (
    critical_kd,
    longest_period,
    pd_loop,
    stability_map,
)
from linkplan.studies.feedback.frequency.worst import refined_minima

_GRID_POINTS = 48


def large_study(study: BodeStudy, limits: Limits | None, say: Callable[[str], None] = silent) -> LargeSignals:
    """Return the large-signal responses at the middle one of a bode study's stable poses.

    Args:
        study: the bode study.
        limits: the planner's limits for the curve; default: the model's.
        say: receives progress messages.

    Raises:
        LinkplanError: if no pose is stable, or the actuator has no limit.
    """
    stable = [entry for entry in study.points if entry.stable and entry.channel == 0]
    if not stable:
        raise LinkplanError("a response beyond the effort limit needs a stable feedback loop, but none of the poses has one")
    entry = stable[len(stable) // 2]
    curve = feasible_curve(
        entry.point,
        default_amplitudes(entry.point),
        study.law.effort_limit,
        position_limit=None if limits is None else limits.position,
        speed_limit=None if limits is None else limits.speed,
    )
    within = curve.amplitude[curve.frequency_hz > 0]
    say(f"large signals at {entry.point.name}")
    signals = large_signals(
        entry.sampled,
        study.law.effort_limit,
        default_large_frequencies(entry.sampled, entry.crossover_hz),
        quantity="reference" if study.law.name == "pd" else "reference+ff",
        farthest=float(within.max()) if within.size else None,
        say=say,
    )
    return structs.replace(signals, feasible=curve_rows(curve), curve=curve)


def along_motion(plan: Plan, law: str, settings: Tracking, say: Callable[[str], None] = silent) -> AlongMotion:
    """Return a tracker's loop along a plan; `settings` replace the plan's gains."""
    plan = replace(plan, problem=plan.problem.varied(tracking=settings))
    mechanism, trajectory = plan.problem.mechanism, plan.require_motion("analyse")
    limit = plan.problem.limits.actuators_effort
    reference = sample(mechanism, trajectory, settings.period_s, trajectory.duration_s, limit)
    tracker = build_tracker(law, plan, reference)
    timing = sampling(mechanism, settings.period_s, settings.delay_periods)
    gains = linear_law(tracker).gains
    say(f"{law} frozen along {plan.problem.name}: {reference.n} control instants")
    radius = frozen_radii(mechanism, reference, gains, timing)
    instants = np.unique(np.linspace(0, reference.n - 1, 25).astype(int))

    @functools.cache
    def worst(k: int) -> tuple[Margins, int]:
        loop = frozen_loop(mechanism, reference, gains, timing, k)
        every = [(margins(loop, channel, refine=False), channel) for channel in mechanism.channels]
        return min(every, key=lambda one: stability(one[0]))

    between = [round(k) for k in refined_minima(lambda k: stability(worst(round(k))[0]), instants)]
    joints, frozen = mechanism.independent_joints, []
    for k in np.unique([*instants, *between]):
        bounds, channel = worst(k)
        frozen.append(FrozenMargins(**structs.asdict(bounds), time_s=float(reference.time_s[k]), joint=joints[channel].name))
    cycle = None
    if reference.cycle is not None:
        say("Floquet multipliers, predicted and measured")
        cycle = floquet(mechanism, reference, tracker, timing, limit)
    return AlongMotion(
        plan=plan.problem.name,
        tracker=law,
        frozen=tuple(frozen),
        largest_frozen_pole=float(radius.max()),
        floquet=cycle,
        n_loops=len(joints),
    )


def frozen_loop(mechanism, reference: SampledReference, gains: np.ndarray, timing: Sampling, k: int) -> FeedbackLoop:
    """Return the loop frozen at instant k: its gain and the motion's state are kept constant."""
    point = OperatingPoint(
        mechanism=mechanism,
        pose=reference.pose_rad[k],
        velocity=reference.velocity_rad_s[k],
        hold=reference.effort[k],
        told=tuple(mechanism.channels),
        forces=tuple(w[k, None] for w in reference.forces),
    )
    return feedback_loop(point, gains[k], timing)


def map_study(study: BodeStudy, say: Callable[[str], None] = silent) -> MapStudy:
    """Return the map around the gains of a bode study of one degree of freedom, at nine positions from first pose to last.

    Positions between them with a local minimum of the largest stable kd are added.
    """
    mechanism, law = study.mechanism, study.law
    own_kp, own_kd = (float(gain[0]) for gain in law.settings.gains(mechanism.independent_joints))
    at = [float(entry.point.state[0]) for entry in study.points]
    positions = np.linspace(min(at), max(at), 9 if len(at) > 1 else 1)

    def point_at(x: float) -> OperatingPoint:
        return operating_point(mechanism, np.array([x]), law.effort_limit)

    def largest(x: float) -> float:
        try:
            return critical_kd(point_at(x), own_kp, law.timing)[1]
        except LinkplanError:  # a pose between two poses that can be held need not be one
            return np.inf

    if len(positions) > 1:
        positions = np.sort([*positions, *refined_minima(largest, positions)])
    points = [point_at(x) for x in positions]
    critical = np.array([critical_kd(point, own_kp, law.timing) for point in points])
    inertia = np.array([float(point.inertia[0, 0]) for point in points])
    # 2 J / T is the largest stable kd without delay, and J / T^2 the natural scale of kp.
    largest_kd = 2 * inertia.max() / law.timing.period_s
    scale = inertia / law.timing.period_s**2
    kp, kd = (
        np.geomspace(min([*own, low]) / 3, 2 * max([*own, high]), _GRID_POINTS)
        for own, low, high in (
            ([own_kp] if own_kp > 0 else [], 1e-4 * scale.min(), 5 * scale.max()),
            ([own_kd] if own_kd > 0 else [], 3e-3 * largest_kd, 2 * largest_kd),
        )
    )
    found = stability_map(points, law.timing, kp, kd, law.effort_limit, say)
    delay = law.timing.delay_steps / law.timing.substeps
    longest, where = longest_period(points, own_kp, own_kd, delay, law.timing.period_s)
    say("gains on both sides of the stability boundary at every pose, in MuJoCo")
    tried = np.where(np.isfinite(critical[:, 1]), critical[:, 1], 1.0)[:, None] * (
        1.0 + TRIAL_GAIN_SHARE * np.array([-1, 1])
    )
    loops = [pd_loop(point, own_kp, x, law.timing) for point, pair in zip(points, tried, strict=True) for x in pair]
    settles = settle_trials(loops, law.effort_limit).reshape(-1, 2)
    joint = mechanism.independent_joints[0]
    ends = zip(points, np.nan_to_num(critical, nan=0.0, posinf=np.inf).tolist(), settles.tolist(), strict=True)
    return MapStudy(
        **structs.asdict(found),
        critical_kd=[
            {
                f"position_{joint.unit}": joint.shown(point.state[0]),
                "least": low,
                "largest": high,
                "settles_below_in_mujoco": below,
                "settles_above_in_mujoco": above,
            }
            for point, (low, high), (below, above) in ends
        ],
        longest_period_s=longest,
        as_predicted=sum(one.settles_in_mujoco == one.stable for one in found.tried),
        tried_count=len(found.tried),
        gains=(own_kp, own_kd),
        critical=critical,
        settles_near_border=settles,
        longest_at=where,
    )
