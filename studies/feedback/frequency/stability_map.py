"""The PD gains that keep a sampled feedback loop stable at all poses: boundary, margins and the longest control period.

Stability follows from the closed-loop poles of the sampled model in MuJoCo's own steps. The map also holds the smallest
phase margin.
"""

from collections.abc import Callable, Sequence

import numpy as np
from msgspec import Struct

from linkplan.controllers.sampling import Sampling, closed, sampling, spectral_radius
from linkplan.controllers.trackers.pd import pd_gain
from linkplan.models.actuation.distribution import unit_efforts
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.search.planning import silent
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop, OperatingPoint, feedback_loop
from linkplan.studies.feedback.frequency.quick import quick_loops
from linkplan.studies.feedback.frequency.simulated_loops import settle_trials
from linkplan.studies.feedback.frequency.worst import last_good

# Points along each axis of the grid from which the boundary is drawn.
_BORDER_GRID_POINTS = 240
# Relative tolerance of a bisected stability boundary.
_BORDER_TOLERANCE = 1e-6


class TriedGains(Struct, frozen=True, kw_only=True, eq=False):
    """PD gains that MuJoCo simulated at a pose, and whether they settle there. `stable` is the prediction."""

    kp: float
    kd: float
    pose: str
    settles_in_mujoco: bool
    stable: Beside[bool] = NOT_READ


class StabilityMap(Struct, frozen=True, kw_only=True, eq=False):
    """The loop over grids of gains kp (n,) and kd (m,): at each pair of gains, the worst over all points.

    `radius` (n, m): the largest pole. `phase_margin_deg` (n, m) is NaN where the loop is unstable. `border` (kp, kd,
    radius): the radius on a finer grid.
    """

    kp: np.ndarray
    kd: np.ndarray
    radius: np.ndarray
    tried: Sequence[TriedGains]
    points: Beside[tuple[OperatingPoint, ...]] = NOT_READ
    timing: Beside[Sampling] = NOT_READ
    phase_margin_deg: Beside[np.ndarray] = NOT_READ
    border: Beside[tuple[np.ndarray, np.ndarray, np.ndarray]] = NOT_READ


def effort_map(point: OperatingPoint) -> np.ndarray:
    """Return the map (n_u, n_s) from PD's joint efforts to actuator efforts."""
    return unit_efforts(np.array(point.mechanism.dynamics.effort_map(point.pose)))


def pd_loop(point: OperatingPoint, kp: float, kd: float, timing: Sampling) -> FeedbackLoop:
    """Return the PD loop of gains [N.m/rad, N.m.s/rad] about a point."""
    return feedback_loop(point, pd_gains(point, kp, kd), timing)


def radii(point: OperatingPoint, kp: np.ndarray, kd: np.ndarray, timing: Sampling) -> np.ndarray:
    """Return the largest pole's size (...,) of PD loops of gains kp, kd (...,) about a point."""
    return radii_about(point, timing)(pd_gains(point, kp, kd))


def radii_about(point: OperatingPoint, timing: Sampling) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function from gains K (..., n_u, 2 n_s) to the largest pole's size (...,) of loops about a point."""
    matrices = feedback_loop(point, pd_gains(point, 1.0, 1.0), timing).actuated_matrices()
    return lambda gains: spectral_radius(closed(*matrices, gains))


def pd_gains(point: OperatingPoint, kp: float | np.ndarray, kd: float | np.ndarray) -> np.ndarray:
    """Return K (..., n_u, 2 n_s) of gains (...,)."""
    kp, kd = np.broadcast_arrays(np.asarray(kp, dtype=float), np.asarray(kd, dtype=float))
    return pd_gain(effort_map(point), kp[..., None, None], kd[..., None, None])


def critical_kd(point: OperatingPoint, kp: float, timing: Sampling) -> tuple[float, float]:
    """Return the smallest and the largest kd at which the sampled loop is stable with the given kp, NaN if none is."""
    scale = float(np.max(np.linalg.eigvalsh(np.atleast_2d(point.inertia)))) / timing.period_s
    kd = np.concatenate([[0.0], np.geomspace(1e-6 * scale, 10 * scale, 3600)])
    largest = radii_about(point, timing)
    stable = largest(pd_gains(point, np.full_like(kd, kp), kd)) < 1.0
    if not np.any(stable):
        return np.nan, np.nan
    inside = np.flatnonzero(stable)

    def border(good: float, bad: float) -> float:
        return last_good(unstable, good, bad, True, _BORDER_TOLERANCE)[0]

    def unstable(kd: float) -> bool | None:
        return bool(largest(pd_gains(point, kp, kd)) >= 1.0) or None

    first, last = int(inside[0]), int(inside[-1])
    kd = kd.tolist()
    low = 0.0 if first == 0 else border(kd[first], kd[first - 1])
    low = low if low > _BORDER_TOLERANCE * kd[last] else 0.0
    return low, border(kd[last], kd[last + 1]) if last + 1 < len(kd) else np.inf


