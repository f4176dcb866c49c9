"""Test signals for frequency responses, and the responses that follow from the measured signals.

A test signal is added to the command of an actuator ("effort") or to the reference of a joint, without feedforward
("reference") or with it ("reference+ff"). With the added signal W or R, the command U and the position Y:

    effort:      S = U / W,   T = 1 - S,   L = (W - U) / U,   plant = Y / U     open loop from closed-loop data
    reference:   Y / R,   control sensitivity U / R

All frequencies, points and excitations run side by side, each in its own simulation (`simulated_loops`).
"""

from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.studies.feedback.frequency.feedback_loops import (
    FeedbackLoop,
    channel_effort,
    outputs_of,
    plant_name,
    quantity_unit,
    refuse_above_nyquist,
)
from linkplan.studies.feedback.frequency.response import Response

EXCITATIONS = {
    "effort": ("plant", "loop", "sensitivity", "complementary"),
    "reference": ("reference", "control"),
    "reference+ff": ("reference+ff",),
}
# Default motion of the joint under a test signal [rad; on a slide, as a share of the model's extent].
MOTION_AMPLITUDE_RAD = np.radians(0.02)
# The test signal is reduced if its command exceeds this share of the distance from the holding effort to the limit.
EFFORT_SHARE = 0.05

# Longest window [control periods], which takes minutes, and the periods of all windows together: a gigabyte.
_MAX_WINDOW_PERIODS, _MAX_PERIODS = 2_000_000, 12_500_000


def refuse_long(samples: float, lowest_hz: float, copies: float) -> None:
    """Refuse a measurement whose windows are too long to store.

    Raises:
        LinkplanError: with the number of samples and the lowest frequency that can be measured.
    """
    most = min(_MAX_WINDOW_PERIODS, _MAX_PERIODS / max(copies, 1.0))
    if samples > most:
        raise LinkplanError(
            f"{lowest_hz:g} Hz needs windows of {samples:.3g} control periods in {copies:g} simulations at once; at most"
            f" {most:.3g} can be stored: measure from about {lowest_hz * samples / most:.3g} Hz on, or use a longer control"
            " period"
        )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Setup:
    """The settings of a measurement.

    `amplitude` [rad or m]: desired motion of the joint; the prediction scales the test signal to it. `longest_s` [s] ends
    the measurement; an estimate that has not settled by then has a large uncertainty.
    """

    amplitude: float | None = None
    longest_s: float = 10.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Measurement:
    """The measured responses of each loop or plant by name, the number of simulated steps, and the simulation settings.

    `actuated`: for each loop and excitation, the phasors (n,) of the commanded and of the applied effort, relative
    to the holding effort [N.m or N].
    """

    responses: tuple[dict[str, Response], ...]
    simulated_steps: int
    conditions: dict
    actuated: tuple[dict[str, tuple[np.ndarray, np.ndarray]], ...] = ()


