"""Whole turns of joints over one cycle of a periodic motion."""

import numpy as np

from linkplan.models.mechanism import Mechanism


def whole_turns(mechanism: Mechanism, travelled: np.ndarray) -> np.ndarray:
    """Return the whole turns (n_q,) [rad] nearest to the joints' travel [rad or m]; 0 for joints that do not turn."""
    hinges = np.array([joint.turns for joint in mechanism.joints])
    return np.where(hinges, 2 * np.pi * np.round(travelled / (2 * np.pi)), 0.0)
