"""Loops of several coordinates: broken one by one, with push rods, and with joints that coast."""

import re
from functools import cache

import control
import numpy as np
import pytest

import linkplan
import linkplan.studies.feedback.bode.bode as bode_module
from linkplan.controllers.linearisation import linearise
from linkplan.controllers.sampling import sampling
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import BodeStudy, bode_study
from linkplan.studies.feedback.bode.poses import loop_poses
from linkplan.studies.feedback.frequency.excitation import Setup
from linkplan.studies.feedback.frequency.feedback_loops import (
    CONTINUOUS,
    feedback_loop,
    law_gain,
    operating_point,
    sampled_law,
)
from linkplan.studies.feedback.frequency.margins import margins
from linkplan.studies.feedback.frequency.sinestream import measure
from linkplan.studies.output.text import text_of
from tests.support.boom import boom
from tests.support.drawn_by_others import HOEKEN, MOTOR
from tests.support.linkages import RSSR
from tests.support.parallel_ankle import ankle
from tests.support.tolerances_loops import CROSSOVER, MARGIN, MEASURED_DB, MEASURED_DEG

# The five-bar in the coordinates of its left leg: each of its motors, on the legs' first joints, moves both.
LEG = ("O1", "E1")
GAINS = Tracking(kp={"O1": 30.0, "E1": 8.0}, kd={"O1": 1.5, "E1": 0.2}, period_s=1e-3)


def leg_loop(kind=CONTINUOUS):
    mechanism = load_mechanism("five-bar", independent=LEG)
    point = operating_point(mechanism, mechanism.home[mechanism.independent])
    gain = law_gain(point, "pd", GAINS, mechanism.effort_limit)
    return mechanism, point, feedback_loop(point, gain, sampling(mechanism, 1e-3), kind)


def test_each_row_is_the_loop_of_its_own_coordinate_with_the_others_closed():
    mechanism, point, loop = leg_loop()
    effort_map = np.array(mechanism.dynamics.effort_map(point.pose))
    assert np.abs(effort_map - np.diag(np.diag(effort_map))).max() > 0.1  # the motors do not each move one coordinate
    A, B = (m[0] for m in linearise(mechanism, point.pose[None], point.velocity[None], point.hold[None]))
    on_coordinates, gains = B @ np.linalg.inv(effort_map), np.array([[30.0, 0.0, 1.5, 0.0], [0.0, 8.0, 0.0, 0.2]])
    frequency, found = np.array([0.5, 3.0, 20.0]), []
    for channel, other in ((0, 1), (1, 0)):
        closed = A - on_coordinates[:, [other]] @ gains[[other]]  # the other coordinate's own PD, by hand
        system = control.StateSpace(closed, on_coordinates[:, [channel]], gains[[channel]], 0)
        expected = np.array([system(2j * np.pi * f) for f in frequency])
        assert loop.gains("loop", frequency, channel) == pytest.approx(expected, rel=1e-8)
        found.append(margins(loop, channel))
    assert abs(found[0].phase_margin_deg - found[1].phase_margin_deg) > 10  # rows of their own


def test_the_crossover_that_is_stated_is_where_the_phase_margin_is_and_others_are_named():
    gains = Tracking(kp={"O1": 1.0, "E1": 1.0}, kd={"O1": 0.1, "E1": 0.005}, period_s=1e-3)
    mechanism, point, _ = leg_loop()
    loop = feedback_loop(point, law_gain(point, "pd", gains, mechanism.effort_limit), sampling(mechanism, 1e-3), CONTINUOUS)
    found = margins(loop, 0)
    assert max(found.other_crossovers_hz) > found.crossover_hz  # the highest is another's
    crossovers = np.array([found.crossover_hz, *found.other_crossovers_hz])
    at = loop.gains("loop", crossovers, 0)
    assert np.abs(at) == pytest.approx(np.ones(4), rel=CROSSOVER)
    phase_margins = np.degrees(np.angle(-at))
    assert phase_margins[0] == pytest.approx(found.phase_margin_deg, abs=MARGIN)
    assert np.abs(phase_margins[1:]).min() > abs(phase_margins[0])
    study = bode_study(mechanism, point.pose[mechanism.independent], gains, mechanism.effort_limit, scanned=0)
    others = [f for entry in study.points for f in entry.other_crossovers_hz]
    said = f"in 2 of 2 loops the gain also crosses 1 at {min(others):.4g} to {max(others):.4g} Hz"
    assert said in text_of(study.summary())


@pytest.mark.slow
def test_a_coordinate_s_loop_is_measured_as_predicted():
    mechanism, _, loop = leg_loop("sampled, MuJoCo's steps")
    for channel in range(2):
        taken = measure([loop], np.array([8.0, 30.0]), mechanism.effort_limit, channel=channel)
        for name in ("loop", "plant", "reference"):
            response = taken.responses[0][name]
            db, deg = response.against(loop.response(name, response.frequency_hz, channel))
            assert np.abs(db).max() < 10 * MEASURED_DB, name
            assert np.abs(deg).max() < 10 * MEASURED_DEG, name


