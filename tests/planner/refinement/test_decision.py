"""The decision on the next action of a refinement is a function of its state: a test of each row and each budget."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.refinement import decision
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
from linkplan.planner.refinement.case import CertifiedIterate, RefinementTarget
from linkplan.planner.refinement.decision import (
    CHANGE_WORTH_INTERVALS,
    COST_OF_TIGHTENING,
    ENOUGH_INTERVALS,
    ENOUGH_ROUGH_INTERVALS,
    HALVINGS_BEFORE_TIGHTENING,
    MAX_GROWTH,
    MAX_IDLE_LOOSENINGS,
    MAX_LOOSENED_INTERVALS,
    MAX_READINGS,
    MAX_RELEASES,
    MAX_RESTORATIONS,
    MAX_ROUNDS,
    next_action,
)
from linkplan.planner.refinement.marking import TIGHTENED_OVERRUN
from linkplan.planner.refinement.state import REPORTED_CHANGE, RefinementState, better_of, observed
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


def test_what_no_mesh_mends_and_an_action_that_led_nowhere_are_the_end():
    assert next_action(state(iterate(passed=False, exact=False, repairable=False))) is None
    assert next_action(state(iterate(passed=False, exact=False, growth=ONE_OF_TEN), ended=True)) is None


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


@pytest.mark.parametrize(("overrun", "expected"), [(0.3 * TIGHTENED_OVERRUN, Tighten), (3 * TIGHTENED_OVERRUN, Halve)])
def test_a_small_overrun_is_tightened_and_a_large_one_halved(overrun, expected):
    at = iterate(passed=False, overrun=overrun * ONE_OF_TEN)
    assert isinstance(next_action(state(at)), expected)


@pytest.mark.parametrize("beside", [False, True])
def test_an_overrun_that_halvings_did_not_remove_is_tightened_too_and_sooner_beside_an_error(beside):
    """After the last reading of switches, on one mesh more than where it is still halved alone."""
    first = HALVINGS_BEFORE_TIGHTENING * (1 if beside else 2)
    growth, overrun = (9.0, 0.3 * TIGHTENED_OVERRUN) if beside else (0.0, 1e-3)
    at = iterate(passed=False, exact=not beside, growth=growth * ONE_OF_TEN, overrun=overrun * ONE_OF_TEN)
    for rounds, read_in in ((first - 1, 0), (first, 0), (first + 1, 2)):
        action = next_action(state(at, rounds=rounds, read_in=read_in))
        assert isinstance(action, Halve)
        assert action.tightens == (rounds - read_in >= first)


# What ends the refinement, or is not done once more: a state before it and one at it.
INEXACT = {"exact": False, "passed": False}
ROUGH = replace(AIMS, enclosed=True, objective_tolerance=1e-6)
BUDGETS = {
    "rounds": (MAX_ROUNDS, lambda n: state(erring(10, **INEXACT), rounds=n)),
    "intervals of a motion that passes": (ENOUGH_INTERVALS, lambda n: state(erring(n, exact=False))),
    "growth of a mesh that does not pass": (10 * MAX_GROWTH, lambda n: state(erring(n, **INEXACT))),
    "intervals where efforts jump within": (ENOUGH_ROUGH_INTERVALS, lambda n: state(erring(n, exact=False), target=ROUGH)),
    "restorations": (MAX_RESTORATIONS, lambda n: state(iterate(effort_overrun=3.0 * ONE_OF_TEN), restored=n)),
}


def erring(n: int, **kind) -> CertifiedIterate:
    """Return an iterate on n intervals that errs on one of them."""
    return iterate(growth=9.0 * np.eye(n)[3], n=n, **kind)


@pytest.mark.parametrize("name", BUDGETS)
def test_a_refinement_ends_where_a_budget_is_used_up(name):
    most, at = BUDGETS[name]
    assert [next_action(at(n)) is None for n in (most - 1, most)] == [False, True]


@pytest.mark.parametrize(("scheme", "raised"), [("radau-3", True), ("radau-5", False)])
def test_degrees_above_five_are_not_tried_where_efforts_jump_inside_intervals(scheme, raised):
    action = next_action(state(iterate(passed=False, exact=False, growth=1.0), target=ROUGH, scheme=scheme))
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


@pytest.mark.parametrize(
    ("gain", "changes", "loosens"),
    [
        (2 * COST_OF_TIGHTENING, {}, True),
        (0.5 * COST_OF_TIGHTENING, {}, False),
        (1e-3, {"n": MAX_LOOSENED_INTERVALS - 1}, True),
        (1e-3, {"n": MAX_LOOSENED_INTERVALS}, False),
        (1e-3, {"loosenings_without_gain": MAX_IDLE_LOOSENINGS - 1}, True),
        (1e-3, {"loosenings_without_gain": MAX_IDLE_LOOSENINGS}, False),
    ],
)
def test_limits_are_loosened_while_that_gains_something_on_a_mesh_that_is_not_large(gain, changes, loosens):
    assert (next_action(tightened(gain, **changes)) == Loosen()) == loosens


@pytest.mark.parametrize(("moved", "stops"), [(0.3, True), (3.0, False)])
def test_an_exact_motion_whose_objective_still_moved_gets_another_mesh(moved, stops):
    before = state(iterate(exact=False))
    assert (next_action(observed(before, iterate(objective=1 + moved * REPORTED_CHANGE))) is None) == stops
    assert next_action(observed(before, iterate(objective=0.5))) is not None


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
    short = iterate(objective=1.1, status="Solved_To_Acceptable_Level")
    assert observed(settled, iterate(objective=1.1)).objective_error > 0.09
    assert observed(settled, short).objective_error == settled.objective_error


@pytest.mark.parametrize("releases", [0, MAX_RELEASES - 1, MAX_RELEASES])
def test_wrongly_held_arcs_are_released_a_few_times(releases, monkeypatch):
    monkeypatch.setattr(decision, "arcs_against_their_limits", lambda _: [1])
    assert isinstance(next_action(state(iterate(), releases=releases)), ReleaseArcs) == (releases < MAX_RELEASES)


@pytest.mark.parametrize(("share", "finer"), [(0.3, False), (3.0, True)])
def test_where_efforts_jump_a_large_change_of_the_objective_is_worth_more_intervals(share, finer):
    at = erring((ENOUGH_INTERVALS + ENOUGH_ROUGH_INTERVALS) // 2, exact=False)
    action = next_action(state(at, target=ROUGH, change=share * CHANGE_WORTH_INTERVALS))
    assert isinstance(action, Halve) == finer


@pytest.mark.parametrize(
    ("rounds", "readings", "read"), [(0, 0, False), (1, 0, False), (2, 0, True), (3, 0, False), (4, 1, True), (4, 2, False)]
)
def test_switches_of_a_motion_that_overruns_its_limits_are_read_twice_after_halvings(rounds, readings, read):
    at = iterate(passed=False, exact=False, overrun=1e-3 * ONE_OF_TEN)
    action = next_action(state(at, target=replace(AIMS, switches=True), rounds=rounds, readings=readings))
    assert (action == ReadSwitches()) == read


@pytest.mark.parametrize("readings", [0, MAX_READINGS - 1, MAX_READINGS])
def test_switches_of_an_exact_motion_of_bang_arcs_are_read_a_few_times(readings):
    target = replace(AIMS, switches=True, bang_bang=True)
    assert (next_action(state(iterate(), target=target, readings=readings)) == ReadSwitches()) == (readings < MAX_READINGS)


def test_a_changed_motion_is_halved_where_it_still_needs_half_of_what_a_proof_allows():
    at = iterate(effort_overrun=np.array([0.7, 0.3, *np.zeros(8)]))
    action = next_action(state(at, restored=1))
    assert isinstance(action, ReduceEffortOverrun)
    assert np.flatnonzero(action.marked).tolist() == [0]


@pytest.mark.parametrize(("n", "expected"), [(10, Halve), (250, Tighten)])
def test_where_efforts_jump_limits_are_tightened_once_the_mesh_is_crowded(n, expected):
    at = iterate(passed=False, exact=False, growth=9.0 * np.eye(n)[3], overrun=1e-3 * np.eye(n)[3], n=n)
    assert isinstance(next_action(state(at, target=replace(AIMS, enclosed=True))), expected)


def moved(best: float, loose: float | None, change: float = np.inf) -> float:
    """Return what the objective moved by, with tightened limits (`best`) and with loosened ones (`loosened`)."""
    loosened = None if loose is None else iterate(objective=loose)
    return state(iterate(), best=iterate(objective=best), loosened=loosened, change=change).moved


@pytest.mark.parametrize(("best", "share"), [(2.0, 0.5), (-2.0, 0.0), (0.8, 0.0)])
def test_tightened_limits_cost_what_loosened_ones_save(best, share):
    assert moved(best, 1.0) == pytest.approx(share)


def test_of_negative_objectives_the_cost_is_a_share_of_their_size():
    assert moved(-1.0, -1.5) == pytest.approx(0.5)


def test_without_loosened_limits_the_objective_moves_by_its_last_change():
    assert moved(1.0, None, change=0.25) == 0.25
    assert moved(1.0, None) == 0.0


@pytest.mark.parametrize(
    ("rounds", "error", "falls"), [(3, 0.4e-3, True), (3, 0.6e-3, False), (3, 2e-3, False), (1, 2e-3, True)]
)
def test_an_error_falls_if_a_finer_mesh_leaves_at_most_half_of_it(rounds, error, falls):
    """The first mesh, whose error is 1e-3, is too coarse to compare with."""
    before, at = state(iterate(), rounds=rounds), iterate()
    at = replace(at, report=replace(at.report, integration_error_deg=error))
    assert observed(before, at).error_falls == falls


@pytest.mark.parametrize(("lost", "scheme"), [(False, "radau-5"), (True, None)])
def test_a_motion_whose_error_halving_no_longer_halves_gets_a_higher_degree_before_the_search_ends(lost, scheme):
    at = iterate(passed=False, exact=False, growth=np.geomspace(1e-8, 9.0, 120), n=120)
    action = next_action(state(at, rounds=3, error_falls=False, degree_lost=lost))
    assert action == (None if scheme is None else RaiseDegree(scheme))


@pytest.mark.parametrize(("objective", "better"), [(0.9, True), (1.1, False)])
def test_of_motions_within_the_limits_as_asked_the_best_is_kept(objective, better):
    before = state(iterate(), loosenings_without_gain=1)
    before, at = replace(before, loosened=before.iterate), iterate(objective=objective)
    after = observed(before, at)
    assert (after.best is at) == better
    assert after.loosenings_without_gain == (0 if better else 1)


# What two meshes may differ by though neither is wrong: a tenth of what counts as lost.
MESH = 1e-6
INTERVALS = 40


def passing(objective: float, *, exact: bool = True, errs: float = 1e-4) -> CertifiedIterate:
    at = iterate(objective=objective, exact=exact, n=INTERVALS)
    return replace(at, report=replace(at.report, integration_error_deg=errs))


def target(*, tolerance_given: bool = False) -> RefinementTarget:
    return replace(AIMS, tolerance_given=tolerance_given)


@pytest.mark.parametrize(
    ("coarse", "finer", "is_kept"),
    [(1.0956, 1.1156, True), (-1.2, -1.18, True), *((1.0, finer, False) for finer in (1.0 - MESH, 1.0 + MESH, 0.9))],
)
def test_a_finer_mesh_is_the_answer_unless_it_lost_the_better_motion(coarse, finer, is_kept):
    before, now = passing(coarse), passing(finer)
    assert better_of(before, now, target()) is (before if is_kept else now)


@pytest.mark.parametrize(("gained", "kept"), [(3e-5, False), (3e-4, True)])
def test_of_an_inexact_motion_more_is_asked(gained, kept):
    before, now = passing(1.0 - gained, exact=False), passing(1.0)
    assert better_of(before, now, target()) is (before if kept else now)
    same = passing(1.0 - gained)
    assert better_of(same, now, target()) is same


@pytest.mark.parametrize(("errs", "kept"), [(1e-5, False), (1e-3, True)])
def test_of_two_inexact_motions_more_is_asked_of_the_one_that_errs_by_more(errs, kept):
    before, now = passing(1.0 - 3e-5, exact=False), passing(1.0, exact=False, errs=errs)
    assert better_of(before, now, target()) is (before if kept else now)


def test_a_better_motion_that_misses_the_tolerance_asked_for_is_no_answer():
    before, now = passing(1.0, exact=False), passing(1.1)
    assert better_of(before, now, target(tolerance_given=True)) is now
    assert better_of(before, now, target()) is before


def test_the_first_that_passes_is_the_best_so_far():
    now = passing(1.0)
    assert better_of(None, now, target()) is now
