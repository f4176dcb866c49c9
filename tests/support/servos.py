"""Servos as a plan sees them: efforts, and the ctrl that gives them."""

import numpy as np

from linkplan.models.actuation.actuators import Actuator


def ctrl_of(actuator: Actuator, effort: float, length: float, velocity: float) -> float:
    """Return the ctrl at which an actuator gives an effort at a length and speed, (effort - bias) / gain."""
    state = np.array([1.0, length, velocity])
    return float((effort - state @ actuator.biases) / (state @ actuator.gains))
