"""Which intervals a finer mesh halves: those that an error begins on, and not those that carry it on."""

from types import SimpleNamespace

import numpy as np

from linkplan.planner.refinement.marking import marked_for

# Six intervals: dynamics are not kept on the third, and the integrated state strays from there on.
GROWTH = np.array([0.0, 0.0, 5.0, 20.0, 20.0, 20.0])


def certify_iterate(residual_share, growth=GROWTH):
    certificate = SimpleNamespace(residual_share=np.array(residual_share), growth=growth)
    return SimpleNamespace(certificate=certificate, n_intervals=len(growth))


def test_where_dynamics_are_not_kept_what_merely_carries_the_error_is_not_halved():
    marked = marked_for(certify_iterate([1e-13, 1e-13, 17.0, 1e-13, 1e-13, 1e-13]), 1.0)
    assert marked.tolist() == [False, False, True, False, False, False]


def test_intervals_that_err_themselves_beside_one_that_keeps_no_dynamics_are_halved_too():
    marked = marked_for(certify_iterate([1e-13, 1e-13, 17.0, 0.1, 1e-13, 0.1]), 1.0)
    assert marked.tolist() == [False, False, True, True, False, True]


def test_where_dynamics_are_kept_every_growing_error_counts():
    marked = marked_for(certify_iterate([1e-13, 1e-13, 0.5, 1e-13, 1e-13, 1e-13]), 1.0)
    assert marked.tolist() == [False, False, True, True, True, True]


def test_where_a_growing_error_has_no_number_every_interval_is_halved():
    assert marked_for(certify_iterate(np.zeros(6), np.full(6, 1e306)), 1e4).all()
