"""The distributions of an experiment's metrics: cumulative shares of machines."""

import numpy as np

from linkplan.studies.variations.experiment.distributions import distributions
from linkplan.studies.variations.experiment.metrics import Metric


def drawn(values: list[float], unit: str):
    results = {"figure": np.array(values), "tracker": np.array(["lqr"] * len(values))}
    return distributions(results, ["lqr"], ["figure"], {"figure": Metric(text="a figure", unit=unit)})


def test_a_curve_begins_at_no_machine_and_failures_never_arrive():
    (plot,) = drawn([3.0, 1.0, np.nan, 2.0], "deg")
    (line,) = plot.series
    assert line.look == "steps"  # of one machine after the other
    assert (line.x[0], line.y[0]) == (1, 0)
    assert list(zip(line.x, line.y, strict=True))[1:4] == [(1, 25), (2, 50), (3, 75)]
    assert max(line.y) == 75


def test_a_metric_with_one_value_on_all_machines_has_no_plot():
    assert drawn([0.0, 0.0], "1") == drawn([np.nan], "deg") == []
