"""Robust plans against MuJoCo's own inverse dynamics of every corner's machine, the loop's constraint left out of it."""

from functools import cache
from importlib import resources

import mujoco
import numpy as np
import pytest
import scipy.linalg

from linkplan.models.library import compile_model
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.payload import SHANK
from linkplan.models.poses.assembly import follow
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.instant import Corner, corner_efforts_along
from tests.support.plans import optimal

# A knee with a second motor, at the rocker's pin: one more than its degree of freedom.
TWO_MOTORS = (resources.files("linkplan.models") / "mjcf" / "optimus-knee.xml").read_text(encoding="utf-8")
TWO_MOTORS = TWO_MOTORS.replace("</actuator>", '<motor name="act_C" joint="C" ctrlrange="-30 30"/></actuator>')
RANGES = (
    "robust.payload_factor=[0.8, 1.2]",
    "robust.torque_constant_factor=[0.95, 1.05]",
    "robust.viscous_friction={ A = [0.02, 0.02] }",
    "robust.coulomb_friction={ C = [0.0, 1.0] }",
)


def loop(model: mujoco.MjModel, q: np.ndarray) -> np.ndarray:
    """Return the Jacobian (n_r, n_v) of a model's equalities at a pose, MuJoCo's own."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_fwdPosition(model, data)
    rows = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    return data.efc_J.reshape(-1, model.nv)[rows].copy()


@cache
def machine(payload_factor: float) -> mujoco.MjModel:
    """Return the model of a machine with a factor on its payload."""
    _, model, _ = compile_model(TWO_MOTORS, SHANK.scaled(payload_factor))
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    return model


def missing(mechanism: Mechanism, corner: Corner, q, s_rate, s_acceleration, efforts) -> tuple[float, float]:
    """Return the generalised effort that a machine lacks for a motion under efforts [N.m], and what it needs at all.

    The tree's inverse dynamics with the loop cut, along the loop's null space: pin forces do no work there.
    """
    model = machine(corner.payload_factor)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    null = scipy.linalg.null_space(loop(model, q), rcond=1e-9)
    gamma = null @ np.linalg.inv(null[mechanism.independent])
    rates, h = gamma @ s_rate, 1e-5
    bend = (loop(model, q + h * rates) - loop(model, q - h * rates)) @ rates / (2 * h)
    dependent, J = mechanism.dependent, loop(model, q)
    acceleration = gamma @ s_acceleration
    acceleration[dependent] -= np.linalg.lstsq(J[:, dependent], bend, rcond=None)[0]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, rates, acceleration
    data.ctrl[: len(efforts)] = efforts
    mujoco.mj_inverse(model, data)
    needed = data.qfrc_inverse.copy()
    names = [joint.name for joint in mechanism.joints]
    for name, viscous, coulomb in corner.friction:
        joint = names.index(name)
        needed[joint] += viscous * rates[joint] + coulomb
    mujoco.mj_forward(model, data)
    given = corner.torque_factor * data.qfrc_actuator
    return float(np.abs(gamma.T @ (needed - given)).max()), float(np.abs(gamma.T @ needed).max())


def samples(plan: Plan, n: int) -> tuple[np.ndarray, ...]:
    trajectory = plan.trajectory
    time = (np.arange(n) + 0.5) / n * trajectory.duration_s
    q = follow(plan.problem.mechanism, trajectory.position_at(time), trajectory.start_pose)
    return q, trajectory.velocity_at(time), trajectory.acceleration_at(time), trajectory.effort_at(time)


@pytest.mark.slow
@pytest.mark.parametrize("overrides", [(), (f"mechanism.model='''{TWO_MOTORS}'''",)], ids=["one motor", "two motors"])
def test_at_every_corner_a_robust_plan_s_efforts_keep_their_limits_and_drive_mujoco_s_own_machine(overrides):
    plan = optimal("knee-reach", *overrides, *RANGES)
    mechanism, corners, limit = plan.problem.mechanism, plan.problem.robust.corners, plan.problem.limits.effort
    assert len(corners) == 2 * 2 * 2
    motion = samples(plan, 11)
    efforts = corner_efforts_along(mechanism, corners, *motion)
    assert np.all(np.abs(efforts) <= limit[:, 1] * (1 + 1e-9))
    for item, corner in enumerate(corners):
        found = [missing(mechanism, corner, *(x[k] for x in motion[:3]), efforts[k, item]) for k in range(11)]
        lacking, needed = np.array(found).T
        assert needed.max() > 30
        assert lacking.max() < 1e-6 * needed.max()


def test_with_more_motors_than_freedoms_the_nominal_machine_has_the_plan_s_own_efforts():
    mechanism = load_mechanism(TWO_MOTORS, payload=SHANK)
    q = mechanism.home[None]
    v, a, u = np.array([[2.0]]), np.array([[30.0]]), np.array([[5.0, 7.0]])
    needed = float(mechanism.dynamics.inverse_dynamics(q[0], v[0], a[0]))
    maps = np.array(mechanism.dynamics.effort_map(q[0]))
    u[0, 0] = (needed - maps[0, 1] * u[0, 1]) / maps[0, 0]
    same, weak = corner_efforts_along(mechanism, (Corner(), Corner(torque_factor=0.9)), q, v, a, u)[0]
    np.testing.assert_allclose(same, u[0], rtol=1e-10)
    np.testing.assert_allclose(maps @ weak, needed / 0.9, rtol=1e-10)
    change = weak - u[0]
    np.testing.assert_allclose(change[0] * maps[0, 1], change[1] * maps[0, 0], rtol=1e-9)  # the least one that does it
