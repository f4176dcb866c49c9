"""The imperfections of one machine: small frozen values, each neutral by default, in SI units.

All of them belong to the plant and the loop around it. The tracker is never told.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

# A value for all joints (or actuators) at once, or one for each.
Each = float | np.ndarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Clock:
    """The controller's clock: instant k comes at (k + phase) T factor, and the tracker takes it for k T.

    `delay_periods` of computing pass before a command acts, fractions too, beside the loop's own whole periods.
    """

    period_factor: float = 1.0
    phase_periods: float = 0.0
    delay_periods: float = 0.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Sensors:
    """Encoders on the independent joints: resolution, offset and noise (standard deviations) [rad or m, and per second].

    With `velocity_filter_hz` the velocity is the measured position's difference over a period, low-pass filtered to the
    first order; otherwise it is measured as it is. `noise_seed` makes the noise, whatever else is simulated beside it.
    """

    resolution: Each = 0.0
    offset: Each = 0.0
    noise: Each = 0.0
    velocity_noise: Each = 0.0
    velocity_filter_hz: float | None = None
    noise_seed: tuple[int, ...] = (0,)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Drives:
    """The actuators: steps of the command [N.m or N], torque constant as a factor, first-order bandwidth [Hz], rate limit.

    A command is rounded to the resolution, cut at its limit, delayed, lagged, limited in rate [N.m/s or N/s], and then the
    factor makes of it what acts: a limit is one of the current.
    """

    resolution: Each = 0.0
    constant_factor: Each = 1.0
    bandwidth_hz: Each = np.inf
    rate_limit: Each = np.inf


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Machine:
    """What is built otherwise than modelled.

    `viscous` [N.m.s/rad or N.s/m] and `coulomb` [N.m or N] friction (n_q,) are added at every joint. `mass_factor`
    multiplies the payload's mass and inertia (all moving bodies' without one); `com_shift_m` (3,) moves the payload's centre
    of mass in its body's frame. `length_factor` scales links by body: all points fixed to it, about its own joint.
    `loop_solref` holds the loop constraints' time constant [s] and damping ratio, in place of the model's.
    """

    viscous: Each = 0.0
    coulomb: Each = 0.0
    mass_factor: float = 1.0
    com_shift_m: np.ndarray | None = None
    length_factor: Mapping[str, float] = field(default_factory=dict)
    loop_solref: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Push:
    """A force (3,) [N] on a body's centre of mass in world axes, or an effort [N.m or N] on a joint, for some time [s]."""

    start_s: float
    duration_s: float
    body: str | None = None
    force: np.ndarray | None = None
    joint: str | None = None
    effort: float = 0.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Start:
    """The machine's start beside the reference's: position and velocity errors of the independent joints."""

    position_error: Each = 0.0
    velocity_error: Each = 0.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Imperfections:
    """All imperfections of one simulated machine; `Imperfections()` has none."""

    clock: Clock = Clock()
    sensors: Sensors = Sensors()
    drives: Drives = Drives()
    machine: Machine = Machine()
    start: Start = Start()
    pushes: tuple[Push, ...] = ()
