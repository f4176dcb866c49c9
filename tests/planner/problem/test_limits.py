"""Limits beyond effort, range and speed: each binds, is kept at every instant, costs, and is named where it forbids."""

import re

import numpy as np
import pytest
from scipy.optimize import brentq

from linkplan.models.errors import ProblemError
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import actuator_speeds, singularity_ratios
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_plan, hinge
from tests.support.margins import other_margins
from tests.support.mechanisms import CRANK_ROCKER
from tests.support.motions import effort_rate, pin_forces, power
from tests.support.plans import optimal, planned
from tests.support.refusals import assert_refused
from tests.support.tolerances_planner import BINDS, EFFORT_JUMP, FURTHER_LIMIT, MINIMUM_TIME, SOFT_PIN, TIME_WITH_ARCS

# The hinge's own effort limit [N.m].
EFFORT = 4.0
QUICK = "objective.minimize=time"


def quick_hinge(*overrides: str) -> Plan:
    return hinge(QUICK, *overrides, duration="free")


def inner(plan: Plan, per_interval: int = 60) -> np.ndarray:
    """Return instants strictly inside a plan's intervals, close to both their ends."""
    tau = 0.5 - 0.5 * np.cos(np.pi * (np.arange(per_interval) + 0.5) / per_interval)
    breaks = plan.trajectory.breaks_s
    return (breaks[:-1, None] + np.diff(breaks)[:, None] * tau).ravel()


def line(plan: Plan, stall: float, no_load: float) -> np.ndarray:
    """Return u / stall + w / no_load (n, n_u) at inner instants."""
    time, motion = inner(plan), plan.trajectory
    poses = follow(plan.problem.mechanism, motion.position_at(time), motion.start_pose)
    return motion.effort_at(time) / stall + actuator_speeds(plan.problem, poses, motion.velocity_at(time)) / no_load


# A pure inertia in least time: closed forms.


@pytest.mark.slow
def test_a_slow_effort_ramps_all_the_way():
    """Within the effort's limit u rises from 0 for T / 4, falls for T / 2 and rises to 0: turn = r T^3 / (32 J)."""
    rate = 6.0
    assert (
        np.abs(effort_rate(quick_hinge(), inner(quick_hinge()))).max() < EFFORT_JUMP
    )  # without the limit it jumps in between
    plan = quick_hinge(f"limits.effort_rate.motor={rate}")
    T = (32 * HINGE_INERTIA * TURN / rate) ** (1 / 3)
    assert rate * T / 4 < EFFORT
    assert plan.objective == pytest.approx(T, rel=TIME_WITH_ARCS)


def test_a_fast_effort_ramps_between_its_limits():
    """A ramp from 0, full effort for a while, a ramp of 2 u / r, full braking, a ramp to 0."""
    rate = 40.0
    a, half = EFFORT / HINGE_INERTIA, EFFORT / rate

    def turned(full: float) -> float:
        return a * (full + half) * (full + 2 * half)

    full = brentq(lambda t: turned(t) - TURN, 0, 5, xtol=1e-14)
    plan = quick_hinge(f"limits.effort_rate.motor={rate}")
    assert plan.objective == pytest.approx(2 * (full + 2 * half), rel=TIME_WITH_ARCS)
    assert np.abs(effort_rate(plan, inner(plan))).max() == pytest.approx(rate, rel=BINDS)


def least_time_with_power(drive: float, brake: float) -> float:
    """Return the hinge's least time where drive and brake are each at full effort or at a power [W]: J w^2 / 2 = P t."""

    def arc(P: float, w: float) -> tuple[float, float]:
        first = min(w, P / EFFORT)
        time, angle = HINGE_INERTIA * first / EFFORT, HINGE_INERTIA * first**2 / (2 * EFFORT)
        if w > first:
            time += HINGE_INERTIA * (w**2 - first**2) / (2 * P)
            angle += HINGE_INERTIA * (w**3 - first**3) / (3 * P)
        return time, angle

    top = brentq(lambda w: arc(drive, w)[1] + arc(brake, w)[1] - TURN, 1e-3, 100, xtol=1e-14)
    return arc(drive, top)[0] + arc(brake, top)[0]


@pytest.mark.slow
@pytest.mark.parametrize(("given", "drive", "brake"), [("9.0", 9.0, 9.0), ("[-1000.0,7.0]", 7.0, 1000.0)])
def test_power_makes_energy_grow_in_proportion_to_time(given, drive, brake):
    bare = quick_hinge()
    assert power(bare, inner(bare)).max() > 1.5 * drive
    plan = quick_hinge(f"limits.power_w.motor={given}")
    assert plan.objective == pytest.approx(least_time_with_power(drive, brake), rel=TIME_WITH_ARCS)
    powers = power(plan, inner(plan))
    assert powers.max() <= drive * (1 + FURTHER_LIMIT)
    assert powers.min() >= -brake * (1 + FURTHER_LIMIT)


