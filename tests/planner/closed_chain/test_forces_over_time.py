"""Forces over time: efforts and pin forces by MuJoCo and virtual work, limits that a peak of the force binds, refusals."""

from functools import cache

import mujoco
import numpy as np
import pytest
import scipy

import linkplan
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.joint_forces import joint_forces
from linkplan.models.selection import Selection
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.samples import closure_forces, samples_of
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.extra import ExtraCost, ExtraLimit
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.replan import Replanner
from tests.support.arms import LOWER, UPPER, arm, foot_of
from tests.support.refusals import assert_refused
from tests.support.steering import ARM, FORCE, STEERING, K, P, rack_force, tyre_of

T = 0.4
ROWS = np.array([0.0, 0.06, 0.13, 0.2, 0.27, 0.33, 0.4])
PUSH = np.array([0.0, 8.0, -3.0, 25.0, 10.0, -6.0, 0.0])
SWING = {"time_s": [0.0, 0.2, 0.4], "position_deg": {"J1": [-20.0, 30.0, -20.0], "J2": [60.0, 20.0, 60.0]}}
ALWAYS = Selection(force={"tyre": FORCE})
STEER = {"start_m": {"rack": -0.02}, "goal_m": {"rack": 0.03}, "duration_s": T}


def table(site: str = "foot", interpolation: str = "linear", **axes: np.ndarray) -> dict:
    """Return a table of forces on a site."""
    on = {site: {axis: values.tolist() for axis, values in axes.items()}}
    return {"time_s": ROWS.tolist(), "on": on, "interpolation": interpolation}


def steering(**arguments) -> Problem:
    """Return the problem of the steering linkage, with a side force over time on its tyre."""
    given = {"force_over_time": table("tyre", x=6 * PUSH, y=-100 * PUSH)} | STEER | arguments
    return Problem.reach(load_mechanism(STEERING.format(clamp="")), **given)


@cache
def steered() -> Plan:
    """Return the plan of the steering linkage, made once."""
    return plan_motion(steering()).require()


def curve(interpolation: str, *, repeats: bool = False):
    """Return the function from times (n,) [s] to the push (n,) [N], by numpy or scipy."""
    if interpolation == "linear":
        return lambda t: np.interp(t, ROWS, PUSH)
    return scipy.interpolate.CubicSpline(ROWS, PUSH, bc_type="periodic" if repeats else "not-a-knot")


def followed(interpolation: str = "linear", **arguments) -> Problem:
    """Return the problem of an arm that follows a swing with a push on its foot."""
    forces = table(interpolation=interpolation, x=PUSH, z=2 * PUSH)
    given = {"reference": SWING, "duration_s": T, "force_over_time": forces} | arguments
    return Problem.track(load_mechanism(arm(UPPER, LOWER, limit=80.0)), **given)


