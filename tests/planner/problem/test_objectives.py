"""Objectives of mechanisms: closed forms of single bodies, and every term against its integral along the planned motion."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.replan import structure
from tests.support.bodies import HINGE_INERTIA, LIFT, TURN, UNIT_ARM, body_plan, hinge
from tests.support.mechanisms import simulated
from tests.support.motions import effort_rate, pin_forces, power
from tests.support.plans import optimal, planned, problem_of
from tests.support.refusals import assert_refused
from tests.support.tolerances_planner import (
    EXACT_EFFORT,
    LEAST_WORK,
    MINIMUM_TIME,
    SMOOTHED,
    SOFT_PIN,
    TERM_INTEGRAL,
    WORK_INTEGRAL,
    WORK_WITH_TURNS,
)

# The lift's rise [m], mass [kg] and gravity [m/s2].
RISE, WEIGHT, GRAVITY = 0.8, 2.0, 9.81
LIFTED = 'kind = "reach"\nstart_m = { J = 0.1 }\ngoal_m = { J = 0.9 }\n'
MOTOR = "motors.{}={{torque_constant=0.5,resistance_ohm=0.1}}"
LOSS = 0.1 / 0.5**2


def instants(plan: Plan, per_interval: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes and weights of Gauss's rule on every interval of a plan."""
    nodes, weights = np.polynomial.legendre.leggauss(per_interval)
    breaks = plan.trajectory.breaks_s
    widths = np.diff(breaks)[:, None]
    return (breaks[:-1, None] + widths * (nodes + 1) / 2).ravel(), (widths * weights / 2).ravel()


# A pure inertia and a lift: closed forms.


def test_copper_loss_of_a_pure_inertia_is_its_effort_times_resistance_over_constant_squared():
    plan = hinge("objective.minimize=copper_loss", MOTOR.format("motor"))
    assert plan.objective == pytest.approx(LOSS * 12 * HINGE_INERTIA**2 * TURN**2 / 1.5**3, rel=EXACT_EFFORT)


def test_the_effort_rate_of_a_pure_inertia_is_that_of_its_quintic():
    """The sixth derivative is zero, with x''' = 0 at both ends: x = 5/2 t^2 - 5/2 t^4 + t^5, int x'''^2 = 120."""
    plan = hinge("objective.minimize=effort_rate", "mesh.scheme=radau-5", "mesh.intervals=4")
    assert plan.objective == pytest.approx(120 * HINGE_INERTIA**2 * TURN**2 / 1.5**5, rel=EXACT_EFFORT)


@pytest.mark.slow
def test_the_least_work_of_a_pure_inertia_is_its_energy_at_the_lowest_speed_that_arrives():
    """At full effort up to a speed w, on at w, and full braking: w T = turn + w^2 J / u."""
    plan = hinge("objective.minimize=work")
    ramp = HINGE_INERTIA / 4
    speed = (1.5 - np.sqrt(1.5**2 - 4 * ramp * TURN)) / (2 * ramp)
    assert plan.objective == pytest.approx(HINGE_INERTIA * speed**2 / 2, rel=LEAST_WORK)
    assert plan.objective >= HINGE_INERTIA * speed**2 / 2 * (1 - EXACT_EFFORT)


@pytest.mark.slow
@pytest.mark.parametrize(("angle", "period"), [(1.0, 2.0), (2.0, 3.0)])
def test_the_least_work_of_a_swing_to_and_fro_pays_twice_for_its_speed(angle, period):
    """Between turns with 9 N.m the unit arm coasts. At a turn its speed changes its sign inside an interval."""
    half = period / 2
    fastest = 4.5 * (half - np.sqrt(half**2 - 4 * angle / 9))
    plan = body_plan(
        UNIT_ARM,
        f'kind = "periodic"\nstart_deg = {{ J = 0.0 }}\ngoal_deg = {{ J = {np.degrees(angle)} }}\nduration_s = {period}\n',
        "objective.minimize=work",
    )
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(fastest**2, rel=WORK_WITH_TURNS)


def test_the_least_work_of_a_lift_is_the_energy_that_it_gains():
    plan = body_plan(LIFT, LIFTED + "duration_s = 1.0\n", "objective.minimize=work")
    assert plan.status == "optimal", plan.message
    gained = WEIGHT * GRAVITY * RISE
    assert plan.objective == pytest.approx(gained, rel=SMOOTHED)
    assert plan.objective >= gained * (1 - SMOOTHED / 100)