@pytest.mark.slow
def test_a_motor_s_line_makes_speed_approach_its_no_load_speed():
    """w = w0 (1 - exp(-t / tau)), tau = J w0 / stall, then full braking, which the line does not limit."""
    no_load = np.radians(270.0)
    tau = HINGE_INERTIA * no_load / EFFORT

    def turned(t: float) -> float:
        w = no_load * (1 - np.exp(-t / tau))
        return no_load * (t - tau * (1 - np.exp(-t / tau))) + HINGE_INERTIA * w**2 / (2 * EFFORT)

    drive = brentq(lambda t: turned(t) - TURN, 1e-3, 10, xtol=1e-14)
    exact = drive + HINGE_INERTIA * no_load * (1 - np.exp(-drive / tau)) / EFFORT
    assert line(quick_hinge(), EFFORT, no_load).max() > 1.5
    plan = quick_hinge(f"motors.motor={{stall_effort={EFFORT},no_load_speed_deg_s=270.0}}")
    assert plan.objective == pytest.approx(exact, rel=TIME_WITH_ARCS)
    assert np.abs(line(plan, EFFORT, no_load)).max() <= 1 + FURTHER_LIMIT


# The knee: what is exceeded without a limit is kept with it, and costs.

STALL, NO_LOAD_DEG = 150.0, 2500.0
KNEE = {
    "effort_rate": (("knee-reach",), "limits.effort_rate.act_O=5000", 5000.0),
    "power": (("knee-reach",), "limits.power_w.act_O=580", 580.0),
    "motor": (("knee-sprint",), f"motors.act_O={{stall_effort={STALL},no_load_speed_deg_s={NO_LOAD_DEG}}}", 1.0),
    "closure_force": (("knee-reach",), "limits.closure_force.B=1.7", 1.7),
    "singular_margin": (
        (
            "knee-reach",
            "motion.start_deg={O=45}",
            "motion.goal_deg={O=0}",
            "motion.start_speed_deg_s={O=800}",
            "motion.duration_s=0.2",
        ),
        "limits.singular_margin=0.42",
        0.42,
    ),
}


def jumps_from_rest(plan: Plan) -> bool:
    """Return True if the efforts at the ends are not those that hold the mechanism there."""
    motion, mechanism = plan.trajectory, plan.problem.mechanism
    ends = motion.breaks_s[[0, -1]]
    poses, still = follow(mechanism, motion.position_at(ends), motion.start_pose), np.zeros((2, mechanism.dof))
    apart = motion.effort_at(ends) - needed_effort(mechanism, poses, still, still)[0]
    return bool(np.abs(apart).max() > 1e-3 * np.abs(motion.effort).max())


def amount(plan: Plan, what: str) -> float:
    """Return the worst that a plan comes to, at instants of this test's own, in the limit's unit."""
    time, motion = inner(plan), plan.trajectory
    if what == "effort_rate":
        return np.inf if jumps_from_rest(plan) else float(np.abs(effort_rate(plan, time)).max())
    if what == "power":
        return float(np.abs(power(plan, time)).max())
    if what == "motor":
        return float(np.abs(line(plan, STALL, np.radians(NO_LOAD_DEG))).max())
    if what == "closure_force":
        return float(pin_forces(plan, inner(plan, 4)).max())
    poses = follow(plan.problem.mechanism, motion.position_at(time), motion.start_pose)
    return float(singularity_ratios(plan.problem.mechanism, poses).min())


@pytest.mark.slow
@pytest.mark.parametrize("what", KNEE)
def test_a_limit_that_a_motion_exceeds_is_kept_at_every_instant_once_it_is_asked_for_and_costs(what):
    given, override, limit = KNEE[what]
    bare, kept = optimal(*given), optimal(*given, override)
    slack = SOFT_PIN if what == "closure_force" else FURTHER_LIMIT
    if what == "singular_margin":
        assert amount(bare, what) < 0.9 * limit
        assert amount(kept, what) >= limit * (1 - slack)
    else:
        assert amount(bare, what) > 1.01 * limit
        assert amount(kept, what) <= limit * (1 + slack)
    assert kept.objective > bare.objective * (1 + MINIMUM_TIME)
    assert amount(kept, what) == pytest.approx(limit, rel=SOFT_PIN if what == "closure_force" else BINDS)
    margin = other_margins(kept.certificate)[0]
    assert (margin.what, margin.kept) == (what, True)
    assert abs(margin.limit) == pytest.approx(limit)
    assert abs(margin.value) == pytest.approx(amount(kept, what), rel=BINDS)


