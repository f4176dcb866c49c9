"""The branch of a slider-crank in closed form: roots by Newton and Krawczyk, and their Taylor series."""

import math

import numpy as np
import pytest
from flint import arb, arb_series, ctx

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.proof.branch import krawczyk, newton, series_of
from linkplan.planner.proof.taylor import NotSeparatedError
from linkplan.planner.proof.walk import Blocks, blocks_of

# A crank of 0.3 m, a rod of 0.8 m and a slider on the axis.
CRANK, ROD = 0.3, 0.8
MODEL = """<mujoco><worldbody>
<body><joint name="O" axis="0 -1 0"/><inertial pos="0.1 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
<body pos="0.3 0 0"><joint name="A" axis="0 -1 0"/><inertial pos="0.4 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
<site name="tip" pos="0.8 0 0"/></body></body>
<body pos="1.1 0 0"><joint name="P" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<site name="pin"/></body></worldbody><equality><connect site1="tip" site2="pin"/></equality>
<actuator><motor joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def blocks() -> Blocks:
    mechanism = load_mechanism(MODEL)
    assert [mechanism.joints[i].name for i in mechanism.independent] == ["O"]
    return blocks_of(mechanism)


def root(s: float, exactly=math) -> list:
    """Return the rod's angle to the crank [rad] and the slider's place from home [m]."""
    lean = exactly.asin(-CRANK / ROD * exactly.sin(s))
    return [lean - s, CRANK * exactly.cos(s) + ROD * exactly.cos(lean) - CRANK - ROD]


@pytest.mark.parametrize("s", [0.4, 2.0, -1.3])
@pytest.mark.parametrize("off", [0.0, 1e-3, 0.2])
def test_newton_s_method_finds_the_root_near_a_guess(blocks, s, off):
    found = newton(blocks, np.array([s]), np.array(root(s)) + off)
    np.testing.assert_allclose(found, root(s), atol=1e-13)


def test_newton_s_method_says_where_it_does_not_converge(blocks):
    for guess in ([math.pi / 2 - 0.4, 0.0], [1e9, 1e9]):  # the rod across the guide, where J_z is singular
        with pytest.raises(NotSeparatedError):
            newton(blocks, np.array([0.4]), np.array(guess))


@pytest.mark.parametrize(("s", "width"), [(0.4, 0.0), (0.4, 1e-3), (2.0, 0.05)])
def test_krawczyk_s_enclosure_has_the_roots_of_all_positions_of_a_box_and_little_else(blocks, s, width):
    found = krawczyk(blocks, [arb(s, width)], np.array(root(s)))
    for at in (s - width, s, s + width):
        for enclosure, region, exact in zip(found.enclosure, found.region, root(at), strict=True):
            assert region.contains(enclosure)
            assert float(enclosure.lower()) - 1e-14 <= exact <= float(enclosure.upper()) + 1e-14
    assert all(float(enclosure.rad()) <= 3.0 * width + 1e-14 for enclosure in found.enclosure)


def test_a_guess_off_the_root_is_corrected_as_long_as_the_operator_contracts(blocks):
    for off, known in ((1e-6, True), (1e-2, True), (0.7, False)):
        guess = np.array(root(0.4)) + off
        if not known:
            with pytest.raises(NotSeparatedError):
                krawczyk(blocks, [arb(0.4)], guess)
            continue
        found = krawczyk(blocks, [arb(0.4)], guess)
        for enclosure, exact in zip(found.enclosure, root(0.4), strict=True):
            assert float(enclosure.lower()) - 1e-14 <= exact <= float(enclosure.upper()) + 1e-14
            assert float(enclosure.rad()) < 10 * off**2 + 1e-14


class Series:
    """The functions of flint's series that the closed form needs."""

    asin = staticmethod(lambda x: x.asin())
    sin = staticmethod(lambda x: x.sin())
    cos = staticmethod(lambda x: x.cos())


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 7, 8, 9, 12])
def test_a_series_along_a_motion_has_the_closed_form_s_coefficients(blocks, order):
    ctx.cap = order
    s = arb_series([0.4, 1.5, -0.7, 0.3], prec=order)
    start = krawczyk(blocks, [s[0]], np.array(root(0.4))).enclosure
    found = series_of(blocks, [s], start, order)
    ctx.cap = order
    for one, exact in zip(found, root(s, Series), strict=True):
        assert [float(one[k].mid()) for k in range(order)] == pytest.approx(
            [float(exact[k].mid()) for k in range(order)], rel=1e-12, abs=1e-12
        )
