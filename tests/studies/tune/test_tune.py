"""Gains from requirements: what is asked for is met at every angle, or a sentence says why not."""

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.controllers.sampling import augmented
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.frequency.feedback_loops import feedback_loop, law_gain, operating_point, sampled_law
from linkplan.studies.feedback.frequency.margins import damping_ratio, margins, settling_time_s
from linkplan.studies.feedback.tune.requirements import Requirements
from linkplan.studies.feedback.tune.tune import Tuning, tune
from linkplan.studies.feedback.tune.tune_report import tracking_table
from linkplan.studies.output.text import text_of
from tests.support.oscillators import inertia_alone, mass_on_a_spring
from tests.support.tolerances_loops import GAINS_SCALED

ANGLES_DEG = (-49.0, 3.6, 56.0)


def tuned(payload, law, bandwidth_hz, phase_margin_deg, period_s, delay=0.0, peak=np.inf):
    """Return the tuning of the knee."""
    mechanism = load_mechanism("optimus-knee", payload=payload)
    points = [operating_point(mechanism, np.radians([angle])) for angle in ANGLES_DEG]
    wanted = Requirements(bandwidth_hz=bandwidth_hz, phase_margin_deg=phase_margin_deg, sensitivity_peak=peak)
    settings = Tracking(period_s=period_s, delay_periods=delay)
    return tune(points, wanted, sampled_law(mechanism, law, settings, mechanism.effort_limit))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("payload", "law", "bandwidth", "phase", "period", "delay"),
    [(None, "pd", 100.0, 60.0, 1e-3, 0), ("shank", "pd", 30.0, 60.0, 1e-3, 1), ("shank", "lqr", 30.0, 50.0, 1e-3, 1)],
)
def test_gains_found_do_what_is_wanted_at_every_angle(payload, law, bandwidth, phase, period, delay):
    found = tuned(payload, law, bandwidth, phase, period, delay)
    assert found.found
    # A second look, from the gains alone.
    mechanism, settings = found.mechanism, found.best.law.settings
    for point in [loop.point for loop in found.points]:
        gain = law_gain(point, law, settings, mechanism.effort_limit)
        bounds = margins(feedback_loop(point, gain, found.best.law.timing))
        assert bounds.stable
        assert (bounds.bandwidth_hz or np.inf) >= bandwidth  # none: it reaches the Nyquist frequency
        assert bounds.phase_margin_deg >= phase


@pytest.mark.slow
def test_a_velocity_weight_of_an_lqr_that_is_found_has_an_effect():
    found = tuned("shank", "lqr", 30.0, 60.0, 1e-4)
    settings, limit, point = found.best.law.settings, found.mechanism.effort_limit, found.points[0].point
    stiffer = settings.replace(lqr_velocity_deg_s=settings.lqr_velocity_deg_s / 3)
    damping, more = (law_gain(point, "lqr", one, limit)[0, 1] for one in (settings, stiffer))
    assert more > 1.02 * damping


@pytest.mark.slow
def test_a_sensitivity_peak_is_kept():
    loose, tight = tuned(None, "pd", 60.0, 30.0, 1e-3), tuned(None, "pd", 60.0, 30.0, 1e-3, peak=1.4)
    assert tight.found
    assert tight.best.worst("sensitivity_peak", largest=True)[0] <= 1.4
    assert loose.best.worst("sensitivity_peak", largest=True)[0] > 1.4


@pytest.mark.slow
def test_what_cannot_be_is_refused_in_a_sentence_with_its_reason():
    found = tuned(None, "pd", 300.0, 60.0, 1e-3, 2)
    assert not found.found
    assert "cannot give 300 Hz and 60 deg" in found.message
    said = [line for line in tracking_table(found).splitlines() if line.startswith("#")]
    assert max(map(len, said)) <= 110  # it was one line of four hundred letters
    assert " ".join(line.removeprefix("# ") for line in said) == found.message
    # A hold of 1 ms and a delay of 2 ms: 2.5 ms at 300 Hz.
    assert f"{360 * 300 * 2.5e-3:.3g} deg" in found.message
    assert any(f"O = {angle:.4g} deg" in found.message for angle in ANGLES_DEG)


