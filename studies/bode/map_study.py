"""The study behind `linkplan bode --map`: stable gains at all angles, their boundary tried in MuJoCo, longest period."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.planner.planning import silent
from linkplan.studies.bode.bode import BodeStudy
from linkplan.studies.frequency.feedback_loops import OperatingPoint, operating_point, pd_gain, refuse_several_freedoms
from linkplan.studies.frequency.stability_map import (
    StabilityMap,
    critical_kd,
    effort_map,
    longest_period,
    pd_loop,
    stability_map,
)
from linkplan.studies.frequency.trial import settle_trials
from linkplan.studies.frequency.worst import local_minima
from linkplan.studies.output.tables import table

ANGLES = 9
# Gains tried in MuJoCo lie this share to either side of the stability boundary.
BESIDE = 0.02
_GRID = 48
# The map reaches from a thousandth of the largest stable gain to a few times it, so that the boundary runs through it.
_BELOW, _BEYOND = 1e-3, 4.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MapStudy:
    """A stability map, the stable kd (low, high) at the study's kp for each angle (n, 2), the longest control period [s].

    `longest_s` is None where the gains are unstable however short the period, and infinite where none is too long.
    """

    found: StabilityMap
    beside: np.ndarray  # (n, 2) whether MuJoCo settles a share below and above the largest stable kd of each angle
    kp: float
    kd: float
    critical: np.ndarray
    longest_s: float | None
    longest_at: OperatingPoint | None
    delay_periods: float


def map_study(study: BodeStudy, say: Callable[[str], None] = silent) -> MapStudy:
    """Return the map about a bode study's gains, over nine angles from its first pose to its last.

    Angles between them at which the largest stable kd is least are added.

    Raises:
        LinkplanError: for a mechanism of more than one degree of freedom.
    """
    mechanism, settings = study.mechanism, study.settings
    refuse_several_freedoms(mechanism, "a stability map")
    own_kp, own_kd = (float(gain[0]) for gain in settings.gains(mechanism.independent_joints))
    at = [float(entry.point.state[0]) for entry in study.points]
    positions = np.linspace(min(at), max(at), ANGLES if len(at) > 1 else 1)

    def point_at(x: float) -> OperatingPoint:
        return operating_point(mechanism, np.array([x]), study.effort_limit)

    def largest(x: float) -> float:
        try:
            return _critical(point_at(x), own_kp, study.timing)[1]
        except LinkplanError:  # a stretch between poses that are held may not be
            return np.inf

    if len(positions) > 1:
        positions = np.sort([*positions, *local_minima(largest, positions)])
    points = [point_at(x) for x in positions]
    critical = np.array([_critical(point, own_kp, study.timing) for point in points])
    inertia = np.array([float(point.inertia[0, 0]) for point in points])
    bearable = 2 * inertia.max() / settings.period_s
    most = _BEYOND * max(bearable, own_kd)
    kd = np.geomspace(_BELOW * bearable, most, _GRID)
    stiff = inertia / settings.period_s**2  # what kp is to be compared with
    asked = [own_kp] if own_kp > 0 else []
    kp = np.geomspace(min(*asked, 1e-4 * stiff.min(), stiff.min()) / 3, max(*asked, 5 * stiff.max(), stiff.max()) * 2, _GRID)
    found = stability_map(points, study.timing, kp, kd, study.effort_limit, say)
    delay = study.timing.delay_steps / study.timing.substeps
    try:
        longest, where = longest_period(
            points, lambda point, _: pd_gain(effort_map(point), own_kp, own_kd), delay, settings.period_s
        )
    except LinkplanError:
        longest, where = None, None
    say("gains on both sides of the stability boundary at every angle, in MuJoCo")
    return MapStudy(
        found=found,
        beside=_beside(points, own_kp, critical[:, 1], study.timing, study.effort_limit),
        kp=own_kp,
        kd=own_kd,
        critical=critical,
        longest_s=longest,
        longest_at=where,
        delay_periods=delay,
    )


def _critical(point: OperatingPoint, kp: float, timing) -> tuple[float, float]:
    try:
        return critical_kd(point, kp, timing)
    except LinkplanError:
        return np.nan, np.nan


def _beside(points, kp: float, critical: np.ndarray, timing, effort_limit: np.ndarray) -> np.ndarray:
    """Return whether MuJoCo settles (n, 2) at a share below and above critical gains (n,); above all where there is none."""
    kd = np.where(np.isfinite(critical), critical, 1.0)[:, None] * np.array([1 - BESIDE, 1 + BESIDE])
    loops = [pd_loop(point, kp, value, timing) for point, pair in zip(points, kd, strict=True) for value in pair]
    return settle_trials(loops, effort_limit).settles.reshape(-1, 2)


def agreement(found: StabilityMap) -> tuple[int, int]:
    """Return how many gains tried in MuJoCo do as the sampled model says, and how many were tried."""
    if found.trials is None:
        return 0, 0
    said = [pd_loop(found.points[i], kp, kd, found.timing).stable for kp, kd, i in found.tried]
    return int(np.sum(np.array(said) == found.trials.settles)), len(said)


def map_record(study: MapStudy) -> dict:
    """Return what files say of the map."""
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
                found.points, np.nan_to_num(study.critical, nan=0.0), study.beside, strict=True
            )
        ],
        "longest_period_s": study.longest_s if study.longest_s is not None and np.isfinite(study.longest_s) else None,
        "tried": [
            {"kp": kp, "kd": kd, "pose": found.points[i].name, "settles_in_mujoco": bool(settles)}
            for (kp, kd, i), settles in zip(found.tried, [] if found.trials is None else found.trials.settles, strict=True)
        ],
        "as_predicted": right,
        "tried_count": tried,
    }


def map_text(study: MapStudy) -> str:
    """Return the critical damping gains, the longest period, and what MuJoCo says."""
    found = study.found
    joint = found.points[0].mechanism.independent_joints[0]
    rows = [
        [f"{joint.said(p.state[0], 4)}", float(p.inertia[0, 0]), float(low), float(high)]
        for p, (low, high) in zip(found.points, study.critical, strict=True)
    ]
    turns = joint.kind == "hinge"
    stiffness, damping = ("N.m/rad", "N.m.s/rad") if turns else ("N/m", "N.s/m")
    inertia = "kg m2" if turns else "kg"
    gains = f"kp = {study.kp:g} {stiffness}, kd = {study.kd:g} {damping}"
    head = [f"{joint.name} [{joint.unit}]", f"inertia [{inertia}]", f"least kd [{damping}]", f"largest kd [{damping}]"]
    right, tried = agreement(found)
    lines = [f"stable kd at kp = {study.kp:g} {stiffness}, sampled every {found.timing.period_s:g} s", table(head, rows), ""]
    if study.longest_s is None:
        lines.append(f"{gains} is unstable at any control period")
    elif np.isfinite(study.longest_s):
        lines.append(
            f"{gains} needs a control period below {1e3 * study.longest_s:.4g} ms"
            f" ({1e-3 / study.longest_s:.4g} kHz), for {study.longest_at.name}"
        )
    lines.append(f"at {right} of {tried} gains next to the stability boundary MuJoCo settles or not as predicted")
    return "\n".join(lines)
