"""Distributions of imperfections: which differ from machine to machine, and which are refused."""

import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.imperfections import spread_of


@pytest.mark.parametrize(
    ("value", "is_random"),
    [
        (1.1, False),
        ([0.9, 1.1], True),
        ([1.1, 1.1], False),
        ({"uniform": [0.9, 1.1]}, True),
        ({"normal": [1.0, 0.05]}, True),
        ({"normal": [1.0, 0.0]}, False),
    ],
)
def test_machines_differ_if_a_distribution_has_a_width(value, is_random):
    assert spread_of(value, "payload_mass_factor", "payload_mass_factor").random is is_random


@pytest.mark.parametrize("value", [[1.1, 0.9], {"normal": [1.0, -0.1]}, [1.0], {"uniform": 1.0}, {"mean": [1.0, 2.0]}])
def test_what_is_no_distribution_is_refused(value):
    with pytest.raises(ProblemError, match=r"imperfections\.payload_mass_factor"):
        spread_of(value, "payload_mass_factor", "payload_mass_factor")
