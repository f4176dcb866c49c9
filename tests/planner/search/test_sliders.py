"""A sample of random slider-cranks, planned and judged by answers that are not linkplan's."""

import pytest

from tests.bench.random_sliders import judged

SEED = 1


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1, 2, 3, 6])
def test_a_random_slider_cranks_answer_is_exact(number):
    _, error, _, said = judged(SEED, number)
    assert said == "right", f"{error:+.1e} {said}"
