"""Constant forces on sites: MuJoCo's generalised forces, virtual work, plans, proofs and simulations with them."""

import mujoco
import numpy as np
import pytest

from linkplan import transfer
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate_one
from linkplan.models.audit import audit
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at
from linkplan.models.selected_model import whole_model_text
from linkplan.models.selection import Selection
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker, tracking_reference
from tests.support.refusals import assert_refused
from tests.support.steering import FORCE, STEERING, rack_force, tyre_of


def steering(clamp: str = "", **force: tuple[float, float, float]) -> Mechanism:
    """Return the steering linkage, with stiff loops, with forces by site."""
    return load_mechanism(STEERING.format(clamp=clamp), solref="stiff", selection=Selection(force=force))


@pytest.mark.parametrize("s", [-0.04, 0.0, 0.013, 0.04])
def test_the_rack_force_of_a_tyre_load_is_that_of_virtual_work(s):
    mechanism, still = steering(tyre=FORCE), np.zeros((1, 1))
    effort, missed = needed_effort(mechanism, close_at(mechanism, np.array([s]))[None], still, still)
    assert abs(rack_force(s)) > 200
    assert effort[0, 0] == pytest.approx(rack_force(s), rel=1e-8)
    assert np.abs(missed).max() < 1e-9


def test_their_generalised_forces_are_those_of_mujocos_own_model():
    mechanism = steering(tyre=FORCE)
    model = mechanism.model
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    assert model.nu == 2
    assert [actuator.name for actuator in mechanism.actuators] == ["rack"]
    for _ in range(20):
        q = rng.uniform(-1.0, 1.0, mechanism.n_q)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, model.site("tyre").id)
        own = np.array(mechanism.dynamics.passive(q, np.zeros(mechanism.n_q))).ravel()
        np.testing.assert_allclose(own, data.qfrc_actuator, atol=1e-9)
        np.testing.assert_allclose(own, jacobian.T @ FORCE, atol=1e-9)


def test_a_hold_and_the_map_of_outputs_contain_them():
    mechanism = steering(tyre=FORCE)
    plan = plan_motion(Problem.hold(mechanism, start_m={"rack": 0.02}, duration_s=0.2)).require()
    assert plan.trajectory.effort.ravel() == pytest.approx(rack_force(0.02), rel=1e-8)
    table = transfer(mechanism, ["rack"])
    assert table.struct.home["hold"][0] == pytest.approx(rack_force(0.0), rel=1e-8)
    assert table.struct.home["gravity"][0] == pytest.approx(0.0, abs=1e-9), "in a horizontal plane"


def test_a_planned_motion_counts_them_is_proved_and_is_followed_in_mujoco():
    ends = {"start_m": {"rack": -0.03}, "goal_m": {"rack": 0.03}, "duration_s": 0.3}
    problem = Problem.reach(steering(tyre=FORCE), **ends)
    plan = plan_motion(problem).require()
    proof = prove(problem, plan.trajectory, existence=False)
    assert {finding.answer for finding in proof.findings} == {"proved", "sampled"}
    without = prove(Problem.reach(steering(), **ends), plan.trajectory)
    lacking = [finding for finding in without.findings if "planned effort lacks" in finding.name]
    assert [finding.answer for finding in lacking] == ["refuted"], "the same efforts do not move the unloaded linkage so"
    plant = MujocoPlant(mechanism=problem.mechanism, loop=ControlLoop(effort_limit=problem.limits.effort))
    reference = tracking_reference(plan)
    run = simulate_one(plant, build_tracker("lqr", plan, reference), reference)
    assert np.abs(run.error_rad).max() < 1e-3, "[m]"


def test_the_work_of_a_motion_is_kinetic_energy_and_that_against_the_force():
    """From rest to rest, without losses, the motor does the work - F . (p1 - p0)."""
    ends = {"start_m": {"rack": -0.03}, "goal_m": {"rack": 0.03}, "duration_s": 0.3}
    plan = plan_motion(Problem.reach(steering(tyre=FORCE), **ends)).require()
    motion = plan.trajectory
    nodes, weights = np.polynomial.legendre.leggauss(12)
    time = motion.times_at(0.5 + 0.5 * nodes)
    width = (np.diff(motion.breaks_s)[:, None] * 0.5 * weights).ravel()
    work = width @ (motion.effort_at(time) * motion.velocity_at(time)).ravel()
    assert work == pytest.approx(-np.array(FORCE[:2]) @ (tyre_of(0.03) - tyre_of(-0.03)), rel=1e-6)


