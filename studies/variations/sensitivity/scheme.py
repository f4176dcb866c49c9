"""Designs of trials for a sensitivity analysis: one at a time, Morris' trajectories, and Sobol's matrices.

The trials form groups that are evaluated together: one draw of the noise, one trajectory, or one pair of independent points.
Noise, if there is any, is the last factor. Within a group, the noise changes only in its own step, so the change in another
factor's step is not due to noise.
"""

from dataclasses import dataclass
from importlib import metadata
from types import ModuleType

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.extras import load_extra

ONE_AT_A_TIME, MORRIS, SOBOL = SENSITIVE = ("one-at-a-time", "morris", "sobol")
# Levels of Morris' grid; a step is two thirds of the range (Saltelli et al., Global Sensitivity Analysis, 2008, 3.2).
MORRIS_LEVELS = 4
# Fewest groups for an estimate of the spread.
_MIN_GROUPS = {ONE_AT_A_TIME: 2, MORRIS: 4, SOBOL: 16}


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SamplingScheme:
    """Trials of factors: `points` (n, d) in [0, 1] and numbers of noise draws (n,), in `n_groups` groups of equal size.

    With `noisy`, the noise is a factor in addition to the d factors of the points. A coordinate of a point is the share of
    the factor's range from the low to the high end; in Sobol's design it is the cumulative probability.
    """

    design: str
    points: np.ndarray
    draws: np.ndarray
    n_groups: int
    noisy: bool

    @property
    def n_factors(self) -> int:
        """The number of factors including the noise."""
        return self.points.shape[1] + self.noisy

    @property
    def size(self) -> int:
        """The number of trials in a group."""
        return len(self.points) // self.n_groups

    @property
    def independent(self) -> np.ndarray:
        """A mask (n,) of independent trials.

        In Sobol's design they are both points of a pair. In the others they are the first trial of each group.
        """
        place = np.arange(len(self.points)) % self.size
        return (place == 0) | (place == self.size - 1) if self.design == SOBOL else place == 0


def scheme_of(design: str, n_factors: int, noisy: bool, samples: int, seed: int) -> SamplingScheme:
    """Return the scheme of a design with as many whole groups as fit into a number of samples.

    One at a time without noise always has one group: the middle and both ends of each factor. The number of groups of
    Sobol's design is a power of two, for which its sequence is balanced.

    Raises:
        ProblemError: if there is no factor, or too few samples for enough groups.
        LinkplanError: if SALib is needed and not installed.
    """
    if n_factors + noisy == 0:
        raise ProblemError(f"the design '{design}' needs an imperfection with a range, and there is none")
    d = n_factors + noisy
    size = {ONE_AT_A_TIME: 2 * n_factors + 1, MORRIS: d + 1, SOBOL: d + 2}[design]
    groups = samples // size
    if design == ONE_AT_A_TIME and not noisy:
        groups = 1
    elif groups < (least := _MIN_GROUPS[design]):
        raise ProblemError(
            f"the design '{design}' of {d} imperfections needs at least {least * size} samples, {least} groups of {size};"
            f" got {samples}"
        )
    if design == SOBOL:
        groups = 1 << (groups.bit_length() - 1)
    cube = _cube(design, d, groups, seed, noisy)
    points, draws = cube, np.zeros(len(cube), dtype=int)
    if noisy:
        points = cube[:, :-1]
        # Each group has its own draws: a level of noise has no meaning outside its group.
        pairs = np.column_stack([np.arange(len(cube)) // size, cube[:, -1]])
        draws = np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1)
    return SamplingScheme(design=design, points=points, draws=draws, n_groups=groups, noisy=noisy)


def _cube(design: str, d: int, groups: int, seed: int, noisy: bool) -> np.ndarray:
    """Return the trials (n, d) of whole groups.

    One at a time: the middle, then each factor at its low and at its high end. Morris: a trajectory of d steps, each of one
    factor by two thirds of its range (Technometrics 33, 1991). Sobol: A, A with one column of B in turn, B (Saltelli et al.,
    Computer Physics Communications 181, 2010).
    """
    if design == ONE_AT_A_TIME:
        factors = d - noisy
        group = np.full((2 * factors + 1, d), 0.5)
        for i in range(factors):
            group[1 + 2 * i, i], group[2 + 2 * i, i] = 0.0, 1.0
        return np.tile(group, (groups, 1))
    generator = np.random.default_rng(seed)
    if design == MORRIS:
        return salib("sample.morris").sample(unit_cube(d), groups, num_levels=MORRIS_LEVELS, seed=generator)
    return salib("sample.sobol").sample(unit_cube(d), groups, calc_second_order=False, seed=generator)


def salib(name: str) -> ModuleType:
    """Return a module of SALib.

    Raises:
        MissingPackageError: if it is not installed.
    """
    return load_extra(f"SALib.{name}", "Morris' or Sobol's design")


def salib_version() -> str:
    """Return SALib's version, on which the trials depend.

    Raises:
        MissingPackageError: if it is not installed.
    """
    salib("util")
    return metadata.version("SALib")


def unit_cube(d: int) -> dict:
    """Return SALib's description of d factors between 0 and 1."""
    return {"num_vars": d, "names": [str(i) for i in range(d)], "bounds": [[0.0, 1.0]] * d, "groups": None}
