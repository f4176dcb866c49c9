"""Trackers: pure laws from a control instant and the measured state to efforts.

The feedback loop calls every tracker through `steps_of`. There are two kinds:

* `Tracker`: `effort(k, position_rad, velocity_rad_s)` for one state. With the class attribute `batched = True`, `effort`
  also accepts leading batch axes: position and velocity (..., n_s) -> efforts (..., n_u). Otherwise states are passed one
  by one.
* `TrackerWithMemory`: `start(n)` and `step(k, position_rad, velocity_rad_s, memory)`, always for a batch of n states. The
  feedback loop stores the memory. The law receives it, returns the next memory and stores nothing itself.

Positions of slides are in m, their velocities in m/s.

The efforts of one state must not depend on the other states of its batch, to the last bit. `ordered_product` ensures this
for products.

`StateFeedback` is the linear law. Feedforward adds the efforts of the reference motion.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, cast

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.models.mechanism import Mechanism


def ordered_product(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return M x (..., p) of M (..., p, m) and x (..., m), summed over m from the first column to the last.

    BLAS chooses its kernels, and so the order of summation, by the size of the batch, which changes the last bit.
    """
    total = matrix[..., 0] * vector[..., :1]
    for j in range(1, vector.shape[-1]):
        total = total + matrix[..., j] * vector[..., j : j + 1]
    return total


def added(terms: np.ndarray) -> np.ndarray:
    """Return the sums (...,) of terms (..., m) in order from the first to the last."""
    total = terms[..., 0]
    for j in range(1, terms.shape[-1]):
        total = total + terms[..., j]
    return total


class Tracker(Protocol):
    """A law u = f(k, s, v) without history, filter, saturation or delay, which belong to the feedback loop.

    Example::

        class Stiff:
            name = "stiff"

            def __init__(self, reference):
                self.reference = reference

            def effort(self, k, position_rad, velocity_rad_s):
                error = self.reference.position_rad[k] - position_rad
                rate = self.reference.velocity_rad_s[k] - velocity_rad_s
                return 200.0 * error + rate + self.reference.effort[k]

        print(linkplan.track(linkplan.plan("knee-reach"), Stiff))
    """

    @property
    def name(self) -> str:
        """The name in tables and files."""
        ...

    def effort(self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray) -> np.ndarray:
        """Return efforts (n_u,) [N.m or N] at instant k for measured s [rad or m] and v [rad/s or m/s], both (n_s,)."""
        ...


class TrackerWithMemory(Protocol):
    """A law (u_k, m_k+1) = f(k, s, v, m_k) over a batch of states; the feedback loop stores the memory m."""

    @property
    def name(self) -> str:
        """The name in tables and files."""
        ...

    def start(self, n: int) -> np.ndarray:
        """Return the memory (n, n_m) before the first control instant of n simulations."""
        ...

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] at instant k for measured s and v (n, n_s), and the next memory (n, n_m)."""
        ...


AnyTracker = Tracker | TrackerWithMemory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Errors:
    """Errors and efforts of unit cost in a regulator.

    Position and velocity errors [rad or m, and per second] are one value for all joints or (n_s,). Efforts (n_u,) [N.m or N]
    are usually the effort limits.
    """

    position: float | np.ndarray
    velocity: float | np.ndarray
    effort: np.ndarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Design:
    """What a built-in tracker is built from.

    Args:
        mechanism: the nominal one.
        reference: its sampled motion.
        settings: the keys of [tracking], a `linkplan.planner.problem.settings.Tracking`.
        errors: returns the errors and efforts of unit cost.
        effort_limit: of the actuators (n_u, 2) [N.m or N].
        compile_mode: whether functions are compiled, as `solver.compile`.
    """

    mechanism: Mechanism
    reference: SampledReference
    settings: Any
    errors: Callable[[], Errors]
    effort_limit: np.ndarray
    compile_mode: str = "auto"

    @property
    def of_errors(self) -> tuple[float, float]:
        """The natural frequency [rad/s] and the damping ratio of the errors."""
        return 2 * np.pi * self.settings.bandwidth_hz, self.settings.damping_ratio


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class StateFeedback:
    """u = u_ff[k] + K[k] (x_ref[k] - x), x = (s, v): PD, gain-scheduled PD and LQR.

    `gains` K (n, n_u, 2 n_s). If `feedforward` is True, u_ff is the reference's effort; otherwise it is zero.
    """

    reference: SampledReference
    gains: np.ndarray
    name: str
    feedforward: bool = False
    batched: ClassVar[bool] = True

    def effort(self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray) -> np.ndarray:
        """Return efforts (..., n_u) [N.m or N] for states (..., n_s)."""
        reference, gains, n_s = self.reference, self.gains[k], position_rad.shape[-1]
        on_position = ordered_product(gains[:, :n_s], reference.position_rad[k] - position_rad)
        effort = on_position + ordered_product(gains[:, n_s:], reference.velocity_rad_s[k] - velocity_rad_s)
        return reference.effort[k] + effort if self.feedforward else effort


def with_feedforward(law: StateFeedback) -> StateFeedback:
    """Return a law with the reference's efforts added, and "+ff" added to its name."""
    return replace(law, name=f"{law.name}+ff", feedforward=True)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Memoryless:
    """A `Tracker` as a `TrackerWithMemory` with an empty memory (n, 0)."""

    law: Tracker
    batched: bool

    @property
    def name(self) -> str:
        """The law's name."""
        return self.law.name

    def start(self, n: int) -> np.ndarray:
        """Return the empty memory (n, 0)."""
        return np.empty((n, 0))

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N], for all states at once or, if the law is not batched, one by one."""
        if len(position_rad) == 1:  # a small law takes half the time without the batch axis
            return np.asarray(self.law.effort(k, position_rad[0], velocity_rad_s[0]), dtype=float)[None], memory
        if self.batched:
            return self.law.effort(k, position_rad, velocity_rad_s), memory
        each = [self.law.effort(k, s, v) for s, v in zip(position_rad, velocity_rad_s, strict=True)]
        return np.array(each, dtype=float), memory


def steps_of(tracker: AnyTracker) -> TrackerWithMemory:
    """Return a tracker as a `TrackerWithMemory`."""
    if callable(getattr(tracker, "step", None)) and callable(getattr(tracker, "start", None)):
        return cast(TrackerWithMemory, tracker)
    return Memoryless(law=cast(Tracker, tracker), batched=bool(getattr(tracker, "batched", False)))