def all_are_proved(plan: Plan) -> bool:
    """Return True if all claims on a plan at every instant are proved."""
    findings = prove(plan.problem, plan.trajectory, existence=False).findings
    return {finding.answer for finding in findings} <= {"proved", "sampled"}


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_the_efforts_of_a_followed_motion_are_those_of_mujocos_inverse_dynamics_less_the_applied_force(interpolation):
    problem = followed(interpolation)
    plan = plan_motion(problem).require()
    motion, model, off = plan.trajectory, problem.mechanism.model, []
    data, foot = mujoco.MjData(model), model.site("foot").id
    for t in np.random.default_rng(0).uniform(0.0, T, (60, 1)):
        data.qpos[:], data.qvel[:], data.qacc[:] = (
            of(t)[0] for of in (motion.position_at, motion.velocity_at, motion.acceleration_at)
        )
        mujoco.mj_inverse(model, data)
        applied, push = np.zeros(2), curve(interpolation, repeats=True)(t)[0] * np.array([1.0, 0.0, 2.0])
        mujoco.mj_applyFT(model, data, push, np.zeros(3), data.site_xpos[foot], model.site_bodyid[foot], applied)
        off.append(motion.effort_at(t)[0] - (data.qfrc_inverse - applied))
        assert np.abs(applied).max() < 50
    assert np.abs(off).max() < 1e-6, "[N.m]"
    assert {finding.answer for finding in prove(problem, motion).findings} <= {"proved", "sampled"}


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_a_planned_motion_of_a_loop_gives_the_force_its_virtual_work(interpolation):
    """The rack's force differs from that without the tyre's by f ds = -F . dp."""
    problem = steering(force_over_time=table("tyre", interpolation, x=6 * PUSH, y=-100 * PUSH))
    plan = plan_motion(problem).require()
    motion, time = plan.trajectory, np.linspace(0.0, T, 41)[1:-1]
    s, v, a = (of(time) for of in (motion.position_at, motion.velocity_at, motion.acceleration_at))
    poses = follow(problem.mechanism, s, motion.start_pose)
    unloaded, _ = needed_effort(load_mechanism(STEERING.format(clamp="")), poses, v, a)
    push = curve(interpolation)(time)[:, None] * [6.0, -100.0]
    by_hand = unloaded[:, 0] + [rack_force(at, force) for at, force in zip(s[:, 0], push, strict=True)]
    assert np.ptp(by_hand - unloaded[:, 0]) > 150
    assert np.abs(needed_effort(problem.mechanism, poses, v, a, time)[0][:, 0] - by_hand).max() < 1e-4
    assert np.abs(motion.effort_at(time)[:, 0] - by_hand).max() < 1e-4 * np.ptp(by_hand)


def test_pin_forces_at_rest_balance_the_force_of_their_instant():
    """The force in the rod acts along it. Its moment about the knuckle's pin balances the moment of the tyre's force."""
    problem, s, time = steering(), np.full((3, 1), 0.02), np.array([0.06, 0.2, 0.3])
    mechanism = problem.mechanism
    still, poses = np.zeros((3, 1)), follow(mechanism, s, mechanism.home)
    forces = mechanism.forces_at(time)
    effort, _ = needed_effort(mechanism, poses, still, still, time)
    found = closure_forces(problem, poses, still, still, effort, *forces)[:, 0]
    knuckle = joint_forces(mechanism, poses, still, still, effort, *forces).force["knuckle"]
    tyre, turn = tyre_of(0.02), float(poses[0, mechanism.joint_index("knuckle")])
    end = K + np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ ARM
    along = end - P - np.array([0.0, 0.02])
    along /= np.linalg.norm(along)
    for k, push in enumerate(np.interp(time, ROWS, PUSH)[:, None] * [6.0, -100.0]):
        (x, z), (p, r) = end - K, tyre - K
        rod = -(p * push[1] - r * push[0]) / (x * along[1] - z * along[0])  # on the knuckle, along the rod
        assert found[k] == pytest.approx(abs(rod), rel=1e-6)
        planar = np.linalg.norm(push + rod * along)
        assert knuckle[k] == pytest.approx(np.hypot(planar, 9 * 9.81), rel=1e-6)


@pytest.mark.slow
def test_a_constant_table_is_the_constant_force():
    constant = {"time_s": [0.0, T], "on": {"tyre": {axis: [f, f] for axis, f in zip("xyz", FORCE, strict=True)}}}
    over_time = plan_motion(steering(force_over_time=constant)).require()
    always = plan_motion(Problem.reach(load_mechanism(STEERING.format(clamp=""), selection=ALWAYS), **STEER)).require()
    free = plan_motion(steering(force_over_time=None)).require()
    assert abs(free.objective / always.objective - 1) > 0.1
    assert over_time.objective == pytest.approx(always.objective, rel=1e-9)
    time = np.linspace(0.0, T, 30)
    np.testing.assert_allclose(over_time.trajectory.effort_at(time), always.trajectory.effort_at(time), atol=1e-5)


