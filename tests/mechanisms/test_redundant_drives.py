"""More motors than degrees of freedom: every command shares their efforts within the limits of each."""

import numpy as np
import pytest
import scipy

import linkplan
from linkplan.controllers.trackers.tracker import steps_of
from linkplan.models.poses.along import demanded
from linkplan.models.poses.assembly import close_at
from linkplan.studies.compare.compare import build_tracker, tracking_reference
from linkplan.studies.feedback.frequency.feedback_loops import operating_point
from tests.support.redundant import (
    antagonist,
    finger,
    hung_plate,
    hung_point,
    least_holding_efforts,
    three_legs,
    two_motors,
    unequal_antagonist,
)

SWING = {"start_deg": {"e": -30}, "goal_deg": {"e": 40}, "duration_s": 0.4}
TABLE = {"time_s": [0, 0.2, 0.4], "position_deg": {"e": [-30, 0, 40]}}
GAINS = {"kp": 20.0, "kd": 0.6}


def loaded(text: str, **keys):
    return linkplan.load_mechanism(text, **keys)


@pytest.mark.parametrize("text", [antagonist(), two_motors(20.0, 0.5), hung_point(), hung_point(corners="1110")])
def test_check_holds_every_pose_by_the_least_efforts_within_the_limits(text):
    mechanism = loaded(text)
    limit, held = mechanism.effort_limit, 0
    for path in linkplan.check(mechanism).struct.paths:
        for pose, effort in list(zip(path.poses, path.holding_effort, strict=True))[::20]:
            least = least_holding_efforts(mechanism, pose, limit)
            held += least is not None
            if least is None:
                assert np.any((effort < limit[:, 0]) | (effort > limit[:, 1]))
            else:
                assert effort == pytest.approx(least, rel=1e-6, abs=1e-6)
    assert held > 5


@pytest.mark.parametrize("make", [unequal_antagonist, finger, three_legs, hung_plate, hung_point, antagonist])
def test_redundant_drives_hold_and_stiffen_a_pose_by_their_least_efforts(make):
    """A pose is held by the efforts of least norm, and linearised about those of least norm within 90 % of each range.

    Finite differences of the effort that is missing beside these give the stiffness of the linearised mechanism.
    """
    mechanism = loaded(make())
    limit, n, home = mechanism.effort_limit, mechanism.dof, mechanism.home
    rest, start = home[mechanism.independent], {"start_deg": {}, "start_m": {}}
    for joint, s in zip(mechanism.independent_joints, rest, strict=True):
        start[f"start_{joint.unit}"][joint.name] = joint.shown(s)
    problem = linkplan.Problem.hold(mechanism, duration_s=0.2, **{key: value for key, value in start.items() if value})
    plan = linkplan.plan(problem)
    least = least_holding_efforts(mechanism, home, limit)
    assert plan.passed, plan.message
    np.testing.assert_allclose(plan.trajectory.effort_at(np.array([0.1]))[0], least, rtol=1e-6, atol=1e-9)
    inside = limit + 0.05 * np.ptp(limit, axis=1, keepdims=True) * [1.0, -1.0]
    hold = least_holding_efforts(mechanism, home, inside)

    def missing(s: np.ndarray) -> np.ndarray:
        still = np.zeros((1, n))
        (tau,), (there,) = demanded(mechanism, close_at(mechanism, s)[None], still, still)
        return tau - there @ hold

    steps = 1e-5 * np.eye(n)
    stiffness = np.array([(missing(rest + step) - missing(rest - step)) / 2e-5 for step in steps]).T
    point, inertia = operating_point(mechanism, rest), np.array(mechanism.dynamics.reduced_inertia(home))
    np.testing.assert_allclose(point.hold, hold, rtol=1e-6, atol=1e-6)
    found = -inertia @ point.linearised()[0][n:, :n]
    np.testing.assert_allclose(found, stiffness, rtol=1e-5, atol=1e-6 * np.abs(stiffness).max())