def test_gains_of_an_inertia_grow_with_the_square_and_the_first_power_of_the_bandwidth():
    mechanism = load_mechanism(inertia_alone(0.05, 3.0))
    point = operating_point(mechanism, np.zeros(1))
    law = sampled_law(mechanism, "pd", Tracking(period_s=1e-4), mechanism.effort_limit)
    kp, kd = [], []
    for bandwidth in (5.0, 10.0):
        wanted = Requirements(bandwidth_hz=bandwidth, phase_margin_deg=60.0)
        found = tune([point], wanted, law)
        assert found.found
        kp.append(found.best.law.settings.kp)
        kd.append(found.best.law.settings.kd)
    assert kp[1] / kp[0] == pytest.approx(4.0, rel=GAINS_SCALED)
    assert kd[1] / kd[0] == pytest.approx(2.0, rel=GAINS_SCALED)


def test_the_motors_side_sees_gains_through_the_square_of_its_gear():
    oscillator = mass_on_a_spring(gear=5.0)
    mechanism = load_mechanism(oscillator.mjcf)
    point = operating_point(mechanism, np.array([oscillator.position]))
    wanted = Requirements(bandwidth_hz=10.0, phase_margin_deg=40.0)
    found = tune([point], wanted, sampled_law(mechanism, "pd", Tracking(period_s=1e-3), mechanism.effort_limit))
    (motor,) = found.motors
    assert motor.is_constant
    assert motor.kp == pytest.approx(found.best.law.settings.kp / 25)
    # The effort of the actuator at a joint's error e is kp e / gear, at the motor's own motion gear e: kp / gear^2.
    gain = law_gain(point, "pd", found.best.law.settings, mechanism.effort_limit)
    assert gain[0, 0] / 5.0 == pytest.approx(motor.kp)
    assert "N/m" in text_of(found.blocks())
    assert motor.gear == 5.0
    assert found.gains["motor_side"] == found.motors


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"bandwidth_hz": 10.0, "phase_margin_deg": 190.0}, "0 to 180"),
        ({"bandwidth_hz": 10.0, "phase_margin_deg": 60.0, "sensitivity_peak": 0.9}, "above 1"),
    ],
)
def test_wanted_nonsense_is_refused(values, words):
    with pytest.raises(LinkplanError, match=words):
        Requirements(**values)


def test_a_bandwidth_beyond_nyquist_is_refused():
    with pytest.raises(LinkplanError, match="Nyquist"):
        tuned(None, "pd", 600.0, 60.0, 1e-3)


def test_positions_of_a_slide_are_no_angles():
    mechanism = load_mechanism(mass_on_a_spring().mjcf)
    points = [operating_point(mechanism, np.array([position])) for position in (0.0, 0.1)]
    law = sampled_law(mechanism, "pd", Tracking(period_s=2e-3), mechanism.effort_limit)
    found = tune(points, Requirements(bandwidth_hz=10.0, phase_margin_deg=60.0), law)
    assert "10 Hz and 60 deg at all 2 poses, sampled" in found.message


# A four-bar whose inertia changes fifteenfold: 30 Hz and 50 deg with a delay are met only by a loop that creeps for seconds.
FOUR_BAR = """<mujoco><compiler angle="degree" autolimits="true"/><option timestep="0.0002"/><worldbody>
<body name="crank" pos="0 0 1" euler="0 -67.25 0"><joint name="J1" axis="0 1 0" damping="0.01" armature="0.0008"
 range="-112.75 112.75"/><inertial pos="-0.0171764 0 0.1167173" mass="1.25981" diaginertia="0.0052311 0.0052311 0.0052311"/>
<body name="coupler" pos="0 0 0.22196551582805346" euler="0 238.80836311623435 0"><joint name="J2" axis="0 1 0"/>
<inertial pos="-0.0353925 0 0.0841411" mass="0.8464220" diaginertia="0.0029929 0.0029929 0.0029929"/>
<site name="tip" pos="0 0 0.26191718141585807"/></body></body>
<body name="rocker" pos="0.16135985711961665 0 1" euler="0 -117.87051600108566 0"><joint name="J3" axis="0 1 0"
 damping="0.005"/><inertial pos="-0.0430349 0 0.1888777" mass="1.5614725" diaginertia="0.0272916 0.0272916 0.0272916"/>
<site name="pin" pos="0 0 0.3705932079874623"/></body></worldbody>
<equality><connect name="B" site1="tip" site2="pin" solref="0.0004 1" solimp="0.9999 0.9999 0.001"/></equality>
<actuator><motor name="drive" joint="J1" ctrlrange="-50 50"/></actuator></mujoco>"""


