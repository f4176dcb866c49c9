"""The study behind `linkplan bode --map`: stable gains at all poses, checked in MuJoCo, and the longest control period."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.planner.planning import silent
from linkplan.studies.bode.bode import BodeStudy
from linkplan.studies.frequency.feedback_loops import OperatingPoint, operating_point, refuse_several_freedoms
from linkplan.studies.frequency.stability_map import (
    StabilityMap,
    critical_kd,
    longest_period,
    pd_loop,
    stability_map,
)
from linkplan.studies.frequency.trial import settle_trials
from linkplan.studies.frequency.worst import local_minima

# Gains simulated in MuJoCo lie this share above and below the stability boundary.
TRIAL_GAIN_SHARE = 0.02
_GRID_POINTS = 48


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MapStudy:
    """A stability map, the stable kd (low, high) at the study's kp for each pose (n, 2), the longest control period [s].

    `longest_s` is None if the gains are unstable at any period, and infinite if they are stable at any period.
    """

    found: StabilityMap
    settles_near_border: np.ndarray  # (n, 2): MuJoCo settles just below and just above each pose's largest stable kd
    kp: float
    kd: float
    critical: np.ndarray
    longest_s: float | None
    longest_at: OperatingPoint | None


def map_study(study: BodeStudy, say: Callable[[str], None] = silent) -> MapStudy:
    """Return the map around a bode study's gains, at nine positions from its first pose to its last.

    Positions between them with a local minimum of the largest stable kd are added.

    Raises:
        LinkplanError: for a mechanism of more than one degree of freedom.
    """
    mechanism, law = study.mechanism, study.law
    refuse_several_freedoms(mechanism, "a stability map")
    own_kp, own_kd = (float(gain[0]) for gain in law.settings.gains(mechanism.independent_joints))
    at = [float(entry.point.state[0]) for entry in study.points]
    positions = np.linspace(min(at), max(at), 9 if len(at) > 1 else 1)

    def point_at(x: float) -> OperatingPoint:
        return operating_point(mechanism, np.array([x]), law.effort_limit)

    def largest(x: float) -> float:
        try:
            return critical_kd(point_at(x), own_kp, law.timing)[1]
        except LinkplanError:  # poses between two held ones may not be held
            return np.inf

    if len(positions) > 1:
        positions = np.sort([*positions, *local_minima(largest, positions)])
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
    return MapStudy(
        found=found,
        settles_near_border=_settles_near_border(points, own_kp, critical[:, 1], law.timing, law.effort_limit),
        kp=own_kp,
        kd=own_kd,
        critical=critical,
        longest_s=longest,
        longest_at=where,
    )


def _settles_near_border(points, kp: float, critical: np.ndarray, timing, effort_limit: np.ndarray) -> np.ndarray:
    """Return whether MuJoCo settles (n, 2) just below and just above the critical kd (n,); kd = 1 if there is none."""
    kd = np.where(np.isfinite(critical), critical, 1.0)[:, None] * np.array([1 - TRIAL_GAIN_SHARE, 1 + TRIAL_GAIN_SHARE])
    loops = [pd_loop(point, kp, value, timing) for point, pair in zip(points, kd, strict=True) for value in pair]
    return settle_trials(loops, effort_limit).reshape(-1, 2)


def agreement(found: StabilityMap) -> tuple[int, int]:
    """Return the number of simulated gains for which MuJoCo agrees with the sampled model, and the number simulated."""
    predicted = np.array([pd_loop(found.points[i], kp, kd, found.timing).stable for kp, kd, i in found.tried], dtype=bool)
    return int(np.sum(predicted == found.settles)), len(predicted)


def map_record(study: MapStudy) -> dict:
    """Return the map as a JSON record."""
    found = study.found
    joint = found.points[0].mechanism.independent_joints[0]
    right, tried = agreement(found)
    return {
        "kp": found.kp,
        "kd": found.kd,
        "radius": found.radius,
        "critical_kd": [
            {
                f"position_{joint.unit}": joint.shown(p.state[0]),
                "least": float(low),
                "largest": float(high) if np.isfinite(high) else None,
                "settles_below_in_mujoco": bool(below),
                "settles_above_in_mujoco": bool(above),
            }
            for p, (low, high), (below, above) in zip(
                found.points, np.nan_to_num(study.critical, nan=0.0), study.settles_near_border, strict=True
            )
        ],
        "longest_period_s": study.longest_s if study.longest_s is not None and np.isfinite(study.longest_s) else None,
        "tried": [
            {"kp": kp, "kd": kd, "pose": found.points[i].name, "settles_in_mujoco": bool(settles)}
            for (kp, kd, i), settles in zip(found.tried, found.settles, strict=True)
        ],
        "as_predicted": right,
        "tried_count": tried,
    }
