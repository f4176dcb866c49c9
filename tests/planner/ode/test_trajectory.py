"""A solution as functions of time, from a beginning that is not zero."""

import numpy as np
import pytest

from linkplan.planner.transcription.collocation import Curves

MOTION = Curves(
    breaks_s=np.array([1.0, 2.0, 4.0]), state=np.array([[[0.0], [2.0]], [[2.0], [-4.0]]]),
    effort=np.array([2.0, -3.0])[None, :, None],
)  # fmt: skip


def test_a_motion_lasts_from_its_first_break_to_its_last():
    assert MOTION.duration_s == 3.0


def test_rates_are_the_slopes_of_states():
    at = np.array([1.5, 2.0, 3.0])
    assert MOTION.state_at(at)[:, 0] == pytest.approx([1.0, 2.0, -1.0])
    assert MOTION.rate_at(at)[:, 0] == pytest.approx([2.0, -3.0, -3.0])


def test_dense_times_are_on_both_sides_of_each_break():
    time = MOTION.dense_times(4)
    assert time == pytest.approx([1.0, 1.25, 1.5, 1.75, 2.0, 2.0, 2.5, 3.0, 3.5, 4.0], abs=1e-9)
    assert MOTION.effort_at(time)[:, 0].tolist() == [2.0] * 5 + [-3.0] * 5