@pytest.mark.slow
def test_letting_a_lift_down_takes_no_work():
    down = 'kind = "reach"\nstart_m = { J = 0.9 }\ngoal_m = { J = 0.1 }\nduration_s = 0.7\n'
    plan = body_plan(LIFT, down, "objective.minimize=work")
    assert plan.status == "optimal", plan.message
    time, weights = instants(plan, 40)
    assert weights @ power(plan, time)[:, 0] == pytest.approx(-WEIGHT * GRAVITY * RISE, rel=SMOOTHED)
    assert plan.objective == pytest.approx(0.0, abs=SMOOTHED * WEIGHT * GRAVITY * RISE)


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.1, 1.0])
def test_time_and_effort_of_a_pure_inertia_are_balanced_where_their_sum_is_least(weight):
    """T + w 12 J^2 d^2 / T^3 is least at T^4 = 36 w J^2 d^2, where it is 4 T / 3."""
    plan = hinge(f"objective.minimize={{time=1.0,effort={weight}}}", duration="free")
    T = (36 * weight * HINGE_INERTIA**2 * TURN**2) ** 0.25
    assert 6 * HINGE_INERTIA * TURN / T**2 < 4  # the effort's limit does not bind
    assert plan.objective == pytest.approx(4 * T / 3, rel=EXACT_EFFORT)
    assert plan.trajectory.duration_s == pytest.approx(T, rel=MINIMUM_TIME)


@pytest.mark.slow
def test_a_weight_only_scales_an_objective_of_one_term():
    once, thrice = hinge("objective.minimize=effort"), hinge("objective.minimize={effort=3.0}")
    assert thrice.objective == pytest.approx(3 * once.objective, rel=EXACT_EFFORT)


def test_effort_and_copper_loss_together_are_an_effort_of_both_weights():
    plan = hinge("objective.minimize={effort=2.0,copper_loss=5.0}", MOTOR.format("motor"))
    alone = 12 * HINGE_INERTIA**2 * TURN**2 / 1.5**3
    assert plan.objective == pytest.approx((2 + 5 * LOSS) * alone, rel=EXACT_EFFORT)


def test_the_least_shaking_force_of_a_lift_is_that_of_its_cubic_and_its_weight():
    """The integral of (m (a + g))^2 is at least m^2 (12 d^2 / T^3 + g^2 T): a falls linearly, and its mean is zero."""
    plan = body_plan(LIFT, f"{LIFTED}duration_s = 1.5\n", "objective.minimize=shaking_force")
    least = WEIGHT**2 * (12 * RISE**2 / 1.5**3 + GRAVITY**2 * 1.5)
    assert (plan.status, plan.objective) == ("optimal", pytest.approx(least, rel=EXACT_EFFORT))


@pytest.mark.slow
def test_the_shaking_force_is_what_accelerates_the_masses_and_carries_their_weight():
    """By MuJoCo's total momentum along the motion, whose derivative is a central difference."""
    plan, h = optimal("slider-crank-turn", "objective.minimize=shaking_force"), 1e-5
    model, motion, (time, weights) = plan.problem.mechanism.model, plan.trajectory, instants(plan, 6)

    def momentum(at: np.ndarray) -> np.ndarray:
        poses = follow(plan.problem.mechanism, motion.position_at(at), motion.start_pose)
        rates = joint_rates(plan.problem.mechanism, poses, motion.velocity_at(at))
        return np.array([total_momentum(model, q, rate) for q, rate in zip(poses, rates, strict=True)])

    forces = (momentum(time + h) - momentum(time - h)) / (2 * h) - model.body_mass.sum() * model.opt.gravity
    assert weights @ (forces**2).sum(axis=1) == pytest.approx(plan.objective, rel=1e-5)
    rival = optimal("slider-crank-turn")
    on_frame = samples_of(rival.problem, rival.trajectory)
    force = on_frame.joint_forces.on_frame[:, :3]
    assert np.trapezoid((force**2).sum(axis=1), on_frame.time) > 1.2 * plan.objective


