"""Mechanisms as others write them: an adaptive gripper and a sprung leg, with all that their files have in them."""

from functools import cache

import numpy as np
import pytest

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import spring_equilibrium, sprung_freedoms
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.check.inspection import inspect
from linkplan.studies.compare.compare import track
from tests.support.data import DATA
from tests.support.mechanism_checks import acceleration, rigid_acceleration
from tests.support.mechanisms import simulated
from tests.support.tolerances import DIFFERENCES, REST_EFFORT, TREE, relative_error

GRIPPER = DATA / "adaptive_gripper.xml"
LEG = DATA / "sprung_leg.xml"
LOCKS = (
    '<equality><joint joint1="right_coupler_joint" polycoef="0 0 0 0 0"/>'
    '<joint joint1="left_coupler_joint" polycoef="0 0 0 0 0"/>'
)
# What the gripper's soft loops let its drivers miss under the planned effort [deg].
TRACKED_DEG = 0.01


@cache
def gripper() -> Mechanism:
    return load_mechanism(GRIPPER)


@cache
def leg() -> Mechanism:
    return load_mechanism(LEG)


@cache
def locked() -> str:
    return GRIPPER.read_text(encoding="utf-8").replace("<equality>", LOCKS)


def test_an_adaptive_gripper_has_a_freedom_for_each_finger_beside_its_drive():
    assert (gripper().n_q, gripper().dof, gripper().n_closure_rows, len(gripper().closure_rows)) == (8, 3, 7, 5)
    assert gripper().actuators[0].target == "tendon split"


def test_its_fingers_are_said_to_be_pressed_onto_their_stops():
    found = inspect(gripper(), [])
    (pressed,) = (problem for problem in found.problems if "press" in problem)
    assert "right_coupler_joint (0 deg), left_coupler_joint (0 deg) onto their stops" in pressed
    assert "driver" not in pressed
    assert sum("springs hold it" in note for note in found.notes) == 2


def test_with_its_couplers_locked_it_moves_as_mujocos_own_matrices_say():
    mechanism = load_mechanism(locked())
    assert mechanism.dof == 1
    assert not any("press" in problem for problem in inspect(mechanism, []).problems)
    for s, v, u in ((0.1, 3.0, 1.0), (0.4, -2.0, -3.0), (0.7, 1.0, 5.0)):
        q = close_at(mechanism, np.array([s]))
        found = acceleration(mechanism, q, np.array([v]), np.array([u]))
        assert relative_error(found, rigid_acceleration(mechanism, q, np.array([v]), np.array([u]))) < DIFFERENCES


@pytest.mark.slow
def test_with_its_couplers_locked_it_is_planned_and_tracked(tmp_path):
    path = tmp_path / "locked.xml"
    path.write_text(locked(), encoding="utf-8")
    ends = {"start_deg": {"left_driver_joint": 5.0}, "goal_deg": {"left_driver_joint": 30.0}}
    plan = plan_motion(Problem.reach(path, **ends, duration_s=0.5, tracking={"kp": 200.0, "kd": 1.0}))
    assert plan.require().certificate.passed
    rollout = track(plan, "pd+ff")
    assert np.degrees(np.abs(rollout.position_rad - rollout.reference_rad).max()) < TRACKED_DEG


@pytest.mark.slow
def test_closed_too_far_its_pads_meet_and_the_plan_is_refused(tmp_path):
    path = tmp_path / "locked.xml"
    path.write_text(locked().replace('ctrlrange="0 255"', 'ctrlrange="-100 400"'), encoding="utf-8")
    ends = {"start_deg": {"left_driver_joint": 5.0}, "goal_deg": {"left_driver_joint": 45.0}}
    plan = plan_motion(Problem.reach(path, **ends, duration_s=0.5))
    assert plan.status == "failed"
    assert "geoms right_pad" in plan.message
    assert "(left_pad) collide at t = " in plan.message


def test_a_sprung_leg_has_eight_freedoms_of_which_one_is_idle_and_two_are_on_springs():
    names = [joint.name for joint in leg().independent_joints]
    assert (leg().n_q, leg().dof, leg().n_closure_rows, len(leg().closure_rows)) == (13, 8, 6, 5)
    idle = {leg().joints[i].name for i in leg().passive_dofs} & set(names)
    assert idle == {"left-achilles-rod_rx"}
    assert [names[c] for c in sprung_freedoms(leg())] == ["left-tarsus", "left-heel-spring"]


def test_a_sprung_leg_s_mass_matrix_is_mujocos():
    q, rates = leg().home, np.zeros(leg().n_q)
    T = np.array([leg().qvel_of(q, rate) for rate in np.eye(leg().n_q)]).T
    at = simulated(leg().model, leg().qpos_of(q), leg().qvel_of(q, rates))
    assert relative_error(np.array(leg().dynamics.mass_matrix(q)), T.T @ at.mass_matrix @ T) < TREE


def test_a_sprung_leg_rests_where_mujocos_forces_leave_nothing_to_its_springs():
    """At the rest found, MuJoCo's gravity and springs do no work along the freedoms that no motor reaches."""
    columns = sprung_freedoms(leg())
    named = {c: float(leg().home[i]) for c, i in enumerate(leg().independent.tolist()) if c not in columns}
    s = spring_equilibrium(leg(), named, columns)
    assert s is not None
    q, still = close_at(leg(), s), np.zeros(leg().n_q)
    at = simulated(leg().model, leg().qpos_of(q), leg().qvel_of(q, still))
    T = np.array([leg().qvel_of(q, rate) for rate in np.eye(leg().n_q)]).T
    along = T @ np.array(leg().dynamics.velocity_map(q))
    forces = along.T @ (at.passive - at.bias)
    assert forces[list(columns)] == pytest.approx([0.0, 0.0], abs=REST_EFFORT)
    assert np.abs(forces).max() > 0.1
    # Home is no rest: there the springs are bent by the loop's assembly.
    at_home = simulated(leg().model, leg().qpos_of(leg().home), leg().qvel_of(leg().home, still))
    bent = (np.array(leg().dynamics.velocity_map(leg().home)).T @ T.T @ (at_home.passive - at_home.bias))[list(columns)]
    assert np.abs(bent).max() > 1.0