def test_check_names_the_amount_by_which_the_limits_of_cables_fail():
    """The upper cables of 20 N, each at 45 deg, hold 28.28 N of the 39.24 N: each lacks (39.24 - 28.28) / sqrt(2) N."""
    found = linkplan.check(loaded(hung_point(least=0.0, most=20.0, corners="1100")))
    path = next(iter(found.struct.paths))
    at = int(np.argmin(np.abs(path.positions[:, 0])))
    assert path.holding_effort[at] == pytest.approx(4 * 9.81 / np.sqrt(2), rel=1e-9)
    assert "would need" in str(found)


def test_a_hold_beyond_all_motors_names_what_they_lack_together():
    """At e = 0 the weight of 1.5 kg at 0.15 m needs 2.20725 N.m; two motors of 0.5 N.m lack 1.20725 N.m."""
    plan = linkplan.plan(linkplan.Problem.hold(loaded(two_motors(0.5, 0.5)), start_deg={"e": 0.0}, duration_s=0.2))
    assert plan.status == "infeasible"
    assert "1.207 N.m on joint e more than all actuators together give" in plan.message


@pytest.mark.parametrize("text", [antagonist(), two_motors(20.0, 0.5)])
def test_a_reference_is_followed_exactly_within_the_limits(text):
    plan = linkplan.plan(linkplan.Problem.track(loaded(text), reference=TABLE))
    assert plan.passed, plan.message
    table = plan.sample(np.linspace(0, 0.4, 101))
    limit = plan.problem.mechanism.effort_limit
    for row, values in zip(limit, np.array(list(table.effort.values())), strict=True):
        assert row[0] - 1e-6 <= values.min()
        assert values.max() <= row[1] + 1e-6
    assert any(np.ptp(values) > 1 for values in table.effort.values())


@pytest.mark.parametrize("text", [antagonist(least=200.0, most=210.0), two_motors(0.5, 0.5)])
def test_a_reference_beyond_what_all_motors_give_is_infeasible(text):
    assert linkplan.plan(linkplan.Problem.track(loaded(text), reference=TABLE)).status == "infeasible"


@pytest.mark.parametrize("rate", [0.5, 0.6, 0.7, 0.8])
def test_a_reference_along_which_cables_rest_at_their_limits_is_followed(rate):
    """The least tension holds for whole intervals; rounding there is no violation."""
    table = {"time_s": [0.0, 0.1 * rate, 0.2 * rate], "position_m": {"x": [0.0, 0.01, 0.03], "z": [0.0, 0.01, 0.03]}}
    plan = linkplan.plan(linkplan.Problem.track(loaded(hung_point(least=2.0, most=1e5)), reference=table))
    assert plan.status == "optimal", plan.message
    assert min(values.min() for values in plan.sample().effort.values()) == pytest.approx(2.0, abs=1e-12)


def test_a_reference_along_which_several_cables_leave_their_limits_one_after_another_is_followed():
    share = [0.0, 0.016, 0.1035, 0.2752, 0.5, 0.7248, 0.8965, 0.984, 1.0]
    position = {"x": [0.12 * x for x in share], "z": [0.12 * x for x in share]}
    table = {
        "time_s": np.linspace(0, 0.2, 9).tolist(),
        "position_m": position,
        "position_deg": {"t": [8 * x for x in share]},
    }
    plan = linkplan.plan(linkplan.Problem.track(loaded(hung_plate()), reference=table))
    assert plan.status == "optimal", plan.message


def test_cables_that_pull_a_point_to_both_sides_give_it_two_loops():
    assert loaded(hung_point()).channels == (0, 1)


def test_the_trackers_distribute_as_the_plan_does():
    """Computed torque and the MPC give the efforts of a pre-tensioned plan, and the LQR's joint efforts within limits."""
    solver = {"compile": "never"}
    tensioned = linkplan.Problem.track(
        loaded(antagonist(), pre_tension={"flex": 60.0, "ext": 60.0}), reference=TABLE, solver=solver
    )
    plan = linkplan.plan(tensioned)
    reference = tracking_reference(plan)
    law = build_tracker("ct", plan, reference)
    found = law.effort(40, reference.position_rad[40] + 1e-3, reference.velocity_rad_s[40])
    assert found.sum() == pytest.approx(reference.effort[40].sum())
    assert found.sum() > 100.0
    plan = linkplan.plan(linkplan.Problem.track(loaded(antagonist()), reference=TABLE, solver=solver))
    reference = tracking_reference(plan)
    arms = np.array([0.03, -0.03])
    for error in (1e-3, -1e-3):
        at = (40, reference.position_rad[40:41] + error, reference.velocity_rad_s[40:41])
        lqr, mpc = (steps_of(build_tracker(name, plan, reference)) for name in ("lqr", "mpc"))
        wanted, given = (law.step(*at, law.start(1))[0][0] for law in (lqr, mpc))
        assert arms @ given == pytest.approx(arms @ wanted, rel=1e-9)
        assert given.min() >= 10.0


