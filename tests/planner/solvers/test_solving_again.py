"""A solve that runs out of iterations is tried again with a barrier that follows the iterates."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.solvers import solve as solvers
from linkplan.planner.solvers.solve import OUT_OF_ITERATIONS, SUCCEEDED, Solution, solve

NOTHING = Solution(
    transcribed=None,
    x=np.zeros(1),
    objective=1.0,
    converged=False,
    status=OUT_OF_ITERATIONS,
    iterations=500,
    build_s=0,
    solve_s=0,
)


@pytest.mark.parametrize("again", [SUCCEEDED, OUT_OF_ITERATIONS])
def test_rounding_does_not_end_a_search_where_another_barrier_finds_the_motion(again, monkeypatch):
    asked = []

    def solved(_, settings, *, adaptive=False, **__):
        asked.append((adaptive, settings.max_iterations))
        found = replace(NOTHING, objective=2.0, converged=again == SUCCEEDED, status=again)
        return found if adaptive else NOTHING

    monkeypatch.setattr(solvers, "_patience", lambda *_: None)
    monkeypatch.setattr(solvers, "_solved", solved)
    solution = solve(None, SolverSettings(max_iterations=200))
    assert [adaptive for adaptive, _ in asked] == [False, True]
    assert asked[1][1] <= asked[0][1]
    assert solution.objective == (2.0 if again == SUCCEEDED else 1.0)


def test_what_is_infeasible_is_not_solved_twice(monkeypatch):
    asked = []

    def solved(*_, **__):
        asked.append(1)
        return replace(NOTHING, status="Infeasible_Problem_Detected")

    monkeypatch.setattr(solvers, "_patience", lambda *_: None)
    monkeypatch.setattr(solvers, "_solved", solved)
    solve(None)
    assert len(asked) == 1