def test_gains_by_joint_name_every_independent_joint():
    mechanism = load_mechanism("five-bar", independent=LEG)
    kp, kd = GAINS.gains(mechanism.independent_joints)
    assert dict(zip([j.name for j in mechanism.independent_joints], kp, strict=True)) == {"O1": 30.0, "E1": 8.0}
    assert kd.min() == 0.2
    with pytest.raises(ProblemError, match=r"tracking.kp must have a value for each independent joint \(O1, O2\), got O1"):
        load_problem("five-bar-reach", ["tracking.kp={ O1 = 20 }"])
    problem = load_problem("five-bar-reach", ["tracking.kp={ O1 = 20, O2 = 30 }"])
    assert problem.tracking.gains_text() == "kp = { O1 = 20, O2 = 30 }, kd = 1"


def test_default_poses_of_several_freedoms_lie_along_the_motion():
    problem = load_problem("five-bar-reach")
    looked = loop_poses(problem.mechanism, problem, problem.limits.effort)
    assert len(looked.positions) == 5
    assert looked.line.unit == "s"
    assert np.ptp(looked.positions[:, 0]) > np.radians(5.0)
    assert "along the path of five-bar-reach" in looked.note


def test_the_text_says_where_the_loops_are_broken():
    mechanism, point, _ = leg_loop()
    limit = mechanism.effort_limit
    text = text_of(bode_study(mechanism, point.state[:2], GAINS, limit, scanned=0).summary())
    assert "each loop is opened at the total effort on its coordinate (O1, E1) of act_O1, act_O2" in text


def test_a_loop_that_is_stable_in_the_model_and_not_in_mujoco_is_a_no(monkeypatch):
    mechanism, point, _ = leg_loop()
    never = np.zeros(1, dtype=bool)
    monkeypatch.setattr(bode_module, "settle_trials", lambda *_: never)
    study = bode_study(mechanism, point.state[:2], GAINS, mechanism.effort_limit, scanned=0)
    assert all(entry.stable for entry in study.points)
    assert not study.stable
    assert study.message.startswith("stable by the sampled model but not in MuJoCo at O1 = ")


def test_poses_are_told_apart_by_the_coordinates_that_differ():
    mechanism = load_mechanism("five-bar", independent=LEG)
    home = mechanism.home[mechanism.independent]
    study = bode_study(mechanism, home + np.array([[0.0, 0.0], [0.0, 0.1]]), GAINS, mechanism.effort_limit, scanned=0)
    assert {entry.point.name.split(" = ")[0] for entry in study.points} == {"E1"}
    assert f"at every pose: O1 = {np.degrees(home[0]):.4g} deg" in text_of(study.summary())
    alone = bode_study(mechanism, home, GAINS, mechanism.effort_limit, scanned=0)
    assert alone.points[0].point.name.startswith("O1 = ")


