"""Test signals for frequency responses, and what follows from the signals that come back.

A test signal enters at the command of an actuator ("effort") or as the reference of a joint, without feedforward
("reference") or with it ("reference+ff"). Of the signals that come back, with U the command, W the part of it that was put
in, Y the position:

    effort:      S = U / W,   T = 1 - S,   L = (W - U) / U,   plant = Y / U     open loop from closed-loop data
    reference:   Y / R,   control sensitivity U / R

All frequencies, points and excitations run at once, each in a simulation of its own (`simulated_loops`).
"""

from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.studies.frequency.feedback_loops import FeedbackLoop, channel_effort, quantity_unit
from linkplan.studies.frequency.method_names import METHODS
from linkplan.studies.frequency.response import Response

EXCITATIONS = {
    "effort": ("plant", "loop", "sensitivity", "complementary"),
    "reference": ("reference", "control"),
    "reference+ff": ("reference+ff",),
}
# A test signal moves the joint by so much [rad; on a slide, of the model's extent], unless its command would take more than
# this share of what the limits leave beside the holding effort.
SMALL = np.radians(0.02)
EFFORT_SHARE = 0.05
# A frequency is moved by less than this share of itself to one that repeats after whole samples.
_FREQUENCY_SHARE = 0.004
_MOST_CYCLES = 64
# A sinusoid's window of more control periods than this takes minutes; what all windows together take is bounded too [bytes].
MOST_SAMPLES, MOST_BYTES = 2_000_000, 1_000_000_000


def refuse_long(samples: float, lowest_hz: float, copies: float, *, bytes_a_sample: int = 80) -> None:
    """Refuse a measurement whose windows are longer than can be kept, before any is asked for.

    Raises:
        LinkplanError: with the number of samples, and the frequency from which on it could be done.
    """
    most = min(MOST_SAMPLES, MOST_BYTES / (bytes_a_sample * max(copies, 1.0)))
    if samples > most:
        raise LinkplanError(
            f"{lowest_hz:g} Hz takes windows of {samples:.3g} control periods in {copies:g} simulations at once; at most"
            f" {most:.3g} are kept, as from about {lowest_hz * samples / most:.3g} Hz on, or with a longer"
            " control period"
        )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Setup:
    """How to measure.

    `amplitude` [rad or m] of the joint's motion, for which the test signal is scaled by the prediction; `ramp_cycles` of a
    smooth beginning; a window is one or more whole cycles, and an estimate settled when what is still to die away, by the
    change between windows and the slowest predicted pole, is below `tolerance` of it; `windows` are then averaged.
    `longest_s` ends the wait: what has not settled by then says so by its uncertainty.
    """

    method: str = "sinestream"
    amplitude: float | None = None
    ramp_cycles: int = 2
    windows: int = 3
    tolerance: float = 1e-4
    longest_s: float = 10.0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise LinkplanError(f"unknown way to measure '{self.method}'; ways are {', '.join(METHODS)}")
        if self.amplitude is not None and not (np.isfinite(self.amplitude) and self.amplitude > 0):
            raise LinkplanError(f"the amplitude of a test signal is a positive number, got {self.amplitude:g}")
        if self.ramp_cycles < 0 or self.windows < 2 or not 0 < self.tolerance < 1 or not self.longest_s > 0:
            raise LinkplanError(
                "a measurement has a ramp of 0 cycles or more, 2 windows or more and a tolerance within 0 to 1"
            )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Measurement:
    """What was measured about each loop: responses by quantity, simulated steps, the conditions of the simulation.

    `actuated`, of a sinestream: by excitation the phasors (n,) of the command and of the effort applied, beside the holding
    effort [N.m or N].
    """

    responses: tuple[dict[str, Response], ...]
    simulated_steps: int
    conditions: dict
    actuated: tuple[dict[str, tuple[np.ndarray, np.ndarray]], ...] = ()


