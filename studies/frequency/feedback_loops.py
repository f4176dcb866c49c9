"""Feedback loops about an operating point, predicted: continuous, sampled, and sampled in MuJoCo's own steps.

    command u = u_hold + K (x_ref - x),   x = (s, v),   X = G U

G is the way from commands to the state: (j w I - A)^-1 B as s-plane design has it, without hold or delay; with z = e^(j w T)
G = (z I - A)^-1 (B z^-d + B_late z^-d-1). S = (I + K G)^-1. The loop of coordinate i is broken at the effort on it, the
others closed: with efforts tau = E u on the coordinates it is 1 / (E S E^-1)_ii - 1 (Skogestad & Postlethwaite,
Multivariable Feedback Control, 2005, 3.2). Of a single freedom that is the loop at its actuator.
"""

from dataclasses import dataclass

import control
import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.sampling import Sampling, augmented, closed, exact, simulated, spectral_radius
from linkplan.controllers.trackers.lqr import linearise, lqr
from linkplan.controllers.trackers.names import LINEAR
from linkplan.controllers.trackers.pd import pd
from linkplan.models.errors import LinkplanError
from linkplan.models.interrupts import check
from linkplan.models.mechanism import Mechanism
from linkplan.models.names import choose
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.frequency.response import Response

CONTINUOUS, EXACT, SIMULATED = "continuous", "sampled, exact hold", "sampled, MuJoCo's steps"
# What each response is of, and its unit: {o} is the joint's unit over {u}, the effort's.
QUANTITIES = {
    "plant": "{q}/{u}",
    "loop": "1",
    "sensitivity": "1",
    "complementary": "1",
    "control": "{u}/{q}",
    "reference": "1",
    "reference+ff": "1",
}
# As sentences call them.
LAW_NAMES = {"pd": "PD", "pd+ff": "PD with feedforward", "lqr": "LQR"}
# An effort that misses this share of what is needed does not hold the pose.
_HELD = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OperatingPoint:
    """A closed pose (n_q,) that efforts `hold` (n_u,) keep at rest, or a state of a motion with its velocity (n_s,)."""

    mechanism: Mechanism
    pose: np.ndarray
    velocity: np.ndarray
    hold: np.ndarray

    @property
    def state(self) -> np.ndarray:
        """X = (s, v) (2 n_s,) [rad or m, and a second]."""
        return np.concatenate([self.pose[self.mechanism.independent], self.velocity])

    @property
    def name(self) -> str:
        """The independent joints' positions, for people."""
        index = self.mechanism.independent
        shown = zip(self.mechanism.independent_joints, self.pose[index], strict=True)
        return ", ".join(f"{joint.name} = {joint.said(x)} {joint.unit}" for joint, x in shown)

    @property
    def inertia(self) -> np.ndarray:
        """The reduced inertia (n_s, n_s) [kg m2 or kg]."""
        return np.array(self.mechanism.dynamics.reduced_inertia(self.pose))

    def constant(self, period_s: float, n: int = 1) -> SampledReference:
        """Return the point as a reference at rest over n control periods [s]."""
        return SampledReference(
            period_s=period_s,
            time_s=period_s * np.arange(n),
            pose=np.tile(self.pose, (n, 1)),
            position=np.tile(self.state[: self.mechanism.dof], (n, 1)),
            velocity=np.tile(self.velocity, (n, 1)),
            effort=np.tile(self.hold, (n, 1)),
            cycle=None,
        )


def operating_point(mechanism: Mechanism, position: np.ndarray, effort_limit: np.ndarray | None = None) -> OperatingPoint:
    """Return the mechanism held at independent positions (n_s,) [rad or m].

    Raises:
        LinkplanError: where there are not as many actuators as freedoms, the loops do not close, or no effort within the
            limits (n_u, 2) holds the pose.
    """
    require_actuated(mechanism)
    pose = close_at(mechanism, np.atleast_1d(position))
    still = np.zeros((1, mechanism.dof))
    hold, missed = needed_effort(mechanism, pose[None], still, still)
    point = OperatingPoint(mechanism=mechanism, pose=pose, velocity=still[0], hold=hold[0])
    if not np.all(np.isfinite(hold)) or np.abs(missed).max() > _HELD * max(1.0, np.abs(hold).max()):
        raise LinkplanError(f"no effort holds '{mechanism.name}' at {point.name}")
    limit = mechanism.effort_limit if effort_limit is None else effort_limit
    for actuator, effort, (low, high) in zip(mechanism.actuators, hold[0], limit, strict=True):
        # At the end of its limits an actuator answers to one side only: no loop is linear there.
        room = _HELD * max(abs(low), abs(high)) if np.isfinite([low, high]).all() else 0.0
        if not low + room < effort < high - room:
            shown = effort if abs(effort) > room else 0.0
            raise LinkplanError(
                f"'{mechanism.name}' cannot be held at {point.name}: {actuator.name} would need {shown:.4g}"
                f" {actuator.unit}, its limits are {low:g} to {high:g}, and a feedback loop needs effort to both sides"
                " of what holds it"
            )
    return point