@pytest.mark.slow
@pytest.mark.parametrize("text", [antagonist(), two_motors(20.0, 0.5)])
def test_every_tracker_follows_as_well_as_with_one_strong_motor(text):
    trackers = ["pd+ff", "lqr", "lqi", "gs-pd+ff", "ct", "mpc"]
    found = {}
    for name, model in (("redundant", text), ("one", two_motors(20.0))):
        plan = linkplan.plan(linkplan.Problem.reach(loaded(model), **SWING, tracking=GAINS))
        runs = linkplan.compare(plan, trackers, mass_factor=1.0, delay_periods=0).runs
        found[name] = {tracker: np.sqrt(np.mean(run.error_deg["e"] ** 2)) for tracker, run in runs.items()}
    assert found["one"]["pd+ff"] < 0.1
    for tracker in trackers:
        assert found["redundant"][tracker] < 1.3 * found["one"][tracker] + 0.01, tracker


@pytest.mark.slow
def test_margins_and_gains_are_those_of_one_motor_that_is_as_strong():
    problems = [linkplan.Problem.reach(loaded(text), **SWING, tracking=GAINS) for text in (antagonist(), two_motors(20.0))]
    redundant, one = (linkplan.bode(problem, at_deg=[{"e": 10.0}], measure=False) for problem in problems)
    assert redundant.stable
    loops = [one.struct.points[0] for one in (redundant, one)]
    assert loops[0].settles_in_mujoco
    assert loops[0].phase_margin_deg == pytest.approx(loops[1].phase_margin_deg, rel=1e-6)
    redundant, one = (linkplan.tune(problem, bandwidth_hz=3.0) for problem in problems)
    assert redundant.struct.gains["kp"] == pytest.approx(one.struct.gains["kp"], rel=1e-3)


def test_two_motors_on_a_sprung_cart_drive_one_joint():
    """F and F2 push the same cart; the mass behind a spring moves along."""
    text = """<mujoco><option gravity="0 0 0" timestep="0.0005"/><default><geom contype="0" conaffinity="0"/></default>
      <worldbody><body><joint name="x1" type="slide" axis="1 0 0" damping="3"/><geom size="0.05" mass="1.5"/></body>
        <body pos="0.3 0 0"><joint name="x2" type="slide" axis="1 0 0" damping="0.4"/><geom size="0.05" mass="0.7"/></body>
      </worldbody>
      <tendon><fixed stiffness="900" damping="0.5"><joint joint="x1" coef="1"/><joint joint="x2" coef="-1"/></fixed></tendon>
      <actuator><motor name="F" joint="x1" ctrlrange="-50 50"/>{more}</actuator></mujoco>"""
    second = '<motor name="F2" joint="x1" ctrlrange="-20 20"/>'
    found = [linkplan.tune(loaded(text.format(more=more)), bandwidth_hz=2.0).struct.gains for more in (second, "")]
    assert loaded(text.format(more=second)).channels == (0,)
    for key in ("kp", "kd"):
        assert found[0][key] == pytest.approx(found[1][key], rel=1e-9)