def test_an_exported_model_has_the_same_force():
    mechanism = steering(tyre=FORCE)
    again = load_mechanism(whole_model_text(mechanism))
    q = close_at(mechanism, np.array([0.02]))
    still = np.zeros(mechanism.n_q)
    forces = [np.array(one.dynamics.passive(q, still)).ravel() for one in (mechanism, again)]
    assert np.abs(forces[0]).max() > 10
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-9)
    assert mechanism.source["force"] == {"tyre": tuple(FORCE)}


def test_a_force_is_noted_and_a_zero_one_is_none():
    (noted,) = audit(steering(tyre=FORCE).model)
    assert not noted.falsifies
    assert noted.text.endswith("it has no gain: a constant force; plans include it")
    assert not audit(steering(tyre=(0.0, 0.0, 0.0)).model)


LAW = 'gaintype="fixed" biastype="affine"'


@pytest.mark.parametrize(
    ("actuator", "included"),
    [
        (f'<general site="tyre" refsite="post" gear="3 -4 0 0 0 0" {LAW} gainprm="0" biasprm="2"/>', True),
        (f'<general site="tyre" refsite="post" gear="3 -4 0 0 0 1" {LAW} gainprm="0" biasprm="2"/>', False),
        (f'<general site="tyre" refsite="post" gear="3 -4 0 0 0 0" {LAW} gainprm="0" biasprm="2 0 -1"/>', False),
        (f'<general site="tyre" gear="3 -4 0 0 0 0" {LAW} gainprm="0" biasprm="2"/>', False),
    ],
    ids=["a constant force", "a torque", "a damper", "a force that turns with its body"],
)
def test_an_actuator_of_a_file_is_such_a_force_or_is_refused(actuator, included):
    """The post's axes are turned by a quarter: gear (3, -4) is (4, 3) in the world."""
    post = '<worldbody><site name="post" euler="0 0 90"/>'
    text = STEERING.format(clamp="").replace("<worldbody>", post).replace("</actuator>", f"{actuator}</actuator>")
    mechanism = load_mechanism(text)
    assert any(one.falsifies for one in audit(mechanism.model)) is not included
    if included:
        still = np.zeros((1, 1))
        effort, _ = needed_effort(mechanism, mechanism.home[None], still, still)
        assert effort[0, 0] == pytest.approx(rack_force(0.0, (8.0, 6.0)), rel=1e-8)


@pytest.mark.parametrize(
    ("force", "words"),
    [
        ({"tyres": [0.0, 1.0, 0.0]}, "unknown site in mechanism.force 'tyres' (did you mean 'tyre'?)"),
        ({"tyre": [0.0, 1.0]}, "mechanism.force.tyre must be [x, y, z] in newtons, got [0.0, 1.0]"),
        ({"tyre": 5.0}, "mechanism.force.tyre must be [x, y, z] in newtons, got 5.0"),
    ],
)
def test_a_force_that_cannot_act_is_refused_in_one_line(force, words):
    text = STEERING.format(clamp="")
    assert_refused(lambda: Problem.hold(text, start_m={"rack": 0.0}, duration_s=0.2, force=force), words)


def test_a_clamp_that_would_cut_the_force_is_named():
    chain = """<mujoco><worldbody><body name="arm"><joint name="hip" axis="0 1 0" actuatorfrcrange="-5 5"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/><site name="hand" pos="0.3 0 0"/></body></worldbody>
    <actuator><motor name="m" joint="hip"/></actuator></mujoco>"""
    with pytest.raises(LinkplanError, match="the actuatorfrcrange of joint 'hip' would clamp the force"):
        load_mechanism(chain, selection=Selection(force={"hand": (0.0, 0.0, 9.0)}))
