"""Which instants a film shows, how slowly, and what may be asked of it."""

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.studies.render.motion import frame_times, own_slowness
from linkplan.studies.render.render import picture
from linkplan.studies.render.settings import RenderSettings
from tests.support.pictures import PERIOD_S, waved


def test_a_films_frames_are_evenly_spaced_from_the_beginning_to_the_end():
    times = frame_times(0.16, 25.0, 25.0)
    assert len(times) == 101
    assert times[[0, -1]] == pytest.approx([0.0, 0.16])
    assert np.diff(times) == pytest.approx(0.0016)


def test_the_end_is_shown_even_where_no_frame_falls_on_it():
    times = frame_times(0.1, 1.0, 25.0)
    assert times[-1] == pytest.approx(0.1, abs=0.02)
    assert times[-1] >= 0.08
    assert np.all(np.diff(times) > 0)


def test_a_motion_that_repeats_itself_leaves_out_the_end_which_is_the_beginning():
    times = frame_times(0.25, 4.0, 25.0, repeats=True)
    assert len(times) == 25
    assert times[-1] == pytest.approx(0.25 - 0.01)


def test_too_many_frames_are_refused_with_how_many_there_would_be():
    with pytest.raises(ProblemError, match=r"2\.?\d*.* s, 1e\+06 times slower .* frames; at most 20000"):
        frame_times(2.0, 1e6, 25.0)


@pytest.mark.parametrize(("duration", "slow"), [(4.0, 1.0), (100.0, 1.0), (2.0, 2.0), (0.4, 10.0), (0.004, 1000.0)])
def test_a_short_motion_is_slowed_down_to_some_seconds_by_a_round_factor(duration, slow):
    assert own_slowness(duration) == pytest.approx(slow)


def test_an_instant_is_the_control_period_that_it_falls_into():
    motion = waved("optimus-knee")
    assert [motion.index_at(t) for t in (0.0, 2.5 * PERIOD_S, 3 * PERIOD_S, 99.0)] == [0, 2, 3, len(motion.time_s) - 1]


def test_a_picture_of_an_instant_after_the_run_is_refused_with_its_end():
    motion = waved("optimus-knee")
    asked = RenderSettings(suffix=".png", at_s=99.0)
    with pytest.raises(ProblemError, match=f"ends at {motion.time_s[-1]:.4g} s; there is no picture of it at 99 s"):
        picture(motion, None, asked, None)
