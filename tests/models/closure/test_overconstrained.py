"""Overconstrained linkages: mobility, a full turn, closed forms and least-norm forces, exact and with a file's rounding."""

import copy
import re
from functools import cache

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.reach import reach
from tests.support.linkages import LINKAGES, WELDED
from tests.support.mechanisms import replaced
from tests.support.overconstrained import bennett, bennett_follower, bricard, bricard_follower, coupled_cranks
from tests.support.spins import TWO_BALLS
from tests.support.tolerances import ANGLE_RAD, RANDOM_LIMIT, SWEPT_GAP_M, relative_error

NOISE = 1e-7
# Gap [m] of links of a decimetre whose axes are off by NOISE: a few times their product.
NOISY_GAP_M = 3e-7
# Angles [rad] of the noisy linkages against the exact ones' closed forms: the noise over a transmission of a third and up.
NOISY_RAD = 1e-6
MODELS = {"bennett": bennett, "cranks": coupled_cranks, "bricard": bricard}


@cache
def over(name: str, noise: float = 0.0) -> Mechanism:
    """Return one of the overconstrained mechanisms."""
    return load_mechanism(MODELS[name](noise))


@pytest.mark.parametrize("noise", [0.0, NOISE])
@pytest.mark.parametrize("name", ["bennett", "cranks"])
def test_what_turns_for_ever_has_a_reach_of_a_full_turn(name, noise):
    mechanism = over(name, noise)
    assert (mechanism.dof, len(mechanism.projected)) == (1, 1)
    can = reach(mechanism)
    assert can.turns_fully
    assert can.singular == ()
    assert max(mechanism.gap_m(q) for q in can.poses) < (NOISY_GAP_M if noise else 1e-11)


@pytest.mark.parametrize(("noise", "allowed"), [(0.0, ANGLE_RAD), (NOISE, NOISY_RAD)])
def test_bennetts_opposite_angles_are_equal_and_the_next_one_follows_its_closed_form(noise, allowed):
    mechanism = over("bennett", noise)
    travelled = np.linspace(0.0, 2 * np.pi, 200)
    q = follow(mechanism, travelled[:, None]) - 0.0
    drawn = np.radians(60.0)
    phi = bennett_follower(drawn + travelled)
    apart = np.angle(np.exp(1j * (q[:, 1] - (phi - phi[0]))))
    assert np.abs(apart).max() < allowed
    assert np.abs(np.angle(np.exp(1j * (q[:, 2] + q[:, 0])))).max() < allowed


def test_coupled_cranks_keep_equal_angles_all_round():
    q = follow(over("cranks"), np.linspace(0.0, 2 * np.pi, 200)[:, None])
    assert np.abs(q[:, [2, 3]] - q[:, [0]]).max() < ANGLE_RAD
    assert np.abs(q[:, 1] + q[:, 0]).max() < ANGLE_RAD


def test_bricards_reach_ends_where_its_closed_form_does():
    mechanism = over("bricard")
    can = reach(mechanism)
    ends = np.radians([-120.0 - 70.0, 120.0 - 70.0])  # |cos p| <= 1 wants cos t >= -1/2
    assert np.abs([can.lower.position, can.upper.position] - ends).max() < 1e-6
    travelled = np.linspace(0.0, np.radians(45.0), 30)
    q = follow(mechanism, travelled[:, None])
    expected = [bricard_follower(np.radians(70.0) + t) - bricard_follower(np.radians(70.0)) for t in travelled]
    assert np.abs(q[:, 1] - expected).max() < ANGLE_RAD


@pytest.mark.parametrize("noise", [0.0, NOISE])
@pytest.mark.parametrize("name", ["bennett", "cranks"])
def test_rates_and_accelerations_are_those_of_the_closed_motion(name, noise):
    mechanism, h = over(name, noise), 1e-3
    for s in np.linspace(0.3, 6.0, 9):
        q = [close_at(mechanism, np.array([s + k * h]), close_at(mechanism, np.array([s]))) for k in (-2, -1, 0, 1, 2)]
        rate = (8 * (q[3] - q[1]) - (q[4] - q[0])) / (12 * h)
        gamma = np.array(mechanism.dynamics.velocity_map(q[2])).ravel()
        assert np.abs(gamma - rate).max() < 1e-8


