"""Ball and free joints, and rods that go round with a hinge: coordinates against MuJoCo's quaternions."""

from functools import cache

import mujoco
import numpy as np
import pytest
import scipy.integrate
from hypothesis import given, settings
from hypothesis import strategies as st

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.charts import CHART_RANGE, RodChart, StereographicChart
from tests.support.linkages import PSSR, RSSR
from tests.support.mechanisms import derivative, numbers, random_quaternion, replaced, simulated
from tests.support.spins import ROUND, SPINS
from tests.support.tolerances import (
    CENTRED,
    CONSERVED,
    DIFFERENCES,
    ENERGY,
    SPIN,
    SWEPT_GAP_M,
    TREE,
    TREE_ACCELERATION,
    UNIT_VECTOR,
    relative_error,
)
from tests.support.tolerances_planner import ROUNDING

# A free body that carries a ball-jointed arm with a forearm: off-centre masses and anchors, damping, armature, actuators.
ACROBAT = """
<mujoco model="acrobat"><compiler angle="radian"/><option gravity="1 -2 -9"/>
  <default><geom contype="0" conaffinity="0" size="0.05"/></default>
  <worldbody><site name="beacon" pos="0.3 0.2 1" euler="0.2 0.3 1"/>
    <body name="trunk" pos="1 2 3" euler="0.1 0.2 0.3"><freejoint name="base"/>
      <geom type="box" size="0.1 0.2 0.3" pos="0.02 0.03 0.01"/>
      <body name="arm" pos="0.1 0.2 0.3" euler="1 0.2 0.1">
        <joint name="shoulder" type="ball" pos="0.05 0.1 0.02" damping="0.3" armature="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.2 0.1 0.3"/><site name="hand" pos="0.2 0.1 0.3" euler="1 0.2 0.3"/>
        <body name="fore" pos="0.2 0.1 0.3" euler="0.3 0.1 2"><joint name="elbow" axis="0 1 1" ref="-0.2" damping="0.1"/>
          <geom type="capsule" fromto="0 0 0 0.1 0 0.2"/><site name="tip" pos="0.1 0 0.2"/></body></body></body>
  </worldbody>
  <actuator>
    <motor name="torso" joint="base" gear="1 2 3 4 5 6"/><motor name="world" jointinparent="base" gear="1 2 3 4 5 6"/>
    <motor name="own" joint="shoulder" gear="1 2 3"/><motor name="parent" jointinparent="shoulder" gear="1 2 3"/>
    <motor name="jet" site="tip" gear="1 2 3 4 5 6"/><motor name="seen" site="tip" refsite="hand" gear="1 2 3 4 5 6"/>
    <motor name="far" site="tip" refsite="beacon" gear="0.3 1 -2 0 0 0"/>
  </actuator>
  <keyframe><key name="home" qpos="1 2 3 0.5 -0.5 0.5 0.5 0.8 0.6 0 0 0.3"/></keyframe>
</mujoco>"""


@cache
def acrobat() -> Mechanism:
    return load_mechanism(ACROBAT)


