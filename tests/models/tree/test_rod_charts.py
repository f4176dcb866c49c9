"""Rods that go round with a hinge: azimuth, tilt and spin, against MuJoCo's quaternions, through whole turns."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.charts import RodChart, StereographicChart
from tests.support.linkages import PSSR, RSSR
from tests.support.mechanisms import derivative, replaced, simulated
from tests.support.spins import ROUND, SPINS
from tests.support.tolerances import DIFFERENCES, SPIN, SWEPT_GAP_M, TREE, UNIT_VECTOR, relative_error


def chart() -> RodChart:
    hinge, line = np.array([0.1, 0.9, -0.3]), np.array([0.8, -0.2, 0.5])
    return RodChart(hinge=hinge / np.linalg.norm(hinge), line=line / np.linalg.norm(line))


def coordinates() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(40, 3)) * [4.0, 0.3, 4.0]


def test_coordinates_come_back_from_their_quaternion_but_for_whole_turns():
    c = coordinates()
    off = chart().coordinates_of(chart().quaternion_of(c)) - c
    turns = np.round(off / (2 * np.pi))
    assert np.abs(turns[:, [0, 2]]).max() >= 1, "some have gone round"
    assert not np.any(turns[:, 1])
    assert np.abs(off - 2 * np.pi * turns).max() < 100 * UNIT_VECTOR


def test_the_angular_velocity_is_the_quaternions():
    rates = np.random.default_rng(1).normal(size=(40, 3))
    for c, rate in zip(coordinates(), rates, strict=True):
        w = chart().velocity_of(c, rate)
        moved = derivative(lambda t, c=c, r=rate: chart().quaternion_of(c + t * r), 1e-3)
        quaternion = chart().quaternion_of(c)
        inverse = np.concatenate([quaternion[:1], -quaternion[1:]])
        spin = 2 * (inverse[0] * moved[1:] + moved[0] * inverse[1:] + np.cross(inverse[1:], moved[1:]))
        assert relative_error(w, spin) < DIFFERENCES
        assert relative_error(chart().rates_of(c, w), rate) < 100 * SPIN


@pytest.mark.parametrize("name", ROUND)
def test_the_crank_takes_its_rod_round_and_round(name):
    mechanism = load_mechanism(ROUND[name])
    assert [joint.name for joint in mechanism.independent_joints] == ["O", SPINS[name]]
    assert all(isinstance(chart.rotation, RodChart) for chart in mechanism.coordinates.charts)
    path = np.column_stack([np.linspace(0, 4 * np.pi, 241), np.zeros(241)])
    poses = follow(mechanism, path)
    assert mechanism.gaps_m(poses).max() < SWEPT_GAP_M
    gone = (poses[-1] - poses[0]) / (2 * np.pi)
    assert np.abs(gone - np.round(gone)).max() < SWEPT_GAP_M, "all is back after two turns"


@pytest.mark.parametrize("name", ROUND)
def test_turned_twice_round_and_spun_its_inertia_is_mujocos(name):
    mechanism = load_mechanism(ROUND[name])
    path = np.column_stack([np.linspace(0, 11.0, 200), np.linspace(0, -9.0, 200)])
    q = follow(mechanism, path)[-1]
    qpos = mechanism.qpos_of(q)
    T = np.array([mechanism.qvel_of(q, rate) for rate in np.eye(mechanism.n_q)]).T
    at = simulated(mechanism.model, qpos, np.zeros(mechanism.model.nv))
    assert relative_error(np.array(mechanism.dynamics.mass_matrix(q)), T.T @ at.mass_matrix @ T) < TREE
    assert np.abs(at.residual).max() < SWEPT_GAP_M
    assert np.abs(mechanism.q_of(qpos, q) - q).max() < SWEPT_GAP_M
    if mechanism.coordinates.charts:
        assert np.abs(mechanism.q_of(qpos) - q).max() > np.pi, "by itself a quaternion knows no turns"


def test_a_rod_along_the_hinge_keeps_the_chart_that_has_no_pole_there():
    along = replaced(RSSR, '<joint name="crank"/>', '<joint name="crank" axis="0.25 0.08 0.06"/>')
    for text in (along, PSSR):
        (chart,) = load_mechanism(text).coordinates.charts
        assert isinstance(chart.rotation, StereographicChart)


def test_a_rod_that_comes_to_lie_along_the_hinge_is_named():
    mechanism = load_mechanism(ROUND["ball"])
    poses = np.tile(mechanism.home, (2, 1))
    poses[1, 1:4] = [20.0, 0.3, -20.0]
    assert mechanism.coordinates.range_violation(poses) is None, "spin and azimuth go on for ever"
    poses[1, 2] = mechanism.joints[2].upper + 0.01
    left = mechanism.coordinates.range_violation(poses)
    assert left is not None
    assert "'rod'" in left
    assert "hinge" in left
