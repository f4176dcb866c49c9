"""Reserve and ranges: effort limits kept at every corner, by second routes; what they cost; what cannot be asked."""

import copy
from dataclasses import replace
from functools import cache
from importlib import resources

import mujoco
import numpy as np
import pytest
import scipy.linalg
from msgspec import structs

from linkplan.controllers.reference import sample
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import LinkplanError
from linkplan.models.library import compile_model
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.payload import SHANK
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.efforts import RobustLimit
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.instant import Corner, Robust, corner_efforts_along
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion, price_of
from linkplan.studies.compare.compare import build_tracker
from tests.support.machines import run_alone
from tests.support.mechanisms import FIVE_BAR
from tests.support.plans import optimal
from tests.support.refusals import assert_refused

HEAVY = ["robust.payload_factor=[0.8, 1.2]"]


def planned(name: str, *overrides: str):
    return plan_motion(load_problem(name, list(overrides)))


def samples(plan) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    trajectory, mechanism = plan.trajectory, plan.problem.mechanism
    time = trajectory.dense_times(7)
    q = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    return time, q, trajectory.velocity_at(time), trajectory.acceleration_at(time)


def test_least_time_over_a_range_of_payloads_is_that_of_the_heaviest():
    """Of a motion from rest to rest of one freedom the heavier machine needs more effort everywhere."""
    robust = planned("knee-sprint", *HEAVY)
    problem = load_problem("knee-sprint")
    heavy = load_mechanism("optimus-knee", payload=SHANK.scaled(1.2))
    alone = plan_motion(problem.replace(mechanism=heavy))
    assert alone.objective > 1.05 * planned("knee-sprint").objective
    assert robust.objective == pytest.approx(alone.objective, rel=1e-7)


def test_a_corner_s_efforts_are_the_inverse_dynamics_of_its_own_machine():
    plan = optimal("knee-reach")
    _, q, v, a = samples(plan)
    corner = Corner(payload_factor=0.7, torque_factor=0.9, friction=(("O", 0.05, 0.0),))
    found = corner_efforts_along(plan.problem.mechanism, (corner,), q, v, a, np.zeros_like(v))[:, 0]
    other = load_mechanism("optimus-knee", payload=SHANK.scaled(0.7))
    wanted = (needed_effort(other, q, v, a)[0] + 0.05 * v) / 0.9
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)


def test_corners_of_several_freedoms_are_solved_for_together():
    mechanism = load_mechanism(FIVE_BAR)
    rng = np.random.default_rng(2)
    q = np.tile(mechanism.home, (4, 1))
    v, a, u = rng.normal(size=(3, 4, mechanism.dof))
    found = corner_efforts_along(mechanism, (Corner(torque_factor=0.5),), q, v, a, u)[:, 0]
    np.testing.assert_allclose(found, 2 * needed_effort(mechanism, q, v, a)[0], rtol=1e-9)


def test_dry_friction_is_kept_against_either_direction():
    corners = Robust(coulomb_friction={"O": (0.0, 2.0)}).corners
    assert sorted(one.friction[0][2] for one in corners) == [-2.0, 2.0]


def test_a_certificate_names_the_corner_at_which_a_plan_fails():
    plan = optimal("knee-sprint")
    certificate = certify(plan.problem.varied(robust=Robust(payload_factor=(0.8, 1.2))), plan.trajectory)
    assert certificate.failures
    assert "act_O with payload 1.2" in certificate.failures[0]


def test_a_weaker_torque_constant_is_a_reserve():
    weak = planned("knee-sprint", "robust.torque_constant_factor=[0.9, 1.0]")
    kept = planned("knee-sprint", "limits.reserve=0.1")
    assert weak.objective == pytest.approx(kept.objective, rel=1e-6)
    assert kept.certificate.peak_effort[0] == pytest.approx(90.0)
    np.testing.assert_allclose(kept.problem.limits.actuators_effort, [[-100.0, 100.0]])


@pytest.mark.slow
def test_a_corner_needs_a_row_unless_a_weaker_machine_implies_its_limit():
    """Efforts are inversely proportional to the torque constant, so a limit that includes zero holds for larger ones too."""
    ranges = ["robust.torque_constant_factor=[0.9, 1.1]", "robust.payload_factor=[0.8, 1.2]"]

    def factors(*overrides: str) -> list[tuple[float, float]]:
        limits = RobustLimit.of(load_problem("knee-reach", [*ranges, *overrides]))
        assert len(limits) == 4
        corners = [one.corners[one.corner] for one in limits if one.rows.node is not None]
        return sorted((corner.torque_factor, corner.payload_factor) for corner in corners)

    assert factors() == [(0.9, 0.8), (0.9, 1.2)]
    assert len(factors("limits.effort.act_O=[10, 100]")) == 4


