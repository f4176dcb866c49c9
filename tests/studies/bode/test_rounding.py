"""Positions in reports: what is rounding of zero is printed as zero, whatever says it."""

import numpy as np
import pytest

from linkplan.models.tree.joints import where
from linkplan.studies.feedback.bode.scan import coordinate_line
from tests.support.mechanism_checks import mechanism_of

# What a loop's closing leaves of zero [rad].
ROUNDING = -1.2e-10


def test_a_place_on_a_line_of_angles_is_zero_where_it_is_rounding():
    line = coordinate_line(mechanism_of("optimus-knee"), 0, -1.0, 1.0, np.zeros(1))
    assert line.place(ROUNDING) == "O = 0 deg"
    assert line.place(np.radians(30.0)) == "O = 30 deg"


@pytest.mark.parametrize(("position", "said"), [(ROUNDING, "O = 0 deg"), (1e-6, "O = 5.72958e-05 deg")])
def test_positions_in_refusals_are_zero_where_they_are_rounding(position, said):
    assert where(mechanism_of("optimus-knee").joints[:1], [position], 6) == said
