"""Mechanisms with closed poses, speeds, accelerations and efforts to go with them: random four-bars, and named chains."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import close_at
from tests.support.mechanisms import CHAINS, Simulated, random_four_bar, random_quaternion, simulated

# Poses of each, and the names of the random ones.
N_POSES = 5
FOUR_BARS = tuple(f"four-bar {seed}" for seed in range(8))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Case:
    """A mechanism with closed poses q (n, n_q), and speeds v, accelerations a and efforts u to go with them."""

    mechanism: Mechanism
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray

    def samples(self):
        """Return (q, v, a, u) pose by pose."""
        return zip(self.q, self.v, self.a, self.u, strict=True)

    def simulated(self, k: int, impedance: float = 0.9999) -> Simulated:
        """Return MuJoCo's quantities at a pose, its constraints of an impedance."""
        rates = joint_rates(self.mechanism, self.q, self.v)
        return simulated(self.mechanism.model, self.q[k], rates[k], self.u[k], impedance=impedance)

    def limit(self, k: int, quantity: str) -> np.ndarray:
        """Return MuJoCo's quantity for a constraint of no softness, extrapolated from two small softnesses."""
        impedance = np.array([0.999, 0.9999])
        soft = (1 - impedance) / impedance
        first, second = (getattr(self.simulated(k, d), quantity) for d in impedance)
        return (soft[0] * second - soft[1] * first) / (soft[0] - soft[1])


@cache
def case(name: str) -> Case:
    """Return one of them, made once."""
    if name in CHAINS:
        rng = np.random.default_rng(3)
        mechanism = load_mechanism(CHAINS[name])
        centre = mechanism.home[mechanism.independent]
        s = centre + rng.uniform(-0.4, 0.4, (N_POSES, mechanism.dof))
        q = np.array([close_at(mechanism, x) for x in s])
    else:
        seed = int(name.split()[1])
        rng = np.random.default_rng(seed)
        bar = random_four_bar(rng)
        motors = ("O",) if seed % 4 else ("O", "C", "O")
        text = bar.mjcf(rng, quaternion=random_quaternion(rng), anchor_form=seed % 2 == 1, motors=motors)
        mechanism = load_mechanism(text)
        q = bar.samples(rng, N_POSES)
    shape = (N_POSES, mechanism.dof)
    return Case(
        mechanism=mechanism,
        q=q,
        v=rng.normal(size=shape),
        a=rng.normal(size=shape),
        u=rng.uniform(-1, 1, (N_POSES, mechanism.n_u)),
    )
