"""Units in which a program's unknowns are of order one."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scales:
    """Units in which the unknowns are of order one.

    `time_s` [s], `position` (n_s,) [rad or m], `effort` (n_u,) and `residual` (n_s,), of generalised efforts, [N.m or N],
    `length_m` of the closure [m].
    """

    time_s: float
    position: np.ndarray
    effort: np.ndarray
    residual: np.ndarray
    length_m: float

    @property
    def power(self) -> float:
        """The unit of power [W]."""
        return float((self.residual * self.position).max()) / self.time_s

    @property
    def force(self) -> float:
        """The unit of closure forces [N]."""
        return float(self.residual.max()) / self.length_m

    def vector(self) -> np.ndarray:
        """Return the scales as parameters of a node."""
        units = [self.length_m, self.power, self.force]
        return np.concatenate([[self.time_s], self.position, self.effort, self.residual, units])