def whole_samples(frequency_hz: np.ndarray, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return cycles p (n,) and samples N (n,) such that p / (N T) is close to each frequency.

    Duplicates are removed. The Nyquist frequency itself is lowered, because sine and cosine are indistinguishable there.

    Raises:
        LinkplanError: for frequencies that are not positive or are above the Nyquist frequency.
    """
    frequency = np.unique(np.asarray(frequency_hz, dtype=float))
    refuse_above_nyquist(frequency, period_s)
    refuse_long(1.0 / (frequency[0] * period_s), float(frequency[0]), 1.0)
    found: dict[float, tuple[int, int]] = {}
    for wanted in frequency:
        # Up to 64 cycles in whole samples; the fewest cycles that change the frequency by less than 0.4 %.
        p = np.arange(1, 65)
        N = np.maximum(np.round(p / (wanted * period_s)).astype(int), 2 * p + 1)
        change = np.abs(p / (N * period_s) / wanted - 1)
        close = change < 0.004
        best = int(np.argmax(close)) if np.any(close) else int(np.argmin(change))
        shared = int(np.gcd(p[best], N[best]))
        pair = int(p[best]) // shared, int(N[best]) // shared
        found[pair[0] / pair[1]] = pair
    pairs = [found[key] for key in sorted(found)]
    return np.array([p for p, _ in pairs]), np.array([N for _, N in pairs])


def command_headroom(loop: FeedbackLoop, effort_limit: np.ndarray, channel: int) -> float:
    """Return the smallest effort [N.m or N] at a channel that brings an actuator from its holding effort to a limit."""
    _, push = channel_effort(loop.point, channel)
    low, high = effort_limit.T
    with np.errstate(divide="ignore"):
        return float((np.minimum(high - loop.point.hold, loop.point.hold - low) / np.abs(push)).min())


def signal_amplitude(
    loop: FeedbackLoop, frequency_hz: np.ndarray, excitation: str, effort_limit: np.ndarray, setup: Setup, channel: int
) -> np.ndarray:
    """Return amplitudes (n,) of a test signal [its unit] that move the joint little and do not saturate an actuator."""
    joint = loop.point.mechanism.independent_joints[channel]
    small = MOTION_AMPLITUDE_RAD * (1.0 if joint.kind == "hinge" else loop.point.mechanism.extent_m)
    wanted = small if setup.amplitude is None else setup.amplitude
    room = np.inf if setup.amplitude is not None else EFFORT_SHARE * command_headroom(loop, effort_limit, channel)
    sensitivity = loop.gains("sensitivity", frequency_hz, channel)
    if excitation == "effort":
        moves, commands = loop.gains("plant", frequency_hz, channel) * sensitivity, sensitivity
    else:
        moves = loop.gains(excitation, frequency_hz, channel)
        commands = moves / loop.gains("plant", frequency_hz, channel)
    # The reference's own amplitude is bounded too: a loop that does not follow it still commands effort for it.
    moves = np.abs(moves) if excitation == "effort" else np.maximum(np.abs(moves), 1.0)
    return np.minimum(wanted / moves, room / np.abs(commands))


def quantities(
    loop: FeedbackLoop,
    channel: int,
    excitation: str,
    frequency_hz: np.ndarray,
    signals: np.ndarray,
    quality: dict[str, np.ndarray],
) -> dict[str, Response]:
    """Return the responses that follow from one excitation.

    Args:
        loop: the measured loop.
        channel: the joint.
        excitation: a key of EXCITATIONS.
        frequency_hz: (n,).
        signals: phasors (windows, n, 4 or more) of the added signal, the command, the applied effort and the positions of
            the loop's outputs.
        quality: coherence, distortion, residual and saturated (n,) of the same signals.
    """
    W, U, _, Y = (signals[:, :, i] for i in range(4))
    mechanism = loop.point.mechanism
    by_quantity = {
        "plant": lambda: Y / U,
        "loop": lambda: (W - U) / U,
        "sensitivity": lambda: U / W,
        "complementary": lambda: 1.0 - U / W,
        "reference": lambda: Y / W,
        "control": lambda: U / W,
        "reference+ff": lambda: Y / W,
    }
    wanted = [(name, name, channel, by_quantity[name]()) for name in EXCITATIONS[excitation]]
    if excitation == "effort":
        for k, output in enumerate(outputs_of(mechanism, channel)[1:], start=4):
            wanted.append((plant_name(mechanism, channel, output), "plant", output, signals[:, :, k] / U))
    return {
        name: measured_response(
            frequency_hz, estimates, quantity_unit(loop.point, quantity, channel, output), excitation, quality
        )
        for name, quantity, output, estimates in wanted
    }


def measured_response(
    frequency_hz: np.ndarray, estimates: np.ndarray, unit: str, excitation: str, quality: dict[str, np.ndarray]
) -> Response:
    """Return the response of gains estimated in several windows (windows, n)."""
    gain = estimates.mean(axis=0)
    return Response(
        frequency_hz=frequency_hz,
        gain=gain,
        unit=unit,
        origin=f"measured in MuJoCo, sinestream, {excitation}",
        uncertainty=np.sqrt(np.mean(np.abs(estimates - gain) ** 2, axis=0) / (len(estimates) - 1)),
        **quality,
    )
