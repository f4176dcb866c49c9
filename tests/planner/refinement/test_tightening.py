"""Tightened limits, and the nearest feasible point on a finer mesh."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.deadline import Deadline
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess, guess_from
from linkplan.planner.limits.joints import RANGE_SLACK, RangeLimit, SpeedLimit
from linkplan.planner.limits.kinds import tightened_in
from linkplan.planner.limits.limit import LimitFacts, Margin, Tightened
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.refinement.actions import ReduceEffortOverrun
from linkplan.planner.refinement.case import attempt, certify_iterate
from linkplan.planner.refinement.decision import next_action
from linkplan.planner.refinement.marking import (
    Tightening,
    evened,
    tightened_share,
    tightening_over,
    tightenings_of,
)
from linkplan.planner.refinement.state import RefinementState
from linkplan.planner.solvers.newton import FEASIBLE, nearest_feasible
from linkplan.planner.transcription.mesh import uniform
from tests.support.limited_row import LimitedRow


def speed_margin(joint: int, overrun: list[float]) -> Margin:
    """Return a joint's margin to a speed limit of 1 that it overruns on intervals."""
    most = max(overrun)
    given = {"name": "J", "unit": "rad/s", "time_s": 0.0, "upper": True, "size": 1.0, "limit": 1.0}
    return Margin(of=SpeedLimit(joint), value=1.0 + most, left=-most, overrun=np.array(overrun), **given)


def test_a_range_is_tightened_in_the_problem_and_not_on_intervals():
    given = {"name": "J", "unit": "rad", "time_s": 0.0, "upper": True, "size": 1.0, "limit": 1.0}
    over = Margin(of=RangeLimit(0, None), value=1.1, left=-0.1, overrun=np.full(3, 0.1), **given)
    assert not over.kept
    assert tightenings_of((over,), np.arange(4.0)) == ()


@pytest.mark.parametrize(("over", "moves"), [(2e-9, 2e-8), (1e-12, 1.1e-12), (1e-3, 1.1e-3)])
def test_a_range_moves_by_more_than_the_closure_error_of_a_correction(over, moves):
    """Corrections hold loops closed within 1e-8: a range that moved by 2e-9 was exceeded by as much each time."""
    problem = load_problem("knee-reach")
    joint, unit = int(problem.mechanism.dependent[0]), float(np.degrees(1.0))
    given = {"name": "J", "unit": "deg", "time_s": 0.0, "upper": True, "size": 1.0, "slack": unit * RANGE_SLACK}
    beyond = {"limit": 1.0, "value": 1.0 + unit * over, "left": -unit * over, "overrun": np.full(3, over)}
    margin = Margin(of=RangeLimit(joint, None), **given, **beyond)
    change = tightened_in(problem, margin, 1.1, 2e-8).limits.position[joint] - problem.limits.position[joint]
    assert change == pytest.approx([moves, -moves], rel=1e-3, abs=1e-15)


def test_an_infinite_overrun_is_not_removed_by_a_tightening():
    """A jump of acceleration is of an infinite jerk; bounds tightened by it would be no numbers."""
    assert tightenings_of((speed_margin(0, [0.0, np.inf]),), np.arange(3.0)) == ()


@pytest.mark.parametrize("begin_s", [0.0, 2.0])
def test_a_speed_limit_is_tightened_on_the_intervals_where_it_is_overrun_at_shares_of_the_duration(begin_s):
    margins = (speed_margin(0, [0.0, 0.0]), speed_margin(1, [0.0, 1e-3]))
    (found,) = tightenings_of(margins, begin_s + np.array([0.0, 1.0, 4.0]))
    assert (found.what, found.item) == ("speed", 1)
    np.testing.assert_allclose(found.breaks, [0.0, 0.25, 1.0])
    assert found.share[0] == 0.0
    assert 1e-3 < found.share[1] < 1.5e-3


def test_a_tightening_exceeds_the_overrun_that_it_removes():
    overrun = np.geomspace(1e-9, 0.1, 9)
    assert np.all(tightened_share(overrun) > 1.05 * overrun)
    assert tightened_share(np.zeros(1)) == 0.0


@pytest.mark.parametrize(("overrun", "is_even"), [(1e-6, True), (1e-4, False)])
def test_a_little_tightening_is_the_same_on_all_intervals(overrun, is_even):
    (found,) = evened(tightenings_of((speed_margin(0, [0.0, overrun, 0.0]),), np.arange(4.0)))
    assert found.share.max() == pytest.approx(tightened_share(np.array([overrun]))[0])
    assert bool(np.ptp(found.share) == 0) is is_even


def test_a_tightening_is_a_ten_millionth_of_the_limit_at_the_least():
    assert 1e-7 <= tightened_share(np.array([1e-12]))[0] < 5e-7


