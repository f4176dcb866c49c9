"""The slider-crank's dimensions, and its kinematics and energies in closed form."""

import numpy as np

from tests.support.fourbar import G

# Lengths [m].
CRANK, ROD = 0.05, 0.15
# Masses [kg], centres from the link's first pin [m], moments about the centres [kg m2].
CRANK_MASS, CRANK_CENTRE, CRANK_MOMENT = 0.3, 0.02, 2e-4
ROD_MASS, ROD_CENTRE, ROD_MOMENT = 0.2, 0.06, 6e-4
SLIDER_MASS = 0.6


def rod(th: float) -> tuple[float, float]:
    """Return the rod's angle and its rate per crank rate."""
    phi = np.arcsin(-CRANK / ROD * np.sin(th))
    return phi, -CRANK * np.cos(th) / (ROD * np.cos(phi))


def slider(th: float) -> tuple[float, float]:
    """Return the slider's place and its rate per crank rate."""
    phi, rate = rod(th)
    return CRANK * np.cos(th) + ROD * np.cos(phi), -CRANK * np.sin(th) - ROD * np.sin(phi) * rate


def inertia(s: np.ndarray) -> np.ndarray:
    """Return the reduced inertia (1, 1)."""
    (th,) = s
    phi, rate = rod(th)
    centre = CRANK * np.array([-np.sin(th), np.cos(th)]) + ROD_CENTRE * rate * np.array([-np.sin(phi), np.cos(phi)])
    crank = CRANK_MOMENT + CRANK_MASS * CRANK_CENTRE**2
    return np.array([[crank + ROD_MASS * centre @ centre + ROD_MOMENT * rate**2 + SLIDER_MASS * slider(th)[1] ** 2]])


def potential(s: np.ndarray) -> float:
    """Return the potential energy; the slider stays level."""
    (th,) = s
    return float(
        G * (CRANK_MASS * CRANK_CENTRE * np.sin(th) + ROD_MASS * (CRANK * np.sin(th) + ROD_CENTRE * np.sin(rod(th)[0])))
    )
