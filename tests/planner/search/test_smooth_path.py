"""The smooth path itself as an answer, where the solver finds none: a motion of large robots that is not optimised."""

import numpy as np
import pytest

from linkplan.models import deadline
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search import without_solver
from linkplan.planner.search.ladder import SHORT_BUDGET, Search, SearchMethod
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.reasons import nothing_found
from linkplan.planner.search.without_solver import _is_carried
from tests.support.plans import optimal

STRONG = "limits.effort={ act_O1 = [-3.0, 3.0], act_O2 = [-3.0, 3.0] }"


def unsolved(problem) -> Plan:
    """Return the plan of a problem that no method is tried on."""
    return plan_motion(problem, methods=(), diagnoses=(nothing_found,))


@pytest.fixture(scope="module")
def smooth():
    return unsolved(load_problem("five-bar-reach", [STRONG]))


def test_the_smooth_path_answers_where_no_rung_finds_a_motion(smooth):
    assert smooth.status == "feasible", smooth.message
    assert smooth.certificate.passed
    assert "along the smooth path" in smooth.message
    assert "found no better one" in smooth.message
    best = optimal("five-bar-reach", STRONG)
    assert smooth.trajectory.duration_s == pytest.approx(best.trajectory.duration_s)
    assert smooth.objective > 1.01 * best.objective, "a path that is not optimised costs more"


def test_it_answers_however_late_the_search_ends():
    """A compiler or a solver's first iteration cannot be interrupted."""

    def compiling(_search, _budget):
        deadline._CHILD_TIME.seconds += 1000.0

    late = SearchMethod(name="late", run=compiling, budget=SHORT_BUDGET)
    problem = load_problem("five-bar-reach", [STRONG, "solver.max_time_s=20"])
    plan = plan_motion(problem, methods=(late,), diagnoses=(nothing_found,))
    assert plan.status == "feasible", plan.message


def test_it_is_a_quintic_in_the_independent_joints(smooth):
    motion, trajectory = smooth.problem.motion, smooth.trajectory
    share = np.linspace(0.0, 1.0, 41)[:, None]
    asked = motion.start + (10 * share**3 - 15 * share**4 + 6 * share**5) * (motion.goal - motion.start)
    assert np.abs(trajectory.position_at(share[:, 0] * trajectory.duration_s) - asked).max() < 1e-12


def test_its_efforts_are_those_of_inverse_dynamics_and_its_objective_is_their_integral(smooth):
    trajectory, mechanism = smooth.trajectory, smooth.problem.mechanism
    time = np.linspace(0.0, trajectory.duration_s, 2001)
    poses = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    needed, _ = needed_effort(mechanism, poses, trajectory.velocity_at(time), trajectory.acceleration_at(time))
    assert np.abs(needed - trajectory.effort_at(time)).max() < 1e-8 * np.abs(needed).max()
    integral = float(np.trapezoid((needed**2).sum(axis=1), time))
    assert smooth.objective == pytest.approx(integral, rel=1e-5)


@pytest.mark.parametrize(("power_w", "longest_s", "factor"), [(3.0, 9.0, 2), (1.0, 9.0, 4), (1.0, 0.5, None)])
def test_with_a_free_duration_it_takes_as_long_as_limits_on_power_ask_for(power_w, longest_s, factor):
    """A motion in twice the time needs an eighth of the power where no weight is carried."""
    power = f"limits.power_w={{ act_O1 = {power_w}, act_O2 = {power_w} }}"
    free = ['motion.duration_s="free"', f"motion.max_duration_s={longest_s}", 'objective.minimize="time"']
    problem = load_problem("five-bar-reach", [STRONG, power, *free])
    plan = unsolved(problem)
    assert plan.status == ("failed" if factor is None else "feasible")
    if factor is not None:
        least_s = Search(problem=problem, start_pose=problem.start_pose()).smooth.duration_s
        assert plan.trajectory.duration_s == pytest.approx(factor * least_s)


def test_it_is_no_answer_if_its_efforts_exceed_their_limits():
    plan = unsolved(load_problem("five-bar-reach"))
    assert plan.status == "failed"
    assert "times its limit" in plan.message


def test_it_is_no_answer_if_a_joint_has_no_drive():
    assert not unsolved(load_problem("cart-pole-swing-up")).passed


@pytest.mark.parametrize(("name", "carried"), [("five-bar-reach", True), ("cart-pole-swing-up", False)])
def test_a_path_is_carried_where_the_actuators_give_every_effort_that_it_needs(name, carried):
    """A pole without a motor does not follow the smooth path, though the cart does."""
    problem = load_problem(name, [STRONG] if name == "five-bar-reach" else [])
    search = Search(problem=problem, start_pose=problem.start_pose())
    assert _is_carried(problem, search.smooth) is carried


@pytest.mark.parametrize(("missing", "carried"), [(0.9e-9, True), (1.1e-9, False)])
def test_an_effort_that_is_missing_to_rounding_of_the_largest_one_is_none(monkeypatch, missing, carried):
    """One of the actuators rests, which makes the missing efforts no more important."""

    def needed(mechanism, poses, *_motion):
        return np.tile([0.0, 2.0], (len(poses), 1)), np.full((len(poses), mechanism.dof), 2.0 * missing)

    monkeypatch.setattr(without_solver, "needed_effort", needed)
    problem = load_problem("five-bar-reach", [STRONG])
    assert _is_carried(problem, Search(problem=problem, start_pose=problem.start_pose()).smooth) is carried
