"""Borders of stability: critical damping gains, delay margins, periods and maps, against MuJoCo's own runs beside them."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.controllers.sampling import sampling
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.feedback.frequency.feedback_loops import SIMULATED, feedback_loop, operating_point
from linkplan.studies.feedback.frequency.margins import delay_margin, margins
from linkplan.studies.feedback.frequency.quick import quick_loops
from linkplan.studies.feedback.frequency.simulated_loops import settle_trials
from linkplan.studies.feedback.frequency.stability_map import (
    critical_kd,
    longest_period,
    pd_gains,
    pd_loop,
    radii,
    stability_map,
)
from tests.support.oscillators import inertia_alone
from tests.support.tolerances_loops import CRITICAL_KD, DELAY_MARGIN, LONGEST_PERIOD, MARGIN, QUICK, QUICK_DEG, RADIUS

NINE_DEG = np.linspace(-49.07, 56.27, 9)
# The critical gain predicted brackets MuJoCo's own border within this. Measured 5e-4.
BORDER = 0.02
# A delay this much below its margin is stable in MuJoCo, this much above it is not.
DELAY = 0.05


@pytest.fixture(scope="module")
def knee():
    return load_mechanism("optimus-knee")


def at(mechanism, degrees):
    return operating_point(mechanism, np.radians([degrees]))


def test_critical_kd_of_an_inertia_is_two_j_over_t():
    mechanism = load_mechanism(inertia_alone(0.05))
    point = operating_point(mechanism, np.zeros(1))
    timing = sampling(mechanism, 1e-3)
    # z = -1 is a root where 4 - 2 kd T / J - kp T^2 / J = 0 in MuJoCo's steps.
    for kp in (5.0, 500.0, 5000.0):
        assert critical_kd(point, kp, timing)[1] == pytest.approx(2 * 0.05 / 1e-3 - kp * 1e-3 / 2, rel=CRITICAL_KD)


def test_critical_kd_brackets_mujocos_own_border_at_nine_angles(knee):
    timing = sampling(knee, 1e-4)
    points = [at(knee, angle) for angle in NINE_DEG]
    critical = [critical_kd(point, 200.0, timing)[1] for point in points]
    below = [pd_loop(point, 200.0, kd * (1 - BORDER), timing) for point, kd in zip(points, critical, strict=True)]
    above = [pd_loop(point, 200.0, kd * (1 + BORDER), timing) for point, kd in zip(points, critical, strict=True)]
    assert settle_trials(below, knee.effort_limit).all()
    assert not settle_trials(above, knee.effort_limit).any()


# A light four-bar that holds a mass on its rocker.
LIGHT = """<mujoco><option timestep="2e-3"/><worldbody>
<body><joint name="crank" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .03" size=".002" mass="1e-3"/>
<body name="coupler" pos="0 0 .03"><joint name="pin" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .06 0 0" size=".002" mass="1e-3"/></body></body>
<body name="rocker" pos=".06 0 0"><joint name="rock" axis="0 1 0"/><geom size=".005" pos=".04 0 .03" mass=".03"/>
<geom type="capsule" fromto="0 0 0 0 0 .03" size=".002" mass="1e-3"/></body></worldbody>
<equality><connect body1="coupler" body2="rocker" anchor=".06 0 0" {solref}/></equality>
<actuator><motor joint="crank" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize("solref", ["", 'solref=".04 1"'])
def test_a_loop_whose_soft_closures_sink_under_the_weight_settles_all_the_same(solref):
    """At first the crank moves up to a thousand times as fast as the kick. Beyond the critical gain it never rests."""
    mechanism = load_mechanism(LIGHT.format(solref=solref))
    timing, point = sampling(mechanism, 2e-3), operating_point(mechanism, np.zeros(1))
    inertia, omega = float(point.inertia[0, 0]), 2 * np.pi * 4
    kp, kd = inertia * omega**2, 2 * inertia * omega
    loops = [pd_loop(point, kp, kd, timing), pd_loop(point, kp, 1.2 * critical_kd(point, kp, timing)[1], timing)]
    assert settle_trials(loops, mechanism.effort_limit).tolist() == [True, False]


PENDULUM = """<mujoco><option timestep="1e-3"/><worldbody><body><joint name="q" axis="0 1 0" damping=".05"/>
<geom type="capsule" fromto="0 0 0 0 0 .3" size=".01" mass="1"/></body></worldbody>
<actuator><motor joint="q" ctrlrange="-10 10"/></actuator></mujoco>"""


@pytest.mark.parametrize("period_s", [5e-3, 0.02, 0.05])
def test_a_pendulum_that_comes_to_rest_where_it_fell_to_has_not_settled(period_s):
    """Upright, it stays where kp > m g l = 1.47 N.m/rad. At 1.2 it falls to 62 deg, in few periods if these are long."""
    mechanism = load_mechanism(PENDULUM)
    timing, point = sampling(mechanism, period_s), operating_point(mechanism, np.zeros(1))
    loops = [pd_loop(point, kp, kd, timing) for kp in (1.2, 2.0) for kd in (0.05, 0.2)]
    assert settle_trials(loops, mechanism.effort_limit).tolist() == [False, False, True, True]


