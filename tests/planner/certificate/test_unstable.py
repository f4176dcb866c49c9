"""Motions that are unstable open loop: judged interval by interval, and reached by lengthening the motion of least time."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from linkplan.planner.certificate.certificate import certify
from linkplan.planner.certificate.integration import RESTART_GROWTH, integrate
from linkplan.planner.closed_chain.guess import guess_from
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.kinds import INTEGRATION_DEG
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import recording
from linkplan.planner.search import continuations
from linkplan.planner.search.continuations import MIN_SAVING, continued, from_continuation
from linkplan.planner.search.ladder import FULL_BUDGET, KnownMotions
from linkplan.planner.search.planning import plan_motion, search_for
from linkplan.planner.search.starts import least_time_motion
from tests.support.bodies import HINGE, HINGE_INERTIA, PENDULUM, body_plan, body_problem
from tests.support.fourbar_problems import random_case

# The rod about upright: an error grows by e for every 1 / RATE [s].
MASS, CENTRE, INERTIA = 1.0, 0.5, 0.26
RATE = np.sqrt(MASS * 9.81 * CENTRE / INERTIA)
WAIT_S = 7.0
# Lengthened motions are finished by the same solver: closed forms as elsewhere, relative.
CLOSED_FORM = 1e-6


@cache
def over_upright() -> Plan:
    """Return the plan of a rod that waits next to upright for a long time."""
    motion = f'kind = "reach"\nstart_deg = {{ J = 178.0 }}\ngoal_deg = {{ J = 182.0 }}\nduration_s = {WAIT_S}\n'
    return body_plan(PENDULUM.format(limit=20.0), motion)


def allowed(plan: Plan) -> np.ndarray:
    return np.full(plan.trajectory.n_s, np.radians(INTEGRATION_DEG))


def test_an_error_next_to_upright_would_grow_beyond_all_rounding():
    assert np.exp(RATE * WAIT_S) > 1e6 * RESTART_GROWTH


@pytest.mark.slow
def test_a_rod_that_waits_upright_is_planned_and_judged_anew_as_often_as_errors_grow():
    plan = over_upright()
    assert plan.status == "optimal", plan.message
    most = np.log(np.exp(RATE * WAIT_S)) / np.log(RESTART_GROWTH)
    assert 1 <= plan.certificate.integration_restarts <= most + 1
    assert plan.certificate.integration_error_deg <= INTEGRATION_DEG


def test_a_stable_motion_is_integrated_in_one_go():
    plan = body_plan(
        PENDULUM.format(limit=20.0), 'kind = "reach"\nstart_deg = { J = -40.0 }\ngoal_deg = { J = 40.0 }\nduration_s = 1.0\n'
    )
    assert plan.certificate.passed
    assert plan.certificate.integration_restarts == 0


@pytest.mark.slow
@pytest.mark.parametrize("share", [1e-3, 1e-2])
def test_an_unstable_motion_with_efforts_that_are_not_its_own_does_not_pass(share):
    plan = over_upright()
    motion = plan.trajectory
    wrong = replace(motion, effort=motion.effort * (1 + share))
    assert not certify(plan.problem, wrong).passed


def test_what_is_begun_anew_still_adds_up_what_each_interval_is_off():
    """A step of the planned velocity in the middle is a defect: it grows by no more than RESTART_GROWTH, and is seen."""
    plan = over_upright()
    motion, jump = plan.trajectory, 1e-4
    velocity = np.array(motion.velocity)
    half = velocity.shape[1] // 2
    velocity[:, half:] += jump
    speed = float(np.abs(velocity).max())
    judged = integrate(plan.problem.mechanism, replace(motion, velocity=velocity), speed, allowed(plan))
    assert judged.velocity * speed > 0.5 * jump


def quick_hinge_guess():
    motion = 'kind = "reach"\nstart_deg = { J = 10.0 }\ngoal_deg = { J = 100.0 }\nduration_s = "free"\n'
    quick = body_plan(HINGE, motion, "objective.minimize=time")
    assert quick.status == "optimal"
    return quick.trajectory


@pytest.mark.slow
def test_a_least_time_motion_is_lengthened_to_the_fixed_duration_that_is_asked():
    """A pure inertia's least effort in T: 12 J^2 turn^2 / T^3."""
    quick = quick_hinge_guess()
    T = 5.0 * quick.duration_s
    problem = body_problem(
        HINGE, f'kind = "reach"\nstart_deg = {{ J = 10.0 }}\ngoal_deg = {{ J = 100.0 }}\nduration_s = {T}\n'
    )
    with recording() as steps:
        reached = continued(problem, guess_from(quick), 40, KnownMotions())
    assert reached is not None
    assert reached.start.duration_s == pytest.approx(T)
    assert not reached.enough
    assert len(steps) >= np.log(5.0) / np.log(1.15)
    assert steps[-1].objective == pytest.approx(12 * HINGE_INERTIA**2 * (np.pi / 2) ** 2 / T**3, rel=CLOSED_FORM)


