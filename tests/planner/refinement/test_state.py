"""The state of a refinement: costs, errors, and the best motion so far."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.refinement.case import CertifiedIterate, RefinementTarget
from linkplan.planner.refinement.state import better_of, observed
from tests.support.refinement_states import AIMS, iterate, state


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