ROWS = [LimitedRow(LimitFacts(kind="power"), 0), LimitedRow(LimitFacts(kind="tube", tightened=Tightened.IN_UNITS), 1)]


def tightened(share: list[float], limit: list[float], breaks_s: np.ndarray, *, upper: bool = True, item: int = 0):
    """Return by how much two path limits are tightened on the intervals of a mesh; the shares are of [0, 0.25, 1]."""
    one = Tightening(
        what=ROWS[item].facts.kind,
        item=ROWS[item].item,
        breaks=np.array([0.0, 0.25, 1.0]),
        share=np.array(share),
        upper=upper,
    )
    return tightening_over((one,), ROWS, np.array([limit, limit]))(breaks_s)


@pytest.mark.parametrize("begin_s", [0.0, 3.0])
def test_each_interval_of_another_mesh_is_tightened_as_the_one_around_its_middle(begin_s):
    breaks = begin_s + np.array([0.0, 0.4, 0.8, 2.0, 4.0])
    found = tightened([0.1, 0.02], [-3.0, 4.0], breaks)
    assert found[:, 0] == pytest.approx([0.4, 0.4, 0.08, 0.08])
    assert not found[:, 1].any()
    assert tightened([0.1, 0.02], [-3.0, 4.0], breaks, upper=False)[:, 0] == pytest.approx([0.3, 0.3, 0.06, 0.06])


def test_a_limit_in_units_is_tightened_by_the_share_itself():
    assert tightened([0.1, 0.02], [-3.0, 4.0], np.array([0.0, 0.1, 1.0]), item=1)[:, 1] == pytest.approx([0.1, 0.02])


@pytest.mark.parametrize(("limit", "most"), [([1.0, 4.0], 1.35), ([-4.0, -1.0], 1.35), ([-np.inf, 4.0], 40.0)])
def test_two_bounds_keep_a_tenth_of_their_distance(limit, most):
    found = tightened([10.0, 0.0], limit, np.array([0.0, 0.1, 1.0]))
    assert found[:, 0] == pytest.approx([min(10.0 * abs(limit[1]), most), 0.0])


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


def test_no_program_is_solved_after_the_deadline(coarse):
    solution = coarse.best.found.solution
    found = nearest_feasible(solution.transcribed, solution.x + 1e-5, Deadline().within(-1.0))
    assert (found.converged, found.iterations) == (False, 0)


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
    without_cost = ca.Function("grad_f", [x, p], [ca.MX(0), ca.MX(x.shape[0], 1)])
    functions = {"jac_g": ca.Function("jac_g", [x, p], [g, ca.jacobian(g, x)]), "grad_f": without_cost}
    free = {"lower": np.full(len(transcribed.start), -np.inf), "upper": np.full(len(transcribed.start), np.inf)}
    rows = {"row_lower": np.zeros(1), "row_upper": np.zeros(1)}
    alone = replace(transcribed, program=replace(transcribed.program, functions=functions), **free, **rows)
    near = nearest_feasible(alone, transcribed.start)
    assert not near.converged
    assert near.iterations == 10  # where the row is ten times what it was


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
    # Equations hold within 1e-8, limits within 1e-10.
    slack = np.where(transcribed.row_lower == transcribed.row_upper, 1e-8, 1.01e-10)
    assert np.all((transcribed.row_lower - slack <= rows) & (rows <= transcribed.row_upper + slack))
    moved = [np.linalg.norm((one - begin)[layout.effort()]) for one in (x, finer.x)]
    assert moved[0] < 0.9 * moved[1]


def test_a_violation_in_one_interval_is_corrected_near_it_or_everywhere_where_that_is_not_enough():
    problem = load_problem("knee-reach")
    case = case_of(problem)
    solution = attempt(case, first_guess(problem, problem.start_pose()), uniform(40), np.array([0.16]), "once").solution
    transcribed, effort = solution.transcribed, solution.transcribed.program.layout.effort()
    moved = solution.x.copy()
    moved[effort[20]] += 1e-3
    found = nearest_feasible(transcribed, moved)
    assert found.converged
    assert found.iterations
    np.testing.assert_array_equal(found.x[effort[:15]], solution.x[effort[:15]])
    assert np.any(found.x[effort[18:23]] != moved[effort[18:23]])
    lower, upper = transcribed.lower.copy(), transcribed.upper.copy()
    lower[effort[10:31]] = upper[effort[10:31]] = moved[effort[10:31]]
    found = nearest_feasible(replace(transcribed, lower=lower, upper=upper), moved)
    assert found.converged
    assert np.any(found.x[effort[:10]] != moved[effort[:10]])