@pytest.mark.slow
def test_a_free_duration_is_lengthened_until_more_time_saves_next_to_nothing():
    """A weight lifted in free time: at the best duration of a pendulum's rise a longer motion is no better."""
    motion = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 60.0 }\nduration_s = "free"\nmax_duration_s = 20.0\n'
    given = PENDULUM.format(limit=20.0)
    quick = body_plan(given, motion, "objective.minimize=time")
    assert quick.status == "optimal", quick.message
    problem = body_problem(given, motion)
    reached = continued(problem, guess_from(quick.trajectory), 40, KnownMotions())
    assert reached is not None
    best = plan_motion(problem)
    assert best.status == "optimal", best.message
    assert reached.start.duration_s <= reached.longest_s * (1 + 1e-9)
    assert reached.start.duration_s == pytest.approx(best.trajectory.duration_s, rel=MIN_SAVING)


@pytest.mark.slow
def test_a_motion_five_times_as_long_as_the_least_is_planned_by_lengthening():
    """Number 313 of the random problems: solvers that begin elsewhere are lost, or pass where their mesh does not look."""
    case = random_case(1, 313)
    plan = plan_motion(Problem.from_tables("long", case.tables))
    assert plan.status == "optimal", plan.message
    assert plan.certificate.passed
    assert plan.trajectory.duration_s == pytest.approx(case.duration)


@pytest.mark.slow
def test_a_least_duration_is_kept_by_a_motion_that_is_lengthened():
    """A pure inertia's best motion within [4 T, 6 T] takes 6 T; on the way there none ends before 4 T is allowed."""
    quick = quick_hinge_guess()
    T = quick.duration_s
    motion = 'kind = "reach"\nstart_deg = { J = 10.0 }\ngoal_deg = { J = 100.0 }\nduration_s = "free"\n'
    problem = body_problem(HINGE, motion + f"min_duration_s = {4 * T}\nmax_duration_s = {6 * T}\n")
    reached = continued(problem, guess_from(quick), 40, KnownMotions())
    assert reached is not None
    assert reached.longest_s >= 4 * T
    assert reached.start.duration_s >= 4 * T * (1 - 1e-9)


@pytest.mark.slow
def test_switch_times_that_move_far_are_followed_on_the_way(monkeypatch):
    """A rod is swung beyond its motor's reach: with 15 % more time, windows about the least time's switches hold it."""
    given = PENDULUM.format(limit=2.0)
    motion = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 120.0 }\nduration_s = "free"\n'
    free = body_problem(given, motion)
    quick = least_time_motion(search_for(free), FULL_BUDGET)
    step, held = continuations._step, []

    def noted(problem, at, allowed):
        found = step(problem, at, allowed)
        held.append(found is not None and found.held)
        return found

    monkeypatch.setattr(continuations, "_step", noted)
    longest = 1.15 * quick.duration_s
    reached = continued(body_problem(given, motion + f"max_duration_s = {longest}\n"), quick, 40, KnownMotions())
    assert held[0]
    assert len(held) > 1
    assert reached is not None
    assert not reached.lost
    assert reached.longest_s == pytest.approx(longest)
    first, last = quick.switch_times_s[0], np.cumsum(reached.shares)[0] * reached.start.duration_s
    assert last < 0.5 * first, "its first switch comes much earlier"


@pytest.mark.slow
def test_where_longer_motions_are_lost_the_last_one_on_the_way_is_returned_and_says_so(monkeypatch):
    """A pure inertia may take ten times its least time; whatever is allowed more than 1.5 times is lost."""
    quick = quick_hinge_guess()
    motion = 'kind = "reach"\nstart_deg = { J = 10.0 }\ngoal_deg = { J = 100.0 }\nduration_s = "free"\n'
    problem = body_problem(HINGE, motion + f"max_duration_s = {10 * quick.duration_s}\n")
    step = continuations._step

    def losing(problem, at, allowed):
        return step(problem, at, allowed) if allowed < 1.5 * quick.duration_s else None

    monkeypatch.setattr(continuations, "_step", losing)
    search = search_for(problem)
    plan = from_continuation(search, FULL_BUDGET)
    assert plan.certificate.passed
    assert plan.status == "feasible"
    assert "longer motions were lost" in plan.message
    assert 1.3 * quick.duration_s < plan.trajectory.duration_s < 1.5 * quick.duration_s
