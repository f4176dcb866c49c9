"""A motion on a finer mesh that is nearest to one on a coarse mesh, until its efforts hold by inverse dynamics."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess, guess_from
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.refinement.actions import ReduceEffortOverrun
from linkplan.planner.refinement.case import attempt, certify_iterate
from linkplan.planner.refinement.decision import next_action
from linkplan.planner.refinement.state import RefinementState
from linkplan.planner.solvers.newton import FEASIBLE, nearest_feasible
from linkplan.planner.transcription.mesh import uniform


@pytest.fixture(scope="module")
def coarse() -> RefinementState:
    """Return a motion of the knee on seven intervals whose efforts exceed their limit between the nodes."""
    problem = load_problem("knee-reach", ["mesh.intervals=7", "limits.effort.act_O=[-83.0, 83.0]"])
    case = case_of(problem)
    found = attempt(case, first_guess(problem, problem.start_pose()), uniform(7), np.array([0.16]), "once")
    at = certify_iterate(case, found)
    assert at.passed
    return RefinementState(asked=case, case=case, iterate=at, best=at, warm=False, restored=1)


def effort_is_proved(state: RefinementState) -> bool:
    """Return True if the state's best motion keeps its efforts' limit by inverse dynamics, at every instant."""
    findings = prove(state.asked.problem, state.best.found.motion, existence=False).findings
    (effort,) = [finding for finding in findings if "by inverse dynamics" in finding.name]
    return effort.answer == "proved"


def test_a_motion_is_kept_on_finer_meshes_until_its_effort_is_proved(coarse):
    state, objective = coarse, coarse.best.found.solution.objective
    assert not effort_is_proved(state)
    while (action := next_action(state)) is not None:
        assert isinstance(action, ReduceEffortOverrun)
        state = action.apply(state)
    assert state.best.n_intervals > coarse.best.n_intervals
    assert state.best.found.solution.status == FEASIBLE
    assert effort_is_proved(state)
    assert state.best.found.solution.objective == pytest.approx(objective, rel=1e-4)


def test_rows_that_contradict_each_other_lead_to_no_motion(coarse):
    solution = coarse.best.found.solution
    apart = replace(solution.transcribed, row_lower=solution.transcribed.row_lower + 1.0)
    apart = replace(apart, row_upper=apart.row_upper + 1.0)
    assert not nearest_feasible(apart, solution.x).converged


def test_a_row_without_bounds_is_left_out_and_nothing_is_printed(coarse, capfd):
    solution = coarse.best.found.solution
    lower, upper = solution.transcribed.row_lower.copy(), solution.transcribed.row_upper.copy()
    lower[0], upper[0] = -np.inf, np.inf
    free = replace(solution.transcribed, row_lower=lower, row_upper=upper)
    found = nearest_feasible(free, solution.x + 1e-5)
    assert found.converged
    assert found.iterations
    assert capfd.readouterr() == ("", "")


def test_a_feasible_point_stays(coarse):
    solution = coarse.best.found.solution
    again = nearest_feasible(solution.transcribed, solution.x)
    assert (again.converged, again.iterations) == (True, 0)
    np.testing.assert_allclose(again.x, solution.x, atol=1e-9)
    assert again.objective == pytest.approx(solution.objective, rel=1e-12)


def test_steps_that_lead_away_end(coarse):
    """Newton's steps to the root of a cubic root double the distance each time."""
    transcribed, k = coarse.best.found.solution.transcribed, 5  # a state without limits
    x, p = ca.MX.sym("x", len(transcribed.start)), ca.MX.sym("p", len(transcribed.parameters))
    y = x[k] - transcribed.start[k] - 20.0
    g = ca.sign(y) * ca.fabs(y) ** (1 / 3)
    functions = {"jac_g": ca.Function("jac_g", [x, p], [g, ca.jacobian(g, x)]), "grad_f": without_cost(x, p)}
    free = {"lower": np.full(len(transcribed.start), -np.inf), "upper": np.full(len(transcribed.start), np.inf)}
    rows = {"row_lower": np.zeros(1), "row_upper": np.zeros(1)}
    alone = replace(transcribed, program=replace(transcribed.program, functions=functions), **free, **rows)
    near = nearest_feasible(alone, transcribed.start)
    assert not near.converged
    assert near.iterations == 10  # where the row is ten times what it was


def without_cost(x: ca.MX, p: ca.MX) -> ca.Function:
    """Return an objective that is zero, and its gradient."""
    return ca.Function("grad_f", [x, p], [ca.MX(0), ca.MX(x.shape[0], 1)])


def test_no_feasible_point_is_nearer(coarse):
    """The optimum on a finer mesh is feasible there too, and further from the coarse motion."""
    found, case = coarse.best.found, coarse.asked
    finer = attempt(case, guess_from(found.motion), uniform(14), np.array([0.16]), "once").solution
    transcribed, layout = finer.transcribed, finer.transcribed.program.layout
    begin = transcribed.start
    near = nearest_feasible(transcribed, begin)
    x, p = near.x, transcribed.parameters
    rows = np.array(transcribed.program.functions["nlp"](x, p)[1]).ravel()
    assert np.all((transcribed.lower <= x) & (x <= transcribed.upper))
    assert np.all((transcribed.row_lower - 1e-8 <= rows) & (rows <= transcribed.row_upper + 1e-8))
    moved = [np.linalg.norm((one - begin)[layout.effort()]) for one in (x, finer.x)]
    assert moved[0] < 0.9 * moved[1]
