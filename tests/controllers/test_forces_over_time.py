"""Forces over time in simulation: a loop of MuJoCo's own steps, errors with and without the force, rigid loops, machines."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from linkplan.controllers.imperfections.imperfections import Clock, Imperfections, Machine
from linkplan.controllers.linearisation import linearise
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rigid_plant import RigidPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker, tracking_reference
from tests.support.arms import LOWER, UPPER, arm
from tests.support.steering import STEERING

T = 0.3
TIME_S, PUSH = [0.0, 0.1, 0.15, 0.3], [0.0, 30.0, -20.0, 0.0]
TABLE = {"time_s": TIME_S, "on": {"foot": {"x": [-0.5 * f for f in PUSH], "z": PUSH}}}
TYRE = {"time_s": TIME_S, "on": {"tyre": {"y": [-60 * f for f in PUSH]}}}


@pytest.fixture(scope="module")
def plan() -> Plan:
    """Return the plan of an arm under a push on its foot."""
    ends = {"start_deg": {"J1": 0.0, "J2": 60.0}, "goal_deg": {"J1": 30.0, "J2": 20.0}, "duration_s": T}
    mechanism = load_mechanism(arm(UPPER, LOWER, limit=60.0))
    tracking = {"kp": 200.0, "kd": 4.0, "period_s": 1e-3, "duration_s": T}
    return plan_motion(Problem.reach(mechanism, **ends, force_over_time=TABLE, tracking=tracking)).require()


@pytest.fixture(scope="module")
def steered() -> Plan:
    """Return the plan of the steering linkage with stiff loops under a tyre's force."""
    mechanism = load_mechanism(STEERING.format(clamp=""), solref="stiff")
    ends = {"start_m": {"rack": -0.02}, "goal_m": {"rack": 0.03}, "duration_s": T}
    return plan_motion(Problem.reach(mechanism, **ends, force_over_time=TYRE)).require()


def error_of(plan: Plan, tracker: str, mechanism: Mechanism) -> float:
    """Return the largest error [rad or m] of a tracker on a plant that has the forces of a mechanism."""
    reference = tracking_reference(plan)
    law, loop = build_tracker(tracker, plan, reference), ControlLoop(effort_limit=plan.problem.limits.effort)
    run = simulate(MujocoPlant(mechanism=mechanism, loop=loop), law, reference)
    assert run.failure[0] is None
    return float(np.abs(run.pose[:, 0, mechanism.independent] - reference.position_rad).max())


def stepped(plan: Plan, reference: SampledReference) -> np.ndarray:
    """Return the positions (n, 2) of PD with feedforward in a loop of MuJoCo's steps, the push applied by mj_applyFT."""
    model = mujoco.MjModel.from_xml_string(arm(UPPER, LOWER, limit=60.0))
    data, law, found = mujoco.MjData(model), build_tracker("pd+ff", plan, reference), []
    foot, steps = model.site("foot").id, round(reference.period_s / model.opt.timestep)
    data.qpos[:], data.qvel[:] = reference.position_rad[0], reference.velocity_rad_s[0]
    for k in range(reference.n):
        found.append(data.qpos.copy())
        data.ctrl[:] = law.effort(k, data.qpos.copy(), data.qvel.copy())
        for j in range(steps):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            push = np.interp((k * steps + j + 0.5) * model.opt.timestep, TIME_S, PUSH) * np.array([-0.5, 0.0, 1.0])
            data.qfrc_applied[:] = 0.0
            mujoco.mj_applyFT(
                model, data, push, np.zeros(3), data.site_xpos[foot], model.site_bodyid[foot], data.qfrc_applied
            )
            mujoco.mj_step(model, data)
    return np.array(found)


