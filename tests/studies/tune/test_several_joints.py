"""Gains of several joints: each joint's loop meets the requirements with the others closed, by python-control's figures."""

import tomllib
from functools import cache

import control
import numpy as np
import pytest
import scipy.optimize

import linkplan
from linkplan.controllers.sampling import augmented
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.frequency.feedback_loops import operating_point, sampled_law
from linkplan.studies.feedback.tune.requirements import Requirements
from linkplan.studies.feedback.tune.tune import tune
from linkplan.studies.feedback.tune.tune_report import tracking_table
from linkplan.studies.output.text import text_of
from tests.support.parallel_ankle import ankle
from tests.support.tolerances_loops import MARGIN

PERIOD_S = 1e-3


@cache
def five_bar_tuned(independent, bandwidth_hz, phase_margin_deg=60.0, stiffness=None):
    """Return the tuning of the five-bar in some coordinates at home, with one period of delay."""
    mechanism = load_mechanism("five-bar", independent=independent)
    point = operating_point(mechanism, mechanism.home[mechanism.independent])
    settings = Tracking(period_s=PERIOD_S, delay_periods=1)
    wanted = Requirements(bandwidth_hz=bandwidth_hz, phase_margin_deg=phase_margin_deg, stiffness=stiffness)
    return tune([point], wanted, sampled_law(mechanism, "pd", settings, mechanism.effort_limit))


def broken_loop(found, judged):
    """Return python-control's sampled system of one joint's loop, with the other joint's PD closed by hand."""
    point, mechanism = judged.point, found.mechanism
    law = found.best.law
    kp, kd = law.settings.gains(mechanism.independent_joints)
    loop = law.loop(point)
    A, B = augmented(loop.A, loop.B, loop.B_late, law.timing)
    on_joints = B @ np.linalg.inv(np.array(mechanism.dynamics.effort_map(point.pose)))
    rows = np.zeros((2, len(A)))
    for k in range(2):
        rows[k, k], rows[k, 2 + k] = kp[k], kd[k]
    own, other = [judged.channel], [1 - judged.channel]
    return control.StateSpace(A - on_joints[:, other] @ rows[other], on_joints[:, own], rows[own], 0, PERIOD_S)


def phase_margin_deg(system):
    """Return the least phase margin [deg] over the frequencies at which a sampled system's gain is one."""

    def response(f):
        return complex(system(np.exp(2j * np.pi * f * PERIOD_S)))

    def size(f):
        return np.log(abs(response(f)))

    grid = np.geomspace(0.01, 0.5 / PERIOD_S, 3000)
    sizes = np.array([size(f) for f in grid])
    brackets = np.flatnonzero(sizes[:-1] * sizes[1:] < 0)
    assert brackets.size
    crossovers = [scipy.optimize.brentq(size, grid[k], grid[k + 1], xtol=1e-12) for k in brackets]
    return min(abs(np.degrees(np.angle(-response(f)))) for f in crossovers)


@pytest.mark.parametrize(
    ("independent", "bandwidth_hz", "stiffness"), [(("O1", "O2"), 12.0, None), (("O1", "E1"), 5.0, 20.0)]
)
def test_each_joint_s_loop_has_its_margins_by_python_control(independent, bandwidth_hz, stiffness):
    found = five_bar_tuned(independent, bandwidth_hz, stiffness=stiffness)
    assert found.found
    assert [judged.channel for judged in found.best.loops] == [0, 1]
    for judged in found.best.loops:
        system, bounds = broken_loop(found, judged), judged
        phase_margin = phase_margin_deg(system)
        assert phase_margin >= 60.0
        assert phase_margin == pytest.approx(bounds.phase_margin_deg, abs=MARGIN)
        closed = control.feedback(system, 1)
        assert np.abs(closed.poles()).max() < 1.0
        at = np.abs([complex(closed(np.exp(2j * np.pi * f * PERIOD_S))) for f in (1e-4, bounds.bandwidth_hz)])
        assert 20 * np.log10(at[1]) == pytest.approx(-3.0, abs=0.02)
        assert at[0] == pytest.approx(bounds.response_at_rest, rel=1e-4)
        assert bounds.bandwidth_hz >= bandwidth_hz
        # A steady effort on the joint moves it by the effort over the stiffness, the other joint's loop closed.
        unit = control.StateSpace(closed.A, system.B, np.eye(len(closed.A))[[judged.channel]], 0, PERIOD_S)
        assert control.dcgain(unit) == pytest.approx(1.0 / judged.stiffness_at_rest, rel=2e-3)


