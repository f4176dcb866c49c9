"""Feedback loops of mechanisms whose rods spin between ball joints: a spin has no loop, and moves nothing else."""

import pytest

import linkplan
from tests.support.linkages import RSSR
from tests.support.parallel_ankle import ankle

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
    for ours, theirs in zip(spun.study.points, plain.study.points, strict=True):
        assert ours.phase_margin_deg == pytest.approx(theirs.phase_margin_deg, abs=0.1)
        assert ours.disk_margin == pytest.approx(theirs.disk_margin, rel=2e-3)
        assert ours.settles_in_mujoco
    assert spun.study.measurement["closed_loop_deviation_db"] < 0.01  # [dB], measured in MuJoCo


@pytest.mark.slow
def test_a_spatial_four_bar_on_balls_has_a_single_loop(tmp_path):
    loop = linkplan.bode(linkplan.load_mechanism(RSSR), tracker="lqr", measure=False)
    assert loop.stable
    assert loop.poses == ("crank = 0 deg",)
    loop.plot(tmp_path / "bode.png")
    assert (tmp_path / "bode.png").is_file()
