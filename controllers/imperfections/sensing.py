"""The sensors of many simulations at once: from true to measured states. Written for speed.

Every row is computed independently, so that a simulation's measurements do not depend on the others, to the last bit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.imperfections.imperfections import Sensors, stacked

# Control instants for which noise is drawn at a time.
_NOISE_BLOCK_INSTANTS = 256


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SensorState:
    """Sensors of simulations (n,) with their state: arrays (n, n_s), `filtered` and `pole` (n, 1).

    `filtered` marks velocities that are differences of measured positions; `pole` belongs to their filter, and is 0 without
    a filter. `before` is the last measured position and `estimate` the last filtered velocity. `generators` make the noise;
    `drawn` (n, t, 2 n_s) holds its present block, with t = 0 without noise. `measure` changes `before`, `estimate` and
    `drawn`.
    """

    period_s: float
    resolution: np.ndarray
    offset: np.ndarray
    noise: np.ndarray  # (n, 2 n_s), of position and velocity
    filtered: np.ndarray
    pole: np.ndarray
    generators: tuple[np.random.Generator | None, ...]
    perfect: bool
    drawn: np.ndarray
    before: np.ndarray
    estimate: np.ndarray


def sensing(sensors: Sequence[Sensors], position: np.ndarray, velocity: np.ndarray, period_s: float) -> SensorState:
    """Return the sensors of simulations that start at positions and velocities (n, n_s), read every period [s]."""
    n, n_s = position.shape

    def of_all(name: str) -> np.ndarray:
        return stacked([getattr(one, name) for one in sensors], n_s)

    noise = np.concatenate([of_all("noise"), of_all("velocity_noise")], axis=1)
    filters = [one.velocity_filter_hz for one in sensors]
    poles = [0.0 if f is None else float(np.exp(-2 * np.pi * f * period_s)) for f in filters]
    filtered = np.array([[one.differentiates] for one in sensors])
    resolution, offset, noisy = of_all("resolution"), of_all("offset"), bool(np.any(noise))
    return SensorState(
        period_s=period_s,
        resolution=resolution,
        offset=offset,
        noise=noise,
        filtered=filtered,
        pole=np.array(poles)[:, None],
        generators=tuple(
            np.random.default_rng(np.random.SeedSequence(one.noise_seed)) if noisy else None for one in sensors
        ),
        perfect=not (np.any(resolution) or np.any(offset) or np.any(noise) or np.any(filtered)),
        drawn=np.empty((n, _NOISE_BLOCK_INSTANTS if noisy else 0, 2 * n_s)),
        # The measurement one period before the start.
        before=_rounded(position - period_s * velocity + offset, resolution),
        estimate=np.array(velocity, dtype=float),
    )


def measure(sensing: SensorState, k: int, position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the measured positions and velocities (n, n_s) at instant k."""
    if sensing.perfect:
        return position, velocity
    n_s, drawn = position.shape[1], sensing.drawn
    read, rate = position + sensing.offset, velocity
    if drawn.shape[1]:
        if k % _NOISE_BLOCK_INSTANTS == 0:
            for block, generator in zip(drawn, sensing.generators, strict=True):
                generator.standard_normal(out=block)
        noise = sensing.noise * drawn[:, k % _NOISE_BLOCK_INSTANTS]
        read, rate = read + noise[:, :n_s], rate + noise[:, n_s:]
    read = _rounded(read, sensing.resolution)
    difference = (read - sensing.before) / sensing.period_s
    estimate = sensing.pole * sensing.estimate + (1.0 - sensing.pole) * difference
    sensing.before[:], sensing.estimate[:] = read, estimate
    return read, np.where(sensing.filtered, estimate, rate)


def _rounded(value: np.ndarray, resolution: np.ndarray) -> np.ndarray:
    """Return values rounded to a resolution; a zero resolution does not round."""
    step = np.where(resolution > 0, resolution, 1.0)
    return np.where(resolution > 0, step * np.round(value / step), value)
