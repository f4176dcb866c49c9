"""Bends: motions to start from are perturbed at random, but the same in every run (multistart)."""

from dataclasses import dataclass

import numpy as np

# Half waves over the motion that a perturbation is a sum of, and its size as a share of the motion's; every fourth
# perturbation is larger.
_WAVES = 3
_SIZE = 0.5
_LARGER = 4


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Perturbation:
    """What is added to a motion (n, k), in its own units, and the factor on its duration, from a half to two."""

    offset: np.ndarray
    stretch: float


def perturbation(number: int, along: np.ndarray, span: np.ndarray) -> Perturbation:
    """Return a perturbation: half waves of random size, nothing at the motion's ends.

    Args:
        number: which of the perturbations; the seed.
        along: shares (n,) of the motion, from 0 to 1.
        span: the motion's size (k,) in each coordinate.
    """
    rng, wave = np.random.default_rng(number), 1 + np.arange(_WAVES)
    shape = np.sin(np.pi * np.outer(along, wave)) @ (rng.uniform(-1.0, 1.0, (_WAVES, len(span))) / wave[:, None])
    return Perturbation(offset=_SIZE * (1 + number // _LARGER) * shape * span, stretch=float(2.0 ** rng.uniform(-1.0, 1.0)))