def test_what_forbids_a_robust_motion_is_named():
    plan = planned("knee-reach", "robust.payload_factor=[1.0, 2.0]", "objective.minimize=peak_effort", "mesh.intervals=10")
    assert plan.status == "infeasible"
    assert "payload 2" in plan.message


def test_the_price_is_what_the_nominal_machine_does_better():
    plan = planned("knee-sprint", "limits.reserve=0.1")
    price = price_of(plan)
    assert price.nominal == pytest.approx(optimal("knee-sprint").objective, rel=1e-9)
    assert f"{100 * (plan.objective / price.nominal - 1):+.3g} %" in price.sentence()
    assert "80 times as much" in structs.replace(price, objective=80 * price.nominal).sentence()
    assert price_of(optimal("knee-sprint")) is None


@pytest.mark.slow
def test_a_plan_with_a_reserve_is_tracked_with_a_fifth_more_payload_and_a_period_of_delay():
    """By lqr and mpc within 0.5 deg; and no tracker opens the loop. docs/choose-a-tracker.md has a periodic motion, too."""
    plan = planned("knee-sprint", *HEAVY, "limits.reserve=0.05")
    problem = plan.problem
    reference = sample(problem.mechanism, plan.trajectory, 1e-4, 2 * plan.trajectory.duration_s)
    loop = ControlLoop(effort_limit=problem.limits.actuators_effort, mass_factor=1.2, delay_periods=1)
    for kind in TRACKERS:
        followed = run_alone(problem.mechanism, reference, build_tracker(kind, plan, reference), loop)
        worst = np.degrees(np.abs(followed.error_rad).max())
        assert worst > 0.01, kind
        assert worst < 0.5 or kind not in ("lqr", "mpc"), kind
        assert followed.gap_m.max() < 10e-6, kind


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("robust.payload_factor=[1.2, 0.8]", "low <= high"),
        ("robust.payload_factor=[0.0, 0.8]", "positive factors"),
        ("robust.payload_factor=1.2", "[low, high]"),
        ("robust.payload_factr=[0.8, 1.2]", "payload_factor"),
        ("robust.viscous_friction={ Q = [0.0, 1.0] }", "'Q'"),
        ("robust.coulomb_friction={ O = [-1.0, 1.0] }", "from zero on"),
        ("limits.reserve=1.0", "limits.reserve"),
    ],
)
def test_ranges_that_mean_nothing_are_refused_in_one_line(asked, said):
    assert_refused(lambda: load_problem("knee-reach", [asked]), said)


ON_POLE = 'mechanism.payload={ body = "pole", mass_kg = 0.1, com_m = [0, 0, -0.4], inertia_kgm2 = [0, 0, 0] }'


@pytest.mark.parametrize(
    ("overrides", "lost"),
    [
        (["robust.coulomb_friction={ pole = [0.0, 0.1] }"], "pole rubbing"),
        ([ON_POLE, "robust.payload_factor=[0.8, 1.0]"], "payload 0.8"),
    ],
)
def test_what_efforts_of_an_underactuated_mechanism_cannot_make_up_for_is_refused_with_the_reason(overrides, lost):
    with pytest.raises(LinkplanError, match=f"'cart-pole' move 1 of 2 degrees of freedom, .* at the corner: {lost}"):
        load_problem("cart-pole-swing-up", overrides)


