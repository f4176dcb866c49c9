"""The yardsticks of `make bench`: they measure what they say, and a part that is not there is named."""

import csv

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.planner.problem.problem import load_problem
from tests.bench import c_code, packages
from tests.bench import sizes as bench_sizes
from tests.bench.__main__ import PARTS, between_nodes, main
from tests.bench.opti_peer import acceleration_function, build_peer, drift
from tests.bench.record import changed
from tests.bench.rounding import unlike
from tests.bench.timing import GOAL, START
from tests.support.compiled import needs_gcc
from tests.support.planar import random_planar
from tests.support.tolerances_planner import TYPED_BY_HAND

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


ENDS = np.radians([-49.07, 56.27])
# The least effort, in which Opti and linkplan agree, the least time (tests/data/knee.json), and how far forty intervals may
# be from them.
LEAST = {0.16: 382.59, None: 0.12185126841421788}
APART = 1e-3
# One answer by two ways at IPOPT's tolerance.
SOLVED = 1e-8


def test_the_closed_form_typed_by_hand_is_the_reduced_model():
    mechanism, by_hand = load_mechanism("optimus-knee", payload="shank"), acceleration_function()
    for s in np.linspace(-1.2, 1.2, 9):
        pose = close_at(mechanism, np.array([s]))
        assert float(by_hand(s, 3.0, 50.0)) == pytest.approx(
            float(mechanism.dynamics.acceleration(pose, 3.0, 50.0)), rel=TYPED_BY_HAND
        )


def test_its_least_time_rests_on_torque_beyond_the_limit_between_nodes():
    peer = build_peer(40, *ENDS, None)
    solution = peer.solve(ENDS[1])
    torque = np.array(solution.value(peer.effort)).reshape(-1)
    assert np.abs(torque).max() <= 100.0 + 1e-5
    assert between_nodes(torque) > 101.0


def test_it_is_solved_again_from_its_multipliers_for_the_answer_of_a_fresh_one():
    peer, goal = build_peer(10, *ENDS, 0.16), np.radians(55.0)
    first = peer.solve(ENDS[1])
    again, fresh = peer.again(), build_peer(10, ENDS[0], goal, 0.16)
    asked = float(fresh.solve(goal).value(fresh.opti.f))
    assert abs(asked / float(first.value(peer.opti.f)) - 1) > APART
    assert again(goal) == pytest.approx(asked, rel=SOLVED)
    assert again(ENDS[1]) == pytest.approx(float(first.value(peer.opti.f)), rel=SOLVED)


@pytest.mark.slow
@pytest.mark.parametrize("duration", LEAST)
@pytest.mark.parametrize(("package", "solve"), [("rockit", packages.by_rockit), ("yapss", packages.by_yapss)])
def test_packages_solve_the_same_problem_and_again_for_another_goal(package, solve, duration):
    pytest.importorskip(package)
    answer = solve(duration)
    again = answer.again()
    assert answer.objective == pytest.approx(LEAST[duration], rel=APART)
    assert again(np.radians(55.0)) < (1 - APART) * answer.objective
    assert again(ENDS[1]) == pytest.approx(answer.objective, rel=SOLVED)


def test_every_decimal_number_is_changed_by_its_share_and_equal_ones_remain_equal():
    model = '<mujoco><option timestep="0.002"/><geom contype="1" size="0.1 -2.5e-3"/></mujoco>'
    tables = {"mechanism": {"model": model}, "motion": {"start_deg": {"q": 30.5}, "goal_deg": {"q": 30.5}, "kind": "reach"}}
    after = changed(tables, 1e-12)
    assert after["motion"]["start_deg"] == after["motion"]["goal_deg"]
    assert 0 < abs(after["motion"]["start_deg"]["q"] / 30.5 - 1) < 1.1e-12
    assert after["motion"]["kind"] == "reach"
    assert 'contype="1"' in after["mechanism"]["model"]
    for number in ("0.002", "0.1 ", "-2.5e-3"):
        assert number in model
        assert f'"{number}"' not in after["mechanism"]["model"]
    assert changed(tables, 0.0) == tables


def test_an_answer_is_unlike_another_by_its_status_or_by_more_than_a_millionth():
    before = {("fourbar", "1"): {"status": "optimal", "objective": 1.0}}
    assert not unlike(before, {("fourbar", "1"): {"status": "optimal", "objective": 1.0 + 5e-7}})
    assert len(unlike(before, {("fourbar", "1"): {"status": "optimal", "objective": 1.0 + 5e-6}})) == 1
    assert len(unlike(before, {("fourbar", "1"): {"status": "failed", "objective": None}})) == 2