def test_dry_friction_is_said_to_damp_the_measured_motion(tmp_path):
    arm = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="arm" axis="0 1 0" frictionloss="{}"/>
      <inertial pos="0.5 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody>
      <actuator><motor joint="arm" ctrlrange="-20 20"/></actuator></mujoco>"""
    words, deviations = "use a larger test signal", []
    for friction, amplitude in ((0.0, None), (0.3, None), (0.3, 0.5)):
        (tmp_path / "arm.xml").write_text(arm.format(friction))
        mechanism = load_mechanism(str(tmp_path / "arm.xml"))
        gains, setup = Tracking(kp=20.0, kd=2.0, period_s=2e-3), Setup(amplitude=amplitude)
        study = bode_study(
            mechanism, np.zeros((1, 1)), gains, mechanism.effort_limit, setup=setup, frequency_hz=np.array([3.0]), scanned=0
        )
        assert (words in text_of(study.summary())) == (friction > 0)
        deviations.append(study.measurement["closed_loop_deviation_db"])
    free, held, moved = deviations
    assert free < 1e-3 < moved < 1.0 < held


SETTINGS = {"kp": 100.0, "kd": 3.0, "period_s": 5e-4}


@pytest.mark.slow
def test_an_ankle_on_ball_joints_has_the_loops_of_one_on_universal_joints():
    with_spins = ankle(balls=True)
    assert (with_spins.dof, with_spins.n_u) == (4, 2)
    spun = linkplan.bode(with_spins, tracking=SETTINGS, frequency_hz=[120.0])
    plain = linkplan.bode(ankle(balls=False), tracking=SETTINGS, measure=False)
    assert spun.stable
    assert spun.poses == plain.poses == ("motor_left = 0 deg, motor_right = 0 deg",)
    assert spun.lti().nstates == plain.lti().nstates == 4
    assert all(abs(pole) < 1.0 for pole in spun.lti(closed=True).poles())
    for ours, theirs in zip(spun.points, plain.points, strict=True):
        assert ours.phase_margin_deg == pytest.approx(theirs.phase_margin_deg, abs=0.1)
        assert ours.disk_margin == pytest.approx(theirs.disk_margin, rel=2e-3)
        assert ours.settles_in_mujoco
    assert spun.measurement["closed_loop_deviation_db"] < 0.01  # [dB], measured in MuJoCo


@pytest.mark.slow
def test_a_spatial_four_bar_on_balls_has_a_single_loop(tmp_path):
    loop = linkplan.bode(linkplan.load_mechanism(RSSR), tracker="lqr", measure=False)
    assert loop.stable
    assert loop.poses == ("crank = 0 deg",)
    loop.plot(tmp_path / "bode.png")
    assert (tmp_path / "bode.png").is_file()


BOOM_GAINS = Tracking(kp={"turn": 0.0, "hip": 60.0, "knee": 20.0}, kd={"turn": 0.0, "hip": 2.0, "knee": 0.5}, period_s=1e-3)


@pytest.fixture(scope="module")
def leg():
    return load_mechanism(boom())


def test_responses_of_the_leg_are_measured_as_predicted_while_the_boom_coasts(leg):
    study = bode_study(
        leg,
        np.array([[0.0, 0.3, -0.4]]),
        BOOM_GAINS,
        leg.effort_limit,
        setup=Setup(),
        frequency_hz=np.array([3.0, 20.0]),
        scanned=0,
    )
    assert [entry.channel for entry in study.points] == [1, 2]
    for entry in study.points:
        assert entry.settles_in_mujoco
        for quantity, response in entry.responses.items():
            assert response.gain == pytest.approx(entry.predicted[quantity].gain, rel=1e-5)
    assert study.softness is None
    titles = [section.title for section in study.sections("the leg")]
    assert titles == ["Feedback loop: the leg", "Frequency response of hip", "Frequency response of knee"]


def test_lqr_regulates_the_leg_and_leaves_the_boom_alone(leg):
    law = sampled_law(leg, "lqr", BOOM_GAINS, leg.effort_limit)
    loop = law.loop(operating_point(leg, np.array([0.0, 0.3, -0.4])))
    assert loop.stable
    assert np.all(loop.gain[:, [0, 3]] == 0)
    assert np.all(np.diag(loop.gain[:, 1:3]) > 0)


# Hoeken's linkage as somebody writes it, its coupler and rocker drawn through each other.
THROUGH = re.sub(r"<contact>.*?</contact>", "", HOEKEN.format(actuator=MOTOR), flags=re.S)
TOUCHING_GAINS = Tracking(kp=2.0, kd=0.02, period_s=2e-3)


@cache
def study() -> BodeStudy:
    mechanism = load_mechanism(THROUGH, solref="stiff")
    positions, limit = np.radians([[10.0], [25.0]]), mechanism.effort_limit
    return bode_study(
        mechanism, positions, TOUCHING_GAINS, limit, setup=Setup(), frequency_hz=np.array([1.0, 5.0]), scanned=0
    )


def test_contacts_at_a_pose_are_named_with_the_line_that_lets_links_pass():
    text = text_of(study().summary())
    assert "contacts of geom 1 of coupler and geom 2 of rocker push in MuJoCo at 2 of 2 poses" in text
    assert '<exclude body1="coupler" body2="rocker"/>' in text
    assert "contacts of" in study().contacts


def test_no_response_is_measured_where_contacts_push():
    assert all(point.stable for point in study().points)  # or nothing would be measured anyway
    assert study().measurement is None
    assert not any(point.responses for point in study().points)
    assert "not measured: there are contacts" in text_of(study().summary())


def test_no_plant_is_measured_where_contacts_push_and_all_of_it_is_predicted():
    ports = {"from_effort": [study().mechanism.actuators[0].name], "to_position": [study().mechanism.joints[-1].name]}
    found = linkplan.bode(study().mechanism, at_deg=[10.0, 25.0], kp=2.0, kd=0.02, period_s=2e-3, **ports)
    assert found.measurement is None
    assert len(found.caveats) == 2
    assert all(caveat.endswith("there are contacts") for caveat in found.caveats)
    assert "contacts of" in found.contacts
    assert all(one.moves and not one.measured for point in found.points for one in point.responses.values())


def test_without_contacts_nothing_is_said_of_them():
    mechanism = load_mechanism(HOEKEN.format(actuator=MOTOR), solref="stiff")
    found = bode_study(mechanism, np.radians([[10.0]]), TOUCHING_GAINS, mechanism.effort_limit, scanned=0)
    assert found.contacts is None
    assert "contacts" not in text_of(found.summary())
