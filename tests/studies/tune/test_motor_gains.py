"""Gains at motors across screws, gears and linkages."""

import control
import numpy as np
import pytest
import scipy.linalg

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.reach import reach
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.frequency.feedback_loops import operating_point, sampled_law
from linkplan.studies.feedback.tune.requirements import Requirements
from linkplan.studies.feedback.tune.tune import Tuning, tune
from linkplan.studies.feedback.tune.tune_report import gain_lines
from tests.support.driven_linkages import MODELS, Linkage
from tests.support.parallel_ankle import ankle_text

RAD_PER_M = 2000.0


def screw_stage(actuator: str, coupling: str = "") -> str:
    """Return a table of 4 kg driven by a screw of 2000 rad/m: as the motor's gear, or as a rotor coupled to the table."""
    rotor = '<body><joint name="motor" axis="0 0 1"/><inertial mass="1" pos="0 0 0" diaginertia="1e-5 1e-5 1e-5"/></body>'
    return f"""<mujoco><option timestep="1e-3"/><worldbody>{rotor if coupling else ""}
      <body><joint name="table" type="slide" axis="1 0 0" damping="50" armature="{0 if coupling else 1e-5 * RAD_PER_M**2}"/>
        <inertial mass="4" pos="0 0 0" diaginertia="0.01 0.01 0.01"/></body></worldbody>
      <equality>{coupling}</equality><actuator>{actuator}</actuator></mujoco>"""


def tuned(mechanism: Mechanism, positions: list[float], bandwidth_hz: float = 10.0, **wanted) -> Tuning:
    """Return PD gains at independent positions [rad or m] of one degree of freedom, sampled every 1 ms."""
    points = [operating_point(mechanism, np.array([x])) for x in positions]
    law = sampled_law(mechanism, "pd", Tracking(period_s=1e-3), mechanism.effort_limit)
    return tune(points, Requirements(bandwidth_hz=bandwidth_hz, phase_margin_deg=60.0, **wanted), law)


def test_a_screw_has_the_same_motor_gains_as_a_gear_and_as_a_coupling():
    coupling = f'<joint joint1="motor" joint2="table" polycoef="0 {RAD_PER_M} 0 0 0"/>'
    coupled = screw_stage('<motor name="m" joint="motor" ctrlrange="-1 1"/>', coupling)
    geared = screw_stage(f'<motor name="m" joint="table" gear="{RAD_PER_M}" ctrlrange="-1 1"/>')
    found = {
        "as a gear": load_mechanism(geared),
        "as a coupling": load_mechanism(coupled, independent=["table"]),
        "of the motor itself": load_mechanism(coupled, independent=["motor"]),
    }
    gains = {name: tuned(mechanism, [0.0]).motors[0] for name, mechanism in found.items()}
    stiffness = [motor.kp for motor in gains.values()]
    assert stiffness == pytest.approx([stiffness[0]] * 3, rel=1e-6)
    assert {motor.units[0] for motor in gains.values()} == {"N.m/rad"}
    # The rotor's inertia and the table's, seen at the motor, at the natural frequency that the joint's gains give.
    assert stiffness[0] == pytest.approx(tuned(found["as a gear"], [0.0]).best.law.settings.kp / RAD_PER_M**2)


def test_motors_that_move_several_joints_have_no_gains_of_their_own():
    mechanism = load_mechanism(ankle_text(), independent=["ankle_pitch", "ankle_roll"])
    point = operating_point(mechanism, mechanism.home[mechanism.independent])
    law = sampled_law(mechanism, "pd", Tracking(period_s=1e-3), mechanism.effort_limit)
    found = tune([point], Requirements(bandwidth_hz=5.0, phase_margin_deg=40.0), law)
    assert found.motors == ()
    assert any("not the only motor of one joint" in text for _, text in gain_lines(found))


