"""Arcs that are held too long: multipliers of the wrong sign show them, and refinement reads the arcs anew."""

import numpy as np
import pytest

from linkplan.planner.refinement.pontryagin import arcs_against_their_limits
from linkplan.planner.refinement.refine import refine
from tests.support.bodies import HINGE_INERTIA, TURN
from tests.support.held_arcs import held, held_case

WRONG = ([4.0, -4.0, 4.0, -4.0], [0.41, 0.46, 0.56])


def test_an_answer_with_wrong_arcs_becomes_the_right_one():
    case, found = held_case(), held(*WRONG)
    least = 2 * np.sqrt(HINGE_INERTIA * TURN / 4.0)
    assert case.certify(found.motion).passed
    assert found.motion.duration_s > 1.005 * least
    right = refine(case, found)
    assert len(right.against) == 0
    assert len(arcs_against_their_limits(found.solution)) > 0
    assert right.motion.duration_s == pytest.approx(least, rel=1e-8)