def test_a_simulation_is_a_loop_of_mujoco_s_steps_with_the_force_applied_at_the_site(plan):
    reference, loop = tracking_reference(plan), ControlLoop(effort_limit=plan.problem.limits.effort)
    law = build_tracker("pd+ff", plan, reference)
    run = simulate(MujocoPlant(mechanism=plan.problem.mechanism, loop=loop), law, reference)
    by_hand = stepped(plan, reference)
    assert np.abs(by_hand - reference.position_rad).max() < 2e-3, "[rad]: it is a motion near the plan"
    np.testing.assert_allclose(run.pose[:, 0], by_hand, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "tracker"),
    [
        *(("plan", one) for one in ("pd+ff", "gs-pd+ff", "lqr", "lqi", "ct", "mpc")),
        *(("steered", one) for one in ("lqr", "ct", "mpc")),
    ],
)
def test_trackers_follow_a_plan_under_the_force_and_not_without_it(name, tracker, request):
    planned = request.getfixturevalue(name)
    mechanism = planned.problem.mechanism
    with_force, without = (error_of(planned, tracker, one) for one in (mechanism, replace(mechanism, forces=None)))
    most, times = (2e-3, 10) if name == "plan" else (1e-4, 5)  # an arm [rad], a loop driven by a slide [m]
    assert with_force < most
    assert without > times * with_force


@pytest.mark.parametrize("tracker", ["lqr", "ct"])
def test_rigid_loops_have_the_force(steered, tracker):
    reference = tracking_reference(steered)
    law, mechanism = build_tracker(tracker, steered, reference), steered.problem.mechanism
    errors = []
    for one in (mechanism, replace(mechanism, forces=None)):
        run = simulate(RigidPlant(mechanism=one), law, reference)
        errors.append(np.abs(run.pose[:, 0, mechanism.independent] - reference.position_rad).max())
    assert errors[0] < 1e-6, "[m]"
    assert errors[1] > 100 * errors[0]


def test_the_linearised_motion_is_the_slope_of_mujoco_s_accelerations_under_the_force(plan):
    reference, model = tracking_reference(plan), plan.problem.mechanism.model
    data, foot, k, step = mujoco.MjData(model), model.site("foot").id, 120, 1e-5

    def acceleration(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, reference.effort[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        push = np.interp(reference.period_s * (k + 0.5), TIME_S, PUSH) * np.array([-0.5, 0.0, 1.0])
        data.qfrc_applied[:] = 0.0
        body = model.site_bodyid[foot]
        mujoco.mj_applyFT(model, data, push, np.zeros(3), data.site_xpos[foot], body, data.qfrc_applied)
        mujoco.mj_forward(model, data)
        return data.qacc.copy()

    q, v = reference.position_rad[k], reference.velocity_rad_s[k]
    slopes = [(acceleration(q + step * e, v) - acceleration(q - step * e, v)) / (2 * step) for e in np.eye(2)]
    states = reference.pose_rad[k, None], v[None], reference.effort[k, None]
    A, _ = linearise(plan.problem.mechanism, *states, *(w[k, None] for w in reference.forces))
    without, _ = linearise(plan.problem.mechanism, *states)
    np.testing.assert_allclose(A[0, 2:, :2], np.array(slopes).T, rtol=1e-5, atol=1e-4)
    assert np.abs(A - without).max() > 1.0


def test_machines_of_an_ensemble_have_the_force_at_their_own_time_and_beside_pushes(plan):
    """A machine whose clock is late by half a period meets the force half a period later; a heavier one errs more."""
    mechanism, reference = plan.problem.mechanism, tracking_reference(plan)
    law, loop = build_tracker("lqr", plan, reference), ControlLoop(effort_limit=plan.problem.limits.effort)
    machines = [
        Imperfections(),
        Imperfections(clock=Clock(phase_periods=0.5)),
        Imperfections(machine=Machine(mass_factor=1.2)),
    ]
    together = simulate(MujocoPlant(mechanism=mechanism, loop=loop), law, reference, machines)
    for i, one in enumerate(machines):
        alone = simulate(MujocoPlant(mechanism=mechanism, loop=loop), law, reference, [one])
        assert np.array_equal(alone.pose[:, 0], together.pose[:, i])
    errors = np.abs(together.pose[:, :, mechanism.independent] - reference.position_rad[:, None]).max(axis=(0, 2))
    assert errors[0] < 2e-3
    assert errors[2] > 3 * errors[0]
