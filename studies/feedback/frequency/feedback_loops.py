"""Linear models of feedback loops about an operating point: continuous, sampled exactly, and in MuJoCo's own steps.

    command u = u_hold + K (x_ref - x),   x = (s, v),   X = G U

G is the transfer function from commands to the state. Continuous, without hold or delay: G = (j w I - A)^-1 B. Sampled, with
z = e^(j w T): G = (z I - A)^-1 (B z^-d + B_late z^-d-1). The sensitivity is S = (I + K G)^-1. The loop of coordinate i is
broken at the effort on i while the other loops are closed. With efforts tau = E u on the coordinates this loop is
1 / (E S E^-1)_ii - 1 (Skogestad & Postlethwaite, Multivariable Feedback Control, 2005, 3.2). A mechanism of one degree of
freedom has a single loop, broken at its actuator. Passive spins, which move nothing else, have no loop, and their poles are
ignored.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from linkplan.controllers.linearisation import linearise
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.sampling import Sampling, augmented, closed, held_over, sampling, simulated, spectral_radius
from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.controllers.trackers.tracker import Design, Errors
from linkplan.models.actuation.distribution import unit_efforts
from linkplan.models.deadline import check
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.joints import where
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.check.holding import held_pose
from linkplan.studies.compare.lqr_weights import scaled, unit_effort
from linkplan.studies.feedback.frequency.response import Response

if TYPE_CHECKING:
    import control

CONTINUOUS, SIMULATED, EXACT = "continuous", "sampled, MuJoCo's steps", "sampled, exact"
# The unit of each response: {q} is the joint's unit, {u} the effort's.
QUANTITIES = {
    "plant": "{q}/{u}",
    "loop": "1",
    "sensitivity": "1",
    "complementary": "1",
    "control": "{u}/{q}",
    "reference": "1",
    "reference+ff": "1",
}


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OperatingPoint:
    """A closed pose (n_q,) with its velocity (n_s,) and effort `hold` (n_u,): at rest, or an instant of a motion.

    `told` are the independent joints that its name states. `forces` are those over time at its instant, see
    `Mechanism.forces_at`.
    """

    mechanism: Mechanism
    pose: np.ndarray
    velocity: np.ndarray
    hold: np.ndarray
    told: tuple[int, ...]
    forces: tuple[np.ndarray, ...] = ()

    @property
    def state(self) -> np.ndarray:
        """The state x = (s, v) (2 n_s,) [rad or m, rad/s or m/s]."""
        return np.concatenate([self.pose[self.mechanism.independent], self.velocity])

    @property
    def name(self) -> str:
        """The positions of the joints that distinguish it from other points, as text."""
        return self._places(self.told)

    @property
    def shared_coordinates(self) -> str:
        """The positions of the other joints with a feedback loop, the same at all points, as text."""
        return self._places([k for k in self.mechanism.channels if k not in self.told])

    def _places(self, joints: Sequence[int]) -> str:
        return where([self.mechanism.independent_joints[k] for k in joints], self.state[list(joints)])

    @property
    def inertia(self) -> np.ndarray:
        """The reduced inertia (n_s, n_s) [kg m2 or kg]."""
        return np.array(self.mechanism.dynamics.reduced_inertia(self.pose))

    def linearised(self) -> tuple[np.ndarray, np.ndarray]:
        """Return A (2 n_s, 2 n_s) and B (2 n_s, n_u) of x' = A x + B u about the point."""
        A, B = linearise(self.mechanism, *self._states)
        return A[0], B[0]

    @property
    def _states(self) -> tuple[np.ndarray, ...]:
        return self.pose[None], self.velocity[None], self.hold[None], *self.forces

    def sampled(self, timing: Sampling) -> tuple[np.ndarray, ...]:
        """Return A, B and B_late of a period in MuJoCo's own steps about the point."""
        pose, velocity, hold, *forces = self._states
        return tuple(matrix[0] for matrix in simulated(self.mechanism, pose, velocity, hold, timing, *forces))

    def constant(self, period_s: float, n: int = 1) -> SampledReference:
        """Return the point as a reference at rest over n control periods [s]."""
        return SampledReference(
            period_s=period_s,
            time_s=period_s * np.arange(n),
            pose_rad=np.tile(self.pose, (n, 1)),
            position_rad=np.tile(self.state[: self.mechanism.dof], (n, 1)),
            velocity_rad_s=np.tile(self.velocity, (n, 1)),
            effort=np.tile(self.hold, (n, 1)),
            cycle=None,
        )


