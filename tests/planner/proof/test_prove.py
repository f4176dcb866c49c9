"""Proofs: plans that keep their limits are proved, and plans that are spoilt between the samples are refuted."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.deadline import NO_DEADLINE, Deadline, OutOfTimeError
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.finding import Proof
from linkplan.planner.proof.prove import _Sweep
from linkplan.planner.proof.prove import prove as prove_all
from linkplan.planner.proof.walk import blocks_of
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from tests.support.linkages import RSSR
from tests.support.plans import optimal, planned, problem_of
from tests.support.provable import beside_its_limit, limited, needed, peak, rubbing_swing, swing, with_a_spoilt_coefficient

INVERSE = "by inverse dynamics"
# `make bench` (part proofs) proves and refutes the plans of a hundred seeds.
SEEDS = range(2)


def prove(*given) -> Proof:
    """Return the proof of limits; `test_existence` is about the model's own motion."""
    return prove_all(*given, existence=False)


def answers(proof: Proof, words: str) -> set[str]:
    """Return the answers of the claims with these words in their names."""
    return {finding.answer for finding in proof.findings if words in finding.name}


def knee() -> tuple[Problem, Trajectory]:
    plan = optimal("knee-reach")
    return plan.problem, plan.trajectory


def spoilt(name: str, at: tuple, by: float) -> Proof:
    """Return the proof of the knee's reach with one coefficient moved."""
    problem, motion = knee()
    coefficients = np.array(getattr(motion, name))
    coefficients[at] += by
    return prove(problem, replace(motion, **{name: coefficients}))


QUICK = ("knee-reach", "slider-crank-turn", "five-bar-reach", "cart-pole-swing-up")
SLOW = ("knee-sprint", "knee-linear-reach", "squeezer-turn", "gripper-close", "knee-sine")


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_built_in_plans_are_proved(name):
    plan = optimal(name)
    proof = prove(plan.problem, plan.trajectory)
    assert proof.complete, proof.sentence()
    assert answers(proof, INVERSE) == {"proved"}
    assert any("contacts" in finding.name for finding in proof.of("sampled"))


@pytest.mark.slow
def test_a_spatial_loop_with_ball_joints_is_proved():
    mechanism = load_mechanism(RSSR)
    crank = mechanism.independent_joints[0].name
    start = float(np.degrees(mechanism.home[mechanism.independent[0]]))
    problem = Problem.reach(mechanism, start_deg={crank: start}, goal_deg={crank: start + 60}, duration_s=0.8)
    plan = plan_motion(problem)
    proof = prove(problem, plan.trajectory)
    assert proof.complete
    assert answers(proof, "loops close") == {"proved"}


def test_dry_friction_is_enclosed():
    problem, motion = rubbing_swing()
    proof = prove(problem, motion)
    assert answers(proof, INVERSE) == {"proved"}
    assert answers(proof, "loops close") == {"proved"}
    (bound,) = [finding.bound for finding in proof.findings if INVERSE in finding.name]
    assert abs(bound) == pytest.approx(peak(problem.mechanism, motion), rel=1e-2)


def test_the_knees_bound_is_the_largest_effort_of_dense_samples():
    problem, motion = knee()
    (bound,) = [f.bound for f in prove(problem, motion).findings if INVERSE in f.name]
    largest = np.abs(needed(problem.mechanism, motion, motion.dense_times(200))).max()
    assert largest <= bound <= largest * (1 + 1e-6)