def total_momentum(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Return the linear momentum (3,) [kg m/s] of all bodies."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return model.body_mass.sum() * data.subtree_linvel[0]


# The knee: every term is the integral that it is said to be.

TERMS: dict[str, Callable[[Plan, np.ndarray], np.ndarray]] = {
    "effort": lambda plan, t: (plan.trajectory.effort_at(t) ** 2).sum(axis=1),
    "copper_loss": lambda plan, t: LOSS * (plan.trajectory.effort_at(t) ** 2).sum(axis=1),
    "effort_rate": lambda plan, t: (effort_rate(plan, t) ** 2).sum(axis=1),
    "time": lambda plan, t: np.ones(len(t)),  # noqa: ARG005
}
KNEE = ("knee-reach", MOTOR.format("act_O"))


def value(plan: Plan, term: str) -> float:
    time, weights = instants(plan, 12)
    return float(weights @ TERMS[term](plan, time))


@pytest.mark.slow
@pytest.mark.parametrize("term", ["effort", "copper_loss", "effort_rate"])
def test_a_term_s_value_is_its_integral_along_the_motion(term):
    plan = optimal(*KNEE, f"objective.minimize={term}")
    assert plan.objective == pytest.approx(value(plan, term), rel=TERM_INTEGRAL)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "other"), [("effort", "effort_rate"), ("effort_rate", "effort"), ("closure_force", "work")]
)
def test_each_term_is_least_where_it_is_asked_for(term, other):
    plan, rival = optimal(*KNEE, f"objective.minimize={term}"), optimal(*KNEE, f"objective.minimize={other}")
    if term == "closure_force":
        time, weights = instants(rival, 2)
        assert weights @ pin_forces(rival, time) ** 2 > 1.01 * plan.objective
    else:
        assert value(rival, term) > 1.01 * plan.objective


@pytest.mark.slow
def test_a_sum_s_value_is_the_sum_of_its_terms_integrals():
    weights = {"time": 30.0, "effort": 1e-3, "effort_rate": 1e-8}
    asked = ",".join(f"{term}={weight}" for term, weight in weights.items())
    plan = optimal(*KNEE, "motion.duration_s=free", f"objective.minimize={{{asked}}}")
    parts = {term: weight * value(plan, term) for term, weight in weights.items()}
    assert min(parts.values()) > 1e-3 * sum(parts.values())  # each has a say
    assert plan.objective == pytest.approx(sum(parts.values()), rel=TERM_INTEGRAL)


@pytest.mark.slow
def test_the_work_of_the_knee_is_the_integral_of_its_positive_power():
    plan = optimal("knee-reach", "objective.minimize=work")
    time, weights = instants(plan, 60)
    positive = float(weights @ np.maximum(0.0, power(plan, time)[:, 0]))
    assert positive == pytest.approx(plan.objective, rel=WORK_INTEGRAL)


@pytest.mark.slow
def test_the_work_of_the_knee_is_no_less_than_the_energy_that_it_gains():
    plan = optimal("knee-reach", "objective.minimize=work")
    mechanism, motion = plan.problem.mechanism, plan.trajectory
    ends = follow(mechanism, motion.position_at([0.0, motion.duration_s]), motion.start_pose)
    low, high = (simulated(mechanism.model, q, np.zeros(mechanism.n_q)).energy[0] for q in ends)
    assert plan.objective >= high - low
    time, weights = instants(plan, 60)
    assert weights @ power(plan, time)[:, 0] == pytest.approx(high - low, abs=WORK_INTEGRAL * plan.objective)
    effort = optimal("knee-reach")
    time, weights = instants(effort, 60)
    assert weights @ np.maximum(0.0, power(effort, time)[:, 0]) > 1.05 * plan.objective


@pytest.mark.slow
def test_the_closure_force_of_the_knee_is_what_mujoco_s_pin_carries():
    plan = optimal("knee-reach", "objective.minimize=closure_force")
    time, weights = instants(plan, 3)
    forces = pin_forces(plan, time)
    assert weights @ forces**2 == pytest.approx(plan.objective, rel=SOFT_PIN)
    assert forces.max() <= plan.certificate.peak_closure_force[0] * (1 + SOFT_PIN)


