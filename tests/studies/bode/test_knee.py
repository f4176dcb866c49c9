"""The knee's loops, measured in MuJoCo beside the sampled prediction: five angles, bare and with the shank, PD and LQR."""

import control
import numpy as np
import pytest
from scipy.optimize import brentq

from linkplan.controllers.sampling import sampling
from linkplan.models.library import built_in_text
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.planner.files.folders import plain_record
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.bode.poses import loop_poses
from linkplan.studies.feedback.frequency.excitation import Setup
from linkplan.studies.feedback.frequency.feedback_loops import SIMULATED, feedback_loop, law_gain, operating_point
from linkplan.studies.feedback.frequency.margins import margins
from linkplan.studies.feedback.frequency.sinestream import measure
from linkplan.studies.output.text import text_of
from tests.support.tolerances_loops import (
    AT_NYQUIST_DB,
    CROSSOVER,
    DISK,
    KNEE_DB,
    KNEE_DEG,
    MARGIN,
    MEASURED_DB,
    MEASURED_DEG,
    ON_A_GRID,
    POSE_DEG,
)

ANGLES_DEG = (-49.07, -20.0, 3.6, 30.0, 56.27)
CASES = {
    ("bare", "pd"): (None, 1.0, np.geomspace(40, 4500, 7)),
    ("bare", "lqr"): (None, 1.0, np.geomspace(40, 4500, 7)),
    ("shank", "pd"): ("shank", 20.0, np.geomspace(5, 2000, 7)),
    ("shank", "lqr"): ("shank", 20.0, np.geomspace(5, 2000, 7)),
}


def knee_loops(payload, law, kd, angles=ANGLES_DEG, period=1e-4, delay=0.0):
    """Return the knee and its loops at angles [deg]."""
    mechanism = load_mechanism("optimus-knee", payload=payload)
    settings = Tracking(kp=200.0, kd=kd, period_s=period)
    timing = sampling(mechanism, period, delay)
    points = [operating_point(mechanism, np.radians([angle]), mechanism.effort_limit) for angle in angles]
    limit = mechanism.effort_limit
    return mechanism, [feedback_loop(p, law_gain(p, law, settings, limit), timing, SIMULATED) for p in points]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=" ".join)
def test_measured_closed_loops_are_as_predicted_at_five_angles(case):
    payload, kd, frequencies = CASES[case]
    mechanism, loops = knee_loops(payload, case[1], kd)
    taken = measure(loops, frequencies, mechanism.effort_limit, excitations=("effort", "reference+ff"))
    coherent = 0
    for loop, responses in zip(loops, taken.responses, strict=True):
        for name in ("complementary", "sensitivity", "loop", "reference+ff"):
            response = responses[name]
            db, deg = response.against(loop.response(name, response.frequency_hz))
            seen = response.coherence > 0.99
            coherent += seen.sum()
            assert np.abs(db[seen]).max() < KNEE_DB, name
            assert np.abs(deg[seen]).max() < KNEE_DEG, name
    assert coherent > 0.9 * 4 * 5 * len(frequencies)


def test_what_is_left_between_knee_and_prediction_is_the_softness_of_the_loop_constraint():
    off = []
    for impedance in ("0.999 0.999 0.001", "0.9999 0.9999 0.001"):
        text = built_in_text("optimus-knee").replace("0.999 0.999 0.001", impedance)
        mechanism = load_mechanism(text)
        settings = Tracking(kp=200.0, kd=1.0)
        point = operating_point(mechanism, np.radians([56.27]))
        loop = feedback_loop(point, law_gain(point, "pd", settings, mechanism.effort_limit), sampling(mechanism, 1e-4))
        taken = measure([loop], np.array([500.0, 1000.0, 2000.0]), mechanism.effort_limit, excitations=("effort",))
        response = taken.responses[0]["loop"]
        off.append(np.abs(response.against(loop.response("loop", response.frequency_hz))[1]).max())
    assert off[1] < 0.2 * off[0]


@pytest.mark.slow
def test_a_computing_delay_of_two_periods_and_a_half_is_measured_as_predicted():
    mechanism, loops = knee_loops("shank", "pd", 20.0, (3.6,), period=1e-3, delay=2.5)
    taken = measure(loops, np.geomspace(5, 100, 5), mechanism.effort_limit, excitations=("effort",))
    response = taken.responses[0]["loop"]
    db, deg = response.against(loops[0].response("loop", response.frequency_hz))
    assert np.abs(db).max() < MEASURED_DB
    assert np.abs(deg).max() < MEASURED_DEG


