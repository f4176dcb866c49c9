"""The figure of an experiment: axes on which values can be read."""

import numpy as np
import pytest

from linkplan.studies.output.figure import figure_of
from linkplan.studies.variations.experiment.distributions import distributions
from linkplan.studies.variations.experiment.metrics import Metric


@pytest.mark.parametrize("slowest", [600.0, 9e5])
def test_a_logarithmic_axis_has_several_labelled_ticks_within_it_however_short(slowest):
    results = np.zeros(200, dtype=[("tracker", "U8"), ("chatter", float)])
    results["tracker"][:100], results["tracker"][100:] = "pd", "ct"
    results["chatter"][:100] = np.linspace(25.0, 60.0, 100)
    results["chatter"][100:] = np.linspace(0.5, 1.0, 100) * slowest
    metrics = {"chatter": Metric(text="total variation of the effort", unit="N.m")}
    figure = figure_of(distributions(results, ["pd", "ct"], list(metrics), metrics), None)
    axes = figure.axes[0]
    assert axes.get_xscale() == "log"
    figure.draw_without_rendering()
    low, high = axes.get_xlim()
    ticks = [
        tick
        for minor in (False, True)
        for tick, label in zip(axes.get_xticks(minor=minor), axes.get_xticklabels(minor=minor), strict=True)
        if low <= tick <= high and label.get_text()
    ]
    assert len(ticks) >= 3
