"""Four-bars as texts and as loaded mechanisms, each loaded once."""

from functools import cache

import numpy as np

from linkplan.models.mechanism import Mechanism, load_mechanism
from tests.support.mechanisms import CRANK_ROCKER, FourBar, random_four_bar, random_quaternion, replaced

# One four-bar as text, and with a range on its crank.
PLAIN = CRANK_ROCKER.mjcf(np.random.default_rng(0))
RANGED = replaced(PLAIN, '<joint name="O"', '<joint name="O" limited="true" range="-1 2"')


@cache
def load(bar: FourBar, seed: int = 0, aslant: bool = False) -> Mechanism:
    """Return a four-bar's mechanism, of masses by the seed, in the plane or aslant."""
    rng = np.random.default_rng(seed)
    return load_mechanism(bar.mjcf(rng, quaternion=random_quaternion(rng) if aslant else None))


@cache
def random_bars(n: int = 6) -> tuple[FourBar, ...]:
    """Return the first n random four-bars."""
    return tuple(random_four_bar(np.random.default_rng(seed)) for seed in range(n))