def longest_period(
    points: Sequence[OperatingPoint], kp: float, kd: float, delay_periods: float, begin_s: float
) -> tuple[float | None, OperatingPoint | None]:
    """Return the longest control period [s] at which PD is stable at every point, and the point that limits it.

    The period is None if PD is unstable at every period, and infinite if it is stable at every period.

    Args:
        points: operating points of one mechanism.
        kp: gain [N.m/rad or N/m].
        kd: gain [N.m.s/rad or N.s/m].
        delay_periods: computing delay in periods.
        begin_s: the first period to try [s]; it is halved while unstable, then increased.
    """

    def unstable(period: float) -> OperatingPoint | None:
        timing = sampling(points[0].mechanism, period, delay_periods)
        return next((point for point in points if not pd_loop(point, kp, kd, timing).stable), None)

    good = begin_s
    for _ in range(40):
        if unstable(good) is None:
            break
        good *= 0.5
    else:
        return None, None
    bad, culprit = good, None
    while culprit is None and bad < 1e6 * begin_s:
        good, bad = bad, 1.05 * bad
        culprit = unstable(bad)
    if culprit is None:
        return np.inf, None
    return last_good(unstable, good, bad, culprit, 1e-4)


def stability_map(
    points: Sequence[OperatingPoint],
    timing: Sampling,
    kp: np.ndarray,
    kd: np.ndarray,
    effort_limit: np.ndarray,
    say: Callable[[str], None] = silent,
) -> StabilityMap:
    """Return the map over gains kp (n,) and kd (m,); gains on both sides of the border are simulated, too.

    `effort_limit` (n_u, 2) [N.m or N] is that of MuJoCo's actuators.
    """
    shape = len(kp), len(kd)
    radius, margin = np.zeros(shape), np.full(shape, np.inf)
    fine_kp, fine_kd = (np.geomspace(axis[0], axis[-1], _BORDER_GRID_POINTS) for axis in (kp, kd))
    fine = np.zeros((_BORDER_GRID_POINTS, _BORDER_GRID_POINTS))
    for point in points:
        say(f"gains at {point.name}")
        fine = np.maximum(fine, radii(point, fine_kp[:, None], fine_kd[None, :], timing))
        radius = np.maximum(radius, radii(point, kp[:, None], kd[None, :], timing))
        quick = [quick_loops(point, pd_gains(point, np.full(len(kd), p), kd), timing, [0])[0] for p in kp]
        margin = np.minimum(margin, [one.phase_margin_deg for one in quick])
    gains = border_points(points, timing, kp)
    say(f"{len(gains)} gains on both sides of the stability boundary, in MuJoCo")
    loops = [pd_loop(points[index], p, d, timing) for p, d, index in gains]
    settles = settle_trials(loops, effort_limit).tolist() if loops else []
    return StabilityMap(
        kp=np.array(kp),
        kd=np.array(kd),
        radius=radius,
        tried=[
            TriedGains(kp=p, kd=d, pose=loop.point.name, settles_in_mujoco=settled, stable=loop.stable)
            for (p, d, _), loop, settled in zip(gains, loops, settles, strict=True)
        ],
        points=tuple(points),
        timing=timing,
        phase_margin_deg=np.where(radius >= 1.0, np.nan, margin),
        border=(fine_kp, fine_kd, fine),
    )


def border_points(points: Sequence[OperatingPoint], timing: Sampling, kp: np.ndarray) -> list[tuple[float, float, int]]:
    """Return gains (kp, kd, point index) on both sides of the upper border, for the point that determines it at each kp."""
    found, share = [], 0.03
    for gain in np.geomspace(kp[0] if kp[0] > 0 else kp[1], kp[-1], 7).tolist():
        largest = [critical_kd(point, gain, timing)[1] for point in points]
        kd, index = min((0.0 if np.isnan(kd) else kd, index) for index, kd in enumerate(largest))
        if 0 < kd < np.inf:
            found += [(gain, kd * (1 - share), index), (gain, kd * (1 + share), index)]
    return found
