"""The yardsticks of `make bench`: they measure what they say, and a part that is not there is named."""

import numpy as np
import pytest

from planner.solve import build_solver, run_solver
from tests.bench import PARTS, between_nodes, main
from tests.bench_shares import Timed
from tests.bench_timing import GOAL, START, first_program
from tests.peer import build_peer, drift
from tests.test_planner_plans import problem_of

# A fourth-order scheme on twice the intervals: its error falls by 16; quadratic torques leave some of that.
_FOURTH_ORDER = 8.0
# A parabola's height between fifty-one samples.
_ON_A_GRID = 2e-3


def test_an_unknown_part_is_named(capsys):
    assert main(["speed"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "unknown part 'speed'" in said.err
    assert all(part in said.err for part in PARTS)


def test_a_quadratics_peak_between_nodes_is_its_vertex():
    # Through (0, 8), (1/2, 9) and (1, 8) goes 8 + 4 t (1 - t); through (0, 8), (1/2, 9) and (1, 4) 8 + 8 t - 12 t^2.
    assert between_nodes(np.array([8.0, 9.0, 8.0])) == pytest.approx(9.0)
    assert between_nodes(np.array([8.0, 9.0, 4.0])) == pytest.approx(28 / 3, abs=_ON_A_GRID)


def test_the_peers_drift_falls_with_the_order_of_its_scheme():
    coarse, fine = (
        drift(peer, peer.solve(GOAL)) for peer in (build_peer(intervals, START, GOAL, 0.16) for intervals in (10, 20))
    )
    assert fine > 0
    assert coarse / fine > _FOURTH_ORDER


def test_the_parts_of_a_solve_make_up_its_whole():
    problem = problem_of("knee-reach", "mesh.intervals=10", "solver.compile=never")
    program = first_program(problem)
    solver = Timed(build_solver(program.program, problem.solver))
    assert run_solver(solver, program).converged
    parts = solver.parts(solver.whole)
    assert parts["evaluation"] > 0
    assert parts["linear algebra"] > 0
    assert sum(parts.values()) == pytest.approx(solver.whole)