def test_the_gain_reduction_margin_of_a_pendulum_held_upright_is_the_stiffness_over_the_weights():
    mechanism = load_mechanism(PENDULUM)
    found = margins(pd_loop(operating_point(mechanism, np.zeros(1)), 3.0, 0.2, sampling(mechanism, 1e-3)))
    assert found.gain_reduction_margin_db == pytest.approx(20 * np.log10(3.0 / (9.81 * 0.15)), abs=MARGIN)
    hanging = margins(pd_loop(operating_point(mechanism, np.array([np.pi])), 3.0, 0.2, sampling(mechanism, 1e-3)))
    assert hanging.gain_reduction_margin_db is None


def test_the_documents_gains_are_beyond_the_border_at_every_angle_and_within_it_at_a_tenth_of_the_period(knee):
    points = [at(knee, angle) for angle in NINE_DEG]
    for period, stable in ((1e-4, False), (1e-5, True)):
        loops = [pd_loop(point, 200.0, 10.0, sampling(knee, period)) for point in points]
        assert [loop.stable for loop in loops] == [stable] * 9
        assert settle_trials(loops, knee.effort_limit).tolist() == [stable] * 9


@pytest.mark.slow
@pytest.mark.parametrize("angle", [-49.07, 3.6, 56.27])
def test_a_delay_a_little_below_its_margin_is_stable_in_mujoco_and_a_little_above_is_not(knee, angle):
    point = at(knee, angle)
    loop = pd_loop(point, 200.0, 1.0, sampling(knee, 1e-4))
    margin = margins(loop).delay_margin_s
    exact, substeps = delay_margin(loop, margin)
    assert exact == pytest.approx(margin, rel=DELAY_MARGIN)
    timing = replace(loop.timing, substeps=substeps)
    settled = []
    for delay, toward in ((margin * (1 - DELAY), np.floor), (margin * (1 + DELAY), np.ceil)):
        late = replace(timing, delay_steps=int(toward(delay / timing.timestep_s)))
        trial = feedback_loop(point, loop.gain, late, SIMULATED)
        settled.append(bool(settle_trials([trial], knee.effort_limit)[0]))
    assert settled == [True, False]


def test_the_longest_period_of_the_documents_gains_is_the_critical_ones(knee):
    points = [at(knee, angle) for angle in NINE_DEG]
    longest, where = longest_period(points, 200.0, 10.0, 0.0, 1e-4)
    least = min(float(point.inertia[0, 0]) for point in points)
    assert longest == pytest.approx(2 * least / 10.0, rel=LONGEST_PERIOD)
    assert where.name == points[-1].name
    loops = {f: [pd_loop(points[-1], 200.0, 10.0, sampling(knee, f * longest))] for f in (0.97, 1.03)}
    assert settle_trials(loops[0.97], knee.effort_limit).all()
    assert not settle_trials(loops[1.03], knee.effort_limit).any()


@pytest.mark.slow
@pytest.mark.parametrize("payload", [None, "shank"])
def test_a_map_agrees_with_mujoco_on_both_sides_of_its_border(payload):
    mechanism = load_mechanism("optimus-knee", payload=payload)
    points = [at(mechanism, angle) for angle in (-49.07, 3.6, 56.27)]
    timing = sampling(mechanism, 1e-4, 1)
    inertia = float(points[0].inertia[0, 0])
    kp = np.geomspace(1e-6, 0.1, 8) * inertia / 1e-8
    kd = np.geomspace(1e-3, 4.0, 9) * inertia / 1e-4
    found = stability_map(points, timing, kp, kd, mechanism.effort_limit)
    named = {point.name: point for point in points}
    predicted = [pd_loop(named[one.pose], one.kp, one.kd, timing).stable for one in found.tried]
    assert {True, False} == set(predicted)
    assert [one.settles_in_mujoco for one in found.tried] == predicted
    assert [one.stable for one in found.tried] == predicted
    for i, j in ((0, 0), (3, 4), (7, 8), (5, 2)):
        loops = [pd_loop(point, kp[i], kd[j], timing) for point in points]
        assert found.radius[i, j] == pytest.approx(max(loop.radius for loop in loops), rel=RADIUS)
        assert np.isnan(found.phase_margin_deg[i, j]) == (found.radius[i, j] >= 1)


def test_quick_margins_are_the_margins(knee):
    point = at(knee, 56.27)
    timing = sampling(knee, 1e-4, 1)
    kp, kd = np.array([200.0, 20.0, 5.0]), np.array([0.5, 0.1, 0.02])
    quick = quick_loops(point, pd_gains(point, kp, kd), timing, [0])[0]
    assert quick.radius == pytest.approx(radii(point, kp, kd, timing))
    for k in range(3):
        full = margins(pd_loop(point, kp[k], kd[k], timing), refine=False)
        assert quick.phase_margin_deg[k] == pytest.approx(full.phase_margin_deg, abs=QUICK_DEG)
        assert quick.sensitivity_peak[k] == pytest.approx(full.sensitivity_peak, rel=QUICK)
        assert quick.bandwidth_hz[k] == pytest.approx(full.bandwidth_hz or np.inf, rel=QUICK)
