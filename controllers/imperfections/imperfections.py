"""The imperfections of one machine, frozen values in SI units that are neutral by default, and their keys in files.

All of them belong to the plant and to the feedback loop. The tracker does not use them.

Settings of many machines are one array, because broadcasting each one takes longer than a control period.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from linkplan.models.mechanism import Mechanism

# One value for all joints (or actuators), or an array with one for each.
Each = float | np.ndarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Clock:
    """The controller's clock: instant k is at time (k + phase) T factor, while the tracker assumes k T.

    `delay_periods` (may be a fraction) adds to the loop's own whole periods of delay.
    """

    period_factor: float = 1.0
    phase_periods: float = 0.0
    delay_periods: float = 0.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Sensors:
    """Encoders on the independent joints: resolution, offset and noise (standard deviations) [rad or m, and per second].

    The velocity is the difference quotient of the measured position, with a first-order low-pass filter at
    `velocity_filter_hz`. Without that frequency it is the plain quotient if positions are rounded, and measured directly if
    they are not, or if `velocity_noise` describes a sensor of its own. The noise depends on `noise_seed` only.
    """

    resolution: Each = 0.0
    offset: Each = 0.0
    noise: Each = 0.0
    velocity_noise: Each = 0.0
    velocity_filter_hz: float | None = None
    noise_seed: tuple[int, ...] = (0,)

    @property
    def differentiates(self) -> bool:
        """Whether velocities are difference quotients of measured positions."""
        return self.velocity_filter_hz is not None or (bool(np.any(self.resolution)) and not np.any(self.velocity_noise))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Drives:
    """The actuators: command resolution [N.m or N], torque constant factor, first-order bandwidth [Hz], rate limit.

    A command is rounded to the resolution, clipped to its limit, delayed, low-pass filtered, limited in rate [N.m/s or N/s]
    and finally multiplied by the factor. The effort limit is therefore a limit of the current.
    """

    resolution: Each = 0.0
    constant_factor: Each = 1.0
    bandwidth_hz: Each = np.inf
    rate_limit: Each = np.inf


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Machine:
    """The differences between the machine and its model.

    `parameters` are values [SI] of numbers of the model by name (`models.parameters`); the other differences apply to these.
    `viscous` [N.m.s/rad or N.s/m] and `coulomb` [N.m or N] friction (n_q,) are added at every joint. `mass_factor`
    multiplies the payload's mass and inertia, or those of all moving bodies without a payload. `com_shift_m` (3,) moves the
    payload's centre of mass in its body's frame. `length_factor` scales the points fixed to a body about the body's joint.
    `loop_solref` replaces the time constant [s] and damping ratio of the loop constraints.
    """

    parameters: Mapping[str, float] = field(default_factory=dict)
    viscous: Each = 0.0
    coulomb: Each = 0.0
    mass_factor: float = 1.0
    com_shift_m: np.ndarray | None = None
    length_factor: Mapping[str, float] = field(default_factory=dict)
    loop_solref: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Push:
    """A force (3,) [N] on a body's centre of mass in world axes, or an effort [N.m or N] on a joint, during a time [s]."""

    start_s: float
    duration_s: float
    body: str | None = None
    force: np.ndarray | None = None
    joint: str | None = None
    effort: float = 0.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Start:
    """The errors of initial position and velocity of the independent joints."""

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


def imperfections_from(
    given: Mapping[str, Mapping[str, float]],
    mechanism: Mechanism,
    noise_seed: tuple[int, ...],
    push_body: str | None = None,
    push_joint: str | None = None,
) -> Imperfections:
    """Return the imperfections with values in a problem file's units.

    Args:
        given: the values by key of [imperfections], and by joint, actuator or body ("" for the whole machine).
        mechanism: the mechanism.
        noise_seed: of the sensors' noise.
        push_body: what a push's force acts on.
        push_joint: what its effort acts on.
    """
    one = {key: found[""] for key, found in given.items() if "" in found}
    independent = [joint.name for joint in mechanism.independent_joints]
    joints = [joint.name for joint in mechanism.joints]
    actuators = [actuator.name for actuator in mechanism.actuators]

    def each(names: list[str], key: str, neutral: float) -> np.ndarray:
        return np.array([given.get(key, {}).get(name, neutral) for name in names])

    def coordinates(stem: str, angle: str = "_deg", length: str = "_m") -> np.ndarray:
        return np.radians(each(independent, stem + angle, 0.0)) + each(independent, stem + length, 0.0)

    machine = Machine(
        parameters=given.get("parameters", {}),
        viscous=each(joints, "viscous_friction", 0.0),
        coulomb=each(joints, "coulomb_friction", 0.0),
        mass_factor=one.get("payload_mass_factor", 1.0),
        com_shift_m=_vector(one, "payload_com_{}_m"),
        length_factor=given.get("link_length_factor", {}),
        loop_solref=_solref(one, mechanism),
    )
    return Imperfections(
        clock=Clock(
            period_factor=one.get("period_factor", 1.0),
            phase_periods=one.get("phase_periods", 0.0),
            delay_periods=one.get("delay_periods", 0.0),
        ),
        sensors=Sensors(
            resolution=coordinates("encoder_resolution"),
            offset=coordinates("encoder_offset"),
            noise=coordinates("position_noise"),
            velocity_noise=coordinates("velocity_noise", "_deg_s", "_m_s"),
            velocity_filter_hz=one.get("velocity_filter_hz"),
            noise_seed=noise_seed,
        ),
        drives=Drives(
            resolution=each(actuators, "torque_resolution", 0.0),
            constant_factor=each(actuators, "torque_constant_factor", 1.0),
            bandwidth_hz=each(actuators, "torque_bandwidth_hz", np.inf),
            rate_limit=each(actuators, "torque_rate", np.inf),
        ),
        machine=machine,
        start=Start(
            position_error=coordinates("start_error"),
            velocity_error=coordinates("start_velocity_error", "_deg_s", "_m_s"),
        ),
        pushes=_pushes(one, push_body, push_joint),
    )


def _vector(one: Mapping[str, float], key: str) -> np.ndarray | None:
    names = [key.format(axis) for axis in "xyz"]
    return np.array([one.get(name, 0.0) for name in names]) if any(name in one for name in names) else None


def _solref(one: Mapping[str, float], mechanism: Mechanism) -> tuple[float, float] | None:
    names = ("loop_time_constant_s", "loop_damping_ratio")
    if not any(name in one for name in names) or not mechanism.model.neq:
        return None
    own = mechanism.model.eq_solref[0]
    return one.get(names[0], float(own[0])), one.get(names[1], float(own[1]))


def _pushes(one: Mapping[str, float], body: str | None, joint: str | None) -> tuple[Push, ...]:
    start, duration = one.get("push_start_s", 0.0), one.get("push_duration_s", 0.0)
    pushes = []
    if body is not None:
        force = _vector(one, "push_force_{}_n")
        pushes.append(Push(start_s=start, duration_s=duration, body=body, force=force))
    if joint is not None:
        effort = one.get("push_effort", 0.0)
        pushes.append(Push(start_s=start, duration_s=duration, joint=joint, effort=effort))
    return tuple(pushes)


def stacked(values: Sequence, width: int) -> np.ndarray:
    """Return numbers or rows (width,) of n machines as an array (n, width)."""
    return np.array([np.broadcast_to(value, (width,)) for value in values], dtype=float)