@pytest.mark.slow
@pytest.mark.parametrize("phase_margin_deg", [50.0, 40.0])
def test_gains_settle_an_error_within_cycles_of_the_bandwidth_and_not_after_seconds(phase_margin_deg):
    mechanism = load_mechanism(FOUR_BAR)
    points = [operating_point(mechanism, np.radians([angle])) for angle in (-110.49, 0.0, 45.1, 110.49)]
    wanted, settings = (
        Requirements(bandwidth_hz=30.0, phase_margin_deg=phase_margin_deg),
        Tracking(period_s=1e-3, delay_periods=1),
    )
    found = tune(points, wanted, sampled_law(mechanism, "pd", settings, mechanism.effort_limit))
    assert found.found is (phase_margin_deg < 50.0)
    for judged in found.points:
        point = judged.point
        gain = law_gain(point, "pd", found.best.law.settings, mechanism.effort_limit)
        loop = feedback_loop(point, gain, found.best.law.timing)
        # The state after the time in which an error is to settle, from the loop's own steps.
        steps = round(wanted.settling_s / 1e-3)
        after = np.linalg.matrix_power(loop.matrix, steps)[0, 0]
        assert abs(after) < 0.05
        # A steady torque on the joint moves it by the torque over the stiffness.
        _, push = augmented(loop.A, loop.B, loop.B_late, loop.timing)
        steady = np.linalg.solve(np.eye(len(loop.matrix)) - loop.matrix, push[:, 0])
        assert steady[0] == pytest.approx(1.0 / judged.stiffness_at_rest, rel=1e-3)


def test_the_table_of_worst_values_states_the_level_of_the_bandwidth_and_the_stiffness():
    mechanism = load_mechanism(inertia_alone(0.05, 3.0))
    law = sampled_law(mechanism, "pd", Tracking(period_s=1e-4), mechanism.effort_limit)
    wanted = Requirements(bandwidth_hz=5.0, phase_margin_deg=60.0)
    found = tune([operating_point(mechanism, np.zeros(1))], wanted, law)
    shown = " ".join(text_of(found.blocks()).split())
    assert f"bandwidth -3 dB [Hz] 5 {found.best.worst('bandwidth_hz')[0]:.4g}" in shown
    assert f"stiffness at rest [N.m/rad] {found.best.law.settings.kp:.4g}" in shown


def test_poles_of_a_second_order_system_have_its_damping_ratio_and_settle_with_its_slowest():
    poles = np.exp(1e-3 * np.array([[-3.0 + 4.0j, -3.0 - 4.0j], [-2.0, -20.0]]))
    np.testing.assert_allclose(damping_ratio(poles), [0.6, 1.0], rtol=1e-12)
    np.testing.assert_allclose(settling_time_s(poles, 1e-3), np.log(50.0) / np.array([3.0, 2.0]), rtol=1e-9)
    assert np.isinf(settling_time_s(np.array([1.01]), 1e-3))


def test_all_points_of_the_figure_are_inside_its_axes():
    figure = tuned("shank", "pd", 30.0, 60.0, 1e-3, 1).plot()
    for axes in figure.axes:
        for line in axes.lines:
            values = np.asarray(line.get_ydata(), dtype=float)
            low, high = axes.get_ylim()
            assert (values >= low).all()
            assert (values <= low + 0.95 * (high - low)).all(), axes.get_ylabel()


def test_bandwidths_of_more_than_a_decade_are_on_a_logarithmic_axis():
    mechanism = load_mechanism("optimus-knee")
    points = [operating_point(mechanism, np.radians([angle])) for angle in (0.0, 76.8)]  # far from and next to a dead centre
    law = sampled_law(mechanism, "pd", Tracking(period_s=1e-4), mechanism.effort_limit)
    found = tune(points, Requirements(bandwidth_hz=10.0, phase_margin_deg=60.0), law)
    axes = found.plot().axes[0]
    values = np.asarray(axes.lines[0].get_ydata(), dtype=float)
    assert values.max() > 10 * values.min() >= 100.0
    assert axes.get_yscale() == "log"
    assert axes.get_ylim()[0] < 10.0


MASS_KG, LENGTH_M, ANGLE = 2.0, 0.5, np.radians(20.0)
# A mass on a light rod that hangs: its weight gives the hinge a stiffness of m g l cos(angle).
HANGING = f"""<mujoco><option timestep="5e-4" integrator="implicitfast"/><worldbody>
  <body><joint name="arm" axis="0 1 0" damping="0.1"/>
    <inertial mass="{MASS_KG}" pos="0 0 {-LENGTH_M}" diaginertia="1e-3 1e-3 1e-3"/>
  </body></worldbody><actuator><motor name="m" joint="arm" ctrlrange="-50 50"/></actuator></mujoco>"""
