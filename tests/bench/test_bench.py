"""The yardsticks of `make bench`: they measure what they say, and a part that is not there is named."""

import csv

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import load_problem
from tests.bench import c_code
from tests.bench import sizes as bench_sizes
from tests.bench.__main__ import PARTS, between_nodes, main
from tests.bench.opti_peer import build_peer, drift
from tests.bench.timing import GOAL, START
from tests.support.compiled import needs_gcc
from tests.support.planar import random_planar

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


@needs_gcc
def test_exported_c_is_measured_where_it_computes_what_casadi_computes(monkeypatch):
    monkeypatch.setattr(c_code, "STATES", 50)
    each, off = c_code.measured(load_mechanism("slider-crank"))
    assert off < 1e-12
    assert set(each) == {"C", "close", "CasADi", "CasADi in C", "mj_inverse"}
    assert each["mj_inverse"] > each["C"]
