"""The figure of an experiment: cumulative shares of machines."""

import numpy as np
from matplotlib.figure import Figure

from linkplan.studies.experiment.draw_experiment import draw_distribution
from linkplan.studies.experiment.metrics import Metric


def drawn(values: list[float], unit: str):
    axis = Figure().subplots()
    results = {"figure": np.array(values), "tracker": np.array(["lqr"] * len(values))}
    draw_distribution(axis, results, ["lqr"], "figure", Metric(text="a figure", unit=unit))
    return axis


def test_a_curve_begins_at_no_machine_and_failures_never_arrive():
    (line,) = drawn([3.0, 1.0, np.nan, 2.0], "deg").lines
    np.testing.assert_array_equal(line.get_xdata(), [1, 1, 2, 3])
    np.testing.assert_array_equal(line.get_ydata(), [0, 25, 50, 75])
    (nothing,) = drawn([np.nan], "deg").lines
    assert len(nothing.get_xdata()) == 0


def test_shares_that_are_all_zero_have_an_axis_that_hardly_goes_below():
    low, high = drawn([0.0, 0.0], "1").get_xlim()
    assert -0.002 < low < 0 < high
