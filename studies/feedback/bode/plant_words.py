"""Sentences on a plant: its verdict, its unstable poles, its zeros in the right half plane."""

from collections.abc import Iterator, Sequence

import numpy as np

from linkplan.studies.feedback.bode.plant_result import PlantPoint, PlantResponse, Root


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
    """Yield a sentence for each response with unstable poles, with zeros in the right half plane, or without motion."""
    for point in points:
        for name, one in point.responses.items():
            at = f"{name} at {point.point.name}"
            if not one.moves:
                yield f"{at}: the effort does not move this output"
            if one.right_half_plane_zeros:
                nearest = min(_size(zero) for zero in one.right_half_plane_zeros)
                yield (
                    f"{at} is non-minimum-phase: zeros in the right half plane at"
                    f" {', '.join(map(root_text, one.right_half_plane_zeros))} rad/s; a loop of this output crosses over"
                    f" below about {nearest / (4 * np.pi):.3g} Hz, half the nearest one"
                )
            if one.unstable_poles:
                fastest = max(_size(pole) for pole in one.unstable_poles)
                yield (
                    f"{at} is unstable by itself: poles at {', '.join(map(root_text, one.unstable_poles))} rad/s; a loop"
                    f" that holds it crosses over above about {fastest / np.pi:.3g} Hz, twice the fastest one"
                )


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
