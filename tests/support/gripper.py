"""The parallel gripper's dimensions, and its inertia and weight in closed form."""

import numpy as np

from tests.support.fourbar import G

# Crank, its centre from the pin, the cable's radius [m]; masses [kg], moments about the centres [kg m2]; springs [N.m/rad],
# their rest [rad] and damping [N.m.s/rad] in every crank's pin.
CRANK, CENTRE, PULLEY = 0.06, 0.03, 0.008
CRANK_MASS, CRANK_MOMENT = 0.02, 8e-6
FOLLOWER_MASS, FOLLOWER_MOMENT = 0.015, 6e-6
FINGER_MASS = 0.04
STIFFNESS, REST, DAMPING = 0.05, np.radians(60.0), 1e-3
INERTIA = 2 * (CRANK_MOMENT + FOLLOWER_MOMENT + (CRANK_MASS + FOLLOWER_MASS) * CENTRE**2 + FINGER_MASS * CRANK**2)
WEIGHT = 2 * G * ((CRANK_MASS + FOLLOWER_MASS) * CENTRE + FINGER_MASS * CRANK)