def test_a_symmetric_mechanism_gets_gains_of_one_frequency_and_a_coupled_one_of_several():
    def natural(found):
        kp, kd = found.best.law.settings.gains(found.mechanism.independent_joints)
        inertia = np.diag(found.points[0].point.inertia)
        return np.sqrt(kp / inertia), kd / (2 * np.sqrt(kp * inertia))

    frequency, damping = natural(five_bar_tuned(("O1", "O2"), 12.0))
    assert frequency[0] == pytest.approx(frequency[1], rel=1e-9)
    assert damping[0] == pytest.approx(damping[1], rel=1e-9)
    frequency, _ = natural(
        five_bar_tuned(("O1", "E1"), 5.0, stiffness=20.0)
    )  # in the coordinates of one leg each motor moves both
    assert frequency.max() > 2 * frequency.min()


def test_what_no_gains_give_is_refused_with_the_joint_that_lacks_it():
    found = five_bar_tuned(("O1", "O2"), 150.0)
    assert not found.found
    assert "cannot give 150 Hz and 60 deg at the pose, in each joint's loop with the others closed" in found.message
    assert any(f"deg at {joint} at O1 = " in found.message for joint in ("O1", "O2"))


def test_an_ankle_on_ball_joints_gets_gains_for_its_motors_and_none_for_its_spins():
    settings = {"period_s": 5e-4}
    spun = linkplan.tune(ankle(balls=True), bandwidth_hz=15.0, tracking=settings)
    plain = linkplan.tune(ankle(balls=False), bandwidth_hz=15.0, tracking=settings)
    assert spun.found
    motors = {"motor_left", "motor_right"}
    for name in ("kp", "kd"):
        gains = spun.tracking[name]
        assert {joint for joint, gain in gains.items() if gain} == motors
        assert {joint: gains[joint] for joint in motors} == pytest.approx(plain.tracking[name], rel=1e-3)
    assert {entry["joint"] for entry in spun.to_dict()["points"]} == motors
    assert {*spun.to_dict()["points"][0]["position_deg"]} == motors


def test_the_tracking_table_gives_a_problem_its_gains_by_joint(tmp_path):
    found = five_bar_tuned(("O1", "O2"), 12.0)
    table = tomllib.loads(tracking_table(found))["tracking"]
    problem = load_problem("five-bar-reach", [f"tracking.{key}={_toml(value)}" for key, value in table.items()])
    kp, kd = problem.tracking.gains(problem.mechanism.independent_joints)
    values = found.tracking
    assert kp == pytest.approx([values["kp"]["O1"], values["kp"]["O2"]], rel=1e-5)
    assert kd == pytest.approx([values["kd"]["O1"], values["kd"]["O2"]], rel=1e-5)
    assert [loop.joint for loop in found.points] == ["O1", "O2"]
    text = text_of(found.blocks())
    assert "the loop of O2, the others closed" in text
    assert f"at O1: kp = {values['kp']['O1']:.5g} N.m/rad" in text
    figure = found.plot(tmp_path / "tune.png")
    assert [axes.get_title().split(", ")[-1] for axes in figure.axes[:2]] == ["loop of O1", "loop of O2"]


def _toml(value):
    if not isinstance(value, dict):
        return str(value)
    return "{ " + ", ".join(f"{name} = {gain}" for name, gain in value.items()) + " }"


def test_lqr_weights_of_several_joints_are_refused_with_what_to_use():
    with pytest.raises(
        LinkplanError, match=r"LQR weights for one degree of freedom only, and 'five-bar' has 2: use pd or pd\+ff"
    ):
        linkplan.tune("five-bar", bandwidth_hz=5, tracker="lqr")


@pytest.mark.slow
def test_tuned_loops_are_measured_in_mujoco_as_predicted():
    poses = [{"O1": -95.0}]
    gains = linkplan.tune("five-bar-reach", bandwidth_hz=10.0, at_deg=poses)
    assert gains.found
    measured = linkplan.bode("five-bar-reach", tracking=gains.tracking, at_deg=poses, frequency_hz=[20.0, 50.0])
    assert measured.stable
    for entry in measured.points:
        assert entry.bandwidth_hz >= 10.0
        assert entry.phase_margin_deg >= 60.0
    assert measured.measurement["closed_loop_deviation_db"] < 2e-3  # [dB]