@pytest.mark.parametrize("name", ["bennett", "cranks"])
def test_forces_are_mujocos_least_norm_ones_all_round(name):
    mechanism = over(name)
    model = copy.copy(mechanism.model)
    model.opt.tolerance, model.opt.iterations = 1e-16, 300  # redundant rows are ill-conditioned for the solver
    model.actuator_ctrllimited[:] = False
    rng = np.random.default_rng(0)
    for s in np.linspace(0.2, 6.2, 7):
        q = close_at(mechanism, np.array([s]))
        v, u = rng.normal(size=1), rng.uniform(-1, 1, 1)
        found = []
        for softness in (1e-3, 1e-4):
            model.body_invweight0[:] = softness  # every row alike: forces are then those of least norm
            data = mujoco.MjData(model)
            data.qpos[:], data.qvel[:] = mechanism.qpos_of(q), np.array(mechanism.dynamics.velocity_map(q)) @ v
            data.ctrl[:] = u
            mujoco.mj_forward(model, data)
            found.append(np.array(data.efc_force[: data.ne]))
        hard = (10 * found[1] - found[0]) / 9
        a = mechanism.dynamics.acceleration(q, v, u)
        force = np.array(mechanism.dynamics.closure_force(q, v, a, u)).ravel()
        assert np.abs(hard).max() > 1e-2, "the loop carries load"
        assert relative_error(force, hard) < RANDOM_LIMIT


# Three parallel cranks on one bar; a slide on a diagonal follows a crank, and a second slide is pinned to the first. The
# pin's x and z rows are one row twice at every pose, within loops that are solved by all their rows.
REPEATED_ROWS = """<mujoco model="diagonal"><default><geom contype="0" conaffinity="0" size=".01"/></default><worldbody>
  <body><joint name="A" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .1"/>
    <body name="bar" pos="0 0 .1"><joint name="B" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .4 0 0"/></body></body>
  <body name="second" pos=".2 0 0"><joint name="C" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .1"/></body>
  <body name="third" pos=".4 0 0"><joint name="D" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .1"/></body>
  <body name="one" pos="0 .1 0"><joint name="S" type="slide" axis="1 0 1"/><geom/></body>
  <body name="two" pos="0 .1 0"><joint name="T" type="slide" axis="1 0 1"/><geom/></body></worldbody>
  <equality><connect body1="bar" body2="second" anchor=".2 0 0"/><connect body1="bar" body2="third" anchor=".4 0 0"/>
    <joint joint1="S" joint2="C" polycoef="0 .1 0 0 0"/><connect body1="one" body2="two" anchor="0 0 0"/></equality>
  <actuator><motor joint="A" ctrlrange="-5 5"/></actuator></mujoco>"""


def test_closure_forces_balance_every_joint_when_rows_of_a_pin_depend_on_one_another():
    mechanism = load_mechanism(REPEATED_ROWS)
    dynamics = mechanism.dynamics
    assert (mechanism.dof, len(mechanism.projected)) == (1, 1)
    q, v, u = close_at(mechanism, np.array([0.7])), np.array([3.0]), np.array([2.0])
    a = np.array(dynamics.acceleration(q, v, u)).ravel()
    step = 1e-6  # [s], of the finite difference that gives q''
    rates = np.array(dynamics.velocity_map(q)) @ v
    ahead, behind = (
        np.array(dynamics.velocity_map(close_at(mechanism, np.array([0.7]) + sign * step * v))) @ v for sign in (1, -1)
    )
    acceleration = np.array(dynamics.velocity_map(q)) @ a + (ahead - behind) / (2 * step)
    needed = np.array(dynamics.tree_effort(q, rates, acceleration)).ravel() - np.array(dynamics.effort_matrix(q)) @ u
    force = np.array(dynamics.closure_force(q, v, a, u)).ravel()
    assert np.abs(needed).max() > 0.01, "the loops carry load"
    assert np.array(dynamics.closure_jacobian(q)).T @ force == pytest.approx(needed, abs=1e-6 * np.abs(needed).max())


@pytest.mark.parametrize("name", LINKAGES)
def test_ordinary_loops_are_solved_in_chosen_rows(name):
    assert load_mechanism(LINKAGES[name]).projected == ()


# Rounding of a file


def noisy_four_bar(noise: float) -> str:
    return replaced(WELDED, '<joint name="C"/>', f'<joint name="C" axis="{noise} 1 {-noise}"/>')


@pytest.mark.parametrize("noise", [1e-7, 1e-6])
def test_axes_that_are_off_by_rounding_do_not_lock_a_planar_loop(noise):
    mechanism = load_mechanism(noisy_four_bar(noise))
    plain = load_mechanism(WELDED)
    assert (mechanism.dof, mechanism.projected) == (1, ()), "and it is solved as the plain one"
    (note,) = mechanism.notes
    assert "rounding" in note
    assert "closure_tolerance_m" in note
    s = np.array([0.5])
    assert np.abs(close_at(mechanism, s) - close_at(plain, s)).max() < 10 * noise


def test_the_tolerance_is_the_users():
    with pytest.raises(ModelError, match=r"locked.*closure_tolerance_m = 1e-09"):
        load_mechanism(noisy_four_bar(1e-6), closure_tolerance_m=1e-9)
    assert load_mechanism(noisy_four_bar(1e-4), closure_tolerance_m=1e-4).dof == 1
    with pytest.raises(ModelError, match="closure_tolerance_m"):
        load_mechanism(WELDED, closure_tolerance_m=-1.0)