def label_differences(points: Sequence[OperatingPoint]) -> list[OperatingPoint]:
    """Return the points with names that have only the coordinates in which the points differ."""
    states = np.array([point.state for point in points])
    differ = tuple(k for k in points[0].mechanism.channels if not np.allclose(states[:, k], states[0, k]))
    return [replace(point, told=differ or point.told) for point in points]


def operating_point(mechanism: Mechanism, position: np.ndarray, effort_limit: np.ndarray | None = None) -> OperatingPoint:
    """Return the mechanism held at independent positions (n_s,) [rad or m].

    Raises:
        LinkplanError: if the mechanism has no actuator, if its loops do not close, or if no effort inside the limits
            (n_u, 2) holds the pose.
    """
    pose, hold = held_pose(mechanism, position, effort_limit)
    told = tuple(mechanism.channels)
    return OperatingPoint(mechanism=mechanism, pose=pose, velocity=np.zeros(mechanism.dof), hold=hold, told=told)


def refuse_above_nyquist(frequency_hz: np.ndarray, period_s: float | None) -> None:
    """Refuse frequencies (n,) [Hz] that are not positive, or above the Nyquist frequency of a control period [s].

    Raises:
        LinkplanError: with the highest frequency and the Nyquist frequency.
    """
    if not (frequency_hz.size and np.all(np.isfinite(frequency_hz)) and np.all(frequency_hz > 0)):
        raise LinkplanError("frequencies are positive numbers of hertz")
    highest = float(frequency_hz.max())
    if period_s is not None and highest > 0.5 / period_s * (1 + 1e-9):
        raise LinkplanError(
            f"{highest:.6g} Hz is above the Nyquist frequency, {0.5 / period_s:.6g} Hz at a control period of {period_s:g} s"
        )


def refuse_several_freedoms(mechanism: Mechanism, what: str) -> None:
    """Refuse a mechanism of more than one degree of freedom."""
    if mechanism.dof != 1:
        raise LinkplanError(f"{what} needs a mechanism of one degree of freedom; '{mechanism.name}' has {mechanism.dof}")


def law_gain(point: OperatingPoint, law: str, settings: Tracking, effort_limit: np.ndarray) -> np.ndarray:
    """Return a tracker's gain K (n_u, 2 n_s) when it holds a point.

    Raises:
        LinkplanError: if LQR has no stabilising gain.
    """
    reference = point.constant(settings.period_s)

    def errors() -> Errors:
        position, velocity = settings.lqr_errors(point.mechanism.independent_joints)
        return Errors(position=position, velocity=velocity, effort=unit_effort(effort_limit, np.abs(point.hold)))

    of = Design(mechanism=point.mechanism, reference=reference, settings=settings, errors=errors, effort_limit=effort_limit)
    return BUILT_IN[law].build(of).gains[0]


