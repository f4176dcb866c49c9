"""Random perturbations of an initial guess, the same in every run (multistart)."""

from dataclasses import dataclass

import numpy as np

# A perturbation is a sum of so many half waves, of this share of the motion's size. Every fourth perturbation is larger.
N_HALF_WAVES = 3
PERTURBATION_SHARE = 0.5
LARGE_EVERY_NTH = 4


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Perturbation:
    """An offset (n, k) that is added to a motion, in its units, and a factor from 0.5 to 2 on its duration."""

    offset: np.ndarray
    stretch: float


def perturbation(number: int, along: np.ndarray, span: np.ndarray) -> Perturbation:
    """Return a perturbation: half waves of random size, nothing at the motion's ends.

    Args:
        number: which of the perturbations; the seed.
        along: shares (n,) of the motion, from 0 to 1.
        span: the motion's size (k,) in each coordinate.
    """
    rng, wave = np.random.default_rng(number), 1 + np.arange(N_HALF_WAVES)
    shape = np.sin(np.pi * np.outer(along, wave)) @ (rng.uniform(-1.0, 1.0, (N_HALF_WAVES, len(span))) / wave[:, None])
    return Perturbation(
        offset=PERTURBATION_SHARE * (1 + number // LARGE_EVERY_NTH) * shape * span,
        stretch=float(2.0 ** rng.uniform(-1.0, 1.0)),
    )
