"""The smooth path and its efforts, and first meshes of guesses."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models import deadline
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.planner.closed_chain.guess import Guess
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import failed
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.methods import SHORT_BUDGET, SearchMethod
from linkplan.planner.search.planning import plan_motion, search_for
from linkplan.planner.search.reasons import nothing_found
from linkplan.planner.search.solving import INTERVALS_PER_SWING, first_mesh, graded_mesh
from linkplan.planner.search.without_solver import _is_carried
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
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
    assert "found no better motion" in smooth.message
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


def test_it_takes_the_place_of_a_motion_that_fails():
    best = optimal("five-bar-reach", STRONG)
    beyond = replace(best, verdict=failed("it needs more effort than its limits permit"))
    method = SearchMethod(name="beyond", run=lambda _search, _budget: beyond, budget=SHORT_BUDGET)
    plan = plan_motion(best.problem, methods=(method,))
    assert plan.status == "feasible"
    assert plan.objective > 1.01 * best.objective
    assert plan.prove(existence=False).passed


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
        least_s = search_for(problem).smooth.duration_s
        assert plan.trajectory.duration_s == pytest.approx(factor * least_s)


def test_it_is_no_answer_if_its_efforts_exceed_their_limits():
    plan = unsolved(load_problem("five-bar-reach"))
    assert plan.status == "failed"
    assert "times its limit" in plan.message


def test_it_is_no_answer_if_a_joint_has_no_drive():
    assert not unsolved(load_problem("cart-pole-swing-up")).passed


PUSHING = "limits.effort.pull=[-20, 20]"


@pytest.mark.parametrize(
    ("name", "settings", "carried"),
    [
        ("five-bar-reach", [STRONG], True),
        ("gripper-close", [PUSHING], True),
        ("gripper-close", [], False),
        ("cart-pole-swing-up", [], False),
    ],
)
def test_a_path_is_carried_where_the_actuators_give_every_effort_that_it_needs(name, settings, carried):
    """A pole without a motor does not follow the smooth path, though the cart does; a cable does not push."""
    problem = load_problem(name, settings)
    search = search_for(problem)
    assert _is_carried(problem, search.smooth) is carried


def problem(*settings: str) -> Problem:
    return body_problem(HINGE, QUARTER_TURN + "duration_s = 4.0\n", *settings)


def guess(position, velocity, duration: float = 4.0, **given) -> Guess:
    return Guess(
        position=lambda t: position(t)[:, None],
        velocity=lambda t: velocity(t)[:, None],
        acceleration=lambda t: 0 * t[:, None],
        effort=None,
        duration_s=duration,
        start_pose=np.zeros(1),
        **given,
    )


def even(**given) -> Guess:
    return guess(lambda t: t, np.ones_like, **given)


@pytest.mark.parametrize("swings", [1, 2, 3, 9])
def test_a_first_mesh_has_the_intervals_asked_for_and_some_for_every_swing(swings):
    mesh, durations = first_mesh(problem("mesh.intervals=31"), even(swings=swings))
    assert mesh.n_intervals == max(31, INTERVALS_PER_SWING * swings if swings > 1 else 0)
    assert durations.tolist() == [4.0]
    assert mesh.n_segments == 1


def test_phases_of_a_guess_are_phases_of_its_first_mesh():
    mesh, durations = first_mesh(problem("mesh.intervals=40"), even(boundaries_s=np.array([0.0, 1.0, 4.0])))
    assert durations.tolist() == [1.0, 3.0]
    assert mesh.n_phases == mesh.n_segments == 2
    assert np.bincount(mesh.segment).tolist() == [10, 30]


def test_an_even_motion_has_an_even_mesh_between_its_switches():
    """Of 20 intervals in 4 s, 5 lie in the first second and 15 in the others; a segment has three at least."""
    mesh, durations = graded_mesh(even(), np.array([1.0]), 20)
    assert durations.tolist() == [1.0, 3.0]
    assert np.bincount(mesh.segment).tolist() == [5, 15]
    np.testing.assert_allclose(mesh.fraction, np.repeat([1 / 5, 1 / 15], [5, 15]))
    short, _ = graded_mesh(even(), np.array([0.1]), 20)
    assert np.bincount(short.segment).tolist() == [3, 20]


def test_a_mesh_is_finer_where_a_motion_is_quick():
    """At speeds of 1 and 3 for half of the time each, a quarter and three quarters of the way, with the change between.

    The shares of the halves are the means of 1/2 of the time, 1/4 and 3/4 of the way, and 0 and 1 of the change of speed,
    which is in the second half.
    """

    def position(t: np.ndarray) -> np.ndarray:
        return np.where(t < 2.0, t, 2.0 + 3.0 * (t - 2.0))

    mesh, _ = graded_mesh(guess(position, lambda t: np.where(t <= 2.0, 1.0, 3.0)), np.array([2.0]), 36)
    assert np.bincount(mesh.segment).tolist() == [9, 27]


def test_switches_lie_in_the_phases_in_which_they_are():
    mesh, durations = graded_mesh(even(boundaries_s=np.array([0.0, 1.5, 4.0])), np.array([3.0, 0.5]), 40)
    assert durations == pytest.approx([0.5, 1.0, 1.5, 1.0])
    assert mesh.phase.tolist() == [0, 0, 1, 1]