LOAD = {"body": "link2", "mass_kg": 0.5, "com_m": [0.25, 0.0, 0.0], "inertia_kgm2": [1e-3, 1e-3, 1e-3]}


def test_machines_of_a_range_of_payloads_need_the_efforts_of_theirs_under_the_same_force():
    text, robust = arm(UPPER, LOWER, limit=80.0), {"payload_factor": [0.8, 1.3]}
    mechanism = load_mechanism(text, payload=LOAD)
    ends = {"start_deg": {"J1": 0.0, "J2": 60.0}, "goal_deg": {"J1": 30.0, "J2": 20.0}, "duration_s": T}
    plan = plan_motion(Problem.reach(mechanism, **ends, robust=robust, force_over_time=table(z=PUSH))).require()
    samples = samples_of(plan.problem, plan.trajectory)
    motion, heavy = (samples.q, samples.v, samples.a), load_mechanism(text, payload=mechanism.payload.scaled(1.3))
    (corner,) = [k for k, one in enumerate(plan.problem.robust.corners) if one.payload_factor == 1.3]
    arms = np.array([jacobian_of(mechanism.model, q) for q in samples.q])[:, 2]
    by_hand = needed_effort(heavy, *motion)[0] - arms * np.interp(samples.time, ROWS, PUSH)[:, None]
    np.testing.assert_allclose(samples.corner_efforts[:, corner], by_hand, atol=1e-9)
    assert all_are_proved(plan)


def jacobian_of(model: mujoco.MjModel, q: np.ndarray) -> np.ndarray:
    """Return MuJoCo's Jacobian (3, nv) of the site "foot"."""
    data, found = mujoco.MjData(model), np.zeros((3, model.nv))
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_jacSite(model, data, found, None, model.site("foot").id)
    return found


@pytest.mark.slow
def test_a_limit_on_a_pin_force_counts_the_force():
    free = steered()
    limit = 0.9 * float(free.certificate.peak_closure_force[0])
    name = free.problem.mechanism.closure_names[0]
    tight = plan_motion(steering(limits={"closure_force": {name: limit}}, mesh={"intervals": 12})).require()
    assert tight.certificate.peak_closure_force[0] == pytest.approx(limit, rel=1e-2)
    assert all_are_proved(tight)


def test_costs_and_limits_of_the_user_s_own_are_taken_under_the_force():
    cost = ExtraCost(name="squares", expression=lambda at: (at.effort["rack"] / 100.0) ** 2, unit="s")
    most = ExtraLimit(name="most", expression=lambda at: at.effort["rack"], lower=-4e3, upper=4e3, unit="N")
    own = plan_motion(steering(minimize={}, extra_costs=[cost], extra_limits=[most])).require()
    assert own.objective == pytest.approx(steered().objective / 1e4, rel=1e-3)
    assert all_are_proved(own)


def test_a_force_too_large_for_the_motor_is_named_with_what_a_motion_needs():
    """The rest at the start needs at least the force's virtual work."""
    heavy = table("tyre", y=np.full(len(ROWS), -2e4))
    plan = plan_motion(steering(force_over_time=heavy, limits={"range_m": {"rack": [-0.03, 0.04]}}))
    assert plan.status == "infeasible"
    assert plan.message.startswith("infeasible: rack on joint rack would have to give")
    assert abs(plan.verdict.overruns[0].value) == pytest.approx(rack_force(-0.02, (0.0, -2e4)), rel=1e-2)


