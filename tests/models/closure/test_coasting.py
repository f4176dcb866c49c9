"""Coordinates that nothing but damping acts on."""

import numpy as np
import pytest
import scipy

from linkplan.models.mechanism import load_mechanism
from tests.support.boom import boom


@pytest.mark.parametrize(
    ("axis", "joint", "motor", "coasts"),
    [
        ("0 0 1", "", "", True),
        ("0 0 1", 'damping=".2" armature=".1"', "", True),
        ("0 .01 1", "", "", False),
        ("0 0 1", 'stiffness=".1"', "", False),
        ("0 0 1", 'frictionloss=".1"', "", False),
        ("0 0 1", "", '<motor joint="turn"/>', False),
    ],
    ids=("bare", "damped", "tilted", "sprung", "dry friction", "driven"),
)
def test_a_boom_coasts_if_nothing_but_damping_acts_on_it(axis, joint, motor, coasts):
    mechanism = load_mechanism(boom(axis, joint, motor))
    assert mechanism.coasting_dofs == ((0,) if coasts else ())


def test_momentum_and_damping_times_angle_stay_together_what_they_were():
    """The motion of a damped boom under jerky efforts on the leg, by integration."""
    mechanism = load_mechanism(boom())
    assert mechanism.coasting_dofs == (0,)

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        q, v = np.split(state, 2)
        u = [np.sin(7 * time), np.cos(5 * time) - 0.3]
        return np.concatenate([v, np.array(mechanism.dynamics.acceleration(q, v, u)).ravel()])

    begin = np.array([0.2, -0.1, 0.3, 0.5, 0.4, -0.6])
    end = scipy.integrate.solve_ivp(rate, (0.0, 1.5), begin, rtol=1e-10, atol=1e-12).y[:, -1]
    law = [float(mechanism.dynamics.reduced_inertia(x[:3])[0, :] @ x[3:]) + 0.2 * x[0] for x in (begin, end)]
    assert abs(end[0] - begin[0]) > 0.1
    assert law[1] == pytest.approx(law[0], rel=1e-8)
