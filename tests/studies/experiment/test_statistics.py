"""Intervals cover what they say; pairs are compared sample by sample; designs meet every part of every range."""

import numpy as np
import pytest
import scipy.stats

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.imperfections import Factor, Spread
from linkplan.studies.variations.experiment.experiment import N_HYPERCUBES, machines_by_design, replicate_of
from linkplan.studies.variations.experiment.experiment_blocks import distributions, estimated
from linkplan.studies.variations.experiment.metrics import Metric
from linkplan.studies.variations.experiment.statistics import Estimate, mean_of, pair_of, share_of

REPEATS = 500
# The share of intervals that cover, of 500: its own standard deviation is 1 %.
COVERAGE, OFF = 0.95, 0.02


def factor(kind: str, first: float, second: float = 0.0, key: str = "delay_periods") -> Factor:
    return Factor(key=key, name="", spread=Spread(kind=kind, first=first, second=second))


def test_paired_differences_are_covered_as_often_as_is_said():
    generator, covered, widths = np.random.default_rng(3), 0, []
    for _ in range(REPEATS):
        common = generator.gamma(2.0, 1.0, 100)  # what makes a machine hard is hard for both trackers
        a, b = common + generator.normal(0.3, 0.2, 100), common + generator.exponential(0.1, 100)
        found = pair_of("a", "b", "rms", a, b).difference
        covered += found.low <= 0.2 <= found.high
        widths.append(found.half)
    assert abs(covered / REPEATS - COVERAGE) <= OFF
    assert np.mean(widths) < 0.05  # unpaired, they would be six times as wide


# Sources of differences about zero with longer or more one-sided tails than a normal one's, as those of real trackers: over
# a thousand imperfect knees they have a skewness of up to 1 and a kurtosis of up to 4 (the exponential's: 2 and 9).
TAILS = {
    "Student's with five degrees of freedom": lambda generator, n: generator.standard_t(5, n),
    "exponential": lambda generator, n: generator.exponential(1.0, n) - 1.0,
}


# Of 500 repeats the share itself has a standard deviation of 1 %: one in twenty good intervals would miss by its own luck.
MANY = 2000


def coverage(tail, n):
    """Return the share of intervals of paired differences (n,) that cover the true one, 0.2."""
    generator, covered = np.random.default_rng(11), 0
    for _ in range(MANY):
        common = generator.gamma(2.0, 1.0, n)
        found = pair_of("a", "b", "rms", common + 0.2 + tail(generator, n), common).difference
        covered += found.low <= 0.2 <= found.high
    return covered / MANY


@pytest.mark.slow
@pytest.mark.parametrize("name", TAILS)
def test_paired_differences_with_long_tails_are_covered_as_often_as_is_said(name):
    assert abs(coverage(TAILS[name], 200) - COVERAGE) <= OFF


@pytest.mark.slow
def test_very_one_sided_differences_are_covered_as_often_only_by_thousands():
    def lognormal(generator, n):
        return generator.lognormal(0.0, 1.0, n) - np.exp(0.5)  # of skewness 6

    assert coverage(lognormal, 50) < COVERAGE - OFF
    assert abs(coverage(lognormal, 2000) - COVERAGE) <= OFF


def test_who_fails_a_sample_loses_it_and_what_neither_finishes_counts_for_none():
    a, b = np.array([1.0, np.nan, np.nan, 2.0, 3.0]), np.array([2.0, 9.0, np.nan, 2.0, 1.0])
    pair = pair_of("a", "b", "rms", a, b)
    assert (pair.wins.value, pair.wins.n) == (pytest.approx(1 / 3), 3)
    assert pair.difference.n == 3
    assert pair.difference.value == pytest.approx(1 / 3)


def test_a_mean_of_nothing_is_none():
    assert mean_of(np.array([np.nan])).n == 0
    assert estimated(mean_of(np.array([]))) == "-"


