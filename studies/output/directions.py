"""What a direction of a drawing is called."""

import numpy as np

_AXES = ("x", "y", "z")
# A unit vector whose component is this near to one is that axis.
_ALONG_AXIS = 1e-6


def direction_said(direction: np.ndarray) -> str:
    """Return the name of a direction (3,): an axis of the world, backwards with a minus, or its components."""
    k = int(np.argmax(np.abs(direction)))
    if 1.0 - abs(direction[k]) < _ALONG_AXIS:
        return _AXES[k] if direction[k] > 0 else f"-{_AXES[k]}"
    return "along (" + ", ".join(f"{x:.3g}" for x in direction) + ")"
