"""Arcs that are held too long are let go from where their multipliers change sign, and the answer is the better one."""

import numpy as np
import pytest

from linkplan.planner.refinement.constrained_arcs import arcs_against_their_limits, released
from linkplan.planner.refinement.decision import refine
from tests.support.bodies import HINGE_INERTIA, TURN
from tests.support.held_arcs import held, held_case

WRONG = ([4.0, -4.0, 4.0, -4.0], [0.41, 0.46, 0.56])


def test_only_what_is_held_wrongly_is_let_go():
    solution = held(*WRONG).solution
    ends, fixed = released(solution)
    assert np.all(np.diff(ends) > 0)
    assert np.isnan(fixed.efforts).any()
    assert np.all(np.isnan(fixed.efforts) | np.isin(fixed.efforts, (4.0, -4.0)))
    assert (fixed.efforts[0, 0], fixed.efforts[-1, 0]) == (4.0, -4.0)


def test_right_arcs_are_left_as_they_are():
    assert released(held([4.0, -4.0], [0.5]).solution) is None


def test_an_answer_with_wrong_arcs_becomes_the_right_one():
    case, found = held_case(), held(*WRONG)
    least = 2 * np.sqrt(HINGE_INERTIA * TURN / 4.0)
    assert case.certify(found.motion).passed
    assert found.motion.duration_s > 1.005 * least
    right = refine(case, found)
    assert len(right.arcs_with_wrong_sign) == 0
    assert len(arcs_against_their_limits(found.solution)) > 0
    assert right.motion.duration_s == pytest.approx(least, rel=1e-8)