def test_motor_gains_across_a_linkage_change_with_the_square_of_its_ratio():
    # A cylinder from (0, 0) to a pin 0.3 m from a hinge at (0.4, 0): its length obeys the law of cosines.
    model = """<mujoco><option gravity="0 0 0"/>
      <default><joint axis="0 -1 0"/><geom contype="0" conaffinity="0"/></default><worldbody>
        <body name="arm" pos="0.4 0 0"><joint name="arm"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.01"/></body>
        <body><joint name="swivel"/><geom type="capsule" fromto="0 0 0 0.24 0 0.18" size="0.01"/>
          <body name="rod" pos="0.24 0 0.18"><joint name="rod" type="slide" axis="0.8 0 0.6"/>
            <geom type="capsule" fromto="0 0 0 0.16 0 0.12" size="0.005"/></body></body></worldbody>
      <equality><connect body1="rod" body2="arm" anchor="0.16 0 0.12"/></equality>
      <actuator><motor name="m" joint="rod" ctrlrange="-900 900"/></actuator></mujoco>"""
    mechanism = load_mechanism(model, independent=["arm"])
    angles = [-0.4, 0.0, 0.5]
    found = tuned(mechanism, angles)
    (motor,) = found.motors
    # phi is the angle at the hinge between the frame and the arm; the axis -y turns z towards -x for positive angles.
    phi = np.pi / 2 - np.array(angles)
    length = np.sqrt(0.4**2 + 0.3**2 - 2 * 0.4 * 0.3 * np.cos(phi))
    ratio = -0.4 * 0.3 * np.sin(phi) / length
    assert motor.values["ratio"] == pytest.approx(ratio, rel=1e-6)
    assert motor.values["kp"] == pytest.approx(found.best.law.settings.kp / ratio**2, rel=1e-6)
    assert not motor.is_constant
    assert motor.kp is None
    kd = found.best.law.settings.kd / ratio**2
    assert motor.kd_range == pytest.approx([kd.min(), kd.max()], rel=1e-6)


PERIOD_S = 1e-3
POSITIONS = {
    "geared crank": [0.3, 1.2, 2.4],
    "scissor lift": [-0.1, 0.1, 0.25],
    "rack and rocker": [-0.1, 0.0, 0.15],
    "four-bar hatch": [0.0, 0.3, 0.6],
}


@pytest.mark.parametrize("name", MODELS)
def test_the_motor_reaches_over_all_that_its_linkage_does(name):
    text, _, ends = MODELS[name]
    can = reach(load_mechanism(text))
    assert [can.lower.position, can.upper.position] == pytest.approx(ends, rel=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_gains_at_the_motor_stiffness_and_margins_are_those_of_mujocos_rows(name):
    text, joint, _ = MODELS[name]
    mechanism, linkage = load_mechanism(text, independent=[joint]), Linkage(text, joint)
    points = [operating_point(mechanism, np.array([x])) for x in POSITIONS[name]]
    law = sampled_law(mechanism, "pd", Tracking(period_s=PERIOD_S), mechanism.effort_limit)
    found = tune(points, Requirements(bandwidth_hz=8.0, phase_margin_deg=60.0), law)
    assert found.found
    (motor,), settings = found.motors, found.best.law.settings
    for k, position in enumerate(POSITIONS[name]):
        pose = linkage.closed(linkage.pose, position)
        here, passive, margins = linkage.at(pose), linkage.stiffness(pose), found.points[k]
        assert motor.values["kp"][k] == pytest.approx(settings.kp / here.ratio**2, rel=1e-9)
        assert motor.values["kd"][k] == pytest.approx(settings.kd / here.ratio**2, rel=1e-9)
        assert margins.stiffness_at_rest == pytest.approx(settings.kp + passive, rel=1e-5)
        assert margins.response_at_rest == pytest.approx(settings.kp / (settings.kp + passive), rel=1e-5)
        A = np.array([[0.0, 1.0], [-passive / here.inertia, -here.damping / here.inertia]])
        block = np.vstack([np.hstack([A, [[0.0], [1.0 / here.inertia]]]), np.zeros((1, 3))])
        step = scipy.linalg.expm(block * PERIOD_S)
        loop = control.StateSpace(step[:2, :2], step[:2, 2:], [[settings.kp, settings.kd]], 0, PERIOD_S)
        # MuJoCo's own steps differ from an exact hold by some share of a step of delay.
        assert control.stability_margins(loop)[1] == pytest.approx(margins.phase_margin_deg, abs=1.0)
