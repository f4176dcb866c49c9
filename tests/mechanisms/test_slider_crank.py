"""The slider-crank against its closed form: sin(phi) = -(r / l) sin(th), x = r cos(th) + l cos(phi).

M(th) and V(th) are the bodies' energies by the chain rule; the equation of motion is Lagrange's.
"""

import numpy as np
import pytest

from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.reach import reach, toggles
from tests.support.mechanism_checks import acceleration, lagrangian_acceleration, mechanism_of
from tests.support.slider_crank import inertia, potential, rod, slider
from tests.support.tolerances import ANGLE_RAD, BRACKET_RAD, DIFFERENCES, KNEE, relative_error

NAME, PROBLEM = "slider-crank", "slider-crank-turn"
at_every_angle = pytest.mark.parametrize("th", np.radians([-170.0, -90.0, -35.0, 0.0, 50.0, 90.0, 140.0, 180.0]))


def pose(th: float) -> np.ndarray:
    return close_at(mechanism_of(NAME), np.array([th]))


def test_the_crank_is_the_only_freedom():
    mechanism = mechanism_of(NAME)
    assert (mechanism.n_q, len(mechanism.closure_rows)) == (3, 2)
    assert [joint.name for joint in mechanism.independent_joints] == ["O"]


@at_every_angle
def test_rod_and_slider_follow_the_crank_as_the_closed_form_says(th):
    assert np.abs(pose(th) - [th, rod(th)[0] - th, slider(th)[0]]).max() < ANGLE_RAD


@at_every_angle
def test_rates_are_the_closed_form_s_dead_centres_included(th):
    rates = np.array(mechanism_of(NAME).dynamics.velocity_map(pose(th)))[:, 0]
    assert relative_error(rates, [1.0, rod(th)[1] - 1.0, slider(th)[1]]) < KNEE


@at_every_angle
def test_reduced_inertia_is_the_closed_form(th):
    found = np.array(mechanism_of(NAME).dynamics.reduced_inertia(pose(th)))
    assert relative_error(found, inertia(np.array([th]))) < KNEE


@at_every_angle
def test_acceleration_is_lagrange_s(th):
    v, u = np.array([23.0]), np.array([1.3])
    expected = lagrangian_acceleration(inertia, potential, np.array([th]), v, u)
    assert relative_error(acceleration(mechanism_of(NAME), pose(th), v, u), expected) < DIFFERENCES


def test_the_slider_turns_back_at_both_dead_centres_and_the_crank_turns_fully():
    can = reach(mechanism_of(NAME))
    assert can.turns_fully
    assert can.singular == ()
    # Home itself is one of them: a sample at which the slider rests, between two of either sign.
    turning = toggles(mechanism_of(NAME))
    assert [mechanism_of(NAME).joints[j].name for j, _ in turning] == ["B", "B", "B"]
    assert np.abs(np.array([at for _, at in turning]) - [-np.pi, 0.0, np.pi]).max() < BRACKET_RAD