def require_actuated(mechanism: Mechanism) -> None:
    """Refuse a mechanism whose freedoms are not all actuated, each once."""
    if mechanism.n_u == 0:
        raise LinkplanError(f"a feedback loop needs an actuator; '{mechanism.name}' has no motor on a hinge or slide")
    if mechanism.n_u != mechanism.dof:
        raise LinkplanError(
            f"frequency responses need one actuator for every degree of freedom; '{mechanism.name}' has {mechanism.n_u}"
            f" ({', '.join(a.name for a in mechanism.actuators)}) for {mechanism.dof}"
            f" ({', '.join(j.name for j in mechanism.independent_joints)})"
        )


def refuse_several_freedoms(mechanism: Mechanism, what: str) -> None:
    """Refuse a mechanism of more than one degree of freedom."""
    if mechanism.dof != 1:
        raise LinkplanError(f"{what} needs a mechanism of one degree of freedom; '{mechanism.name}' has {mechanism.dof}")


def law_gain(point: OperatingPoint, law: str, settings: Tracking, effort_limit: np.ndarray) -> np.ndarray:
    """Return a tracker's gain K (n_u, 2 n_s) where it holds a point.

    Raises:
        LinkplanError: for an unknown law, or an LQR without a stabilising gain.
    """
    choose("tracker", law, LINEAR, LinkplanError)
    reference = point.constant(settings.period_s)
    if law == "lqr":
        limit = np.abs(effort_limit).max(axis=1)
        position, velocity = settings.lqr_errors(point.mechanism.independent_joints)
        tracker = lqr(
            point.mechanism,
            reference,
            position_weight=position,
            velocity_weight=velocity,
            effort_weight=np.where(np.isfinite(limit), limit, np.maximum(np.abs(point.hold), 1.0)),
        )
        return tracker.gains[0]
    kp, kd = settings.gains(point.mechanism.independent_joints)
    return pd_gain(pd(point.mechanism, reference, kp, kd).map[0], kp, kd)