@cache
def states(n: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Return poses and rates (n, n_q), every chart turned by up to 200 deg."""
    rng = np.random.default_rng(4)
    return rng.uniform(-2.5, 2.5, (n, acrobat().n_q)), 2 * rng.normal(size=(n, acrobat().n_q))


def at(q: np.ndarray, rates: np.ndarray, ctrl: np.ndarray | None = None):
    return simulated(acrobat().model, acrobat().qpos_of(q), acrobat().qvel_of(q, rates), ctrl)


def test_a_ball_joint_has_three_coordinates_and_a_free_joint_six():
    names = [joint.name for joint in acrobat().joints]
    assert names == [*(f"base_{x}" for x in ("x", "y", "z", "rx", "ry", "rz")), *(f"shoulder_r{x}" for x in "xyz"), "elbow"]
    assert [joint.unit for joint in acrobat().joints[:4]] == ["m", "m", "m", "deg"]
    assert acrobat().n_q == acrobat().dof == acrobat().model.nv == 10
    assert acrobat().model.nq == 12


def test_the_charts_are_centred_at_the_home_orientation():
    home = acrobat().home
    assert np.abs(home[[3, 4, 5, 6, 7, 8]]).max() < CENTRED
    assert np.abs(acrobat().qpos_of(home) - acrobat().model.key_qpos[0]).max() < CENTRED


def test_coordinates_come_back_from_mujocos_positions():
    q, rates = states()
    qpos, qvel = acrobat().qpos_of(q), acrobat().qvel_of(q, rates)
    assert np.abs(np.linalg.norm(qpos[:, 3:7], axis=1) - 1).max() < UNIT_VECTOR
    assert np.abs(acrobat().q_of(qpos) - q).max() < ROUNDING
    assert np.abs(acrobat().rates_of(q, qvel) - rates).max() < ROUNDING


@settings(max_examples=50, deadline=None, derandomize=True, database=None)
@given(angle=st.floats(-3.7, 3.7), axis=st.tuples(*[st.floats(-1, 1)] * 3))
def test_a_coordinate_is_four_times_the_tangent_of_a_quarter_of_the_angle(angle, axis):
    length = np.linalg.norm(axis)
    unit = np.array([1.0, 0, 0]) if length < 0.1 else np.array(axis) / length
    turn = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * unit)])
    q = np.array(acrobat().home)
    q[6:9] = 4 * np.tan(angle / 4) * unit
    expected = np.zeros(4)
    mujoco.mju_mulQuat(expected, acrobat().model.key_qpos[0, 7:11], turn)
    assert np.abs(acrobat().qpos_of(q)[7:11] - expected).max() < UNIT_VECTOR
    assert np.abs(acrobat().q_of(acrobat().qpos_of(q)) - q).max() < ROUNDING


def test_rates_are_the_derivative_of_what_mujoco_integrates():
    q, rates = states()
    for pose, rate in zip(q, rates, strict=True):

        def moved(t: float, pose=pose, rate=rate) -> np.ndarray:
            qpos = acrobat().qpos_of(pose)
            mujoco.mj_integratePos(acrobat().model, qpos, acrobat().qvel_of(pose, rate), t)
            return acrobat().q_of(qpos)

        assert relative_error(derivative(moved, 1e-3), rate) < DIFFERENCES


def test_kinetic_and_potential_energy_are_mujocos():
    for q, rates in zip(*states(), strict=True):
        kinetic, potential = (float(e) for e in acrobat().dynamics.energy(q, rates))
        expected = at(q, rates).energy
        assert relative_error([kinetic, potential], expected[::-1]) < ENERGY


def test_acceleration_is_mujocos():
    rng = np.random.default_rng(2)
    for q, rates in zip(*states(), strict=True):
        u = rng.normal(size=7)
        a = np.array(acrobat().dynamics.acceleration(q, rates, u)).ravel()
        moved = derivative(lambda t, q=q, r=rates, a=a: acrobat().qvel_of(q + t * r + t**2 / 2 * a, r + t * a), 1e-3)
        assert relative_error(moved, at(q, rates, u).acceleration) < DIFFERENCES
    q, rates = np.array(acrobat().home), np.zeros(10)
    rates[3:9] = [1, 2, 3, -1, 2, 1]
    # At a chart's centre T is the identity and its derivative along c' vanishes.
    expected = at(q, rates, np.zeros(7)).acceleration
    assert (
        relative_error(np.array(acrobat().dynamics.acceleration(q, rates, np.zeros(7))).ravel(), expected)
        < TREE_ACCELERATION
    )


def test_a_spinning_body_keeps_its_angular_momentum_and_energy():
    text = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="top" type="ball"/>
      <inertial mass="1" pos="0 0 0" diaginertia="0.3 0.2 0.12"/></body></worldbody></mujoco>"""
    top = load_mechanism(text)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([np.array(x).ravel() for x in top.dynamics.flow(y[:3], y[3:], np.zeros(0))])

    start = np.array([0.0, 0, 0, 0.1, 2.0, 0.2])
    path = scipy.integrate.solve_ivp(rates, (0, 1.5), start, method="DOP853", rtol=1e-12, atol=1e-12).y.T
    momenta = []
    for y in (path[0], path[-1]):
        turn, w = np.zeros(9), top.qvel_of(y[:3], y[3:])
        mujoco.mju_quat2Mat(turn, top.qpos_of(y[:3]))
        momenta.append(turn.reshape(3, 3) @ (np.array([0.3, 0.2, 0.12]) * w))
    assert np.abs(path[-1, :3] - path[0, :3]).max() > 1, "it has turned"
    assert np.abs(momenta[1] - momenta[0]).max() < CONSERVED
    energies = [float(top.dynamics.energy(y[:3], y[3:])[0]) for y in (path[0], path[-1])]
    assert abs(energies[1] / energies[0] - 1) < CONSERVED


def test_a_chart_centred_elsewhere_describes_the_same_body():
    turned = random_quaternion(np.random.default_rng(0))
    qpos = np.array(acrobat().model.key_qpos[0])
    key = f'qpos="{numbers([*qpos[:7], *turned, qpos[-1]])}"'
    other = load_mechanism(replaced(ACROBAT, 'qpos="1 2 3 0.5 -0.5 0.5 0.5 0.8 0.6 0 0 0.3"', key))
    q, rates = (x[0] for x in states())
    p = other.q_of(acrobat().qpos_of(q))
    p_rates = other.rates_of(p, acrobat().qvel_of(q, rates))
    assert np.abs(p - q).max() > 0.1, "the coordinates differ"
    first, second = (m.dynamics.energy(*x) for m, x in ((acrobat(), (q, rates)), (other, (p, p_rates))))
    assert relative_error([float(e) for e in second], [float(e) for e in first]) < ENERGY


def test_a_chart_ends_well_before_its_singularity():
    assert 4 * np.arctan(np.sqrt(3) * CHART_RANGE / 4) < np.radians(271)
    assert 4 * np.arctan(CHART_RANGE / 4) > np.radians(215)
    assert all(joint.upper == CHART_RANGE for joint in acrobat().joints if joint.name.startswith("shoulder"))


def test_several_roots_are_several_trees():
    text = """<mujoco><worldbody>
      <body name="a"><joint name="a" type="ball"/><geom size="0.1" pos="0.2 0 0"/></body>
      <body name="b" pos="1 0 0"><joint name="b" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>
      </worldbody></mujoco>"""
    chain = load_mechanism(text)
    inertia = np.array(chain.dynamics.mass_matrix(chain.home))
    assert chain.dof == 4
    assert not np.any(inertia[:3, 3])
    assert np.linalg.eigvalsh(inertia)[0] > 0


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
