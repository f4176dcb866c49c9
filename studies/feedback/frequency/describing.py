"""Large signals: the closed-loop response as a function of amplitude, measured and predicted by the describing function.

Let N(A) be python-control's describing function of the saturation about the holding effort. Harmonic balance for a command
of amplitude A (Gelb & Vander Velde, Multiple-Input Describing Functions, 1968, ch. 3) is

    A |1 + N(A) L_0| = |drive|,   Y = P_0 N(A) U

for the loop L_0 and plant P_0 without saturation. The balance neglects harmonics. It also neglects the shift of the mean
when the two limits are at unequal distances.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from msgspec import UNSET, Struct, UnsetType

from linkplan.models.errors import LinkplanError
from linkplan.models.poses.sign_change import sign_change
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.search.planning import silent
from linkplan.studies.feedback.frequency.excitation import Setup, whole_samples
from linkplan.studies.feedback.frequency.feasible import FeasibleCurve
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop
from linkplan.studies.feedback.frequency.sinestream import measure

# Amplitudes of the command without a limit, divided by the distance to the limit.
MULTIPLES = (0.3, 0.9, 1.2, 1.6, 2.2, 3.0)


class LargeSignals(Struct, frozen=True, kw_only=True, eq=False):
    """The reference response and the actuator's gain at frequencies (n,) [Hz] and amplitudes (n, m).

    `multiples` (m,): amplitude of the command without a limit, divided by `room`, the distance to the limit [N.m or N].
    `measured` and `predicted` (n, m): Y / R, also in dB. `command` (n, m): amplitude of the measured command [N.m or N].
    `describing` (n, m): magnitude of the measured ratio of applied to commanded effort. `describing_predicted` (n, m):
    python-control's describing function at that command. `saturated` (n, m): share of instants at a limit. `feasible`: rows
    of the curve of feasible amplitudes, `curve`.
    """

    pose: str
    response: str
    room: float
    frequency_hz: np.ndarray
    multiples: np.ndarray
    amplitude_deg: np.ndarray | UnsetType = UNSET  # of a hinge
    amplitude_m: np.ndarray | UnsetType = UNSET  # of a slide
    gain_db: np.ndarray
    predicted_db: np.ndarray
    describing: np.ndarray
    describing_predicted: np.ndarray
    command: np.ndarray
    saturated: np.ndarray
    coherence: np.ndarray
    feasible: Sequence[dict[str, float | str | None]] = ()
    measured: Beside[np.ndarray] = NOT_READ
    predicted: Beside[np.ndarray] = NOT_READ
    curve: Beside[FeasibleCurve] = NOT_READ


def saturation(loop: FeedbackLoop, effort_limit: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return the real N(A) (n,) of an actuator's limits about its holding effort, for amplitudes A (n,) [N.m or N]."""
    import control

    low, high = effort_limit[0] - loop.point.hold[0]
    if not (np.isfinite(low) and np.isfinite(high)):
        raise LinkplanError(f"actuator {loop.point.mechanism.actuators[0].name} has no effort limit")
    # Each half of the sine meets one limit, so N(A) is the mean of two symmetric saturations.
    cuts = [control.saturation_nonlinearity(limit) for limit in (-low, high)]

    def mean(A: np.ndarray) -> np.ndarray:
        return np.mean([np.real(control.describing_function(cut, np.atleast_1d(A))) for cut in cuts], axis=0)

    return mean


def balance(loop: FeedbackLoop, quantity: str, frequency_hz: float, amplitude: float, N: Callable) -> tuple[complex, float]:
    """Return harmonic balance's Y / R and command amplitude for a reference of an amplitude [rad or m]."""
    at = np.array([frequency_hz])
    S, P = loop.gains("sensitivity", at)[0], loop.gains("plant", at)[0]
    L = 1.0 / S - 1.0
    linear = loop.gains(quantity, at)[0]
    drive = linear / (P * S)  # input of the loop's summing point per unit of reference

    def excess(A: float) -> float:
        return A * abs(1.0 + float(N(A)[0]) * L) - amplitude * abs(drive)

    high = amplitude * abs(drive) * 1e-6
    while excess(high) < 0:
        high *= 1.3
        if high > 1e12:
            raise LinkplanError("harmonic balance has no solution")
    A = sign_change(excess, high / 1.3, high, xtol=0.0) if excess(high / 1.3) < 0 else high
    n = float(N(A)[0])
    return P * n * drive / (1.0 + n * L), A


def large_signals(
    loop: FeedbackLoop,
    effort_limit: np.ndarray,
    frequency_hz: np.ndarray,
    *,
    multiples: Sequence[float] = MULTIPLES,
    quantity: str = "reference",
    farthest: float | None = None,
    say: Callable[[str], None] = silent,
) -> LargeSignals:
    """Return a loop's reference response as a function of amplitude.

    Args:
        loop: a stable sampled loop.
        effort_limit: (n_u, 2) [N.m or N].
        frequency_hz: (n,), moved so that a period has whole samples.
        multiples: (m,) of the amplitude whose command just reaches the limit.
        quantity: "reference" or "reference+ff".
        farthest: the largest amplitude to try [rad or m]; results beyond it are NaN.
        say: receives progress messages.
    """
    N = saturation(loop, effort_limit)
    room = float(np.abs(effort_limit[0] - loop.point.hold[0]).min())
    cycles, samples = whole_samples(frequency_hz, loop.timing.period_s)
    frequency = cycles / (samples * loop.timing.period_s)
    per_motion = np.abs(loop.gains(quantity, frequency) / loop.gains("plant", frequency))
    sizes = np.asarray(multiples, dtype=float)[:, None] * room / per_motion
    limited = sizes if farthest is None else np.minimum(sizes, farthest)
    setup = Setup(longest_s=3.0)  # a limit, because a saturated loop may never settle
    same = [loop] * len(sizes)
    taken = measure(same, frequency, effort_limit, setup, excitations=(quantity,), say=say, amplitudes=limited)
    responses = [one[quantity] for one in taken.responses]
    commands, applied = np.array([one[quantity] for one in taken.actuated]).transpose(1, 2, 0)
    found: dict[str, Any] = {
        "measured": np.array([response.gain for response in responses]).T,
        "predicted": np.array(
            [[balance(loop, quantity, f, a, N)[0] for a in row] for f, row in zip(frequency, sizes.T, strict=True)]
        ),
        "command": np.abs(commands),
        "describing": np.abs(applied / commands),
        "describing_predicted": np.column_stack([N(size) for size in np.abs(commands).T]),
        "saturated": np.array([response.saturated for response in responses]).T,
        "coherence": np.array([response.coherence for response in responses]).T,
    }
    if farthest is not None:
        found = {name: np.where(farthest < sizes.T, np.nan, values) for name, values in found.items()}
    joint = loop.point.mechanism.independent_joints[0]
    return LargeSignals(
        pose=loop.point.name,
        response=quantity,
        room=room,
        frequency_hz=frequency,
        multiples=np.array(multiples, dtype=float),
        gain_db=20 * np.log10(np.abs(found["measured"])),
        predicted_db=20 * np.log10(np.abs(found["predicted"])),
        **{f"amplitude_{joint.unit}": joint.shown(sizes.T)},
        **found,
    )


def default_large_frequencies(loop: FeedbackLoop, crossover_hz: float | None) -> np.ndarray:
    """Return eight frequencies [Hz] around a crossover."""
    middle = crossover_hz or 0.02 / loop.timing.period_s
    return np.geomspace(0.15 * middle, min(1.5 * middle, 0.2 / loop.timing.period_s), 8)
