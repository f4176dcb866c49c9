"""The yardsticks of `make bench`: they measure what they say, and a part that is not there is named."""

import csv

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.solvers import solve as solving
from linkplan.planner.solvers.solve import build_solver, run_solver
from tests.bench import c_code
from tests.bench import sizes as bench_sizes
from tests.bench.__main__ import PARTS, between_nodes, main
from tests.bench.opti_peer import build_peer, drift
from tests.bench.shares import Timed, timed_solves
from tests.bench.timing import GOAL, START, first_program, medians_s
from tests.support.compiled import needs_gcc
from tests.support.planar import random_planar
from tests.support.plans import problem_of
from tests.support.tolerances_planner import ROUNDING

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


def test_a_solve_s_time_is_told_apart_by_who_spent_it(monkeypatch):
    """On a clock of our own: five seconds in the solver, one and a half of them in the program's functions."""
    now = 100.0

    class Solver:
        def __call__(self, **_: object) -> str:
            nonlocal now
            now += 5.0
            return "answer"

        def stats(self) -> dict[str, float]:
            return {"t_proc_nlp_f": 1.0, "t_proc_nlp_jac_g": 0.5, "t_wall_nlp_f": 7.0, "t_proc_total": 5.0, "iter_count": 9}

    monkeypatch.setattr("tests.bench.shares.time.process_time", lambda: now)
    solver = Timed(Solver())
    assert solver(x0=0.0) == "answer"
    assert solver.parts(6.0) == {"evaluation": 1.5, "linear algebra": 3.5, "call": 1.0}


def test_a_solver_says_what_its_program_s_functions_took():
    problem = problem_of("knee-reach", "mesh.intervals=10", "solver.compile=never")
    program = first_program(problem)
    solver = Timed(build_solver(program.program, problem.solver))
    assert run_solver(solver, program).converged
    assert all(part > 0 for name, part in solver.parts(solver.whole).items() if name != "call")


def test_every_solve_of_a_plan_is_timed_and_solvers_are_themselves_again():
    before = solving.build_solver
    with timed_solves() as solves:
        plan = plan_motion(problem_of("knee-reach", "mesh.intervals=10", "solver.compile=never"))
    assert len(solves) == len(plan.history) > 0
    assert all(spent > 0 for spent in solves)
    assert solving.build_solver is before


def test_works_are_timed_in_turn_and_the_first_round_does_not_count(monkeypatch):
    """On a clock of our own: what takes ten seconds the first time, then one, two, and six."""
    now, done = 0.0, []
    left = {"a": [10.0, 1.0, 6.0, 2.0], "b": [20.0, 5.0, 5.0, 5.0]}

    def work(name: str) -> None:
        nonlocal now
        done.append(name)
        now += left[name].pop(0)

    monkeypatch.setattr("tests.bench.timing.time.process_time", lambda: now)
    assert medians_s({name: lambda name=name: work(name) for name in left}, 3) == {"a": 2.0, "b": 5.0}
    assert done == ["a", "b"] * 4


@pytest.mark.slow
def test_sizes_counts_bodies_loops_and_freedoms_and_writes_every_solve(tmp_path, monkeypatch):
    wanted = ("knee-linear-reach", "cart-pole-swing-up")
    monkeypatch.setattr(bench_sizes, "problems", lambda: map(load_problem, wanted))
    text = bench_sizes.bench_sizes(tmp_path, (4, 8))
    rows = list(csv.DictReader((tmp_path / "sizes.csv").open(encoding="utf-8")))
    counted = {(row["problem"], row["bodies"], row["loops"], row["dof"]) for row in rows}
    # Crank, coupler, rocker, barrel and rod; two loops on one pin. A cart and its pole.
    assert counted == {("knee-linear-reach", "5", "2", "1"), ("cart-pole-swing-up", "2", "0", "2")}
    assert [row["intervals"] for row in rows] == ["4", "8"] * 2
    assert all(float(row["build [s]"]) > 0 and float(row["solve [s]"]) > 0 for row in rows)
    assert "exponent" in text


def test_a_fork_of_two_connects_is_one_loop():
    forked = next(seed for seed in range(100) if "fork" in random_planar(seed).closures)
    planar = random_planar(forked)
    assert bench_sizes.n_loops(load_mechanism(planar.text)) == planar.n_loops


def test_the_exponent_of_a_power_law_is_its_own():
    sizes = [
        bench_sizes.Size(intervals=n, build_s=3e-3 * n**1.25, solve_s=2.0, iterations=1, converged=True)
        for n in (10, 20, 80)
    ]
    assert bench_sizes.exponent(sizes, "build_s") == pytest.approx(1.25)
    assert bench_sizes.exponent(sizes, "solve_s") == pytest.approx(0.0, abs=ROUNDING)


@needs_gcc
def test_exported_c_is_measured_where_it_computes_what_casadi_computes(monkeypatch):
    monkeypatch.setattr(c_code, "STATES", 50)
    each, off = c_code.measured(load_mechanism("slider-crank"))
    assert off < 1e-12
    assert set(each) == {"C", "close", "CasADi", "CasADi in C", "mj_inverse"}
    assert each["mj_inverse"] > each["C"]
