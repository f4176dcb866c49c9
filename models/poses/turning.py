"""What coordinates go on by where a motion repeats itself turn after turn."""

import numpy as np

from linkplan.models.mechanism import Mechanism


def whole_turns(mechanism: Mechanism, travelled: np.ndarray) -> np.ndarray:
    """Return the whole turns [rad] nearest to what joints have travelled (n_q,) [rad or m]; 0 of what does not turn."""
    hinges = np.array([joint.turns for joint in mechanism.joints])
    return np.where(hinges, 2 * np.pi * np.round(travelled / (2 * np.pi)), 0.0)