@pytest.mark.slow
def test_size_speeds_a_motion_up_until_all_motors_together_are_at_their_limits():
    """The same motion r times as fast needs I r^2 a + g: at the fastest both motors are at their limits."""
    problem = linkplan.Problem.reach(loaded(two_motors(20.0, 0.5)), **SWING)
    found = linkplan.size(problem, [{"name": "five", "peak_effort": 5.0}], actuator="m0").struct.motors[0]
    motion = linkplan.plan(problem).trajectory
    time = motion.dense_times(20)
    mechanism, s = problem.mechanism, motion.position_at(time)
    poses = np.array([close_at(mechanism, x) for x in s])

    def needed(rate: float) -> float:
        tau, _ = demanded(mechanism, poses, rate * motion.velocity_at(time), rate**2 * motion.acceleration_at(time))
        return float(np.abs(tau).max())

    assert needed(1.0) < 5.5
    assert found.speed_up == pytest.approx(scipy.optimize.brentq(lambda r: needed(r) - 5.5, 1.0, 5.0), rel=1e-3)


@pytest.mark.slow
def test_a_point_between_four_cables_follows_a_line_in_the_time_of_a_linear_program():
    """Along z = 0 the range of x'' at each place is that of a linear program; the least time is one arc and its mirror."""
    mechanism = loaded(hung_point())
    problem = linkplan.Problem.follow(
        mechanism, path={"site": "hook", "points": [[-0.4, 0, 1.0], [0.4, 0, 1.0]]}, start_m={"x": -0.4, "z": 0.0},
        duration_s="free", minimize="time",
    )  # fmt: skip
    plan = linkplan.plan(problem)
    assert plan.passed, plan.message

    def largest(x: float) -> float:
        (arms,) = demanded(mechanism, close_at(mechanism, np.array([x, 0.0]))[None], np.zeros((1, 2)), np.zeros((1, 2)))[1]
        rows = np.hstack([arms, [[-4.0], [0.0]]])
        return scipy.optimize.linprog(
            [0] * 4 + [-1], A_eq=rows, b_eq=[0.0, 4 * 9.81], bounds=[(5, 100)] * 4 + [(None, None)]
        ).x[4]

    x = np.linspace(-0.4, 0.0, 81)
    most = [largest(float(one)) for one in x]
    energy = scipy.interpolate.CubicSpline(x, most).antiderivative()  # v^2 / 2
    part = np.linspace(0, 1, 20001)  # x = -0.4 + 0.4 part^2 removes the singularity at rest
    pace = np.append(0.8 / np.sqrt(0.8 * most[0]), 0.8 * part[1:] / np.sqrt(2 * energy(-0.4 + 0.4 * part[1:] ** 2)))
    half = np.trapezoid(pace, part)
    assert plan.duration_s == pytest.approx(2 * half, rel=1e-5)


def test_a_pre_tension_and_the_least_peak_are_keys_of_the_mechanism():
    tensioned = loaded(antagonist(), pre_tension={"flex": 60.0, "ext": 60.0})
    hold = next(iter(linkplan.check(tensioned).struct.paths)).holding_effort
    assert hold.sum(axis=1) == pytest.approx(120.0)
    even = loaded(two_motors(20.0, 5.0), effort_sharing="least_peak")
    hold = next(iter(linkplan.check(even).struct.paths)).holding_effort
    assert hold[:, 0] == pytest.approx(4 * hold[:, 1], rel=1e-3)
    with pytest.raises(linkplan.LinkplanError, match=r"unknown actuator in mechanism\.pre_tension 'flexor'"):
        loaded(antagonist(), pre_tension={"flexor": 60.0})


@pytest.mark.slow
def test_new_plans_a_first_motion_within_the_limits_of_the_model():
    found = linkplan.new(antagonist())
    assert found.plan.passed
    assert "effort" not in found.struct.tables.get("limits", {})


@pytest.mark.slow
def test_machines_of_robust_share_efforts_in_units_of_the_motors_limits():
    """A small motor beside a strong one takes a small share of what weaker torque constants need: as one motor of both."""
    least = [
        linkplan.plan(
            linkplan.Problem.reach(
                loaded(two_motors(*limits)), **(SWING | {"duration_s": "free"}), minimize="time",
                robust={"torque_constant_factor": [0.8, 1.2]},
            )
        ).duration_s
        for limits in ((20.0, 0.5), (20.5,))
    ]  # fmt: skip
    assert least[0] == pytest.approx(least[1], rel=1e-6)
