"""A frequency response as a value: predicted or measured, with its unit, uncertainty and origin."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from msgspec import UNSET, Struct, UnsetType, structs

from linkplan.planner.files.structs import NOT_READ, Beside

if TYPE_CHECKING:
    import control

# Measured responses with less coherence are not reliable.
LEAST_COHERENCE = 0.99
_COLUMNS = ("uncertainty", "coherence", "distortion", "residual", "saturated")


class Response(Struct, frozen=True, kw_only=True, eq=False):
    """Complex gains at frequencies (n,) [Hz], in `unit` (output over input).

    `gain_db` is the gain's size in dB of its unit, at least -400 dB, so that a zero gain is finite. `phase_deg` is
    continuous over the frequencies.

    A measured response has five more arrays (n,). `uncertainty`: standard deviation of the gain, in its unit. `coherence`:
    share of the signals' power at the excited frequency. `distortion`: amplitude of the harmonics over the fundamental's.
    `residual`: amplitude of the remainder over the whole signal's. `saturated`: share of instants at an effort limit. A
    predicted response has coherence one and zeros elsewhere. `origin` names the prediction or the measurement.
    `less_predicted_db` and `less_predicted_deg` (n,) are the measured response's difference to the prediction.
    """

    frequency_hz: np.ndarray
    gain: Beside[np.ndarray] = NOT_READ
    gain_db: np.ndarray = NOT_READ
    phase_deg: np.ndarray = NOT_READ
    unit: str
    origin: str
    uncertainty: np.ndarray | None = None
    coherence: np.ndarray | None = None
    distortion: np.ndarray | None = None
    residual: np.ndarray | None = None
    saturated: np.ndarray | None = None
    less_predicted_db: np.ndarray | UnsetType = UNSET
    less_predicted_deg: np.ndarray | UnsetType = UNSET

    def __post_init__(self) -> None:
        if self.gain is NOT_READ:
            return
        frequency = np.array(self.frequency_hz, dtype=float)
        gain = np.array(self.gain, dtype=complex)
        with np.errstate(divide="ignore"):
            db = np.maximum(20 * np.log10(np.abs(gain)), -400.0)
        phase = np.degrees(np.unwrap(np.angle(gain)))
        values = {"frequency_hz": frequency, "gain": gain, "gain_db": db, "phase_deg": phase}
        for name in _COLUMNS:
            value = getattr(self, name)
            values[name] = np.full(frequency.shape, float(name == "coherence")) if value is None else np.array(value, float)
        for name, value in values.items():
            value.flags.writeable = False
            structs.force_setattr(self, name, value)

    def against(self, other: "Response") -> tuple[np.ndarray, np.ndarray]:
        """Return the difference to another one at the same frequencies: gain (n,) [dB] and phase (n,) [deg], within 180."""
        ratio = self.gain / other.gain
        return 20 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))

    def beside(self, predicted: "Response") -> "Response":
        """Return the measured response with its difference to a prediction."""
        db, deg = self.against(predicted)
        return structs.replace(self, less_predicted_db=db, less_predicted_deg=deg)

    def is_known(self, share: float) -> np.ndarray:
        """Return True for each gain (n,) whose uncertainty is at most a share of its size."""
        return self.uncertainty <= share * np.abs(self.gain)

    def frd(self) -> "control.FrequencyResponseData":
        """Return the response as python-control's frequency response data."""
        import control

        return control.FrequencyResponseData(self.gain, 2 * np.pi * self.frequency_hz)


def largest_deviation(
    responses: Sequence[Response], largest_uncertainty: float = np.inf
) -> tuple[float | None, float | None]:
    """Return the largest differences [dB] and [deg] of measured responses to their predictions.

    Only coherent gains whose uncertainty is at most `largest_uncertainty`, a share of their size, are included.
    """
    db, deg = [], []
    for response in responses:
        counts = (response.coherence > LEAST_COHERENCE) & response.is_known(largest_uncertainty)
        db.append(float(np.abs(response.less_predicted_db[counts]).max(initial=0.0)))
        deg.append(float(np.abs(response.less_predicted_deg[counts]).max(initial=0.0)))
    return max(db, default=None), max(deg, default=None)