# Objectives that are refused.


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("objective.minimize=effrot", "did you mean 'effort'"),
        ("objective.minimize={}", "at least one of"),
        ("objective.minimize={effort=0.0}", "positive weight"),
        ("objective.minimize={effort=-1.0}", "positive weight"),
        ("objective.minimize={speed=1.0}", "is one of"),
        ("objective.minimize=copper_loss", "missing for act_O"),
        ("objective.minimize=tracking", "needs a [reference]"),
        ("objective.minimize={time=1.0,effort=1.0}", 'needs motion.duration_s = "free"'),
    ],
)
def test_an_objective_that_does_not_go_is_refused_in_one_line(asked, said):
    assert_refused(lambda: planned("knee-reach", asked), said, kind=ProblemError)


def test_a_peak_is_refused_where_an_effort_has_no_limit():
    free = GANTRY.replace(' ctrlrange="-40 40"', "")
    ends = {"goal_m": {"X": 1.0, "Y": 0.0}, "start_m": {"X": 0.0, "Y": 0.0}}
    with pytest.raises(ProblemError, match=r"'peak_effort' needs finite limits.effort \(.*missing for G\)"):
        Problem.reach(load_mechanism(free), **ends, minimize="peak_effort")


GANTRY = """<mujoco><option gravity="0 0 0"/>
  <worldbody>
    <body><joint name="X" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="3"/>
      <body pos="0 0 .3"><joint name="Y" type="slide" axis="0 1 0"/><geom type="box" size=".1 .1 .1" mass="2"/></body>
    </body>
  </worldbody>
  <actuator><motor name="F" joint="X" ctrlrange="-100 100"/><motor name="G" joint="Y" ctrlrange="-40 40"/></actuator>
</mujoco>"""


def gantry(minimize: str | dict[str, float], duration_s: float | str, y_m: float) -> Problem:
    """Return the problem of 5 kg on X and 2 kg on Y, moved by 1 m and `y_m` from rest to rest."""
    return Problem.reach(
        load_mechanism(GANTRY),
        start_m={"X": 0.0, "Y": 0.0},
        goal_m={"X": 1.0, "Y": y_m},
        duration_s=duration_s,
        minimize=minimize,
    )


@pytest.mark.parametrize(("y_m", "share"), [(0.1, 0.2), (2.0, 0.4)])  # decided by X, by Y
def test_the_least_peak_of_two_motors_is_the_larger_share_of_bang_bang_forces(y_m, share):
    """4 m d / T^2 is 20 N on X in 1 s; on Y it is 0.8 N or 16 N."""
    plan = plan_motion(gantry("peak_effort", 1.0, y_m))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(share, rel=2e-5)
    effort = np.abs(plan.trajectory.effort_at(plan.trajectory.dense_times(20))).max(axis=0)
    assert (effort / [100.0, 40.0]).max() == pytest.approx(plan.objective, rel=1e-6)


def test_time_and_peak_together_have_the_closed_form_s_compromise():
    """T = 2 sqrt(m d / F) with F = 100 k; T + k is least at k = 0.05^(1/3)."""
    plan = plan_motion(gantry({"time": 1.0, "peak_effort": 1.0}, "free", 0.1))
    k = 0.05 ** (1 / 3)
    assert plan.objective == pytest.approx(2 * np.sqrt(0.05 / k) + k, rel=2e-5)
    assert plan.trajectory.duration_s == pytest.approx(2 * np.sqrt(0.05 / k), rel=1e-3)


def test_the_least_peak_in_the_least_time_of_a_limit_is_that_limit():
    """The phase plane integrates the least time under 60 of 100 N.m: another way to the same motion."""
    quick = plan_motion(problem_of("knee-sprint", "limits.effort.act_O=[-60.0, 60.0]"))
    duration = f"motion.duration_s={quick.objective!r}"
    plan = plan_motion(problem_of("knee-sprint", "objective.minimize=peak_effort", duration))
    assert plan.objective == pytest.approx(0.6, rel=1e-5)
    assert plan.certificate.passed


def test_programs_with_other_limits_are_not_used_again_for_a_peak():
    peak = problem_of("knee-reach", "objective.minimize=peak_effort")
    lower = problem_of("knee-reach", "objective.minimize=peak_effort", "limits.effort.act_O=[-90.0, 90.0]")
    assert structure(peak) != structure(lower)
    effort = problem_of("knee-reach", "limits.effort.act_O=[-90.0, 90.0]")
    assert structure(problem_of("knee-reach")) == structure(effort)
