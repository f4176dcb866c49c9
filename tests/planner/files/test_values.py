"""Single values in TOML's syntax, and arrays of trajectories beyond what is read."""

import math

import numpy as np
import pytest

from linkplan.models.errors import PlanFileError, ProblemError
from linkplan.planner.files.columns import read_trajectory
from linkplan.planner.files.tables import inline, parse_value


@pytest.mark.parametrize("value", [1.5, -2, True, math.inf, -math.inf, [1.0, -math.inf], "two words"])
def test_a_value_is_read_back_from_one_line(value):
    assert parse_value(inline(value), "key") == value


def test_no_number_is_read_back_as_none():
    assert inline(math.nan) == "nan"
    assert math.isnan(parse_value("nan", "key"))


def test_a_setting_is_one_value_and_no_further_line():
    assert parse_value("[1, 2]", "key") == [1, 2]
    assert parse_value("bare", "key") == "bare"
    with pytest.raises(ProblemError):
        parse_value("1\nother = 2", "key")


@pytest.mark.parametrize("name", ["position", "velocity", "effort"])
@pytest.mark.parametrize(("coefficients", "legal"), [(24, True), (25, False)])
def test_polynomials_of_up_to_24_coefficients_are_read(tmp_path, name, coefficients, legal):
    arrays = {key: np.zeros((2, 1, 1)) for key in ("position", "velocity", "effort")}
    arrays[name] = np.zeros((coefficients, 1, 1))
    path = tmp_path / "trajectory.npz"
    np.savez(path, breaks_s=np.array([0.0, 1.0]), start_pose=np.zeros(1), periodic=False, **arrays)
    if legal:
        assert len(getattr(read_trajectory(path), name)) == coefficients
    else:
        with pytest.raises(PlanFileError, match="1 intervals of 25 coefficients; at most 20000 of 24 are read"):
            read_trajectory(path)
