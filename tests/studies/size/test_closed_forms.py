"""Sized motors against closed forms: a turned inertia in least time and in a given one, and the slider-crank's energies."""

import numpy as np
import pytest
import scipy

import linkplan
from tests.support.bodies import HINGE, HINGE_INERTIA, TURN
from tests.support.slider_crank import inertia, potential

PEAK, ROTOR = 2.0, 3e-3
GEARS = [2.0, 5.0, 10.0, 20.0, 40.0]


def quarter_turn(**motion) -> linkplan.Problem:
    return linkplan.Problem.reach(HINGE, start_deg={"J": 10.0}, goal_deg={"J": 100.0}, **motion)


def least_time(gear: float, rotor: float = ROTOR) -> float:
    """Return the least time [s] of the quarter turn: the joint's full torque forth and back on both inertias."""
    return 2.0 * np.sqrt(TURN * (HINGE_INERTIA + gear**2 * rotor) / (gear * PEAK))


@pytest.mark.slow
def test_least_times_are_those_of_the_inertia_with_the_reflected_rotor_and_the_best_gear_is_first():
    motors = [{"name": "M", "peak_effort": PEAK, "rms_effort": PEAK / 2, "rotor_inertia": ROTOR, "gears": GEARS}]
    found = linkplan.size(quarter_turn(minimize="time"), motors).sizing
    assert [one.gear for one in found.motors] == sorted(GEARS, key=least_time)
    assert found.motors[0].gear == np.sqrt(HINGE_INERTIA / ROTOR)  # equal inertias on both sides of the gear
    for one in found.motors:
        assert one.duration_s == pytest.approx(least_time(one.gear), rel=1e-7)
        assert one.rotor_share == pytest.approx(one.gear**2 * ROTOR / (HINGE_INERTIA + one.gear**2 * ROTOR), rel=1e-12)
        assert one.rotor_inertia_after_gear == pytest.approx(one.gear**2 * ROTOR, rel=1e-12)
        # The effort is at its limit throughout, twice what the motor may give in the mean: three times as long a rest.
        assert one.loads.rms_share == pytest.approx(2.0, rel=1e-6)
        assert one.loads.needed_rest_s == pytest.approx(3.0 * least_time(one.gear), rel=1e-6)
        assert not one.does
        assert "beyond its limit of 1 N.m; with a rest of" in one.reason
        assert one.margin == pytest.approx(-1.0, rel=1e-6)
        assert one.speed_up is None
    rest_s = 3.01 * max(map(least_time, GEARS))
    rested = linkplan.size(quarter_turn(minimize="time"), motors, rest_s=rest_s).sizing.motors
    assert [(one.gear, one.does) for one in rested] == [(one.gear, True) for one in found.motors]
    shares = [2.0 / np.sqrt(1.0 + rest_s / least_time(one.gear)) for one in rested]
    assert [one.loads.rms_share for one in rested] == pytest.approx(shares, rel=1e-6)


@pytest.mark.slow
def test_a_motor_too_weak_for_the_duration_lacks_what_the_least_peak_says():
    duration, gear = 0.8, 5.0
    least_peak = 4.0 * TURN * (HINGE_INERTIA + gear**2 * ROTOR) / (gear * duration**2)
    assert least_peak < PEAK
    motors = [
        {"name": name, "peak_effort": share * least_peak, "rotor_inertia": ROTOR, "gears": [gear]}
        for name, share in (("weak", 0.7), ("strong", 3.0))
    ]
    found = linkplan.size(quarter_turn(duration_s=duration, minimize="peak_effort"), motors)
    assert found.passed
    strong, weak = found.sizing.motors
    assert (strong.motor, strong.does, weak.does) == ("strong", True, False)
    assert strong.margin == pytest.approx(1.0 - 1.0 / 3.0, rel=1e-4)
    assert strong.speed_up == pytest.approx(np.sqrt(3.0), rel=1e-4)  # efforts grow with the square of the speed
    assert weak.margin == pytest.approx(1.0 - 1.0 / 0.7, rel=1e-4)
    assert weak.speed_up == pytest.approx(np.sqrt(0.7), rel=1e-4)
    assert "the shortest feasible duration is" in weak.reason


