"""The responses of a plant at a pose, and sentences on them: verdict, unstable poles, zeros, modes, measurement."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from msgspec import UNSET, Struct, UnsetType

from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint
from linkplan.studies.feedback.frequency.response import Response
from linkplan.studies.feedback.frequency.transfer_function import Mode, PlantModes, TransferFunction

# Measured gains with a larger uncertainty, as a share of the gain, had not settled; they do not count and are not drawn.
LARGEST_UNCERTAINTY = 0.01


class Root(Struct, frozen=True, kw_only=True):
    """A pole or a zero in the complex plane [rad/s]; of a conjugate pair the one with a positive imaginary part."""

    real_rad_s: float
    imaginary_rad_s: float


class PlantCurve(Struct, frozen=True, kw_only=True, eq=False):
    """A predicted response over frequencies (n,) [Hz]: gain [dB of its unit] and continuous phase [deg]."""

    frequency_hz: np.ndarray
    gain_db: np.ndarray
    phase_deg: np.ndarray


class PlantResponse(PlantModes, frozen=True, kw_only=True, eq=False):
    """The response from one input to one output: poles, zeros and curve of the continuous plant, and its measurement.

    Poles and zeros that cancel are omitted. `integrators` is the number of poles at zero, or minus the number of zeros
    there; `low_frequency_gain` is the limit of s^integrators G, and `gain_at_rest` that of G, None if it is infinite.
    `moves` is False if the input does not move the output at all; there are then no poles, and no curve.
    `right_half_plane_zeros` make it non-minimum-phase. `measured` is compared with `sampled`, the response with hold, delay
    and MuJoCo's steps.
    """

    unit: str
    moves: bool
    integrators: int
    relative_degree: int
    low_frequency_gain: float
    gain_at_rest: float | None
    poles: tuple[Root, ...]
    zeros: tuple[Root, ...]
    unstable_poles: tuple[Root, ...]
    right_half_plane_zeros: tuple[Root, ...]
    curve: PlantCurve | None
    measured: Response | UnsetType = UNSET
    transfer: Beside[TransferFunction] = NOT_READ
    sampled: Beside[PlantCurve | None] = NOT_READ


class PlantPoint(Struct, frozen=True, kw_only=True, eq=False):
    """The plant at one pose; `responses` by "INPUT to OUTPUT".

    `held_by` is the tracker in whose loop it was measured, "itself" for a plant that is stable without one, or None.
    """

    q_deg: dict[str, float]
    q_m: dict[str, float]
    holding_effort: dict[str, float]
    held_by: str | None
    responses: dict[str, PlantResponse]
    point: Beside[OperatingPoint] = NOT_READ


def plant_message(points: Sequence[PlantPoint], efforts: Sequence[str], outputs: Sequence[str]) -> str:
    """Return a sentence on the resonances and anti-resonances of all responses."""
    where = points[0].point.name if len(points) == 1 else f"{len(points)} poses"
    said = [
        _among("resonance", [mode.frequency_hz for one in _all(points) for mode in one.resonances]),
        _among("anti-resonance", [mode.frequency_hz for one in _all(points) for mode in one.anti_resonances]),
    ]
    if unstable := sum(any(one.unstable_poles for one in point.responses.values()) for point in points):
        said.append("unstable by itself" + (f" at {unstable} of {len(points)} poses" if len(points) > 1 else ""))
    if any(one.right_half_plane_zeros for one in _all(points)):
        said.append("non-minimum-phase")
    if not any(one.moves for one in _all(points)):
        said = ["the efforts do not move the outputs"]
    return f"plant from {', '.join(efforts)} to {', '.join(outputs)} at {where}: {', '.join(said)}"


def plant_notes(points: Sequence[PlantPoint]) -> Iterator[str]:
    """Yield sentences on outputs that do not move, on zeros in the right half plane and on unstable poles.

    Of several poses the one with the most restrictive zero or pole is named.
    """
    for name in points[0].responses:
        at = {point.point.name: point.responses[name] for point in points}
        if still := [where for where, one in at.items() if not one.moves]:
            yield f"{name}: the effort does not move this output{_at(still, points)}"
        zeros = [(_size(zero), where) for where, one in at.items() for zero in one.right_half_plane_zeros]
        if zeros:
            nearest, where = min(zeros)
            yield (
                f"{name} is non-minimum-phase{_at([at for _, at in zeros], points)}: a loop of this output should cross over"
                f" below about {nearest / (4 * np.pi):.3g} Hz, half the nearest zero in the right half plane, {nearest:.4g}"
                f" rad/s{_of(where, points)}"
            )
    poles = [
        (_size(pole), point.point.name)
        for point in points
        for one in point.responses.values()
        for pole in one.unstable_poles
    ]
    if poles:
        fastest, where = max(poles)
        yield (
            f"the plant is unstable by itself{_at([at for _, at in poles], points)}: a loop that stabilises it should cross"
            f" over above about {fastest / np.pi:.3g} Hz, twice the fastest unstable pole, {fastest:.4g}"
            f" rad/s{_of(where, points)}"
        )


def _at(places: Sequence[str], points: Sequence[PlantPoint]) -> str:
    """Return " at 2 of 7 poses" for the names of some poses, or nothing for a single pose."""
    return f" at {len(set(places))} of {len(points)} poses" if len(points) > 1 else ""


def _of(place: str, points: Sequence[PlantPoint]) -> str:
    return f" at {place}" if len(points) > 1 else ""


def modes_text(modes: Sequence[Mode]) -> tuple[str, str]:
    """Return the frequencies and damping ratios of modes as text."""
    frequencies = ", ".join(f"{mode.frequency_hz:.4g}" for mode in modes) or "none"
    return frequencies, ", ".join(f"{mode.damping_ratio:.2g}" for mode in modes)


def agreement_text(measurement: Mapping[str, Any], db: str, deg: str, mechanism: Mechanism) -> str:
    """Return the deviation of measured responses from the prediction, by keys of a measurement, and the method."""
    c, solref = measurement, ", ".join(f"{x[0]:g} {x[1]:g}" for x in measurement["solref"]) or "none"
    how = f"sinestream, {c['simulated_steps']} steps of {c['timestep_s']:g} s in MuJoCo {c['mujoco']}, {c['integrator']}"
    text = f"differ from the prediction by at most {c[db]:.2g} dB and {c[deg]:.2g} deg"
    text += f" ({how}, closure constraints' solref {solref})"
    if any(frictions_of(mechanism.model)):
        text += "; dry friction, which the prediction omits, damps small motions: use a larger test signal"
    return text


def root_text(root: Root) -> str:
    """Return a pole or zero [rad/s] as text, a pair as one."""
    if not root.imaginary_rad_s:
        return f"{root.real_rad_s:.4g}"
    return f"{root.real_rad_s:.4g} +- {root.imaginary_rad_s:.4g}i"


def _size(root: Root) -> float:
    return float(np.hypot(root.real_rad_s, root.imaginary_rad_s))


def _all(points: Sequence[PlantPoint]) -> list[PlantResponse]:
    return [one for point in points for one in point.responses.values()]


def _among(what: str, frequency_hz: Sequence[float]) -> str:
    """Return frequencies of one kind as text: none, one, or the range of several."""
    known = sorted({f"{f:.4g}" for f in frequency_hz}, key=float)
    if not known:
        return f"no {what}"
    several = known[0] if len(known) == 1 else f"{', '.join(known)}" if len(known) < 4 else f"{known[0]} to {known[-1]}"
    return f"{what}{'s' if len(known) > 1 else ''} at {several} Hz"
