"""What limits permit at a pose and speeds: the efforts of actuators, and quantities that are affine in a motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class EffortBounds:
    """The efforts of all actuators that the limits of one kind permit.

    Args:
        at: gives the least and the largest effort (..., n_u) at actuator speeds and lengths (..., n_u).
        strength: the largest effort (n_u,) at any speed, infinite without one.
        no_load_speed: gives the largest actuator speeds (..., n_u) with an effort, at lengths (..., n_u); None without one.
        constant: whether the bounds depend neither on speeds nor on lengths.
        of_length: whether they depend on lengths.
        crosses_zero: whether a bound may pass through zero, so that errors are not shares of the bound but of the strength.
    """

    at: Callable[[Any, Any], tuple[np.ndarray, np.ndarray]]
    strength: np.ndarray
    no_load_speed: Callable[[Any], np.ndarray] | None = None
    constant: bool = False
    of_length: bool = False
    crosses_zero: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Affine:
    """A limited quantity that is affine in the acceleration and the effort at a pose and speeds: one value, or a vector.

    `value` gives it (n, n_rows) from q (n, n_q), v and a (n, n_s), u (n, n_u). One value is within the `bounds` [low, high];
    the size of a vector is at most the second one. If it is `of_speed`, it is proportional to the speeds alone. `force_of`
    is the pin or closure whose force [N] it is.
    """

    value: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    bounds: Sequence[float] | np.ndarray
    of_speed: bool = False
    force_of: str = ""
