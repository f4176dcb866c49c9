"""The feasible-amplitude curve: the highest frequency at which any controller can follow a sinusoid of a given amplitude.

    s(t) = s_0 + a cos(w t):  inverse dynamics at every phase within the effort limits, every joint within range and speed

For a pure inertia J the curve is a = u_max / (J w^2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates, needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint
from linkplan.studies.feedback.frequency.worst import last_good


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FeasibleCurve:
    """The highest frequencies (n,) [Hz] at which amplitudes (n,) [rad or m] can be followed, and the limiting constraints.

    The frequency is zero if an amplitude cannot be reached at any speed.
    """

    point: OperatingPoint
    amplitude: np.ndarray
    frequency_hz: np.ndarray
    reason: tuple[str | None, ...]


def feasible_curve(
    point: OperatingPoint,
    amplitude: np.ndarray,
    effort_limit: np.ndarray,
    position_limit: np.ndarray | None = None,
    speed_limit: np.ndarray | None = None,
) -> FeasibleCurve:
    """Return the curve of the first independent joint about a point, while the others stay at rest.

    Args:
        point: the middle of the sinusoids.
        amplitude: (n,) [rad or m].
        effort_limit: (n_u, 2) [N.m or N].
        position_limit: of every joint (n_q, 2); default: the model's.
        speed_limit: of every joint (n_q, 2) [rad/s or m/s]; default: none.
    """
    mechanism = point.mechanism
    ranges = np.array([[j.lower, j.upper] for j in mechanism.joints]) if position_limit is None else position_limit
    speeds = np.tile([-np.inf, np.inf], (mechanism.n_q, 1)) if speed_limit is None else speed_limit
    found = [_highest(mechanism, point, a, effort_limit, ranges, speeds) for a in amplitude]
    return FeasibleCurve(
        point=point,
        amplitude=amplitude,
        frequency_hz=np.array([f for f, _ in found]),
        reason=tuple(reason for _, reason in found),
    )


def _highest(mechanism: Mechanism, point: OperatingPoint, a: float, effort_limit, ranges, speeds):
    """Return the highest frequency [Hz] of an amplitude, and the reason."""
    # The error of an extreme between two phases is of second order in their distance.
    phase = np.linspace(0.0, np.pi, 181)
    path = np.tile(point.state[: mechanism.dof], (len(phase), 1))
    path[:, 0] += a * np.cos(phase)
    try:
        poses = follow(mechanism, path, point.pose)
    except AssemblyError:
        return 0.0, "the loop does not close"
    out = np.flatnonzero(np.any((poses < ranges[:, 0]) | (poses > ranges[:, 1]), axis=0))
    if out.size:
        return 0.0, f"range of {mechanism.joints[out[0]].name}"

    def broken(frequency: float) -> str | None:
        omega = 2 * np.pi * frequency
        v, acceleration = np.zeros_like(path), np.zeros_like(path)
        v[:, 0], acceleration[:, 0] = -a * omega * np.sin(phase), -a * omega**2 * np.cos(phase)
        # The second half of the cycle has the poses of the first half with opposite velocities.
        for sign in (1.0, -1.0):
            rates = joint_rates(mechanism, poses, sign * v)
            fast = np.flatnonzero(np.any((rates < speeds[:, 0]) | (rates > speeds[:, 1]), axis=0))
            if fast.size:
                return f"speed of {mechanism.joints[fast[0]].name}"
            effort, _ = needed_effort(mechanism, poses, sign * v, acceleration, limit=effort_limit)
            past = np.flatnonzero(np.any((effort < effort_limit[:, 0]) | (effort > effort_limit[:, 1]), axis=0))
            if past.size:
                return f"effort of {mechanism.actuators[past[0]].name}"
        return None

    grid = np.geomspace(1e-3, 1e7, 60)  # Hz, wider than the motions of any mechanism
    good = 0.0
    for frequency in grid:
        if (reason := broken(frequency)) is not None:
            return (0.0, reason) if good == 0.0 else last_good(broken, good, frequency, reason, 1e-7)
        good = frequency
    return np.inf, "nothing"


def default_amplitudes(point: OperatingPoint) -> np.ndarray:
    """Return amplitudes (25,) [rad or m] from a hundredth of a degree to the distance to the nearer end of the range."""
    joint = point.mechanism.independent_joints[0]
    at = float(point.state[0])
    widest = min(joint.upper - at, at - joint.lower)
    unit = 1.0 if joint.kind == "hinge" else point.mechanism.extent_m
    widest = widest if np.isfinite(widest) and widest > 0 else np.pi * unit
    return np.geomspace(np.radians(0.01) * unit, widest, 25)


def curve_rows(curve: FeasibleCurve) -> Sequence[dict]:
    """Return the curve as rows for files."""
    joint = curve.point.mechanism.independent_joints[0]
    return [
        {f"amplitude_{joint.unit}": joint.shown(a), "highest_hz": f if np.isfinite(f) else None, "reason": reason}
        for a, f, reason in zip(curve.amplitude, curve.frequency_hz, curve.reason, strict=True)
    ]
