"""Frequency response of a PD loop at a pose: continuous and sampled, from the reduced model.

Plant: the reduced dynamics linearised where the effort holds the pose, x = (s, v), x' = A x + B tau, tau the generalised
effort on the joint. Loop, broken at that effort: L = (kp + kd d/dt) P; sampled with a zero-order hold at the control period
and whole periods of delay, L(z) = [kp kd] (zI - Ad)^-1 Bd z^-delay. Margins are python-control's, on frequency data up to
and including the Nyquist frequency, where a sampled PD loop of small inertia loses its gain margin.
"""

import warnings
from dataclasses import dataclass

import control
import numpy as np

from controllers.lqr import discretise, linearise
from models.along import needed_effort
from models.assembly import close_at
from models.errors import LinkplanError
from models.mechanism import Mechanism

# Points of the grid per decade: margins are interpolated between them to a thousandth of a dB.
_PER_DECADE = 600
_LOWEST_HZ = 0.01
# Crossings in the lowest part of the grid are the double integrator's own -180 deg, reached as the frequency vanishes.
_DC_HZ = 0.02


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Gains:
    """PD gains on the joint [N.m/rad, N.m.s/rad or N/m, N.s/m], control period [s] and delay in whole periods."""

    kp: float
    kd: float
    period_s: float
    delay_periods: int = 0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Margins:
    """What one loop can bear; None where a figure has no meaning (infinite, or the loop is unstable)."""

    stable: bool
    gain_margin_db: float | None
    gain_reduction_margin_db: float | None
    phase_margin_deg: float | None
    delay_margin_s: float | None
    crossover_hz: float | None
    bandwidth_hz: float | None
    sensitivity_peak: float | None
    spectral_radius: float | None  # of the sampled closed loop; below one is stable


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LoopResponse:
    """One loop's frequency response: `frequency_hz` (n,), complex loop gain `open` and `closed`, `sensitivity` (n,)."""

    frequency_hz: np.ndarray
    open: np.ndarray
    closed: np.ndarray
    sensitivity: np.ndarray
    margins: Margins


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PosePoint:
    """The loop at one pose: inertia, the linearised stiffness and damping, the effort that holds it, both responses."""

    pose: np.ndarray
    reduced_inertia: float
    stiffness: float
    damping: float
    holding_effort: np.ndarray
    continuous: LoopResponse
    sampled: LoopResponse


def pose_point(mechanism: Mechanism, position: np.ndarray, gains: Gains) -> PosePoint:
    """Return the loop's responses with the mechanism held at independent positions (1,) [rad or m].

    Raises:
        LinkplanError: for a mechanism with another number of degrees of freedom than one, or without an actuator.
    """
    if mechanism.dof != 1:
        raise LinkplanError(
            f"bode needs a mechanism of one degree of freedom; '{mechanism.name}' has {mechanism.dof}"
            f" ({', '.join(j.name for j in mechanism.independent_joints)})"
        )
    if mechanism.n_u == 0:
        raise LinkplanError(f"bode needs an actuator; '{mechanism.name}' has no motor on a hinge or slide")
    pose = close_at(mechanism, np.atleast_1d(position))
    still = np.zeros((1, 1))
    hold, missed = needed_effort(mechanism, pose[None], still, still)
    joint = mechanism.independent_joints[0]
    if np.abs(missed).max() > 1e-9 * max(1.0, np.abs(hold).max()):
        raise LinkplanError(
            f"no effort holds '{mechanism.name}' at {joint.name} = {joint.shown(pose[mechanism.independent[0]]):g}"
        )
    inertia = float(mechanism.dynamics.reduced_inertia(pose))
    A, _ = linearise(mechanism, pose[None], still, hold)
    B = np.array([[[0.0], [1.0 / inertia]]])  # generalised effort on the joint, whatever the transmission
    return PosePoint(
        pose=pose,
        reduced_inertia=inertia,
        stiffness=-inertia * float(A[0, 1, 0]),
        damping=-inertia * float(A[0, 1, 1]),
        holding_effort=hold[0],
        continuous=_continuous(A[0], B[0], gains),
        sampled=_sampled(A, B, gains),
    )


def frequency_grid(period_s: float) -> np.ndarray:
    """Return frequencies [Hz] from a hundredth of a hertz to the Nyquist frequency, both included."""
    nyquist = 0.5 / period_s
    decades = np.log10(nyquist / _LOWEST_HZ)
    return np.geomspace(_LOWEST_HZ, nyquist, max(200, int(_PER_DECADE * decades)))