def test_a_line_limits_the_speed_of_a_sinusoid_as_its_root_says():
    """q = A sin(w t) of an inertia: u = -n_I A w^2 sin, speed n A w cos, and the line holds at every instant."""
    gear, stall, no_load, amplitude, w = 4.0, 8.0, 40.0, np.radians(60.0), 2 * np.pi
    total = HINGE_INERTIA / gear + gear * ROTOR
    motor = {"name": "M", "peak_effort": 7.0, "stall_effort": stall, "no_load_speed_deg_s": np.degrees(no_load)}
    problem = linkplan.Problem.track(HINGE, reference={"amplitude_deg": {"J": 60.0}, "frequency_hz": 1.0})
    (one,) = linkplan.size(problem, [motor | {"rotor_inertia": ROTOR, "gears": [gear]}]).sizing.motors

    def share(rate: float) -> float:
        return float(np.hypot(total * amplitude * (w * rate) ** 2 / stall, gear * amplitude * w * rate / no_load))

    assert one.tightest == "torque-speed line"
    assert one.loads.line_share == pytest.approx(share(1.0), rel=1e-5)
    assert one.margin == pytest.approx(1.0 - share(1.0), rel=1e-4)
    root = scipy.optimize.brentq(lambda rate: share(rate) - 1.0, 0.1, 10.0, xtol=1e-12)
    assert total * amplitude * (w * root) ** 2 < 7.0  # the line binds before the peak effort
    assert one.speed_up == pytest.approx(root, rel=1e-5)


def crank_terms(th: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return I, I' / 2 and V' (n,) of the bare crank at its angles, derivatives by central differences."""
    h = 1e-5
    at, above, below = ([np.array([x + d]) for x in th] for d in (0.0, h, -h))
    slopes = [
        np.array([of(x) for x in above]).ravel() - np.array([of(x) for x in below]).ravel() for of in (inertia, potential)
    ]
    return np.array([inertia(x) for x in at]).ravel(), slopes[0] / (4 * h), slopes[1] / (2 * h)


@pytest.mark.slow
def test_a_prescribed_turn_of_the_crank_loads_each_gear_as_the_closed_form_s_inverse_dynamics():
    amplitude, bias, frequency, rotor = np.radians(80.0), np.radians(90.0), 2.0, 4e-6
    time = np.linspace(0.0, 1.0 / frequency, 4001)
    w = 2 * np.pi * frequency
    th, v, a = bias + amplitude * np.sin(w * time), amplitude * w * np.cos(w * time), -amplitude * w**2 * np.sin(w * time)
    mass, bend, weight = crank_terms(th)
    joint = mass * a + bend * v**2 + weight
    loads = {gear: joint / gear + gear * rotor * a for gear in (1.0, 4.0, 12.0)}
    limit = 1.3 * np.abs(loads[4.0]).max()
    reference = {"amplitude_deg": {"O": 80.0}, "bias_deg": {"O": 90.0}, "frequency_hz": frequency}
    problem = linkplan.Problem.track("slider-crank", reference=reference)
    motor = {"name": "M", "peak_effort": limit, "rms_effort": limit, "rotor_inertia": rotor, "gears": list(loads)}
    found = linkplan.size(problem, [motor]).sizing
    for one in found.motors:
        own = loads[one.gear]
        assert one.loads.peak_effort == pytest.approx(np.abs(own).max(), rel=1e-4)  # of samples
        assert one.loads.rms_effort == pytest.approx(np.sqrt(np.trapezoid(own**2, time) * frequency), rel=1e-6)
        assert one.margin == pytest.approx(1.0 - np.abs(own).max() / limit, abs=2e-4)
        assert one.does == (np.abs(own).max() <= limit)
    assert {one.does for one in found.motors} == {True, False}

    def excess(rate: float) -> float:
        return float(np.abs(rate**2 * ((mass * a + bend * v**2) / 4 + 4 * rotor * a) + weight / 4).max()) - limit

    (middle,) = (one for one in found.motors if one.gear == 4.0)
    assert middle.speed_up == pytest.approx(scipy.optimize.brentq(excess, 1.0, 3.0), rel=1e-5)


def test_a_warm_motor_is_slowed_down_until_its_rms_effort_is_within_its_limit():
    """A pure inertia's rms effort is proportional to the square of the speed."""
    peak = 4.0 * TURN * HINGE_INERTIA / 0.8**2
    motor = {"name": "M", "peak_effort": 2 * peak, "rms_effort": 0.5 * peak, "rotor_inertia": 0.0}
    (one,) = linkplan.size(quarter_turn(duration_s=0.8), [motor]).sizing.motors
    rms = np.sqrt(12.0) * HINGE_INERTIA * TURN / 0.8**2  # of the least effort, linear in time
    assert one.loads.rms_effort == pytest.approx(rms, rel=1e-6)
    assert not one.does
    assert one.speed_up == pytest.approx(np.sqrt(0.5 * peak / rms), rel=1e-6)
