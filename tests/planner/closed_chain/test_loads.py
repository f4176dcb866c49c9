"""Loads over a place or a speed: energy balances, virtual work, MuJoCo's own steps, proofs and refusals."""

import mujoco
import numpy as np
import pytest
import scipy

from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.selection import Selection
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker, tracking_reference

SLED = """<mujoco><option gravity="0 0 0" timestep="0.0005"/><worldbody><body name="ram">
  <joint name="x" type="slide" axis="1 0 0"/><geom type="box" size="0.05 0.05 0.05" mass="2"/>
  <site name="tool" pos="0.05 0 0"/></body></worldbody>
  <actuator><motor name="f" joint="x" ctrlrange="-400 400"/></actuator></mujoco>"""
AT, EFFORT = [0.0, 0.1, 0.15, 0.2, 0.3], [0.0, 0.0, -40.0, 0.0, 0.0]
SPEEDS, DRAG = [-1.0, -0.5, 0.0, 0.5, 1.0], [40.0, 10.0, 0.0, -10.0, -40.0]
SAME = {
    "place": ({"joint": "x", "at_m": AT, "effort": EFFORT},
              {"site": "tool", "direction": [2, 0, 0], "at_m": [x + 0.05 for x in AT], "effort": EFFORT}),
    "speed": ({"joint": "x", "at_m_s": SPEEDS, "effort": DRAG},
              {"site": "tool", "direction": [1, 0, 0], "at_m_s": SPEEDS, "effort": DRAG}),
}  # fmt: skip


def sled(*loads: dict) -> Problem:
    """Return the problem of 2 kg that move by 0.3 m in 0.8 s against loads."""
    mechanism = load_mechanism(SLED, selection=Selection(load=loads))
    return Problem.reach(mechanism, start_m={"x": 0.0}, goal_m={"x": 0.3}, duration_s=0.8)


@pytest.mark.parametrize("kind", ["place", "speed"])
def test_a_load_on_a_joint_and_on_its_site_is_the_curve_through_its_rows_in_plan_proof_and_simulation(kind):
    rows = (AT, EFFORT) if kind == "place" else (SPEEDS, DRAG)
    curve = scipy.interpolate.PchipInterpolator(*rows)
    plans = [plan_motion(sled(load)) for load in SAME[kind]]
    for plan in plans:
        assert plan.status == "optimal"
        motion, time = plan.trajectory, plan.trajectory.dense_times(5)
        x, v, a = (of(time)[:, 0] for of in (motion.position_at, motion.velocity_at, motion.acceleration_at))
        load = curve(x if kind == "place" else v)
        np.testing.assert_allclose(motion.effort_at(time)[:, 0], 2.0 * a - load, atol=1e-4 * 40)  # the mesh
        assert prove(plan.problem, motion).passed
    assert plans[0].objective == pytest.approx(plans[1].objective, rel=1e-7)
    loaded, bare = (error_of(plans[1], mechanism) for mechanism in (plans[1].problem.mechanism, load_mechanism(SLED)))
    assert bare > 1e-4
    assert loaded < 0.1 * bare


def error_of(plan: Plan, mechanism: Mechanism) -> float:
    """Return the largest error [m] of PD with feedforward in MuJoCo, with the loads of a mechanism."""
    reference, loop = tracking_reference(plan), ControlLoop(effort_limit=plan.problem.limits.effort)
    law = build_tracker("pd+ff", plan, reference)
    run = simulate(MujocoPlant(mechanism=mechanism, loop=loop), law, reference)
    return float(np.abs(run.pose[:, 0, mechanism.independent] - reference.position_rad).max())


R, ROD, INERTIA = 0.1, 0.35, 8.0
PRESS = f"""<mujoco><option gravity="0 0 0"/><worldbody>
  <body name="crank"><joint name="crank" axis="0 1 0"/>
    <inertial pos="0 0 0" mass="20" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
    <body name="rod" pos="0 0 {R}"><joint name="pin" axis="0 1 0"/>
      <inertial pos="0 0 {ROD / 2}" mass="1e-4" diaginertia="1e-7 1e-7 1e-7"/></body></body>
  <body name="ram" pos="0 0 {R + ROD}"><joint name="ram" type="slide" axis="0 0 1"/>
    <inertial pos="0 0 0" mass="1e-4" diaginertia="1e-7 1e-7 1e-7"/></body></worldbody>
  <equality><connect body1="rod" body2="ram" anchor="0 0 {ROD}"/></equality>
  <actuator><motor name="drive" joint="crank" ctrlrange="-500 500"/></actuator></mujoco>"""