@pytest.mark.parametrize(
    ("value", "half", "text"), [(4.5849, 0.042, "4.58 ± 0.04"), (123.4, 12.0, "123 ± 12"), (0.0389, 0.0026, "0.039 ± 0.003")]
)
def test_a_mean_is_printed_to_the_figures_that_its_interval_leaves(value, half, text):
    assert estimated(Estimate(value=value, interval95=(value - half, value + half), n=9)) == text


def test_each_latin_hypercube_meets_every_part_of_every_range_once():
    n = 400
    factors = [factor("uniform", 1.0, 3.0), factor("fixed", 0.5), factor("normal", 10.0, 2.0)]
    values = machines_by_design(factors, "latin-hypercube", n, 3, seed=4)
    for number in range(N_HYPERCUBES):
        own = values[replicate_of(n) == number, 0]
        assert sorted(np.floor((own - 1.0) / 2.0 * len(own)).astype(int)) == list(range(n // N_HYPERCUBES))
    assert np.all(values[:, 1] == 0.5)
    assert np.mean(values[:, 2]) == pytest.approx(10.0, abs=0.1)
    assert np.std(values[:, 2]) == pytest.approx(2.0, rel=0.1)
    assert np.array_equal(values, machines_by_design(factors, "latin-hypercube", n, 3, seed=4))
    assert not np.array_equal(values, machines_by_design(factors, "latin-hypercube", n, 3, seed=5))


def test_a_grid_of_too_many_samples_is_refused():
    with pytest.raises(ProblemError, match=r"a grid of 10 levels in 7 factors has 1e\+07 samples"):
        machines_by_design([factor("uniform", 0.0, 1.0)] * 7, "grid", 1, 10, seed=0)


def test_a_normal_value_is_cut_at_what_is_legal():
    values = machines_by_design([factor("normal", 0.1, 1.0)], "latin-hypercube", 100, 3, seed=0)
    assert values.min() == 0.0


@pytest.mark.parametrize(("hits", "n"), [(3, 10), (1, 7), (90, 100)])
def test_a_share_has_wilsons_interval(hits, n):
    exact = scipy.stats.binomtest(hits, n).proportion_ci(COVERAGE, method="wilson")
    found = share_of(hits, n)
    assert (found.low, found.high) == pytest.approx((exact.low, exact.high), rel=1e-9)


def test_a_grid_reaches_the_ends_of_a_range_and_of_a_normal_distribution_s_central_95_percent():
    values = machines_by_design([factor("uniform", 2.0, 3.0), factor("normal", 1.0, 0.5)], "grid", 1, 3, seed=0)
    assert sorted(set(values[:, 0])) == pytest.approx([2.0, 2.5, 3.0])
    assert sorted(set(values[:, 1])) == pytest.approx([1.0 - 0.5 * 1.959964, 1.0, 1.0 + 0.5 * 1.959964])


def test_the_interval_of_a_latin_hypercube_s_mean_is_as_wide_as_the_mean_varies():
    """Over 400 experiments: 95 % of the intervals hold the true mean, and they are no wider than that asks for."""
    factors = [factor("uniform", 1.0, 3.0)] * 3
    replicate, found, independent = replicate_of(100), [], []
    for seed in range(400):
        x = machines_by_design(factors, "latin-hypercube", 100, 3, seed=seed) - 2.0
        figure = x[:, 0] + x[:, 1] ** 2 + 0.5 * x[:, 0] * x[:, 2]
        found.append(mean_of(figure, replicate))
        independent.append(mean_of(figure))
    held = np.mean([one.low <= 1.0 / 3.0 <= one.high for one in found])
    assert held == pytest.approx(0.95, abs=0.03)
    assert np.mean([one.low <= 1.0 / 3.0 <= one.high for one in independent]) > 0.99
    # Student's factor of nine degrees of freedom, 2.262, on the standard deviation of the means.
    assert np.mean([one.half for one in found]) == pytest.approx(2.262 * np.std([one.value for one in found]), rel=0.1)


def test_hypercubes_are_of_equal_size_and_few_samples_are_independent():
    assert np.bincount(replicate_of(23)).tolist() == [3, 2, 2, 3, 2, 2, 3, 2, 2, 2]
    assert replicate_of(4).tolist() == [0, 1, 2, 3]


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
