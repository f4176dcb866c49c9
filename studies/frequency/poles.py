"""Settling time and damping ratio of a sampled closed loop, from its poles z = e^(s T).

The settling time is that of the slowest pole, to 2 % of a disturbed state. The damping ratio is -Re s / |s|, the least of
the poles that oscillate below half the Nyquist frequency: faster ones come from hold and delay and last a few periods
(Astrom & Wittenmark, Computer-Controlled Systems, 1997, 2.8).
"""

import numpy as np

# A state has settled at this share of its first error.
SETTLED_SHARE = 0.02


def settling_time_s(poles: np.ndarray, period_s: float) -> np.ndarray:
    """Return the settling times (...,) [s] of loops with poles (..., M) per control period; infinite if unstable."""
    radius = np.abs(poles).max(axis=-1)
    with np.errstate(divide="ignore"):
        time = np.log(SETTLED_SHARE) * period_s / np.log(np.minimum(radius, 1.0))
    return np.where(radius < 1.0, time, np.inf)


def damping_ratio(poles: np.ndarray) -> np.ndarray:
    """Return the least damping ratios (...,) of loops with poles (..., M); 1 without oscillation, at most 0 if unstable."""
    with np.errstate(divide="ignore"):
        logarithm = np.log(np.asarray(poles, dtype=complex))
    with np.errstate(invalid="ignore"):
        ratio = -logarithm.real / np.abs(logarithm)
    slow = np.abs(logarithm.imag) <= 0.5 * np.pi
    return np.where(slow & np.isfinite(ratio), ratio, 1.0).min(axis=-1)