def test_places_of_sites_are_limited_under_the_force_and_with_a_payload():
    """The foot stays above a floor; its place is a function of the pose without payload or forces."""
    mechanism = load_mechanism(arm(UPPER, LOWER, limit=80.0), payload=LOAD)
    ends = {"start_deg": {"J1": 0.0, "J2": 0.0}, "goal_deg": {"J1": 60.0, "J2": -150.0}, "duration_s": T}
    floor, time = -0.01, np.linspace(0.0, T, 200)
    for forces in (None, table(z=PUSH)):
        free = plan_motion(Problem.reach(mechanism, **ends, force_over_time=forces)).require()
        boxed = {"site": {"foot": {"z": [floor, 1.0]}}}
        plan = plan_motion(Problem.reach(mechanism, **ends, limits=boxed, force_over_time=forces)).require()
        lowest, least = (foot_of(one.trajectory.position_at(time))[:, 2].min() for one in (plan, free))
        assert least < floor - 1e-3
        assert lowest >= floor - 1e-8


def test_other_forces_are_numbers_of_the_same_program():
    planner, other = Replanner(), table("tyre", x=3 * PUSH, y=-80 * PUSH)
    first = planner.plan(steering())
    again = planner.plan(steering(force_over_time=other))
    fresh = plan_motion(steering(force_over_time=other))
    assert again.history[-1].what == "solved again"
    assert abs(again.objective / first.objective - 1) > 0.1
    assert again.objective == pytest.approx(fresh.objective, rel=1e-6)


def test_a_peak_between_the_nodes_is_seen_by_certificate_and_proof():
    """A motion is planned without a force, then judged with a force that peaks inside an interval of its mesh."""
    calm = table("tyre", y=np.zeros(len(ROWS)))
    plan = plan_motion(steering(force_over_time=calm)).require()
    begin, end = plan.trajectory.breaks_s[10:12]
    middle = 0.5 * (begin + end)
    times = [0.0, middle - 0.2 * (end - begin), middle, middle + 0.2 * (end - begin), T]
    peak = steering(force_over_time={"time_s": times, "on": {"tyre": {"y": [0.0, 0.0, -20000.0, 0.0, 0.0]}}})
    certificate = certify(peak, plan.trajectory)
    assert certificate.inverse_dynamics_excess > 500
    assert begin < certificate.worst_time_s["inverse_dynamics_excess"] < end
    assert any("more effort than planned" in sentence for sentence in certificate.failures)
    refuted = [finding for finding in prove(peak, plan.trajectory).findings if finding.answer == "refuted"]
    assert any("planned effort lacks" in finding.name for finding in refuted)
    assert all(begin <= finding.time_s <= end for finding in refuted if finding.time_s is not None)


def test_a_plan_keeps_a_limit_that_the_force_binds():
    free = steered()
    limit = 0.9 * float(free.certificate.peak_effort[0])
    tight = plan_motion(steering(limits={"effort": {"rack": [-limit, limit]}})).require()
    assert tight.certificate.peak_effort[0] == pytest.approx(limit, rel=1e-3)
    assert tight.objective > (1 + 1e-4) * free.objective
    assert all_are_proved(tight)


@pytest.mark.parametrize(("share", "passes"), [(1.001, True), (0.999, False)])
def test_a_short_peak_of_the_force_decides_on_a_motion_that_is_followed_exactly(share, passes):
    """A pulse of 2 ms, 60 N along z on the foot: its moment about the first joint by hand, that of the motion by MuJoCo."""
    peak_s = 0.1234
    pulse = {"time_s": [0.0, peak_s - 1e-3, peak_s, peak_s + 1e-3, T], "on": {"foot": {"z": [0.0, 0.0, 60.0, 0.0, 0.0]}}}
    at = np.array([peak_s])
    calm = followed(force_over_time=None)
    unloaded = plan_motion(calm).require().trajectory
    moment = 60.0 * foot_of(unloaded.position_at(at))[0, 0]
    limit = share * abs(unloaded.effort_at(at)[0, 0] - moment)
    assert np.abs(unloaded.effort_at(np.linspace(0.0, T, 400))[:, 0]).max() < 0.9 * limit
    plan = plan_motion(followed(force_over_time=pulse, limits={"effort": {"act_J1": [-limit, limit]}}))
    assert plan.passed is passes
    if not passes:
        assert plan.message.startswith("infeasible: on the reference the effort of act_J1 comes to")
        assert "at t = 0.1234 s" in plan.message
        assert "least_duration_s" not in plan.details, "another rate would meet another force"