def with_lqr_errors(
    settings: Tracking, mechanism: Mechanism, points: Sequence[OperatingPoint], limit: np.ndarray
) -> Tracking:
    """Return settings with every LQR error set for a machine that holds points, with effort limits (n_u, 2)."""
    hold = np.max([np.abs(point.hold) for point in points], axis=0)
    return scaled(settings, mechanism, np.array([point.pose for point in points]), unit_effort(limit, hold))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FeedbackLoop:
    """A law with gain K (n_u, 2 n_s) about an operating point: continuous, or sampled exactly or in MuJoCo's steps (`kind`).

    Continuous: x' = A x + B u. Sampled: x_{k+1} = A x_k + B u_{k-d} + B_late u_{k-d-1}.
    """

    point: OperatingPoint
    gain: np.ndarray
    timing: Sampling
    kind: str
    A: np.ndarray
    B: np.ndarray
    B_late: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        """The closed loop's matrix (M, M), without passive spins. A sampled loop's state includes the past commands."""
        return closed(*self.actuated_matrices(), self.gain[:, self.actuated_entries])

    def actuated_matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """Return A (M, M) and B (M, n_u) of the open loop without passive spins."""
        kept = self.actuated_entries
        A, B, late = self.A[kept][:, kept], self.B[kept], self.B_late[kept]
        return (A, B) if self.kind == CONTINUOUS else augmented(A, B, late, self.timing)

    @property
    def actuated_entries(self) -> np.ndarray:
        """The indices of the state's entries that belong to actuated coordinates."""
        return np.flatnonzero(np.tile(self.point.mechanism.actuated, 2))

    @property
    def radius(self) -> float | None:
        """The spectral radius of a sampled closed loop; None for a continuous one."""
        return None if self.kind == CONTINUOUS else float(spectral_radius(self.matrix))

    @property
    def stable(self) -> bool:
        """True if the closed loop is stable."""
        if self.kind == CONTINUOUS:
            return bool(np.all(np.linalg.eigvals(self.matrix).real < 0))
        return self.radius < 1.0

    def system(self, *, closed: bool = False) -> "control.StateSpace":
        """Return the loop as python-control's state space: open, from commands to K x, or closed, from commands to x."""
        import control

        A, B = self.actuated_matrices()
        state = np.eye(len(self.actuated_entries), len(A))
        read = state if closed else self.gain[:, self.actuated_entries] @ state
        period_s = 0 if self.kind == CONTINUOUS else self.timing.period_s
        return control.StateSpace(self.matrix if closed else A, B, read, 0, period_s)

    def plant(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Return G (n, 2 n_s, n_u), commands to the state, at frequencies [Hz].

        Raises:
            LinkplanError: for frequencies beyond the Nyquist frequency of a sampled loop, or not above zero.
        """
        frequency = np.asarray(frequency_hz, dtype=float)
        refuse_above_nyquist(frequency, None if self.kind == CONTINUOUS else self.timing.period_s)
        omega = 2 * np.pi * frequency
        if self.kind == CONTINUOUS:
            at, B = 1j * omega, self.B.astype(complex)[None]
        else:
            at = np.exp(1j * omega * self.timing.period_s)
            back = at[:, None, None] ** -float(self.timing.whole)
            B = (self.B + self.B_late / at[:, None, None]) * back
        return np.linalg.solve(at[:, None, None] * np.eye(len(self.A)) - self.A, B)

    def gains(self, quantity: str, frequency_hz: np.ndarray, channel: int = 0, output: int | None = None) -> np.ndarray:
        """Return the complex gains (n,) of one of `QUANTITIES` at frequencies (n,) [Hz], for coordinate `channel`.

        `output` is the output coordinate of the plant; by default `channel`.
        """
        n_s = self.point.mechanism.dof
        joint, (read, push) = channel, channel_effort(self.point, channel)
        G = self.plant(frequency_hz)
        n_u = G.shape[2]
        S = np.linalg.inv(np.eye(n_u) + self.gain @ G)
        own = read @ S @ push
        if quantity == "sensitivity":
            return own
        if quantity == "loop":
            return 1.0 / own - 1.0
        if quantity == "complementary":
            return 1.0 - own
        if quantity == "plant":
            return (G @ S @ push)[:, joint if output is None else output] / own
        omega = 2 * np.pi * np.asarray(frequency_hz)[:, None]
        to_state = np.zeros((len(omega), 2 * n_s), dtype=complex)
        to_state[:, joint], to_state[:, n_s + joint] = 1.0, 1j * omega[:, 0]
        drive = np.einsum("ui,ni->nu", self.gain, to_state)
        if quantity == "reference+ff":
            drive = drive + self.feedforward(frequency_hz, joint)
        command = np.einsum("nuw,nw->nu", S, drive)
        if quantity == "control":
            return command @ read
        return np.einsum("nu,nu->n", G[:, joint], command)

    def feedforward(self, frequency_hz: np.ndarray, joint: int) -> np.ndarray:
        """Return the efforts (n, n_u) that a unit sinusoid of a joint needs.

        They lead by half a control period, because a held effort acts like its mean over the period.
        """
        n_s = self.point.mechanism.dof
        omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)
        A, B = (matrix[n_s:] for matrix in self.point.linearised())
        w = omega[:, None, None]
        resists = -(w**2) * np.eye(n_s) - A[:, :n_s] - 1j * w * A[:, n_s:]
        along = np.setdiff1d(np.arange(n_s), self.point.mechanism.channels)  # coordinates without a loop
        given = np.concatenate([np.broadcast_to(B, (len(w), *B.shape)), -resists[:, :, along]], axis=2)
        needed = np.linalg.pinv(given) @ resists[:, :, joint, None]
        ahead = 0.0 if self.kind == CONTINUOUS else 0.5 * self.timing.period_s
        return np.exp(1j * omega * ahead)[:, None] * needed[:, : B.shape[1], 0]

    def response(self, quantity: str, frequency_hz: np.ndarray, channel: int = 0, output: int | None = None) -> Response:
        """Return a quantity's predicted response at frequencies (n,) [Hz]; the arguments are those of `gains`."""
        return Response(
            frequency_hz=frequency_hz,
            gain=self.gains(quantity, frequency_hz, channel, output),
            unit=quantity_unit(self.point, quantity, channel, output),
            origin=f"predicted, {self.kind}",
        )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SampledLaw:
    """A linear law by its name and settings, with its timing and the limits (n_u, 2) [N.m or N] of the actuators."""

    name: str
    settings: Tracking
    timing: Sampling
    effort_limit: np.ndarray

    @property
    def by_errors(self) -> bool:
        """Whether its gains follow from errors of unit cost."""
        return BUILT_IN[self.name].by_errors

    def loop(self, point: OperatingPoint, kind: str = SIMULATED) -> FeedbackLoop:
        """Return the law's loop about a point.

        Raises:
            LinkplanError: if LQR has no stabilising gain.
        """
        return feedback_loop(point, law_gain(point, self.name, self.settings, self.effort_limit), self.timing, kind)


def sampled_law(mechanism: Mechanism, name: str, settings: Tracking, effort_limit: np.ndarray) -> SampledLaw:
    """Return a law with the period and the delay of its settings in the simulator's steps."""
    timing = sampling(mechanism, settings.period_s, settings.delay_periods)
    return SampledLaw(name=name, settings=settings, timing=timing, effort_limit=np.array(effort_limit))


def feedback_loop(point: OperatingPoint, gain: np.ndarray, timing: Sampling, kind: str = SIMULATED) -> FeedbackLoop:
    """Return the loop of a gain K (n_u, 2 n_s) about a point."""
    check()  # every sweep and bisection calls this function, so all of them can be interrupted
    if kind == CONTINUOUS:
        A, B = point.linearised()
        late = np.zeros_like(B)
    elif kind == EXACT:
        A, B, late = held_over(*point.linearised(), timing)
    else:
        A, B, late = point.sampled(timing)
    return FeedbackLoop(point=point, gain=gain, timing=timing, kind=kind, A=A, B=B, B_late=late)


@functools.lru_cache(maxsize=32)
def channel_effort(point: OperatingPoint, channel: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows (n_u,) that measure and apply the effort at which a coordinate's loop is broken.

    With one actuator this is the actuator's effort. With several it is the effort on the coordinate: row i of E measures it,
    and column i of E^+ applies one unit to it, shared by its actuators, and none to the other coordinates with a loop.
    """
    channels = list(point.mechanism.channels)
    if point.mechanism.n_u == 1:
        return np.ones(1), np.ones(1)
    effort_map = np.array(point.mechanism.dynamics.effort_map(point.pose))[channels]
    i = channels.index(channel)
    return effort_map[i], unit_efforts(effort_map)[:, i]


def channel_unit(point: OperatingPoint, channel: int) -> str:
    """Return the unit of the effort at which a coordinate's loop is broken."""
    if point.mechanism.n_u == 1:
        return point.mechanism.actuators[0].unit
    return point.mechanism.independent_joints[channel].si_units[1]


def broken_at(mechanism: Mechanism, channel: int) -> str:
    """Return the name of the effort at which a coordinate's loop is broken."""
    if mechanism.n_u == 1:
        return mechanism.actuators[0].name
    return f"the effort on {mechanism.independent_joints[channel].name}"


def outputs_of(mechanism: Mechanism, channel: int) -> tuple[int, ...]:
    """Return the output coordinates of a loop's plant: its own, and those that only move along."""
    along = np.setdiff1d(np.flatnonzero(mechanism.actuated), mechanism.channels)
    return (channel, *along.tolist())


def plant_name(mechanism: Mechanism, channel: int, output: int) -> str:
    """Return the name of the plant from a loop's effort to a coordinate, among the responses."""
    return "plant" if output == channel else f"plant to {mechanism.independent_joints[output].name}"


def quantity_unit(point: OperatingPoint, quantity: str, channel: int, output: int | None = None) -> str:
    """Return a quantity's unit, output over input."""
    joint = point.mechanism.independent_joints[channel if output is None else output]
    unit = channel_unit(point, channel)
    return QUANTITIES[quantity].format(q=joint.si_units[0], u=f"({unit})")