def pd_gain(effort_map: np.ndarray, kp: float | np.ndarray, kd: float | np.ndarray) -> np.ndarray:
    """Return K (n_u, 2 n_s) of PD on the independent joints through a map (n_u, n_s) of their efforts to the actuators.

    Gains are one for all joints or one for each, (n_s,).
    """
    return np.concatenate([kp * effort_map, kd * effort_map], axis=1)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FeedbackLoop:
    """A law of gain K (n_u, 2 n_s) about an operating point, in one of three kinds of time.

    x' = A x + B u for the continuous kind; x_{k+1} = A x_k + B u_{k-d} + B_late u_{k-d-1} for the sampled ones.
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
        """The closed loop's matrix (M, M), past commands included where it is sampled."""
        if self.kind == CONTINUOUS:
            return closed(self.A, self.B, self.gain)
        return closed(*augmented(self.A, self.B, self.B_late, self.timing), self.gain)

    @property
    def radius(self) -> float | None:
        """The largest size of a sampled closed loop's pole; None for the continuous kind."""
        return None if self.kind == CONTINUOUS else float(spectral_radius(self.matrix))

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable."""
        if self.kind == CONTINUOUS:
            return bool(np.all(np.linalg.eigvals(self.matrix).real < 0))
        return self.radius < 1.0

    def system(self) -> control.StateSpace:
        """Return the open loop from commands to K x, others closed or not there, as python-control's state space."""
        if self.kind == CONTINUOUS:
            return control.StateSpace(self.A, self.B, self.gain, 0)
        A, B = augmented(self.A, self.B, self.B_late, self.timing)
        C = np.zeros((len(self.gain), len(A)))
        C[:, : self.gain.shape[1]] = self.gain
        return control.StateSpace(A, B, C, 0, self.timing.period_s)

    def plant(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Return G (n, 2 n_s, n_u), commands to the state, at frequencies [Hz].

        Raises:
            LinkplanError: for frequencies beyond the Nyquist frequency of a sampled loop, or not above zero.
        """
        frequency = np.asarray(frequency_hz, dtype=float)
        if not (frequency.size and np.all(np.isfinite(frequency)) and np.all(frequency > 0)):
            raise LinkplanError("frequencies are positive numbers of hertz")
        omega = 2 * np.pi * frequency
        if self.kind == CONTINUOUS:
            at, B = 1j * omega, self.B.astype(complex)[None]
        else:
            nyquist = self.timing.nyquist_hz
            if frequency.max() > nyquist * (1 + 1e-9):
                raise LinkplanError(
                    f"{frequency.max():.6g} Hz is above the Nyquist frequency, {nyquist:.6g} Hz at a control period of"
                    f" {self.timing.period_s:g} s"
                )
            at = np.exp(1j * omega * self.timing.period_s)
            back = at[:, None, None] ** -float(self.timing.whole)
            B = (self.B + self.B_late / at[:, None, None]) * back
        return np.linalg.solve(at[:, None, None] * np.eye(len(self.A)) - self.A, B)

    def gains(self, quantity: str, frequency_hz: np.ndarray, channel: int = 0) -> np.ndarray:
        """Return complex gains (n,) of a quantity of `QUANTITIES` at frequencies [Hz], of a coordinate and its effort."""
        choose("response", quantity, QUANTITIES, LinkplanError)
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
            return (G @ S @ push)[:, joint] / own
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
        """Return the efforts (n, n_u) that a joint's unit sinusoid needs, half a period ahead: a held value is a mean."""
        n_s = self.point.mechanism.dof
        omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)
        still = (self.point.pose[None], self.point.velocity[None], self.point.hold[None])
        A, B = (matrix[0, n_s:] for matrix in linearise(self.point.mechanism, *still))
        unit = np.eye(n_s)[joint]
        need = -(omega[:, None] ** 2) * unit - A[:, :n_s] @ unit - 1j * omega[:, None] * (A[:, n_s:] @ unit)
        ahead = 0.0 if self.kind == CONTINUOUS else 0.5 * self.timing.period_s
        return np.exp(1j * omega * ahead)[:, None] * (need @ np.linalg.pinv(B).T)

    def response(self, quantity: str, frequency_hz: np.ndarray, channel: int = 0) -> Response:
        """Return a quantity's predicted response at frequencies (n,) [Hz]."""
        return Response(
            frequency_hz=frequency_hz,
            gain=self.gains(quantity, frequency_hz, channel),
            unit=quantity_unit(self.point, quantity, channel),
            origin=f"predicted, {self.kind}",
        )


def feedback_loop(point: OperatingPoint, gain: np.ndarray, timing: Sampling, kind: str = SIMULATED) -> FeedbackLoop:
    """Return the loop of a gain K (n_u, 2 n_s) about a point."""
    check()  # sweeps and bisections come by here
    states = (point.pose[None], point.velocity[None], point.hold[None])
    if kind == CONTINUOUS:
        A, B = linearise(point.mechanism, *states)
        late = np.zeros_like(B)
    else:
        A, B, late = (exact if kind == EXACT else simulated)(point.mechanism, *states, timing)
    return FeedbackLoop(point=point, gain=gain, timing=timing, kind=kind, A=A[0], B=B[0], B_late=late[0])


def channel_effort(point: OperatingPoint, channel: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what reads the effort at which a coordinate's loop is broken, (n_u,), and what puts one unit there, (n_u,).

    Of a single freedom it is its actuator's effort; of several the effort on the coordinate, row i of E and column i of
    E^-1, so that no effort is put on the other coordinates.
    """
    if point.mechanism.dof == 1:
        return np.ones(1), np.ones(1)
    effort_map = np.array(point.mechanism.dynamics.effort_map(point.pose))
    return effort_map[channel], np.linalg.inv(effort_map)[:, channel]


def channel_unit(point: OperatingPoint, channel: int) -> str:
    """Return the unit of the effort at which a coordinate's loop is broken."""
    if point.mechanism.dof == 1:
        return point.mechanism.actuators[0].unit
    return "N.m" if point.mechanism.independent_joints[channel].kind == "hinge" else "N"


def broken_at(mechanism: Mechanism, channel: int) -> str:
    """Return in words where a coordinate's loop is broken."""
    return (
        mechanism.actuators[0].name if mechanism.dof == 1 else f"the effort on {mechanism.independent_joints[channel].name}"
    )


def quantity_unit(point: OperatingPoint, quantity: str, channel: int) -> str:
    """Return a quantity's unit, output over input."""
    joint = point.mechanism.independent_joints[channel]
    unit = channel_unit(point, channel)
    return QUANTITIES[quantity].format(q="rad" if joint.kind == "hinge" else "m", u=f"({unit})")
