"""Of the motions that pass on ever finer meshes the best is returned, not merely the last."""

from dataclasses import replace

import pytest

from linkplan.planner.refinement.case import CertifiedIterate, RefinementTarget
from linkplan.planner.refinement.state import better_of
from tests.support.refinement_states import AIMS, iterate

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
