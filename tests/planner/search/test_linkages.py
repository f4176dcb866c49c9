"""A sample of random linkages, planned and judged by answers that are not linkplan's."""

import pytest

from tests.bench.random_linkages import drawn_slider, judged
from tests.support.linkage_problems import drawn

SEED = 1
# Of each family one, and one of each thing asked; 38's switch times have further to go than its first mesh lets them.
SAMPLE, SLIDERS = (0, 6, 12, 38, 4), (0, 1, 2, 3, 6)


@pytest.mark.slow
@pytest.mark.parametrize(("draw", "number"), [*((drawn, k) for k in SAMPLE), *((drawn_slider, k) for k in SLIDERS)])
def test_a_random_linkage_s_answer_is_exact(draw, number):
    said, error, _ = judged(draw(SEED, number))
    assert said == "right", f"{error:+.1e} {said}"
