"""Malformed and impossible problems over a user's differential equation: one clear line each, or a plan that says why."""

import casadi as ca
import numpy as np
import pytest

from linkplan.models.errors import PlanError, ProblemError
from linkplan.planner.ode.plan import OdePlan, plan_ode
from linkplan.planner.ode.problem import StateGuess
from linkplan.planner.problem.settings import MeshSettings, SolverSettings
from tests.support.ode import INF, NAN, least_time_reach, squared_effort
from tests.support.refusals import assert_refused
from tests.support.tolerances_planner import ODE_CLOSED_FORM


def planned(**changes) -> OdePlan:
    return plan_ode(least_time_reach(**changes))


def at_instant(*values):
    """Return a function of (x, u, p, t) with so many values, of nothing in particular."""
    return lambda x, u, p, t: [x[0] * 0 + value for value in values]  # noqa: ARG005


def at_ends(*values):
    return lambda x0, xT, T, p: [xT[0] * 0 + value for value in values]  # noqa: ARG005


MALFORMED = {
    "fewer values at the start": ({"start": [0]}, "one value a state, got 1 and 2"),
    "no state": ({"start": [], "goal": []}, "one value a state, got 0 and 0"),
    "a start upside down": ({"start": [[1, 0], [0, 0]]}, "low <= high"),
    "a start of three columns": ({"start": [[0, 1, 2], [0, 1, 2]]}, r"shape \(2, 3\)"),
    "no effort": ({"effort_limit": []}, "at least one"),
    "an effort limit upside down": ({"effort_limit": [[1, -1]]}, "low <= high"),
    "an effort limit that is no number": ({"effort_limit": [[NAN, 1]]}, "low <= high"),
    "too few state limits": ({"state_limit": [[0, 1]]}, "each of 2 states, got 1"),
    "a state limit upside down": ({"state_limit": [[1, 0], [0, 1]]}, "low <= high"),
    "a negative duration": ({"duration_s": -1.0}, "duration_s must be a positive number"),
    "durations upside down": ({"duration_s": (2, 1)}, "low < high"),
    "an endless duration": ({"duration_s": INF}, "duration_s must be a positive number"),
    "too few rates": ({"rate": at_instant(1)}, "rate gives 2 values .* got 1"),
    "a rate with a branch on a state": (
        {"rate": lambda x, u, p, t: [x[1], u[0] if x[0] > 0 else 0]},  # noqa: ARG005
        "rate of 'double integrator' cannot be written in CasADi's SX",
    ),
    "a rate with an effort that is not there": (
        {"rate": lambda x, u, p, t: [x[1], u[3]]},  # noqa: ARG005
        "cannot be written in CasADi's SX",
    ),
    "a rate of other arguments": ({"rate": lambda x, u: [x[1], u[0]]}, "2 positional arguments"),
    "a rate that is no function": ({"rate": "x'' = u"}, "not callable"),
    "a running cost of two values": ({"running_cost": at_instant(1, 2)}, "running_cost gives 1 values .* got 2"),
    "a final cost of two values": ({"final_cost": at_ends(1, 2)}, "final_cost gives 1 values .* got 2"),
    "nothing to be best in": ({"final_cost": None}, "running_cost, final_cost or both"),
    "a path without limits": ({"path": at_instant(1)}, "path gives 0 values .* got 1"),
    "limits without a path": ({"path_limit": [[0, 1]]}, "path gives 1 values .* got 0"),
    "ends without limits": ({"ends": at_ends(1)}, "ends gives 0 values .* got 1"),
    "a state that is not there returns": ({"returns": [2]}, "from 0 to 1, got"),
    "parameters that are no numbers": ({"parameters": [NAN]}, "parameters must be finite numbers"),
    "too few names": ({"states": ["x"]}, "states has 2 names, got 1"),
    "no tolerance": ({"tolerance": 0}, "tolerance must be a positive number, got 0"),
    "a negative tolerance on the objective": ({"objective_tolerance": -1.0}, "objective_tolerance"),
    "a guess that is a table": ({"guesses": [{"state": [[0, 0], [1, 0]]}]}, "StateGuess objects, got {'state'"),
    "settings of the solver in a table": ({"solver": {"starts": 4}}, "solver must be a .*SolverSettings, got {'starts'"),
    "more starts than guesses": (
        {"solver": SolverSettings(starts=4)},
        "solver.starts must be 1 for a differential equation, got 4",
    ),
    "settings of the mesh in a table": ({"mesh": {"intervals": 4}}, "mesh must be a .*MeshSettings, got {'intervals'"),
    "a guess of one state": ({"guesses": [StateGuess(state=[[0], [1]])]}, "a guess has 2 states"),
    "a guess of two efforts": (
        {"guesses": [StateGuess(state=[[0, 0], [1, 0]], effort=[[0, 0], [0, 0]])]},
        "a guess has 2 states and 1 efforts",
    ),
    # Values that numpy, CasADi or a function of the user's would choke on.
    "a start of text": ({"start": "ab"}, None),
    "an infinite start": ({"start": [INF, 0]}, None),
    "an odd effort limit": ({"effort_limit": [-1, 1, 2]}, None),
    "an effort that is always infinite": ({"effort_limit": [[INF, INF]]}, None),
    "a duration in words": ({"duration_s": "free"}, None),
    "a rate that divides by nothing": ({"rate": lambda x, u, p, t: 1 / 0}, None),  # noqa: ARG005
    "a rate with a name that is not there": ({"rate": lambda x, u, p, t: [x[1], u.force]}, None),  # noqa: ARG005
    "a rate with a symbol of its own": (
        {"rate": lambda x, u, p, t: [x[1], u[0] + ca.SX.sym("k")]},  # noqa: ARG005
        None,
    ),
    "half a state returns": ({"returns": [0.5]}, None),
    "parameters of text": ({"parameters": "a"}, None),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_problem_is_refused_in_one_line(case):
    changes, said = MALFORMED[case]
    with pytest.raises(ProblemError, match=said) as refusal:
        planned(**changes)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("rows", [[1.0, 2.0], [[1.0, NAN], [0.0, 0.0]], [[1.0, 0.0]]])
def test_a_guess_is_two_or_more_finite_rows_and_lasts(rows):
    assert_refused(lambda: StateGuess(state=rows), "two or more finite rows", kind=ProblemError)
    assert_refused(lambda: StateGuess(state=[[0, 0], [1, 0]], duration_s=-1.0), "duration_s", kind=ProblemError)


# Problems without an answer.


@pytest.mark.parametrize(
    "allowed", [{"duration_s": 1.0, "running_cost": squared_effort, "final_cost": None}, {"duration_s": (0.1, 1.0)}]
)
def test_a_problem_that_no_start_solves_is_failed_and_not_called_infeasible(allowed):
    """Rest to rest over 1 in 1 s takes an effort of 4: nothing here proves that."""
    plan = planned(**allowed)
    assert plan.status == "failed"
    assert plan.trajectory is None
    with pytest.raises(PlanError, match="no start led to a solution") as raised:
        plan.require()
    assert raised.value.plan is plan
    assert str(raised.value) == plan.message


def test_effort_that_is_just_enough_is_not_called_too_small():
    plan = planned(duration_s=1.0, running_cost=squared_effort, final_cost=None, effort_limit=[[-4.001, 4.001]])
    assert plan.status == "optimal", plan.message


@pytest.mark.parametrize("asked", ["start", "goal"])
def test_a_boundary_state_beyond_its_limit_is_refused(asked):
    with pytest.raises(ProblemError, match=f"{asked} asks for x = 1, beyond its limits -inf to 0.5"):
        planned(**{asked: [1, 0], "state_limit": [[-INF, 0.5], [-INF, INF]], "states": ["x", "v"]})


@pytest.mark.slow
def test_a_goal_that_no_effort_reaches_is_not_called_solved():
    plan = planned(rate=lambda x, u, p, t: [x[1] ** 2, u[0]], goal=[-1, 0])  # noqa: ARG005
    assert plan.status == "failed"
    assert plan.objective is None
    assert "\n" not in plan.message


@pytest.mark.parametrize("expression", [lambda x: ca.log(-1 - x**2), lambda x: ca.sqrt(x - 5), lambda x: 1 / (x - x)])
def test_dynamics_that_are_no_number_are_said(expression):
    plan = planned(rate=lambda x, u, p, t: [x[1], u[0] + expression(x[0])])  # noqa: ARG005
    assert plan.status == "failed"
    assert "not finite (NaN)" in plan.message
    assert "\n" not in plan.message


def test_a_solver_that_exceeds_its_time_limit_is_said():
    plan = planned(solver=SolverSettings(max_time_s=1e-3), rate=lambda x, u, p, t: [x[1], u[0] - ca.sin(x[0])])  # noqa: ARG005
    assert plan.status == "failed"
    assert "ran out of its 0.001 s (solver.max_time_s)" in plan.message


@pytest.mark.slow
def test_an_integrated_state_that_misses_its_tolerance_is_said():
    plan = planned(
        rate=lambda x, u, p, t: [x[1], u[0] - ca.sin(5 * x[0])],  # noqa: ARG005
        effort_limit=[[-INF, INF]],
        duration_s=2.0,
        running_cost=squared_effort,
        final_cost=None,
        mesh=MeshSettings(scheme="radau-1", intervals=2, refine="intervals"),
    )
    assert plan.status == "failed"
    assert "integrated state" in plan.message
    assert plan.trajectory is not None  # a motion that does not do is shown, not claimed
    assert (plan.objective, plan.objective_error, plan.duration_s) == (None, None, None)


def test_an_effort_that_falls_for_ever_with_time_has_no_optimum_and_says_so():
    """Rest to rest over 1 in T costs 12 / T^3."""
    plan = planned(duration_s=(0.1, 1e9), effort_limit=[[-INF, INF]], running_cost=squared_effort, final_cost=None)
    assert plan.status == "failed"
    assert (plan.trajectory, plan.objective, plan.objective_error, plan.duration_s) == (None, None, None, None)
    assert "the longer the motion the better, up to 100 s, where the search from its guess ends" in plan.message
    assert "bound duration_s from above" in plan.message
    assert "\n" not in plan.message


def test_a_best_duration_far_from_any_guess_is_found_from_a_guess_with_a_duration_alone():
    """Least time 2 sqrt(d / u) for a micrometre under 1000: 63 us, where a second is begun from."""
    micrometre = {"goal": [1e-6, 0], "effort_limit": [[-1e3, 1e3]], "duration_s": (1e-6, 10)}
    plan = planned(**micrometre)
    assert plan.status == "failed"
    assert "the shorter the motion the better, up to 0.02 s, where the search from its guess ends" in plan.message
    guess = StateGuess(state=[[0, 0], [1e-6, 0]], duration_s=1e-4)
    assert planned(**micrometre, guesses=[guess]).objective == pytest.approx(2 * np.sqrt(1e-6 / 1e3), rel=ODE_CLOSED_FORM)


@pytest.mark.slow
@pytest.mark.parametrize("shortest", [0.3, 0.7, 1.1, 1.3])
def test_a_shortest_duration_that_binds_is_the_user_s_own(shortest):
    """Nothing is asked of the end: the least time is the shortest allowed, whatever units it went through."""
    plan = planned(duration_s=(shortest, 40.0), goal=[NAN, NAN])
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(shortest, rel=ODE_CLOSED_FORM)
