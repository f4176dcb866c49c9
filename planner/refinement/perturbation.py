"""Random perturbations of an initial guess, the same in every run (multistart)."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Perturbation:
    """An offset (n, k) that is added to a motion, in its units, and a factor from 0.5 to 2 on its duration."""

    offset: np.ndarray
    stretch: float


def perturbation(number: int, along: np.ndarray, span: np.ndarray) -> Perturbation:
    """Return a perturbation: three half waves of random size, of half the motion's size together, nothing at its ends.

    Every fourth perturbation is larger.

    Args:
        number: which of the perturbations; the seed.
        along: shares (n,) of the motion, from 0 to 1.
        span: the motion's size (k,) in each coordinate.
    """
    rng, wave = np.random.default_rng(number), np.arange(1, 4)
    shape = np.sin(np.pi * np.outer(along, wave)) @ (rng.uniform(-1.0, 1.0, (len(wave), len(span))) / wave[:, None])
    return Perturbation(offset=0.5 * (1 + number // 4) * shape * span, stretch=float(2.0 ** rng.uniform(-1.0, 1.0)))