def test_what_efforts_of_an_underactuated_mechanism_can_make_up_for_is_a_range_like_others():
    """Another torque constant, friction where the motor is, a payload there: MuJoCo's inverse dynamics of such a machine."""
    on_cart = ON_POLE.replace("pole", "cart")
    overrides = [on_cart, "robust.payload_factor=[0.8, 1.3]", "robust.torque_constant_factor=[0.9, 1.0]"]
    problem = load_problem("cart-pole-swing-up", [*overrides, "robust.viscous_friction={ cart = [0.0, 0.5] }"])
    mechanism, payload = problem.mechanism, problem.mechanism.payload
    rng = np.random.default_rng(5)
    q, v, u = rng.normal(size=(3, 4, 2))
    a = np.array([np.array(mechanism.dynamics.acceleration(*x)).ravel() for x in zip(q, v, u[:, :1], strict=True)])
    corner = Corner(payload_factor=1.3, torque_factor=0.9, friction=(("cart", 0.5, 0.0),))
    found = corner_efforts_along(mechanism, (corner,), q, v, a, u[:, :1])[:, 0, 0]
    model = copy.copy(load_mechanism("cart-pole", payload=payload.scaled(1.3)).model)
    model.dof_damping[0] += 0.5
    for k in range(4):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(data.qfrc_inverse, [0.9 * found[k], 0.0], rtol=1e-9, atol=1e-9)
    assert np.abs(found - u[:, 0]).min() > 1e-3


# A metre with the pole at rest below at both ends needs 5.7 N of 20.
HANGING = ["motion.goal_deg.pole=0", "motion.duration_s=1.5"]


def test_a_motion_within_a_reserve_is_one_of_weaker_motors_too_where_they_move_only_some_freedoms():
    kept = planned("cart-pole-swing-up", *HANGING, "limits.reserve=0.73")
    assert kept.certificate.peak_effort[0] == pytest.approx(5.4, rel=1e-6)
    whole = replace(kept.problem.limits, effort=kept.problem.limits.actuators_effort, reserve=0.0)

    def of_motors(factor: float):
        problem = kept.problem.varied(limits=whole, robust=Robust(torque_constant_factor=(factor, 1.0)))
        return certify(problem, kept.trajectory)

    assert of_motors(0.2701).passed
    assert "torque constant 0.26" in of_motors(0.26).failures[0]


def test_weaker_motors_of_an_underactuated_mechanism_are_planned_for():
    assert optimal("cart-pole-swing-up", *HANGING).certificate.peak_effort[0] > 5.7
    plan = optimal("cart-pole-swing-up", *HANGING, "robust.torque_constant_factor=[0.27, 1.0]")
    assert plan.certificate.peak_effort[0] == pytest.approx(5.4, rel=1e-4)


def test_a_price_is_never_negative():
    """The plan itself is a motion of the nominal machine, also where the search for that one's finds a dearer one."""
    plan = planned("cart-pole-swing-up", "limits.reserve=0.35")
    assert plan.objective < optimal("cart-pole-swing-up").objective
    assert price_of(plan).nominal == plan.objective


def test_a_range_of_payloads_needs_a_payload():
    assert_refused(lambda: load_problem("knee-sprint-bare", HEAVY), "needs a mechanism.payload")


# A knee with a second motor, at the rocker's pin: two motors drive its one degree of freedom.
TWO_MOTORS = (resources.files("linkplan.models") / "mjcf" / "optimus-knee.xml").read_text(encoding="utf-8")
TWO_MOTORS = TWO_MOTORS.replace("</actuator>", '<motor name="act_C" joint="C" ctrlrange="-30 30"/></actuator>')
SLOW_TWO = (f"mechanism.model='''{TWO_MOTORS}'''", "motion.duration_s=0.2")
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


def corner_samples(plan: Plan, n: int) -> tuple[np.ndarray, ...]:
    trajectory = plan.trajectory
    time = (np.arange(n) + 0.5) / n * trajectory.duration_s
    q = follow(plan.problem.mechanism, trajectory.position_at(time), trajectory.start_pose)
    return q, trajectory.velocity_at(time), trajectory.acceleration_at(time), trajectory.effort_at(time)


@pytest.mark.slow
@pytest.mark.parametrize("overrides", [(), SLOW_TWO], ids=["one motor", "two motors"])
def test_at_every_corner_a_robust_plan_s_efforts_keep_their_limits_and_drive_mujoco_s_own_machine(overrides):
    plan = optimal("knee-reach", *overrides, *RANGES)
    mechanism, corners, limit = plan.problem.mechanism, plan.problem.robust.corners, plan.problem.limits.effort
    assert len(corners) == 2 * 2 * 2
    motion = corner_samples(plan, 11)
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
    limit = mechanism.effort_limit[:, 1]
    change, ratio = (weak - u[0]) / limit, maps[0] * limit
    np.testing.assert_allclose(change[0] * ratio[1], change[1] * ratio[0], rtol=1e-9)  # the least change
