"""Parts of an error: they add up, whatever the errors are, and nothing simpler would."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from linkplan.studies.variations.decompose.decompose import error_parts
from linkplan.studies.variations.decompose.decomposition import Shares
from linkplan.studies.variations.decompose.ladder import CAUSES
from tests.support.tolerances_planner import ROUNDING

SIZES = st.tuples(st.integers(1, 7), st.integers(1, 9), st.integers(1, 4), st.integers(1, 3))
NUMBERS = st.floats(-1e3, 1e3, allow_subnormal=False)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(SIZES.flatmap(lambda shape: arrays(float, shape, elements=NUMBERS)))
def test_the_parts_of_any_errors_add_up_to_their_rms(errors):
    found = in_order(errors)
    instants = errors.shape[1] * errors.shape[2]
    assert found.rms_error == pytest.approx(np.sqrt(np.sum(errors[-1] ** 2) / instants), rel=ROUNDING)
    size = max(values(found.rms_of_increment).sum(), found.rms_error)
    assert values(found.parts).sum() == pytest.approx(found.rms_error, abs=ROUNDING * size)
    of_joints = np.sum([values(one) for one in found.parts_of_joints.values()], axis=0)
    np.testing.assert_allclose(of_joints, values(found.parts), atol=ROUNDING * size)


def in_order(errors: np.ndarray) -> Shares:
    """Return the parts of errors whose causes are switched on in one order; further causes add nothing."""
    errors = np.concatenate([errors, np.repeat(errors[-1:], len(CAUSES) - len(errors), axis=0)])
    names = [str(k) for k in range(errors.shape[-1])]
    return error_parts(errors, np.diff(errors, axis=0, prepend=0.0), names)


def values(by_cause: dict[str, float], n: int = len(CAUSES)) -> np.ndarray:
    """Return the values of the first n causes."""
    return np.array(list(by_cause.values()))[:n]


def test_increments_that_are_at_right_angles_share_a_square_as_pythagoras_has_it():
    """Errors of 3 at one instant and of 4 at the next: 9/25 and 16/25 of a rms of 5 over the root of two."""
    first, second = np.array([3.0, 0.0]), np.array([3.0, 4.0])
    found = in_order(np.array([first, second])[:, :, None, None])
    np.testing.assert_allclose(values(found.parts, 2), np.array([9, 16]) / 25 * 5 / np.sqrt(2), rtol=ROUNDING)
    np.testing.assert_allclose(values(found.rms_of_increment, 2), np.array([3, 4]) / np.sqrt(2), rtol=ROUNDING)


def test_a_cause_that_opposes_another_has_a_negative_part():
    found = in_order(np.array([5.0, 2.0])[:, None, None, None])
    np.testing.assert_allclose(values(found.parts, 2), [5.0, -3.0], rtol=ROUNDING)
    assert found.rms_error == 2.0


def test_no_error_has_no_parts():
    found = in_order(np.zeros((3, 4, 1, 2)))
    assert found.rms_error == 0
    np.testing.assert_array_equal(values(found.parts), 0)
