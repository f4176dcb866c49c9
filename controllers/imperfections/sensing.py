"""The sensors of many simulations at once: from true states to what each tracker is given. This file's job is speed.

Every row is worked out by itself, so that a simulation measures the same to the last bit whatever runs beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.controllers.imperfections.imperfections import Sensors
from linkplan.controllers.imperfections.stacking import stacked

# Noise is drawn for so many control instants at a time.
_BLOCK = 256


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Sensing:
    """Sensors of simulations (n,) and what they remember: arrays (n, n_s), `filtered` and `pole` (n, 1).

    `before` is the position measured last and `estimate` the velocity; `generators` make the noise, `drawn` holds the
    present block of it (n, t, 2 n_s), t = 0 where no sensor is noisy. `measure` fills these three, all else stays.
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

    def kept(self, rows: np.ndarray) -> "Sensing":
        """Return the sensors of some of these simulations, by a mask (n,)."""
        names = ("resolution", "offset", "noise", "filtered", "pole", "drawn", "before", "estimate")
        generators = tuple(g for g, keep in zip(self.generators, rows, strict=True) if keep)
        return replace(self, generators=generators, **{name: getattr(self, name)[rows] for name in names})


def sensing(sensors: Sequence[Sensors], position: np.ndarray, velocity: np.ndarray, period_s: float) -> Sensing:
    """Return the sensors of simulations that start at positions and velocities (n, n_s), read every period [s]."""
    n, n_s = position.shape

    def of_all(name: str) -> np.ndarray:
        return stacked([getattr(one, name) for one in sensors], n_s)

    noise = np.concatenate([of_all("noise"), of_all("velocity_noise")], axis=1)
    filters = [one.velocity_filter_hz for one in sensors]
    poles = [0.0 if f is None else float(np.exp(-2 * np.pi * f * period_s)) for f in filters]
    filtered = np.array([[f is not None] for f in filters])
    resolution, offset, noisy = of_all("resolution"), of_all("offset"), bool(np.any(noise))
    return Sensing(
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
        drawn=np.empty((n, _BLOCK if noisy else 0, 2 * n_s)),
        # As if the sensors had been read one period earlier, on the way to the start.
        before=_rounded(position - period_s * velocity + offset, resolution),
        estimate=np.array(velocity, dtype=float),
    )


def measure(sensing: Sensing, k: int, position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return measured positions and velocities (n, n_s) at instant k for true ones."""
    if sensing.perfect:
        return position, velocity
    n_s, drawn = position.shape[1], sensing.drawn
    read, rate = position + sensing.offset, velocity
    if drawn.shape[1]:
        if k % _BLOCK == 0:
            for block, generator in zip(drawn, sensing.generators, strict=True):
                generator.standard_normal(out=block)
        noise = sensing.noise * drawn[:, k % _BLOCK]
        read, rate = read + noise[:, :n_s], rate + noise[:, n_s:]
    read = _rounded(read, sensing.resolution)
    difference = (read - sensing.before) / sensing.period_s
    estimate = sensing.pole * sensing.estimate + (1.0 - sensing.pole) * difference
    sensing.before[:], sensing.estimate[:] = read, estimate
    return read, np.where(sensing.filtered, estimate, rate)


def _rounded(value: np.ndarray, resolution: np.ndarray) -> np.ndarray:
    """Return values at the nearest steps of a resolution; as they are where it is zero."""
    step = np.where(resolution > 0, resolution, 1.0)
    return np.where(resolution > 0, step * np.round(value / step), value)
