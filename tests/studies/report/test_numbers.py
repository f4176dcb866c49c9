"""Numbers of a page: thinned without losing a peak, rounded to what is known."""

import numpy as np

from linkplan.studies.output.numbers import MAX_SAMPLES, drawn_rows, rounded


def test_a_peak_of_one_sample_stays():
    values = np.sin(np.linspace(0, 7, 20_000))
    values[12_345] = 3.0
    rows = drawn_rows(values[:, None])
    assert 12_345 in rows
    assert len(rows) < MAX_SAMPLES


def test_a_smooth_line_is_within_what_a_screen_shows_of_all_its_samples():
    time = np.linspace(0, 2, 20_000)
    values = np.sin(2 * np.pi * 4 * time)
    rows = drawn_rows(values[:, None])
    assert np.abs(np.interp(time, time[rows], values[rows]) - values).max() < 0.01 * np.ptp(values)
    assert (rows[0], rows[-1]) == (0, len(time) - 1)


def test_few_samples_are_all_kept():
    assert len(drawn_rows(np.zeros((MAX_SAMPLES, 3)))) == MAX_SAMPLES


def test_digits_are_counted_from_the_largest():
    assert rounded(np.array([123.456789, 0.000123456])) == [123.46, 0]


def test_on_a_logarithmic_axis_every_value_has_its_own():
    assert rounded(np.array([123.456789, 0.000123456, 0.0, -1.0]), log=True) == [123.5, 0.0001235, None, None]


def test_what_is_no_number_is_none():
    assert rounded(np.array([1.0, np.nan, np.inf])) == [1, None, None]
