"""Units of an instant's quantities."""

import numpy as np
import pytest

from linkplan.planner.problem.instant import Scales


def test_the_units_of_power_and_force_are_the_largest_of_their_parts():
    scales = Scales(
        time_s=0.5, position=np.array([2.0, 0.1]), effort=np.array([7.0]), residual=np.array([3.0, 8.0]), length_m=0.25
    )
    assert scales.power == pytest.approx(2.0 * 3.0 / 0.5)
    assert scales.force == pytest.approx(8.0 / 0.25)
    assert scales.vector() == pytest.approx([0.5, 2.0, 0.1, 7.0, 3.0, 8.0, 0.25, 12.0, 32.0])