def _continuous(A: np.ndarray, B: np.ndarray, gains: Gains) -> LoopResponse:
    loop = control.ss(A, B, np.array([[gains.kp, gains.kd]]), 0)
    stable = bool(np.all(np.real(control.feedback(loop, 1).poles()) < 0))
    return _response(loop, frequency_grid(gains.period_s), stable, None)


def _sampled(A: np.ndarray, B: np.ndarray, gains: Gains) -> LoopResponse:
    Ad, Bd = (matrix[0] for matrix in discretise(A, B, gains.period_s))
    loop = control.ss(Ad, Bd, np.array([[gains.kp, gains.kd]]), 0, gains.period_s)
    d = gains.delay_periods
    if d:
        delay = control.ss(np.eye(d, k=-1), np.eye(d, 1), np.eye(1, d, k=d - 1), 0, gains.period_s)
        loop = control.series(delay, loop)
    radius = float(np.max(np.abs(control.feedback(loop, 1).poles())))
    return _response(loop, frequency_grid(gains.period_s), radius < 1.0, radius)


def _response(loop: control.StateSpace, frequency_hz: np.ndarray, stable: bool, radius: float | None) -> LoopResponse:
    omega = 2 * np.pi * frequency_hz
    if loop.isdtime(strict=True):
        omega[-1] = np.pi / loop.dt
        at = np.exp(1j * omega * loop.dt)
    else:
        at = 1j * omega
    gain = np.asarray(loop(at)).ravel()
    sensitivity = 1.0 / (1.0 + gain)
    closed = gain * sensitivity
    return LoopResponse(
        frequency_hz=frequency_hz,
        open=gain,
        closed=closed,
        sensitivity=sensitivity,
        margins=_margins(gain, closed, sensitivity, omega, stable, radius),
    )


def _margins(gain, closed, sensitivity, omega, stable: bool, radius: float | None) -> Margins:
    if not stable:
        return Margins(
            stable=False,
            gain_margin_db=None,
            gain_reduction_margin_db=None,
            phase_margin_deg=None,
            delay_margin_s=None,
            crossover_hz=None,
            bandwidth_hz=None,
            sensitivity_peak=None,
            spectral_radius=radius,
        )
    data = control.frd(gain, omega)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # division by a vanishing gain at the end of a grid
        gm, pm, _, w_pc, w_gc, _ = (np.atleast_1d(x) for x in control.stability_margins(data, returnall=True))
    gm, w_pc = gm[w_pc > 2 * np.pi * _DC_HZ], w_pc[w_pc > 2 * np.pi * _DC_HZ]
    # At the Nyquist frequency a sampled gain is real: a crossing that lies on the grid's last point and not inside it.
    if radius is not None and gain[-1].real < 0:
        gm = np.append(gm, 1.0 / abs(gain[-1].real))
    raised, lowered = gm[gm > 1], gm[(gm < 1) & (gm > 0)]
    pm_rad = np.mod(np.radians(pm), 2 * np.pi)
    delays = pm_rad / w_gc
    return Margins(
        stable=True,
        gain_margin_db=_finite(20 * np.log10(raised.min())) if raised.size else None,
        gain_reduction_margin_db=_finite(-20 * np.log10(lowered.max())) if lowered.size else None,
        phase_margin_deg=_finite(pm[np.argmin(np.abs(pm))]) if pm.size else None,
        delay_margin_s=_finite(delays.min()) if delays.size else None,
        crossover_hz=_finite(w_gc.max() / (2 * np.pi)) if w_gc.size else None,
        bandwidth_hz=_bandwidth(closed, omega),
        sensitivity_peak=float(np.max(np.abs(sensitivity))),
        spectral_radius=radius,
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _bandwidth(closed: np.ndarray, omega: np.ndarray) -> float | None:
    """Return the first frequency [Hz] at which the closed loop falls 3 dB below its static gain; None if it does not."""
    drop = 20 * np.log10(np.abs(closed) / np.abs(closed[0])) + 3.0
    below = np.flatnonzero(drop < 0)
    if below.size == 0:
        return None
    k = below[0]
    share = drop[k - 1] / (drop[k - 1] - drop[k])
    return float(np.exp((1 - share) * np.log(omega[k - 1]) + share * np.log(omega[k])) / (2 * np.pi))