WEIGHT_STIFFNESS = MASS_KG * 9.81 * LENGTH_M * np.cos(ANGLE)
PERIOD_S = 1e-3


def point_and_law():
    mechanism = load_mechanism(HANGING)
    law = sampled_law(mechanism, "pd", Tracking(period_s=PERIOD_S), mechanism.effort_limit)
    return operating_point(mechanism, np.array([ANGLE])), law


def tuned_at_rest(bandwidth_hz: float, **wanted) -> Tuning:
    point, law = point_and_law()
    return tune([point], Requirements(bandwidth_hz=bandwidth_hz, phase_margin_deg=60.0, **wanted), law)


def test_a_weak_loop_has_the_response_at_rest_of_weight_and_gain_and_no_bandwidth():
    point, law = point_and_law()
    for kp in (3.0, 30.0):
        settings = Tracking(kp=kp, kd=2.0, period_s=PERIOD_S)
        found = margins(feedback_loop(point, law_gain(point, "pd", settings, law.effort_limit), law.timing))
        assert found.response_at_rest == pytest.approx(kp / (kp + WEIGHT_STIFFNESS), rel=1e-9)
        assert found.stiffness_at_rest == pytest.approx(kp + WEIGHT_STIFFNESS, rel=1e-9)
        assert (found.bandwidth_hz == 0.0) == (kp < WEIGHT_STIFFNESS)  # below -3 dB from the start


@pytest.mark.parametrize("bandwidth_hz", [0.3, 1.0, 4.0])
def test_gains_settle_within_five_percent_of_a_small_step_in_mujoco(bandwidth_hz):
    found = tuned_at_rest(bandwidth_hz)
    assert found.found
    (loop,) = found.best.loops
    settings, step = found.best.law.settings, np.radians(0.5)
    model = mujoco.MjModel.from_xml_string(HANGING)
    data = mujoco.MjData(model)
    data.qpos[0] = ANGLE
    hold = MASS_KG * 9.81 * LENGTH_M * np.sin(ANGLE)
    for _ in range(int(20 / PERIOD_S)):
        data.ctrl[0] = hold + settings.kp * (ANGLE + step - data.qpos[0]) - settings.kd * data.qvel[0]
        mujoco.mj_step(model, data, int(PERIOD_S / model.opt.timestep))
    reached = (data.qpos[0] - ANGLE) / step
    assert reached >= 0.949
    assert reached == pytest.approx(loop.response_at_rest, abs=2e-3)  # the weight's stiffness changes over the step


def test_a_named_stiffness_replaces_the_response_at_rest():
    found = tuned_at_rest(1.0, stiffness=20.0)
    assert found.found
    (loop,) = found.best.loops
    assert loop.stiffness_at_rest >= 20.0
    assert loop.response_at_rest < 0.95
    assert "stiffness at rest" in text_of(found.blocks())


def test_a_stiffness_that_no_gain_gives_is_named():
    found = tuned_at_rest(1.0, stiffness=1e7)
    assert not found.found
    assert "stiffness at rest" in found.message or "stable" in found.message


def test_bode_states_the_response_at_rest_of_a_joint_that_sags():
    mechanism = load_mechanism(HANGING)
    weak, strong = (
        text_of(
            bode_study(mechanism, np.array([[ANGLE]]), Tracking(kp=kp, kd=2.0), mechanism.effort_limit, scanned=0).summary()
        )
        for kp in (3.0, 300.0)
    )
    assert "response at rest" in weak
    assert "response at rest" not in strong


@pytest.mark.slow
def test_the_curve_between_the_poses_is_that_of_the_loop_there():
    found = linkplan.tune("slider-crank", bandwidth_hz=5.0, phase_margin_deg=50.0)
    (phase,) = [plot for plot in found.blocks() if getattr(plot, "title", "").startswith("Phase margin over")]
    curve, looked_at = phase.series[:2]
    assert len(curve.x) >= len(looked_at.y) + 30
    again = linkplan.bode(
        "slider-crank", tracking=found.tracking, at_deg=[{"O": curve.x[k]} for k in (3, 12)], measure=False
    )
    assert [curve.y[k] for k in (3, 12)] == pytest.approx([one.phase_margin_deg for one in again.points], rel=1e-2)
    joined = np.interp(curve.x, phase.x, looked_at.y)
    assert np.abs(joined - np.array(curve.y)).max() > 5.0  # a line between the poses would be wrong
