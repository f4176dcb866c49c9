"""Random perturbations of an initial guess, the same in every run (multistart)."""

import numpy as np


def perturbation(number: int, along: np.ndarray, span: np.ndarray) -> tuple[np.ndarray, float]:
    """Return an offset (n, k) to add to a motion, in its units, and a factor from 0.5 to 2 on its duration.

    The offset is a sum of three half waves of random size, together half the motion's size, and zero at the motion's ends.
    Every fourth perturbation is larger.

    Args:
        number: of the perturbation; the seed.
        along: shares (n,) of the motion, from 0 to 1.
        span: the motion's size (k,) in each coordinate.
    """
    rng, wave = np.random.default_rng(number), np.arange(1, 4)
    shape = np.sin(np.pi * np.outer(along, wave)) @ (rng.uniform(-1.0, 1.0, (len(wave), len(span))) / wave[:, None])
    return 0.5 * (1 + number // 4) * shape * span, float(2.0 ** rng.uniform(-1.0, 1.0))
