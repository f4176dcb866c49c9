"""What limits on effort, power and pin forces leave at a place and a speed, in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.phase_plane.leg_field import AT_FORCE, AT_POWER, LegField, PinForces
from linkplan.planner.phase_plane.power_legs import Leg

SPEED = 2.0


def pin(still: tuple, by_effort: tuple, square: tuple = (0.0, 0.0), linear: tuple = (0.0, 0.0)) -> PinForces:
    """Return the forces of one pin with two components, in shares of its rating."""
    curves = np.array([still, square, linear, by_effort])
    return PinForces(curves=lambda _: curves, rows=(slice(0, 2),))


@pytest.mark.parametrize("still", [(0.6, 0.0), (0.0, 0.6), (-0.6, 0.3)])
def test_at_the_least_and_largest_effort_a_pin_bears_its_rating(still):
    by = np.array([0.5, 0.25])
    least, most, bears = pin(still, tuple(by)).efforts(0.0, SPEED)
    assert bears.all()
    assert least[0] < most[0]
    for effort in (least[0], most[0]):
        assert np.linalg.norm(np.array(still) + by * effort) == pytest.approx(1.0, rel=1e-12)


def test_a_pin_force_grows_with_speed_and_its_square():
    moving = pin((0.1, 0.0), (0.5, 0.0), square=(0.05, 0.0), linear=(-0.03, 0.0)).efforts(0.0, SPEED)
    still = pin((0.1 + 0.05 * SPEED**2 - 0.03 * SPEED, 0.0), (0.5, 0.0)).efforts(0.0, 0.0)
    np.testing.assert_allclose(moving, still)


def test_beyond_what_any_effort_relieves_a_pin_bears_none():
    least, most, bears = pin((0.0, 1.5), (0.5, 0.0)).efforts(0.0, SPEED)
    assert not bears.any()
    assert least == most == pytest.approx(0.0)


def field(power: float, way: float = 1.0) -> LegField:
    """Return the field of 2 a = 1 - 0.5 v^2 - 0.25 v + 3 u, with u from -4 to 5."""
    curves = np.array([2.0, 1.0, -0.5, -0.25, 3.0])
    limit = np.array([[-4.0, 5.0]])
    none = np.full((1, 2), np.inf)
    return LegField(curves=lambda _: curves, effort=limit, power=np.array([[-power, power]]), line=none, way=way)


@pytest.mark.parametrize(("way", "towards", "effort"), [(1, True, 5), (1, False, -4), (-1, True, -4), (-1, False, 5)])
def test_without_a_power_limit_the_effort_that_pushes_or_brakes_is_at_its_limit(way, towards, effort):
    held, efforts, a = field(np.inf, way).at(0.0, way * SPEED, towards=towards)
    assert (held[0], efforts[0]) == (np.sign(effort), effort)
    assert a == pytest.approx((1.0 - 0.5 * SPEED**2 - 0.25 * way * SPEED + 3 * effort) / 2)


@pytest.mark.parametrize(("towards", "sign"), [(True, 1), (False, -1)])
def test_where_the_effort_s_limit_exceeds_the_power_the_power_is_held(towards, sign):
    held, efforts, _ = field(12.0).at(0.0, SPEED, towards=towards)
    assert held[0] == sign * AT_POWER
    assert efforts[0] * 3 * SPEED == pytest.approx(sign * 12.0)


@pytest.mark.parametrize(("still", "keeps"), [(0.0, True), (4.0, False), (-4.0, False)])
def test_a_state_is_kept_only_by_an_effort_that_the_actuator_and_the_pin_both_bear(still, keeps):
    """The pin bears efforts from -2 - 2 F to 2 - 2 F, F its force without effort, and the actuator from -4 to 5."""
    limited = replace(field(np.inf), pins=pin((still, 0.0), (0.5, 0.0)))
    at, speed = np.zeros(1), np.array([SPEED])
    limited = replace(limited, curves=lambda _: np.array([[2.0, 1.0, -0.5, -0.25, 3.0]]))
    for towards in (True, False):
        assert limited.keeps(at, speed, limited.at(at, speed, towards=towards)[1]) is keeps


def two_pins(first: tuple[float, float], second: tuple[float, float]) -> PinForces:
    """Return two pins that bear efforts between these: |F + u / 2| <= 1 of either, scaled to its range."""
    by = [2.0 / (high - low) for low, high in (first, second)]
    still = [-b * (low + high) / 2 for b, (low, high) in zip(by, (first, second), strict=True)]
    curves = np.array([[still[0], 0.0, still[1], 0.0], np.zeros(4), np.zeros(4), [by[0], 0.0, by[1], 0.0]])
    return PinForces(curves=lambda _: curves, rows=(slice(0, 2), slice(2, 4)))


@pytest.mark.parametrize(("first", "second", "tighter"), [((-2, 2), (-1, 1), 1), ((-1, 1), (-2, 2), 0)])
@pytest.mark.parametrize("towards", [True, False])
def test_the_tighter_of_two_pins_holds_the_effort(first, second, tighter, towards):
    of, effort = replace(field(np.inf), pins=two_pins(first, second)), 1.0 if towards else -1.0
    for limit in (1.5, 9.0):
        limited = replace(of, effort=np.array([[-limit, limit]]))
        held, efforts, a = limited.at(0.0, SPEED, towards=towards)
        assert (held[0], efforts[0]) == ((AT_FORCE + tighter) * effort, pytest.approx(effort))
        assert a == pytest.approx((1.0 - 0.5 * SPEED**2 - 0.25 * SPEED + 3 * effort) / 2)
    assert kept(of, towards)


@pytest.mark.parametrize("towards", [True, False])
def test_no_effort_keeps_two_pins_that_contradict_each_other(towards):
    assert kept(replace(field(np.inf), pins=two_pins((-2.0, 2.0), (1.0, 3.0))), towards)
    assert not kept(replace(field(np.inf), pins=two_pins((-2.0, 2.0), (3.0, 4.5))), towards)
    assert not kept(replace(field(np.inf), pins=two_pins((3.0, 4.5), (-2.0, 2.0))), towards)


def kept(limited: LegField, towards: bool = True) -> bool:
    limited = replace(limited, curves=lambda _: np.array([[2.0, 1.0, -0.5, -0.25, 3.0]]))
    at, speed = np.zeros(1), np.array([SPEED])
    return limited.keeps(at, speed, limited.at(at, speed, towards=towards)[1])


@pytest.mark.parametrize("towards", [True, False])
def test_a_state_at_the_power_s_limit_is_kept(towards):
    loose = replace(field(12.0), pins=pin((0.0, 0.0), (1e-3, 0.0)))
    assert abs(loose.at(0.0, SPEED, towards=towards)[0][0]) == AT_POWER
    assert kept(loose, towards)


def test_arcs_end_where_the_power_comes_to_its_limit():
    """Accelerated evenly from rest at 2 m/s2, 5 N.m spend 12 W from 0.8 rad/s on, which is 0.4 s after the leg began."""
    limited = field(12.0)
    leg = Leg(
        field=limited,
        state=lambda t: np.array([t**2, 2.0 * t]),
        steps=np.linspace(-1.0, 3.0, 9),
        towards=True,
        begin=0.1,
        end=1.3,
        later=10.0,
    )
    (bang, first), (end, last) = leg.arcs()
    assert (first, last) == ((1,), (AT_POWER,))
    assert (bang, end) == pytest.approx((10.4, 11.3), abs=1e-12)
    assert (leg.time_at(0.25), leg.speed_at(0.25)) == pytest.approx((0.5, 1.0))
    # Four looks in each step of the integration: in the middles of its quarters.
    np.testing.assert_allclose(leg._looks()[:5], [0.15, 0.25, 0.35, 0.45, 0.5625])
    assert len(leg._looks()) == 12
