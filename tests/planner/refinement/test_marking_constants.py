"""Which intervals are halved and when the degree is raised: every share and factor of the choice decides a case."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.problem.settings import MeshSettings
from linkplan.planner.refinement.marking import (
    higher_for,
    higher_on_arcs,
    marked_for,
    most_overrun,
    overrunning,
    rough_of,
)

N = 10


def padded(*values: float) -> np.ndarray:
    """Return the values of the first of ten intervals; those of the others are 0."""
    return np.array([*values, *np.zeros(N - len(values))])


def iterate(growth=(), residual=(), overrun=()) -> SimpleNamespace:
    certificate = SimpleNamespace(growth=padded(*growth), residual_share=padded(*residual))
    report = SimpleNamespace(overrun=padded(*overrun))
    return SimpleNamespace(certificate=certificate, report=report, n_intervals=N, found=SimpleNamespace(fixed=None))


def case() -> SimpleNamespace:
    mesh = MeshSettings(scheme="radau-3")
    return SimpleNamespace(problem=SimpleNamespace(mesh=mesh), target=SimpleNamespace(switches=False))


@pytest.mark.parametrize(
    ("growth", "residual", "marked"),
    [
        ((0.04, 0.06, 1.0), (), [1, 2]),  # above half of an even share of the allowed error
        ((50.0, 0.3, 0.2), (), [0, 1]),  # above half a hundredth of the worst interval's
        ((), (2.0, 0.6, 0.4), [0, 1]),  # above half of the allowed residual
        ((0.0, 5.0, 5.0), (10.0, 2e-5, 0.5e-5), [0, 1]),  # an error that a residual elsewhere causes is not marked
        ((0.5, 0.4), (0.9,), []),  # within what is allowed
    ],
)
def test_an_interval_is_halved_for_more_than_its_share_of_an_error_that_is_too_large(growth, residual, marked):
    assert np.flatnonzero(marked_for(iterate(growth, residual), 1.0)).tolist() == marked


def test_a_stricter_accuracy_marks_intervals_that_are_exact_enough_otherwise():
    at = iterate((0.3, 0.3))
    assert not marked_for(at, 1.0).any()
    assert marked_for(at, 4.0).any()


@pytest.mark.parametrize(
    ("overrun", "over"),
    [((2e-7, 0.5e-7), [0]), ((1.0, 0.015, 0.007), [0, 1]), ((), [])],
)
def test_a_small_overrun_is_left_to_tightening(overrun, over):
    assert np.flatnonzero(overrunning(iterate(overrun=overrun))).tolist() == over


def test_loosened_limits_are_refined_where_the_overrun_is_near_the_largest():
    assert np.flatnonzero(most_overrun(iterate(overrun=(1.0, 0.15, 0.07)))).tolist() == [0, 1]


def test_an_interval_is_rough_where_an_effort_bends_by_a_hundredth_of_its_largest_bend():
    bend = padded(1.0, 0.015, 0.007)
    motion = SimpleNamespace(breaks_s=np.arange(N + 1.0), effort=np.array([np.zeros(N), bend])[:, :, None])
    assert np.flatnonzero(rough_of(motion)).tolist() == [0, 1]


@pytest.mark.parametrize(
    ("n_marked", "largest", "scheme"),
    [(6, 1.0, "radau-5"), (4, 1.0, None), (6, 20.0, "radau-5"), (6, 40.0, None)],
)
def test_the_degree_is_raised_where_half_of_the_intervals_err_evenly(n_marked, largest, scheme):
    growth = np.where(np.arange(N) < n_marked, 1.0, 0.0)
    growth[0] = largest
    assert higher_for(case(), SimpleNamespace(growth=growth), growth > 0) == scheme


@pytest.mark.parametrize(
    ("overrun", "scheme"),
    [((1.0, 1.0, 1.0), "radau-5"), ((1.0, 1.0), None), ((20.0, 1.0, 1.0), "radau-5"), ((40.0, 1.0, 1.0), None)],
)
def test_the_degree_is_raised_where_three_intervals_or_more_overrun_a_limit_evenly(overrun, scheme):
    at = iterate(overrun=overrun)
    assert higher_on_arcs(case(), at, at.report.overrun > 0) == scheme


def test_each_effort_bends_as_a_share_of_its_own_size():
    """The second of two efforts is a thousandth of the first, and bends on the second interval alone."""
    effort = np.array([[[100.0, 0.0], [100.0, 0.0]], [[101.0, 0.0], [101.0, 0.05]], [[102.0, 0.0], [102.0, 0.1]]])
    effort[2, 0, 0] = 100.0  # the first one bends a little on the first interval
    effort[1, 1, 1] = -0.1
    motion = SimpleNamespace(breaks_s=np.arange(3.0), effort=effort)
    assert rough_of(motion).tolist() == [False, True]
