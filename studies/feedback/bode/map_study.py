"""The study of `linkplan bode --map`: stable gains at all poses, checked in MuJoCo, and the longest control period."""

from collections.abc import Callable

import numpy as np
from msgspec.structs import asdict

from linkplan.models.errors import LinkplanError
from linkplan.planner.search.planning import silent
from linkplan.studies.feedback.bode.bode_report import BodeStudy
from linkplan.studies.feedback.bode.bode_result import TRIAL_GAIN_SHARE, MapStudy
from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint, operating_point
from linkplan.studies.feedback.frequency.stability_map import (
    critical_kd,
    longest_period,
    pd_loop,
    stability_map,
)
from linkplan.studies.feedback.frequency.trial import settle_trials
from linkplan.studies.feedback.frequency.worst import refined_minima

_GRID_POINTS = 48


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
    settles = _settles_near_border(points, own_kp, critical[:, 1], law.timing, law.effort_limit)
    joint = mechanism.independent_joints[0]
    ends = zip(points, np.nan_to_num(critical, nan=0.0, posinf=np.inf).tolist(), settles.tolist(), strict=True)
    return MapStudy(
        **asdict(found),
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


def _settles_near_border(points, kp: float, critical: np.ndarray, timing, effort_limit: np.ndarray) -> np.ndarray:
    """Return whether MuJoCo settles (n, 2) just below and just above the critical kd (n,); kd = 1 if there is none."""
    kd = np.where(np.isfinite(critical), critical, 1.0)[:, None] * np.array([1 - TRIAL_GAIN_SHARE, 1 + TRIAL_GAIN_SHARE])
    loops = [pd_loop(point, kp, value, timing) for point, pair in zip(points, kd, strict=True) for value in pair]
    return settle_trials(loops, effort_limit).reshape(-1, 2)