LOCKED_NECK = """<mujoco model="neck"><compiler angle="radian"/><worldbody>
  <body name="trunk"><joint name="hip" axis="0 1 0"/><geom size="0.1" pos="0 0 0.2"/>
    <body name="head" pos="0 0 0.4"><joint name="neck" axis="0 1 0"/><geom size="0.05" pos="0 0 0.1"/></body></body>
  </worldbody>
  <equality><joint joint1="neck"/></equality>
  <actuator><motor name="hip" joint="hip" ctrlrange="-9 9"/><motor name="neck" joint="neck" ctrlrange="-9 9"/></actuator>
</mujoco>"""


def test_every_joint_that_the_loops_lock_and_every_idle_actuator_is_named():
    notes = load_mechanism(LOCKED_NECK).notes
    assert any("lock joint neck" in note for note in notes)
    assert any("actuator neck has no effect" in note for note in notes)
    assert not any("hip" in note for note in notes)


TILTED = """<mujoco model="two drives"><compiler angle="radian"/><worldbody>
  <body name="arm" pos="0 0.5 0"><joint name="arm" axis="0 1 0"/><geom size="0.02" pos="0 0 0.1"/></body>
  <body name="crank"><joint name="crank" axis="0 1 {tilt}"/><geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.05"/>
    <body name="coupler" pos="0 0 0.05"><joint name="coupler" axis="0 1 0"/>
      <geom type="capsule" size="0.01" fromto="0 0 0 0.2 0 0.05"/></body></body>
  <body name="rocker" pos="0.2 0 0"><joint name="rocker" axis="0 1 0"/>
    <geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.1"/></body></worldbody>
  <equality><connect body1="coupler" body2="rocker" anchor="0.2 0 0.05"/></equality>
  <actuator><motor name="arm" joint="arm" ctrlrange="-9 9"/><motor name="crank" joint="crank" ctrlrange="-9 9"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("tilt", [1e-4, 1e-3])
def test_a_drive_that_rounding_locks_is_a_fault_with_the_tolerance_that_frees_it(tilt):
    locked = load_mechanism(TILTED.format(tilt=tilt))
    (fault,) = locked.faults
    assert fault.startswith("actuator crank has no effect: the loops lock joint crank; its motion opens them by ")
    tolerance = float(re.search(r"closure_tolerance_m = (\S+) allows", fault).group(1))
    freed = load_mechanism(TILTED.format(tilt=tilt), closure_tolerance_m=tolerance)
    assert (locked.dof, freed.dof, freed.faults) == (1, 2, ())
    assert 0.05 * tilt < tolerance < 0.2 * tilt  # links of a decimetre
    assert load_mechanism(TILTED.format(tilt=0.5)).faults == ()


# Forces, relative.
FORCE = 1e-8


def turned(mechanism: Mechanism, n: int = 40) -> np.ndarray:
    """Return poses through a whole turn of the crank."""
    return follow(mechanism, np.column_stack([np.linspace(0.0, 2 * np.pi, n), np.zeros(n)]))


def test_five_rows_serve_through_a_whole_turn_without_normal_equations():
    mechanism = load_mechanism(TWO_BALLS)
    assert mechanism.n_closure_rows == 6
    assert len(mechanism.closure_rows) == 5
    assert not mechanism.dynamics.projected
    poses = turned(mechanism)
    values = [np.linalg.svd(np.array(mechanism.dynamics.closure_jacobian(q)), compute_uv=False) for q in poses]
    assert min(value[4] for value in values) > 0.01
    assert max(value[5] for value in values) < 1e-12


def test_the_simulators_own_gaps_stay_closed_along_the_turn():
    mechanism = load_mechanism(TWO_BALLS)
    data = mujoco.MjData(mechanism.model)
    for q in turned(mechanism):
        data.qpos[:] = mechanism.qpos_of(q)
        mujoco.mj_forward(mechanism.model, data)
        assert np.abs(data.efc_pos[: data.ne]).max() < SWEPT_GAP_M


def test_both_pins_bear_the_least_forces_that_hold():
    mechanism = load_mechanism(TWO_BALLS)
    rng = np.random.default_rng(0)
    for q in turned(mechanism, 7):
        motion = (q, rng.normal(size=2), rng.normal(size=2), rng.normal(size=1))
        force = np.array(mechanism.dynamics.closure_force(*motion)).ravel()
        J = np.array(mechanism.dynamics.closure_jacobian(q))
        least = np.linalg.pinv(J.T) @ (J.T @ force)
        assert np.linalg.norm(force) > 0.1
        assert np.linalg.norm(force - least) < FORCE * np.linalg.norm(force)


def test_pins_that_are_not_as_far_apart_in_both_bodies_keep_all_their_rows():
    off = load_mechanism(replaced(TWO_BALLS, 'name="p2" pos="0.03 0.09 -0.1"', 'name="p2" pos="0.03 0.09 -0.1000001"'))
    assert off.home_gap_m > 1e-8
    assert off.gap_m(off.home) > 1e-9, "what gapes is said"
