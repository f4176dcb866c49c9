"""Names of a drawing's directions."""

import numpy as np
import pytest

from linkplan.studies.output.numbers import direction_name


@pytest.mark.parametrize(
    ("direction", "name"),
    [
        ((1.0, 0.0, 0.0), "x"),
        ((0.0, 0.0, -1.0), "-z"),
        ((0.6, 0.8, 0.0), "along (0.6, 0.8, 0)"),
        ((0.6, 0.8, -4.3e-19), "along (0.6, 0.8, 0)"),
    ],
)
def test_a_direction_is_an_axis_of_the_world_or_its_components_without_rounding(direction, name):
    assert direction_name(np.array(direction)) == name