def test_a_problem_file_reads_a_table_and_a_saved_plan_keeps_it(tmp_path):
    rows = np.column_stack([ROWS + 1.0, 6 * PUSH, -100 * PUSH])
    np.savetxt(tmp_path / "load.csv", rows, delimiter=",", header="time_s,tyre_x_N,tyre_y_N", comments="", fmt="%.9g")
    (tmp_path / "steering.xml").write_text(STEERING.format(clamp=""))
    (tmp_path / "steer.toml").write_text(
        '[mechanism]\nmodel = "steering.xml"\n[motion]\nkind = "reach"\nduration_s = 0.4\n'
        'start_m.rack = -0.02\ngoal_m.rack = 0.03\n[force_over_time]\nfile = "load.csv"\n'
    )
    plan = plan_motion(Problem.from_file(tmp_path / "steer.toml")).require()
    assert plan.objective == pytest.approx(steered().objective, rel=1e-9)
    (tmp_path / "plan").mkdir()
    write_plan(plan, tmp_path / "plan")
    (tmp_path / "load.csv").unlink()
    again = read_plan(tmp_path / "plan")
    assert again.passed
    assert again.certificate.dynamics_residual == pytest.approx(plan.certificate.dynamics_residual, rel=1e-6)
    free = again.problem.replace(force_over_time=None)
    assert free.mechanism.forces is None
    assert not certify(free, again.trajectory).passed


def test_a_force_repeats_in_a_periodic_motion():
    period = T / 2
    forces = {"time_s": [0.0, 0.05, 0.1], "on": {"foot": {"z": [0.0, 12.0, 0.0]}}, "period_s": period}
    turning = {"time_s": [0.0, 0.2, 0.4], "position_deg": SWING["position_deg"]}
    problem = followed(force_over_time=forces, reference=turning)
    time = np.array([0.0, 0.025, 0.05, 0.15, 0.225, 0.4, 0.45])
    expected = np.interp(time % period, [0.0, 0.05, 0.1, 0.2], [0.0, 12.0, 0.0, 0.0])
    np.testing.assert_allclose(problem.mechanism.forces_at(time)[0][:, 2], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"on": {"tyres": {"y": PUSH}}}, "unknown site 'tyres' in force_over_time.on (did you mean 'tyre'?)"),
        ({"on": {"tyre": {"y": PUSH[1:]}}}, "force_over_time has 7 times in time_s and as many values of tyre.y, got 6"),
        ({"on": {"tyre": {"u": PUSH}}}, "force_over_time.on.tyre"),
        ({"time_s": ROWS[::-1]}, "force_over_time.time_s must increase from row to row, got 0.33 after 0.4 s"),
        (
            {"time_s": 0.5 * ROWS},
            "force_over_time.time_s ends at 0.2 s from its first row, before the motion's end at 0.4 s",
        ),
        (
            {"period_s": 0.3},
            "force_over_time.period_s must be larger than the last row's time, 0.4 s from the first",
        ),
        ({"interpolation": "quadratic"}, "force_over_time.interpolation"),
        ({"time_s": None}, "[force_over_time] needs force_over_time.file, or force_over_time.time_s"),
        ({"on": {"post": {"y": PUSH}}}, "force_over_time.on.post: the site does not move"),
    ],
)
def test_a_table_that_is_none_is_refused_in_one_line(change, words):
    text = STEERING.format(clamp="").replace("<worldbody>", '<worldbody><site name="post"/>')
    asked = {key: value for key, value in (table("tyre", y=PUSH) | change).items() if value is not None}
    assert_refused(lambda: Problem.reach(load_mechanism(text), **STEER, force_over_time=asked), words)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"duration_s": "free"}, "needs a motion.duration_s in seconds, got 'free'"),
        ({"waypoints": [{"at_m": {"rack": 0.0}}]}, "needs motion.waypoints[0].time_s in seconds, got 'free'"),
    ],
)
def test_a_motion_whose_instants_are_free_is_refused(arguments, words):
    with pytest.raises(LinkplanError, match=r"force_over_time is fixed in time") as refused:
        steering(**arguments)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("forces", "words"),
    [
        ({"time_s": [0.0, 0.4], "on": {"foot": {"z": [0.0, 9.0]}}}, "must equal the first"),
        (
            {"time_s": [0.0, 0.3], "on": {"foot": {"z": [0.0, 0.0]}}},
            "motion.duration_s must be a multiple",
        ),
    ],
)
def test_a_force_of_another_period_than_the_motion_s_is_refused(forces, words):
    mechanism = load_mechanism(arm(UPPER, LOWER))
    assert_refused(lambda: Problem.periodic(mechanism, reference=SWING, duration_s=T, force_over_time=forces), words)