@pytest.mark.slow
def test_the_study_names_the_worst_angle_and_says_how_well_the_two_agree():
    mechanism = load_mechanism("optimus-knee")
    positions = loop_poses(mechanism, None, mechanism.effort_limit).positions[[1, 5]]
    study = bode_study(
        mechanism,
        positions,
        Tracking(kp=200.0, kd=1.0),
        mechanism.effort_limit,
        setup=Setup(),
        frequency_hz=np.array([200.0, 1000.0]),
        scanned=7,
    )
    record, text = plain_record(study), text_of(study.summary())
    # Where the inertia is least the sampled loop is nearest to its border.
    scan = study.scans[0]
    assert np.degrees(scan.positions[scan.worst]) == pytest.approx(62.45, abs=0.1)
    assert record["worst"]["O"]["disk_margin"] == pytest.approx(min(m.disk_margin for m in scan.margins))
    assert record["measurement"]["closed_loop_deviation_db"] < KNEE_DB
    assert record["measurement"]["solref"] == [[0.0002, 1.0]]
    assert "61.67" in study.message
    assert "differ from the prediction by at most" in text
    for point in record["points"]:
        assert point["loops"]["pd"]["settles_in_mujoco"] is True
        assert len(point["loops"]["pd"]["measured"]["loop"]["less_predicted_db"]) == 2


def test_margins_are_python_controls_and_say_which_disk_the_loop_keeps_out_of():
    _, (loop,) = knee_loops(None, "pd", 1.0, (3.6,))
    found = margins(loop)
    system = loop.system()
    omega = np.geomspace(1.0, np.pi / 1e-4, 4001)
    alpha, gain, phase = control.disk_margins(system, omega[:-1])
    assert found.disk_margin == pytest.approx(alpha, rel=DISK)
    assert found.disk_gain_margin_db == pytest.approx(gain, rel=DISK)
    assert found.disk_phase_margin_deg == pytest.approx(phase, rel=DISK)
    L = loop.gains("loop", omega / (2 * np.pi))
    crossing = np.interp(0.0, -np.log(np.abs(L)), omega)
    assert found.crossover_hz == pytest.approx(crossing / (2 * np.pi), rel=ON_A_GRID)
    at = loop.gains("loop", np.array([found.crossover_hz]))[0]
    assert abs(at) == pytest.approx(1.0, rel=CROSSOVER)
    assert found.phase_margin_deg == pytest.approx(180 + np.degrees(np.angle(at)), abs=MARGIN)
    assert found.sensitivity_peak == pytest.approx(np.abs(1 / (1 + L)).max(), rel=ON_A_GRID)
    assert 20 * np.log10(1 / abs(L[-1])) == pytest.approx(found.gain_margin_db, abs=AT_NYQUIST_DB)


@pytest.mark.slow
def test_default_poses_reach_next_to_the_ends_of_the_reach():
    mechanism = load_mechanism("optimus-knee")
    looked = loop_poses(mechanism, None, mechanism.effort_limit)
    poses, note = looked.positions, looked.note
    low, high = -90.0, 78.52165904546642  # its own range, and the singular pose
    assert np.degrees(poses[[0, -1], 0]) == pytest.approx(
        [low + 0.01 * (high - low), high - 0.01 * (high - low)], abs=POSE_DEG
    )
    assert len(poses) == 7
    assert note is None


def test_default_poses_are_those_that_a_one_sided_actuator_can_hold():
    """The gripper's cable only pulls: beyond where springs and weight balance it would have to push."""
    mechanism = load_mechanism("parallel-gripper")
    looked = loop_poses(mechanism, None, mechanism.effort_limit)
    poses, note = looked.positions, looked.note
    still = np.zeros(1)
    for position in poses:
        point = operating_point(mechanism, position)
        assert 1.0 < point.hold[0] < 19.0  # a twentieth of its 20 N is left to either side

    def torque(s: float) -> float:
        return np.array(mechanism.dynamics.inverse_dynamics(close_at(mechanism, np.array([s])), still, still)).item()

    assert torque(np.radians(-69.0)) < 0
    first = brentq(lambda s: torque(s) - 1.0 * 2 * 0.008, np.radians(-69.0), np.radians(9.0))  # a newton on two pulleys
    assert first < poses[0, 0] < first + np.radians(1.0)
    assert "cannot hold" in note