@pytest.mark.parametrize("seed", SEEDS)
def test_an_effort_a_billionth_below_its_mark_is_proved_and_above_it_is_refuted(seed):
    below, above = (prove(*beside_its_limit(seed, share)) for share in (-1e-9, 1e-9))
    assert answers(below, INVERSE) == {"proved"}
    assert answers(below, "loops close") == {"proved"}
    assert answers(above, INVERSE) == {"refuted"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_plans_with_a_spoilt_coefficient_are_refuted(seed):
    assert answers(prove(*with_a_spoilt_coefficient(seed)), INVERSE) == {"refuted"}


def test_a_planned_effort_beyond_its_limit_between_the_nodes_is_refuted():
    problem, motion = swing(1)
    largest = np.abs(motion.effort_at(motion.dense_times(400))).max()
    assert answers(prove(limited(problem, largest * (1 - 1e-6)), motion), "planned effort of") == {"refuted"}


def test_a_refuted_claim_names_an_instant_at_which_its_bound_occurs():
    problem, motion = swing(1)
    largest = np.abs(motion.effort_at(motion.dense_times(400))).max()
    proof = prove(limited(problem, 0.9 * largest), motion)
    (found,) = [finding for finding in proof.of("refuted") if finding.name.startswith("planned effort of")]
    assert motion.effort_at(np.array([found.time_s]))[0, 0] == pytest.approx(found.bound, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "at", "by", "words"),
    [
        ("position", (slice(None), slice(20, None), 0), 1e-6, "position join"),
        ("velocity", (slice(None), slice(20, None), 0), 1e-5, "velocity join"),
        ("velocity", (1, 11, 0), 1e-5, "slope of the planned position"),
        ("position", (-1, -1, 0), 1e-5, "starts and ends"),
        ("velocity", (0, 0, 0), 1e-3, "starts and ends"),
        ("start_pose", (1,), 1e-4, "loops close"),
        ("effort", (slice(None), 5, 0), 40.0, "planned effort"),
        ("velocity", (2, 0, 0), -0.2, INVERSE),
        ("position", (2, 0, 0), 2e-4, INVERSE),
    ],
)
def test_a_spoilt_coefficient_is_refuted(name, at, by, words):
    proof = spoilt(name, at, by)
    assert not proof.passed
    assert "refuted" in answers(proof, words), [f.sentence() for f in proof.of("refuted")]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("limits.speed_deg_s.C={}", "speed of C"),
        ("limits.acceleration_deg_s2.C={}", "acceleration of C"),
        ("limits.jerk_deg_s3.O={}", "jerk of O"),
        ("limits.jerk_deg_s3.C={}", "jerk of C"),
        ("limits.site_jerk_m_s3.B_coupler={}", "jerk of site B_coupler"),
        ("limits.site_speed_m_s.B_coupler={}", "speed of site B_coupler"),
        ("limits.site_acceleration_m_s2.B_coupler={}", "acceleration of site B_coupler"),
        ("limits.power_w.act_O={}", "power of act_O"),
        ("limits.closure_force.B={}", "closure force of B"),
        ("limits.pin_force.O={}", "pin force of O"),
        ("limits.range_deg.O=[-90, {}]", "position of O"),
    ],
)
def test_every_kind_of_limit_is_proved_above_its_largest_value_and_refuted_below(override, words):
    _, motion = knee()
    wide = 89.0 if "position" in words else 1e6
    (bound,) = [f.bound for f in prove(problem_of("knee-reach", override.format(wide)), motion).findings if words in f.name]
    size = np.sqrt(bound) if "force" in words or "site" in words else abs(bound)
    for factor, answer in ((1 + 1e-4, "proved"), (1 - 1e-2, "refuted")):
        narrow = problem_of("knee-reach", override.format(size * factor))
        assert answers(prove(narrow, motion), words) == {answer}, (words, factor)


def test_corners_of_the_ranges_are_proved_and_refuted():
    overrides = ("robust.payload_factor=[0.8, 1.2]", "robust.torque_constant_factor=[0.95, 1.05]")
    _, motion = knee()
    proof = prove(problem_of("knee-reach", *overrides), motion)
    assert len([f for f in proof.findings if "payload" in f.name]) >= 4
    assert "refuted" in answers(proof, "payload 1.2, torque constant 0.95")
    assert "proved" in answers(proof, "payload 0.8, torque constant 1.05")


def test_failures_of_the_certificate_refute_a_plan():
    problem, motion = knee()
    assert prove(problem, motion).passed
    assert not prove(problem, motion, ("a contact",)).passed


def test_a_plan_without_a_motion_has_no_proof():
    with pytest.raises(LinkplanError, match="the plan has no motion"):
        planned("knee-reach", "motion.duration_s=0.01").prove()


def test_a_proof_whose_time_is_up_is_not_made():
    plan = optimal("knee-reach")
    with pytest.raises(OutOfTimeError, match="the time for the proof is over"):
        prove_all(plan.problem, plan.trajectory, (), NO_DEADLINE.within(0.0))


@pytest.mark.parametrize(("share", "is_made"), [(1.0, True), (0.9, False)])
def test_a_proof_that_needs_more_than_its_time_ends_after_the_first_intervals(share, is_made):
    """The deadline's clock counts intervals, so that a share of them fits into the time to the deadline."""
    plan = optimal("knee-reach")
    problem, n = plan.problem, len(plan.trajectory.breaks_s) - 1
    shared = {"problem": problem, "trajectory": plan.trajectory, "blocks": blocks_of(problem.mechanism), "order": 12}
    sweep = _Sweep(claims=[], until=Deadline(at_s=share * n, clock=lambda: sweep.interval), **shared)
    with contextlib.nullcontext() if is_made else pytest.raises(OutOfTimeError, match=f"1 of {n} intervals"):
        sweep.run()
    assert sweep.interval == (n if is_made else 1)