def test_a_table_repeats_with_a_tracked_motion_that_repeats():
    problem = followed()
    late = np.array([0.06, 0.2]) + 3 * T
    np.testing.assert_allclose(problem.mechanism.forces_at(late)[0][:, 0], [8.0, 25.0], atol=1e-9)
    assert plan_motion(problem).trajectory.periodic


def test_a_tracked_motion_under_a_table_that_does_not_return_is_made_once():
    plan = plan_motion(followed(force_over_time=table(z=PUSH + ROWS)))
    assert plan.trajectory is not None
    assert not plan.trajectory.periodic


def test_a_period_that_does_not_fit_a_tracked_motion_is_refused():
    forces = {"time_s": [0.0, 0.1], "on": {"foot": {"z": [0.0, 9.0]}}, "period_s": 0.3}
    assert_refused(lambda: followed(force_over_time=forces), "motion.duration_s must be a multiple")


def test_a_part_of_a_period_is_tracked_with_a_note():
    problem = Problem.track(load_mechanism(arm(UPPER, LOWER)), reference=SWING, duration_s=0.3)
    (note,) = (one for one in problem.notes if "periods of" in one)
    assert "0.75 periods of the reference, of 0.4 s" in note
    assert not any("periods of" in one for one in followed().notes)


def test_rows_times_periods_of_a_table_are_bounded():
    forces = {"time_s": [0.0, 5e-6], "on": {"tyre": {"y": [0.0, 1.0]}}, "period_s": 1e-5}
    assert_refused(lambda: steering(force_over_time=forces), "repeats 40000 times in motion.duration_s = 0.4 s; with 2 rows")
    rare = forces | {"time_s": [0.0, 5e-5], "period_s": 1e-4}
    assert steering(force_over_time=rare).mechanism.forces is not None


@pytest.mark.parametrize("study", ["bode", "tune", "transfer"])
def test_studies_of_poses_say_that_they_omit_the_force(study):
    problem, at = steering(tracking={"kp": 5e4, "kd": 2e3}), {"at_m": [{"rack": 0.0}]}
    made = {
        "bode": lambda: linkplan.bode(problem, **at, measure=False),
        "tune": lambda: linkplan.tune(problem, bandwidth_hz=2.0, **at),
        "transfer": lambda: linkplan.transfer(problem, ["rack"]),
    }
    assert "force_over_time on tyre is omitted" in str(made[study]())


def test_a_hold_is_refused():
    mechanism, asked = load_mechanism(STEERING.format(clamp="")), {"start_m": {"rack": 0.0}, "duration_s": T}
    with pytest.raises(LinkplanError, match=r"needs motion.kind 'reach', 'periodic' or 'track', got 'hold'"):
        Problem.hold(mechanism, **asked, force_over_time=table("tyre", y=PUSH))
