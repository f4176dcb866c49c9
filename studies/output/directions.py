"""Names of a drawing's directions."""

import numpy as np

_AXES = ("x", "y", "z")


def direction_name(direction: np.ndarray) -> str:
    """Return the name of a direction (3,): an axis of the world with its sign, or its components."""
    k = int(np.argmax(np.abs(direction)))
    if 1.0 - abs(direction[k]) < 1e-6:
        return _AXES[k] if direction[k] > 0 else f"-{_AXES[k]}"
    return "along (" + ", ".join(f"{round(float(x), 6) + 0.0:.3g}" for x in direction) + ")"
