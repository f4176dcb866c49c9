"""The decision on the next action of a refinement is a function of its state: one test for each row and each constant."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.refinement import actions, decision
from linkplan.planner.refinement.actions import (
    Halve,
    ImposeRanges,
    Loosen,
    RaiseDegree,
    ReadSwitches,
    ReduceEffortOverrun,
    ReleaseArcs,
    Tighten,
)
from linkplan.planner.refinement.decision import next_action
from linkplan.planner.refinement.state import RefinementState, observed
from tests.support.refinement_states import AIMS, iterate, state

ONE_OF_TEN = np.eye(10)[3]


def test_an_exact_motion_that_passes_is_the_end():
    assert next_action(state(iterate())) is None


def test_an_exact_motion_that_needs_more_effort_than_a_proof_allows_is_halved_there():
    action = next_action(state(iterate(effort_overrun=3.0 * ONE_OF_TEN)))
    assert isinstance(action, Halve)
    np.testing.assert_array_equal(action.marked, ONE_OF_TEN.astype(bool))
    assert next_action(state(iterate(effort_overrun=0.9 * ONE_OF_TEN))) is None


def test_where_it_needs_more_effort_everywhere_the_degree_is_raised_and_on_a_large_mesh_the_motion_is_kept():
    assert next_action(state(iterate(effort_overrun=3.0))) == RaiseDegree("radau-5")
    one_of_many = np.eye(150)[3]
    crowded = state(iterate(effort_overrun=3.0 * one_of_many, n=150))
    action = next_action(crowded)
    assert isinstance(action, ReduceEffortOverrun)
    np.testing.assert_array_equal(action.marked, one_of_many.astype(bool))
    assert next_action(replace(crowded, restored=1, ended=True)) is None
    nearly = state(iterate(effort_overrun=0.9 * one_of_many, n=150), restored=1)
    assert isinstance(next_action(nearly), ReduceEffortOverrun)
    assert next_action(replace(crowded, restored=6)) is None


def test_what_no_mesh_mends_is_the_end():
    assert next_action(state(iterate(passed=False, exact=False, repairable=False))) is None


def test_an_action_that_led_nowhere_is_the_end():
    assert next_action(state(iterate(passed=False, exact=False, growth=ONE_OF_TEN), ended=True)) is None


def test_a_motion_whose_higher_degree_is_not_solved_is_halved(monkeypatch):
    coarse = state(iterate(passed=False, exact=False, growth=1.0))
    action = next_action(coarse)
    assert action == RaiseDegree("radau-5")
    coarse.case.with_scheme = lambda _scheme: coarse.case
    monkeypatch.setattr(actions, "_solved_on", lambda *_: None)
    after = action.apply(coarse)
    assert not after.ended
    assert after.rounds == coarse.rounds + 1
    assert isinstance(next_action(after), Halve)
    passing = replace(coarse, iterate=iterate(passed=True, exact=False, growth=1.0))
    assert action.apply(passing).ended  # a motion that passes is kept as it is


def test_an_error_on_one_interval_halves_it():
    action = next_action(state(iterate(passed=False, exact=False, growth=9.0 * ONE_OF_TEN)))
    assert isinstance(action, Halve)
    np.testing.assert_array_equal(action.marked, ONE_OF_TEN.astype(bool))


def test_an_error_spread_evenly_raises_the_degree():
    assert next_action(state(iterate(passed=False, exact=False, growth=1.0))) == RaiseDegree("radau-5")


def test_where_degrees_are_not_raised_an_even_error_halves_every_interval():
    action = next_action(state(iterate(passed=False, exact=False, growth=1.0), scheme="trapezoid"))
    assert action.marked.all()


def test_a_state_that_leaves_its_range_imposes_ranges_once():
    at = iterate(passed=False, exact=False, growth=9.0 * ONE_OF_TEN, leaves_positions=True)
    assert next_action(state(at)) == ImposeRanges()
    assert isinstance(next_action(state(at, position_rows=True)), Halve)
    assert isinstance(next_action(state(at, rows_lost=True)), Halve)


@pytest.mark.parametrize(("overrun", "expected"), [(3e-8, Tighten), (3e-7, Halve)])
def test_a_small_overrun_is_tightened_and_a_large_one_halved(overrun, expected):
    at = iterate(passed=False, overrun=overrun * ONE_OF_TEN)
    assert isinstance(next_action(state(at)), expected)


@pytest.mark.parametrize(("rounds", "tightens"), [(3, False), (7, False), (8, True)])
def test_an_overrun_that_halving_did_not_remove_is_tightened_too(rounds, tightens):
    action = next_action(state(iterate(passed=False, overrun=1e-3 * ONE_OF_TEN), rounds=rounds))
    assert isinstance(action, Halve)
    assert action.tightens == tightens


@pytest.mark.parametrize(("rounds", "tightens"), [(3, False), (4, True)])
def test_an_overrun_beside_an_error_is_tightened_sooner(rounds, tightens):
    at = iterate(passed=False, exact=False, growth=9.0 * ONE_OF_TEN, overrun=3e-8 * ONE_OF_TEN)
    assert next_action(state(at, rounds=rounds)).tightens == tightens


@pytest.mark.parametrize(("rounds", "stops"), [(23, False), (24, True)])
def test_a_refinement_has_at_most_24_rounds(rounds, stops):
    action = next_action(state(iterate(passed=False, exact=False, growth=9.0 * ONE_OF_TEN), rounds=rounds))
    assert (action is None) == stops


@pytest.mark.parametrize(("n", "stops"), [(99, False), (100, True)])
def test_a_motion_that_passes_is_refined_on_at_most_100_intervals(n, stops):
    growth = 9.0 * np.eye(n)[3]
    assert (next_action(state(iterate(exact=False, growth=growth, n=n))) is None) == stops


@pytest.mark.parametrize(("n", "stops"), [(1199, False), (1200, True)])
def test_a_motion_that_does_not_pass_is_refined_to_120_times_the_first_mesh(n, stops):
    growth = 9.0 * np.eye(n)[3]
    assert (next_action(state(iterate(passed=False, exact=False, growth=growth, n=n))) is None) == stops


@pytest.mark.parametrize(("n", "stops"), [(101, False), (199, False), (200, True)])
def test_where_efforts_jump_inside_intervals_so_many_more_are_allowed(n, stops):
    target = replace(AIMS, enclosed=True, objective_tolerance=1e-6)
    growth = 9.0 * np.eye(n)[3]
    assert (next_action(state(iterate(exact=False, growth=growth, n=n), target=target)) is None) == stops


@pytest.mark.parametrize(("scheme", "raised"), [("radau-3", True), ("radau-5", False)])
def test_degrees_above_five_are_not_tried_where_efforts_jump_inside_intervals(scheme, raised):
    target = replace(AIMS, enclosed=True, objective_tolerance=1e-6)
    action = next_action(state(iterate(passed=False, exact=False, growth=1.0), target=target, scheme=scheme))
    assert isinstance(action, RaiseDegree) == raised


def test_the_objective_keeps_still_on_two_meshes_before_it_is_believed():
    target = replace(AIMS, objective_tolerance=1e-7)
    first = state(iterate(objective=1.0), target=target)
    second = observed(first, iterate(objective=1.0 + 1e-9))
    third = observed(second, iterate(objective=1.0 + 2e-9))
    assert [next_action(one) is None for one in (first, second, third)] == [False, False, True]


def test_a_mesh_that_was_not_refined_where_the_objective_depends_on_it_tells_nothing():
    target = replace(AIMS, objective_tolerance=1e-7)
    first = state(iterate(objective=1.0), target=target)
    third = observed(observed(first, iterate(objective=1.0)), iterate(objective=1.0), tells=False)
    assert next_action(third) is not None


def tightened(gain: float, *, n: int = 10, **changes) -> RefinementState:
    """Return a state whose best motion is within tightened limits; loosening them gains a share of the objective."""
    best = iterate(tightened=True, n=n)
    loose = iterate(passed=False, overrun=1e-4 * np.eye(n)[3], objective=1.0 - gain, n=n)
    return replace(state(best), loosened=loose, iterate=loose, tightenings=2, **changes)


def test_a_motion_within_tightened_limits_is_loosened():
    assert next_action(state(iterate(tightened=True))) == Loosen()


def test_limits_that_were_loosened_are_tightened_twice_by_what_is_left():
    loosened = tightened(1e-3)
    assert next_action(replace(loosened, tightenings=1)) == Tighten()
    assert next_action(loosened) == Loosen()


@pytest.mark.parametrize(("gain", "loosens"), [(5e-7, False), (2e-6, True)])
def test_limits_are_loosened_while_tightening_costs_a_millionth(gain, loosens):
    assert (next_action(tightened(gain)) == Loosen()) == loosens


@pytest.mark.parametrize(("n", "loosens"), [(239, True), (240, False)])
def test_limits_are_loosened_on_at_most_240_intervals(n, loosens):
    assert (next_action(tightened(1e-3, n=n)) == Loosen()) == loosens


@pytest.mark.parametrize(("idle", "loosens"), [(1, True), (2, False)])
def test_two_loosenings_that_gain_nothing_are_the_end(idle, loosens):
    assert (next_action(tightened(1e-3, loosenings_without_gain=idle)) == Loosen()) == loosens


@pytest.mark.parametrize(("n", "change", "finer"), [(39, 1e-3, True), (41, 1e-3, False), (41, np.inf, True)])
def test_digits_of_the_objective_that_nobody_asked_for_are_worth_eight_times_the_first_mesh(n, change, finer):
    """Every mesh has twice the intervals of the one before, and a second one is always solved."""
    target = replace(AIMS, tolerance_given=True, objective_tolerance=1e-6, objective_tolerance_given=False)
    asked = replace(target, objective_tolerance_given=True)
    at = iterate(n=n)
    assert (next_action(state(at, target=target, scheme="trapezoid", change=change)) is not None) == finer
    assert next_action(state(at, target=asked, scheme="trapezoid", change=change)) is not None


@pytest.mark.parametrize(("objective", "stops"), [(1.00003, True), (1.0003, False), (0.5, False)])
def test_an_exact_motion_whose_objective_still_moved_gets_another_mesh(objective, stops):
    before = state(iterate(exact=False))
    assert (next_action(observed(before, iterate(objective=objective))) is None) == stops


def test_the_error_of_the_objective_is_its_largest_change_on_the_meshes_on_which_it_settles():
    target = replace(AIMS, objective_tolerance=1e-6)
    now = state(iterate(), target=target)
    assert now.objective_error == np.inf  # a single mesh tells nothing
    for objective, error in ((1.1, 0.1 / 1.1), (1.1 * (1 + 1e-7), 0.1 / 1.1), (1.1, 1e-7)):
        now = observed(now, iterate(objective=objective))
        assert now.objective_error == pytest.approx(error, rel=1e-5)


def test_a_solver_that_stopped_short_says_nothing_of_the_error_of_the_objective():
    target = replace(AIMS, objective_tolerance=1e-6)
    settled = observed(state(iterate(), target=target), iterate(objective=1.0 + 1e-8))
    short = iterate(objective=1.1)
    short.found.solution.status = "Solved_To_Acceptable_Level"
    assert observed(settled, iterate(objective=1.1)).objective_error > 0.09
    assert observed(settled, short).objective_error == settled.objective_error


@pytest.mark.parametrize(("releases", "released"), [(0, True), (2, True), (3, False)])
def test_wrongly_held_arcs_are_released_three_times(releases, released, monkeypatch):
    monkeypatch.setattr(decision, "arcs_against_their_limits", lambda _: [1])
    assert isinstance(next_action(state(iterate(), releases=releases)), ReleaseArcs) == released


@pytest.mark.parametrize(("change", "finer"), [(3e-5, False), (3e-4, True)])
def test_where_efforts_jump_a_change_of_the_objective_by_a_ten_thousandth_is_worth_150_intervals(change, finer):
    at = iterate(exact=False, growth=9.0 * np.eye(150)[3], n=150)
    target = replace(AIMS, enclosed=True, objective_tolerance=1e-6)
    action = next_action(state(at, target=target, change=change))
    assert isinstance(action, Halve) == finer


@pytest.mark.parametrize(
    ("rounds", "readings", "read"), [(0, 0, False), (1, 0, False), (2, 0, True), (3, 0, False), (4, 1, True), (4, 2, False)]
)
def test_switches_of_a_motion_that_overruns_its_limits_are_read_twice_after_halvings(rounds, readings, read):
    at = iterate(passed=False, exact=False, overrun=1e-3 * ONE_OF_TEN)
    action = next_action(state(at, target=replace(AIMS, switches=True), rounds=rounds, readings=readings))
    assert (action == ReadSwitches()) == read


@pytest.mark.parametrize(("readings", "read"), [(0, True), (2, True), (3, False), (4, False)])
def test_switches_of_an_exact_motion_of_bang_arcs_are_read_at_most_three_times(readings, read):
    target = replace(AIMS, switches=True, bang_bang=True)
    assert (next_action(state(iterate(), target=target, readings=readings)) == ReadSwitches()) == read


def test_a_changed_motion_is_halved_where_it_still_needs_half_of_what_a_proof_allows():
    at = iterate(effort_overrun=np.array([0.7, 0.3, *np.zeros(8)]))
    action = next_action(state(at, restored=1))
    assert isinstance(action, ReduceEffortOverrun)
    assert np.flatnonzero(action.marked).tolist() == [0]


@pytest.mark.parametrize(("n", "expected"), [(10, Halve), (250, Tighten)])
def test_where_efforts_jump_limits_are_tightened_once_the_mesh_is_crowded(n, expected):
    at = iterate(passed=False, exact=False, growth=9.0 * np.eye(n)[3], overrun=1e-3 * np.eye(n)[3], n=n)
    assert isinstance(next_action(state(at, target=replace(AIMS, enclosed=True))), expected)


@pytest.mark.parametrize(("read_in", "tightens"), [(0, True), (3, False)])
def test_limits_are_tightened_so_many_rounds_after_the_last_reading_of_switches(read_in, tightens):
    at = iterate(passed=False, exact=False, growth=9.0 * ONE_OF_TEN, overrun=5e-8 * ONE_OF_TEN)
    action = next_action(state(at, rounds=5, read_in=read_in))
    assert isinstance(action, Halve)
    assert action.tightens == tightens
