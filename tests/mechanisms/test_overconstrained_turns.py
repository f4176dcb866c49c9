"""Overconstrained linkages over a full turn: planned, certified, tracked in MuJoCo, with least-norm pin forces."""

import copy
from functools import cache

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.planner.plan.plan import Plan
from linkplan.planner.search.planning import plan_motion
from tests.support.overconstrained import bennett, bricard, coupled_cranks, sarrus
from tests.support.tolerances import RANDOM_LIMIT, relative_error

NOISE = 1e-7
# What rounding of a file leaves open: links of a decimetre times the axes' error, a few times over [m].
GAP_M = {0.0: 1e-11, NOISE: 3e-7}
# A noisy mechanism's plan is a motion of its own equations as an exact one's is [deg]; without the exact derivative of the
# normal equations 1e-4.
INTEGRATED_DEG = 5e-6
# Least effort with axes that are off by NOISE against that without, relative.
SAME_EFFORT = 1e-6
# Tracking [deg] by a weak PD with feedforward, loops as soft as MuJoCo makes them by default. Measured 0.7.
TRACKED_DEG = 1.0
MODELS = {"bennett": bennett, "cranks": coupled_cranks, "bricard": bricard}
TRACKING = {"period_s": 1e-3, "kp": 2.0, "kd": 0.1, "duration_s": 2.0}


@cache
def planned(name: str, noise: float) -> Plan:
    """Return the plan of a full turn in a second; of Bricard's linkage, whose hinges swing, there and back.

    By `plan_motion`: `linkplan.plan` would begin a proof, which takes longer here than any time it is given.
    """
    model = MODELS[name](noise)
    asked = {"start_deg": {"H0": 0.0}, "goal_deg": {"H0": 40.0}} if name == "bricard" else {"turns": {FIRST[name]: 1}}
    return plan_motion(linkplan.Problem.periodic(model, duration_s=1.0, tracking=TRACKING, **asked)).require()


FIRST = {"bennett": "H0", "cranks": "O0", "bricard": "H0"}
NOISY = [pytest.param(name, marks=pytest.mark.long if name == "bricard" else pytest.mark.slow) for name in MODELS]
of_each = pytest.mark.parametrize("name", MODELS)
exact_and_noisy = pytest.mark.parametrize(
    ("name", "noise"),
    [
        *(pytest.param(name, 0.0, id=f"{name}, exact") for name in MODELS),
        *(pytest.param(*one.values, NOISE, id=f"{one.values[0]}, noisy", marks=one.marks) for one in NOISY),
    ],
)


@exact_and_noisy
def test_a_plan_of_a_turn_is_certified(name, noise):
    plan = planned(name, noise)
    assert plan.certificate.passed
    assert plan.certificate.closure_gap_m < GAP_M[noise]
    assert plan.certificate.integration_error_deg < INTEGRATED_DEG
    trajectory = plan.trajectory
    turned = 0.0 if name == "bricard" else 2 * np.pi
    assert trajectory.position[-1, -1, 0] - trajectory.position[0, 0, 0] == pytest.approx(turned, abs=1e-9)


@pytest.mark.parametrize("name", NOISY)
def test_rounding_of_the_axes_changes_the_effort_no_more_than_itself(name):
    assert planned(name, NOISE).objective == pytest.approx(planned(name, 0.0).objective, rel=SAME_EFFORT)


@exact_and_noisy
def test_a_turn_is_tracked_in_mujoco(name, noise):
    rollout = linkplan.track(planned(name, noise), "pd+ff").comparison.nominal["pd+ff"]
    assert rollout.stable
    assert np.degrees(np.abs(rollout.error_rad).max()) < TRACKED_DEG
    gone = 0.0 if name == "bricard" else 720.0
    assert np.degrees(rollout.position_rad[-1, 0] - rollout.position_rad[0, 0]) == pytest.approx(gone, abs=1.0)


@of_each
def test_pin_forces_along_the_turn_are_mujocos_of_least_norm(name):
    plan = planned(name, 0.0)
    mechanism, trajectory = plan.problem.mechanism, plan.trajectory
    time = np.linspace(0.03, 0.97, 9)
    path = np.concatenate([np.linspace(0.0, 0.03, 20)[:-1], np.linspace(0.03, 0.97, 401)])
    q = follow(mechanism, trajectory.position_at(path), trajectory.start_pose)[19::50]
    v, a, u = (f(time) for f in (trajectory.velocity_at, trajectory.acceleration_at, trajectory.effort_at))
    forces = sampled(mechanism.dynamics.closure_force, q, v, a, u)[:, :, 0]
    expected = np.array([least_norm(mechanism, *x) for x in zip(q, v, u, strict=True)])
    assert np.abs(expected).max() > 1e-2, "the loop carries load"
    assert relative_error(forces, expected) < RANDOM_LIMIT


def least_norm(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return MuJoCo's forces (n_rows,) on the closures' rows in the limit of hard rows that are all alike."""
    model, found = copy.copy(mechanism.model), []
    model.opt.tolerance, model.opt.iterations = 1e-16, 300  # redundant rows are ill-conditioned for the solver
    model.actuator_ctrllimited[:] = False
    for softness in (1e-3, 1e-4):
        model.body_invweight0[:] = softness
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = mechanism.qpos_of(q), np.array(mechanism.dynamics.velocity_map(q)) @ v
        data.ctrl[:] = u
        mujoco.mj_forward(model, data)
        found.append(np.array(data.efc_force[: data.ne]))
    return (10 * found[1] - found[0]) / 9


def test_a_way_through_the_flat_pose_of_sarrus_linkage_is_named_before_any_solving():
    ways = {goal: {"start_deg": {"A1": 0.0}, "goal_deg": {"A1": goal}, "duration_s": 0.6} for goal in (-55.0, -20.0)}
    plan = plan_motion(linkplan.Problem.reach(sarrus(0.5), **ways[-55.0]))
    assert plan.status == "infeasible"
    assert "at A1 = -28.648 deg, the closure's rank falls from 4 to 2" in plan.message
    assert plan.history == ()
    coarse = {"intervals": 10, "tolerance_deg": 1e-2}
    assert plan_motion(linkplan.Problem.reach(sarrus(0.5), **ways[-20.0], mesh=coarse)).status == "optimal"