# A motor on a dependent joint: its speed is the loop's.

# Both motors carry their joints' names.
DRIVEN = re.sub(
    r'<motor joint="(\w)"',
    r'<motor name="\1" joint="\1"',
    CRANK_ROCKER.mjcf(np.random.default_rng(7), motors=("O", "C"), bare=True),
)
SWING = 'kind = "reach"\nstart_deg = { O = 40.0 }\ngoal_deg = { O = 130.0 }\nduration_s = 0.4\n'
TWO = ("limits.effort.O=[-60.0,60.0]", "limits.effort.C=[-60.0,60.0]")


def two_motors(*overrides: str) -> Plan:
    plan = body_plan(DRIVEN, SWING, *TWO, *overrides)
    assert plan.status == "optimal", plan.message
    return plan


@pytest.mark.slow
def test_the_line_of_a_motor_on_a_dependent_joint_is_kept():
    bare = two_motors()
    mechanism, time = bare.problem.mechanism, inner(bare)
    assert mechanism.actuators[1].joint in mechanism.dependent
    stall = 2.0 * np.abs(bare.trajectory.effort_at(time)[:, 1]).max()
    poses = follow(mechanism, bare.trajectory.position_at(time), bare.trajectory.start_pose)
    no_load = 0.6 * np.abs(actuator_speeds(bare.problem, poses, bare.trajectory.velocity_at(time))[:, 1]).max()
    assert np.abs(line(bare, stall, no_load)[:, 1]).max() > 1.05
    kept = two_motors(f"motors.C={{stall_effort={stall},no_load_speed_deg_s={np.degrees(no_load)}}}")
    assert np.abs(line(kept, stall, no_load)[:, 1]).max() <= 1 + FURTHER_LIMIT
    assert kept.objective > bare.objective


# Limits that forbid a motion: one sentence, the amount, the instant.


@pytest.mark.slow
def test_a_limit_that_forbids_a_motion_is_named_with_amount_and_instant():
    override = "motors.motor={stall_effort=4.0,no_load_speed_deg_s=90.0}"
    plan = body_plan(HINGE, QUARTER_TURN + "duration_s = 0.8\n", override, "mesh.intervals=10")
    assert plan.status == "infeasible", plan.message
    assert "\n" not in plan.message
    name = re.escape("torque-speed line of motor (effort / stall + speed / no-load)")
    said = re.search(rf"the {name} would have to be (-?[\d.]+) at t = ([\d.e-]+) s", plan.message)
    assert said, plan.message
    assert abs(float(said[1])) > 1
    assert 0 <= float(said[2]) <= plan.problem.motion.duration_s
    assert f"limit of {np.copysign(1, float(said[1])):.4g}" in plan.message


def test_a_goal_nearer_to_a_singular_pose_than_allowed_is_said_without_solving():
    plan = planned("knee-reach", "limits.singular_margin=0.6")
    assert plan.status == "infeasible"
    assert "the distance from a singular pose, relative to home, is 0.440993 at the goal" in plan.message
    assert "0.159 short of its limit of 0.6" in plan.message
    assert plan.history == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("limits.effort_rate.act_P=5", "act_O"),
        ("limits.effort_rate.act_O=[5,9]", "must admit rest"),
        ("limits.closure_force.Q=5", "B"),
        ("motors.act_O={stall_effort=5}", "must be given together"),
        ("motors.act_O={stall_effort=5,no_load_speed_m_s=3}", "no_load_speed_deg_s"),
    ],
)
def test_a_limit_that_cannot_be_is_refused_in_one_line(given, said):
    assert_refused(lambda: planned("knee-reach", given), said, kind=ProblemError)


AIRY = """<mujoco><option density="1.2"/><worldbody><body name="arm"><joint name="J" axis="0 1 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
  <actuator><motor name="motor" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""
TABLES = {
    "mechanism": {"model": AIRY},
    "motion": {"kind": "reach", "start_deg": {"J": 0}, "goal_deg": {"J": 9}, "duration_s": 1.0},
}


def test_a_refusal_names_the_key_that_plans_without_what_is_not_honoured():
    assert_refused(lambda: Problem.from_tables("airy", TABLES), "limits.unhonoured", kind=ProblemError)


def test_what_is_not_honoured_is_left_out_on_request_and_said_in_the_plan():
    problem = Problem.from_tables("airy", TABLES | {"limits": {"unhonoured": "note"}})
    (said,) = problem.not_honoured
    assert "wrong" in said
    assert "fluid forces" in said
    assert problem.mechanism.model.opt.density == 1.2, "the simulator keeps it"
