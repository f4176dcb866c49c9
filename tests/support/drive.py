"""The line of the knee's linear actuator, from D to B, in closed form from the four-bar's own."""

import numpy as np

from tests.support.fourbar import FourBar

# Pivots D and C seen from O, and the rocker C-B [m].
P_D = np.array([0.285, 0.0])
ROCKER, P_C = 0.0855, np.array([0.057, 0.0])


def line(fourbar: FourBar, q_O: float) -> tuple[float, float]:
    """Return the length of DB and its angle from +z towards +x, in closed form."""
    rocker = float(fourbar.angles(np.array([q_O]))[2, 0])
    way = P_C + ROCKER * np.array([np.sin(rocker), np.cos(rocker)]) - P_D
    return float(np.hypot(*way)), float(np.arctan2(way[0], way[1]))


def line_rates(fourbar: FourBar, q_O: float) -> tuple[float, float]:
    """Return dl/dq_O and the line's turning per knee angle, in closed form."""
    rocker, rate = float(fourbar.angles(np.array([q_O]))[2, 0]), float(fourbar.rates(np.array([q_O]))[2, 0])
    length, angle = line(fourbar, q_O)
    velocity = ROCKER * rate * np.array([np.cos(rocker), -np.sin(rocker)])
    along, across = np.array([np.sin(angle), np.cos(angle)]), np.array([np.cos(angle), -np.sin(angle)])
    return float(velocity @ along), float(velocity @ across) / length