TURN, FORCE = [0.0, 40.0, 70.0, 110.0, 140.0, 360.0], [0.0, 0.0, 6000.0, 9000.0, 0.0, 0.0]


def test_the_least_peak_torque_of_a_punch_press_with_a_flywheel_is_the_work_of_a_stroke_over_a_turn():
    """At that constant torque the flywheel gives what the stroke takes more: no torque with a smaller peak balances it."""
    mechanism = load_mechanism(
        PRESS, selection=Selection(load=[{"joint": "ram", "over": "crank", "at_deg": TURN, "effort": FORCE}])
    )
    problem = Problem.periodic(mechanism, turns={"crank": 1}, duration_s=0.2, minimize="peak_effort", mesh={"intervals": 24})
    plan = plan_motion(problem)
    angle = np.linspace(0.0, 2 * np.pi, 200_001)
    lift = R * np.cos(angle) + np.sqrt(ROD**2 - (R * np.sin(angle)) ** 2)
    force = scipy.interpolate.PchipInterpolator(np.radians(TURN), FORCE)(angle)
    work = -np.trapezoid(force, lift)
    assert work > 500.0
    torque = np.abs(plan.trajectory.effort_at(plan.trajectory.dense_times(5)))
    assert torque.max() == pytest.approx(work / (2 * np.pi), rel=2e-3)
    later = mechanism.home.copy()
    later[0] += 40 * np.pi + 1.5
    first = mechanism.home.copy()
    first[0] += 1.5
    still = np.zeros(3)
    ends = [np.array(mechanism.dynamics.passive(q, still)) for q in (first, later)]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


@pytest.mark.parametrize(
    ("load", "said"),
    [
        ({"joint": "y", "at_m": AT, "effort": EFFORT}, "unknown joint in mechanism.load[0] 'y'"),
        ({"joint": "x", "at_deg": AT, "effort": EFFORT}, "needs one list at_m or at_m_s, got at_deg"),
        ({"site": "tool", "at_m": AT, "effort": EFFORT}, "needs a joint, or a site and its direction"),
        ({"joint": "x", "at_m": AT, "effort": EFFORT[:4]}, "with as many values of effort"),
        ({"joint": "x", "at_m": AT[::-1], "effort": EFFORT}, "at_m must increase"),
    ],
)
def test_wrong_loads_are_refused_in_one_line(load: dict, said: str):
    with pytest.raises(LinkplanError, match=said.replace("[", r"\[").replace("]", r"\]")):
        load_mechanism(SLED, selection=Selection(load=[load]))


def test_a_load_is_the_same_by_virtual_work_and_by_an_applied_force_in_mujoco():
    loads = [{"site": "tool", "direction": [0, 0, 1], "at_m": [0.0, 0.2, 0.5], "effort": [3.0, 10.0, -8.0]}]
    arm = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
      <body pos=".3 0 0"><joint name="b" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/>
      <site name="tool" pos=".2 0 0"/></body></body></worldbody>
      <actuator><motor name="a" joint="a"/><motor name="b" joint="b"/></actuator></mujoco>"""
    mechanism = load_mechanism(arm, selection=Selection(load=loads))
    q, v, a = np.array([[-0.6, -0.3]]), np.array([[0.4, -1.0]]), np.array([[2.0, 3.0]])
    model, data = mujoco.MjModel.from_xml_string(arm), None
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.qacc = q[0], v[0], a[0]
    mujoco.mj_forward(model, data)
    data.qacc = a[0]
    mujoco.mj_inverse(model, data)
    height, pushed = data.site("tool").xpos[2], np.zeros(2)
    push = scipy.interpolate.PchipInterpolator(loads[0]["at_m"], loads[0]["effort"])(height)
    mujoco.mj_applyFT(model, data, np.array([0, 0, push]), np.zeros(3), data.site("tool").xpos, 2, pushed)
    assert 0.1 < height < 0.4
    np.testing.assert_allclose(needed_effort(mechanism, q, v, a)[0][0], data.qfrc_inverse - pushed, atol=1e-9)