def whole_samples(frequency_hz: np.ndarray, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return cycles p (n,) and samples N (n,), so that p / (N T) is next to each frequency and repeats after N samples.

    Doubles are left out; the Nyquist frequency itself, which a sine cannot be told from a cosine at, is moved below.

    Raises:
        LinkplanError: for frequencies that are not positive or are above the Nyquist frequency.
    """
    frequency = np.unique(np.asarray(frequency_hz, dtype=float))
    if not (frequency.size and np.all(np.isfinite(frequency)) and frequency[0] > 0):
        raise LinkplanError("frequencies are positive numbers of hertz")
    nyquist = 0.5 / period_s
    if frequency[-1] > nyquist * (1 + 1e-9):
        raise LinkplanError(
            f"{frequency[-1]:.6g} Hz is above the Nyquist frequency, {nyquist:.6g} Hz at a control period of {period_s:g} s"
        )
    refuse_long(1.0 / (frequency[0] * period_s), float(frequency[0]), 1.0)
    found: dict[float, tuple[int, int]] = {}
    for wanted in frequency:
        p = np.arange(1, _MOST_CYCLES + 1)
        N = np.maximum(np.round(p / (wanted * period_s)).astype(int), 2 * p + 1)
        off = np.abs(p / (N * period_s) / wanted - 1)
        best = int(np.argmax(off < _FREQUENCY_SHARE)) if np.any(off < _FREQUENCY_SHARE) else int(np.argmin(off))
        shared = int(np.gcd(p[best], N[best]))
        pair = int(p[best]) // shared, int(N[best]) // shared
        found[pair[0] / pair[1]] = pair
    pairs = [found[key] for key in sorted(found)]
    return np.array([p for p, _ in pairs]), np.array([N for _, N in pairs])


def command_headroom(loop: FeedbackLoop, effort_limit: np.ndarray, channel: int) -> float:
    """Return the effort [N.m or N] at a channel that takes some actuator from its holding effort to the nearer limit."""
    _, push = channel_effort(loop.point, channel)
    low, high = effort_limit.T
    with np.errstate(divide="ignore"):
        return float((np.minimum(high - loop.point.hold, loop.point.hold - low) / np.abs(push)).min())


def signal_amplitude(
    loop: FeedbackLoop, frequency_hz: np.ndarray, excitation: str, effort_limit: np.ndarray, setup: Setup, channel: int
) -> np.ndarray:
    """Return amplitudes (n,) of a test signal [its unit] that move the joint by little and leave its actuator free."""
    joint = loop.point.mechanism.independent_joints[channel]
    small = SMALL * (1.0 if joint.kind == "hinge" else loop.point.mechanism.extent_m)
    wanted = small if setup.amplitude is None else setup.amplitude
    room = np.inf if setup.amplitude is not None else EFFORT_SHARE * command_headroom(loop, effort_limit, channel)
    sensitivity = loop.gains("sensitivity", frequency_hz, channel)
    if excitation == "effort":
        moves, commands = loop.gains("plant", frequency_hz, channel) * sensitivity, sensitivity
    else:
        moves = loop.gains(excitation, frequency_hz, channel)
        commands = moves / loop.gains("plant", frequency_hz, channel)
    # A reference's own amplitude counts as a motion too: where the loop does not follow it, the command does.
    moves = np.abs(moves) if excitation == "effort" else np.maximum(np.abs(moves), 1.0)
    return np.minimum(wanted / moves, room / np.abs(commands))


def quantities(
    loop: FeedbackLoop,
    channel: int,
    excitation: str,
    frequency_hz: np.ndarray,
    signals: dict[str, np.ndarray],
    quality: dict[str, np.ndarray],
    origin: str,
) -> dict[str, Response]:
    """Return the responses that an excitation shows.

    Args:
        loop: which was measured.
        channel: the joint.
        excitation: of EXCITATIONS.
        frequency_hz: (n,).
        signals: phasors (windows, n) of the signal put in, "in", the command, "command", and the position, "position".
        quality: coherence, distortion, residual and saturated (n,) of the same signals.
        origin: for the responses.
    """
    W, U, Y = signals["in"], signals["command"], signals["position"]
    by_quantity = {
        "plant": lambda: Y / U,
        "loop": lambda: (W - U) / U,
        "sensitivity": lambda: U / W,
        "complementary": lambda: 1.0 - U / W,
        "reference": lambda: Y / W,
        "control": lambda: U / W,
        "reference+ff": lambda: Y / W,
    }
    found = {}
    for name in EXCITATIONS[excitation]:
        estimates = by_quantity[name]()
        spread = np.sqrt(np.mean(np.abs(estimates - estimates.mean(axis=0)) ** 2, axis=0) / (len(estimates) - 1))
        found[name] = Response(
            frequency_hz=frequency_hz,
            gain=estimates.mean(axis=0),
            unit=quantity_unit(loop.point, name, channel),
            origin=origin,
            uncertainty=spread,
            **quality,
        )
    return found
