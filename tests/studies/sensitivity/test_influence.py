"""Influences against closed forms: a linear function, Ishigami's, one with noise; and what is lost on the way."""

import sys

import numpy as np
import pytest

from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.studies.variations.sensitivity.influence import influence_of
from linkplan.studies.variations.sensitivity.scheme import MORRIS_LEVELS, SENSITIVE, scheme_of

SLOPES = np.array([3.0, -2.0, 1.0, 0.0])
# Ishigami and Homma, First international symposium on uncertainty modelling and analysis (1990); a = 7, b = 0.1.
A, B = 7.0, 0.1
PARTS = np.array([0.5 * (1 + B * np.pi**4 / 5) ** 2, A**2 / 8, 0.0])
TOGETHER = 8 * B**2 * np.pi**8 / 225  # of the first and the third
VARIANCE = PARTS.sum() + TOGETHER
FIRST, TOTAL = PARTS / VARIANCE, (PARTS + TOGETHER * np.array([1, 0, 1])) / VARIANCE


def linear(scheme):
    return 5.0 + scheme.points @ SLOPES


def ishigami(scheme):
    x, y, z = (np.pi * (2 * scheme.points - 1)).T
    return np.sin(x) + A * np.sin(y) ** 2 + B * z**4 * np.sin(x)


def noise(scheme, seed=1):
    """Return one number for each draw of the noise, of variance 1/12."""
    return np.random.default_rng(seed).random(scheme.draws.max() + 1)[scheme.draws]


def test_a_linear_function_owes_to_each_factor_its_slope():
    for design in ("one-at-a-time", "morris"):
        scheme = scheme_of(design, 4, False, 60, seed=0)
        found = influence_of(scheme, linear(scheme))
        assert found.importance == pytest.approx(np.abs(SLOPES), abs=1e-12)
        assert found.high - found.low == pytest.approx(0.0, abs=1e-12)
        assert list(found.order) == [0, 1, 2, 3]
    assert found.parts["mean"] == pytest.approx(SLOPES, abs=1e-12)
    assert found.parts["spread"] == pytest.approx(0.0, abs=1e-12)


def test_one_at_a_time_gives_the_figure_at_both_ends():
    scheme = scheme_of("one-at-a-time", 4, False, 1, seed=0)
    found = influence_of(scheme, linear(scheme))
    assert found.middle == pytest.approx(6.0)
    assert found.parts["at_low"] == pytest.approx(6.0 - SLOPES / 2)
    assert found.parts["at_high"] == pytest.approx(6.0 + SLOPES / 2)
    bent = influence_of(scheme, (scheme.points[:, 0] - 0.5) ** 2)  # as much at both ends, and less between them
    assert bent.importance[0] == pytest.approx(0.25)


def test_a_linear_functions_variance_is_shared_by_the_squares_of_its_slopes():
    scheme = scheme_of("sobol", 4, False, 6 * 512, seed=0)
    found, wanted = influence_of(scheme, linear(scheme)), SLOPES**2 / np.sum(SLOPES**2)
    assert found.importance == pytest.approx(wanted, abs=0.02)
    assert found.parts["first_order"] == pytest.approx(wanted, abs=0.02)


def test_ishigamis_indices_are_the_known_ones():
    scheme = scheme_of("sobol", 3, False, 5 * 1024, seed=2)
    found = influence_of(scheme, ishigami(scheme))
    assert np.all((found.low <= TOTAL) & (found.high >= TOTAL))
    half = found.parts["first_order_half"]
    assert np.all(np.abs(found.parts["first_order"] - FIRST) <= half)
    assert np.all(half < 0.1)  # what holds them is no barn door
    assert list(found.order) == [0, 1, 2]


@pytest.mark.slow
def test_intervals_of_sobols_indices_cover_the_known_ones_at_least_as_often_as_is_said():
    covered = []
    for seed in range(100):
        scheme = scheme_of("sobol", 3, False, 5 * 256, seed=seed)
        found = influence_of(scheme, ishigami(scheme), seed)
        covered.append((found.low <= TOTAL) & (found.high >= TOTAL))
    assert np.all(np.mean(covered, axis=0) > 0.93)
    assert np.all(found.high - found.low < 0.5)


@pytest.mark.parametrize("design", SENSITIVE)
def test_a_factor_without_effect_has_none_however_loud_the_noise(design):
    scheme = scheme_of(design, 4, True, 7 * 64, seed=3)
    figures = linear(scheme) + 10 * noise(scheme)
    assert np.ptp(noise(scheme)) > 0.9
    found = influence_of(scheme, figures)
    assert found.importance[3] == pytest.approx(0.0, abs=1e-9)
    assert list(found.order[:2]) == [4, 0]  # luck is the most of it, and is named
    apart = influence_of(scheme, figures + np.random.default_rng(0).random(len(figures)))
    assert apart.importance[3] > 0.001  # as it would be with a noise of its own on every machine


def test_what_is_luck_has_the_share_of_its_variance():
    scheme = scheme_of("sobol", 4, True, 7 * 512, seed=3)
    found = influence_of(scheme, linear(scheme) + 2 * noise(scheme))
    wanted = np.append(SLOPES, 2.0) ** 2
    assert found.importance == pytest.approx(wanted / wanted.sum(), abs=0.03)
    along = scheme_of("morris", 4, True, 6 * 300, seed=3)
    # Two draws from 0 to 1 differ by a third in the mean.
    assert influence_of(along, noise(along)).importance[4] == pytest.approx(1 / 3, abs=0.03)


@pytest.mark.parametrize("design", ["morris", "sobol"])
@pytest.mark.parametrize("noisy", [False, True])
def test_one_thing_changes_at_a_time(design, noisy):
    scheme = scheme_of(design, 3, noisy, 200, seed=1)
    everything = np.column_stack([scheme.points, scheme.draws]).reshape(scheme.n_groups, scheme.size, 4)
    before = everything[:, :-1] if design == "morris" else everything[:, :1]
    after = everything[:, 1:] if design == "morris" else everything[:, 1:-1]
    changed = before != after
    assert np.all(changed.sum(axis=2) == 1)
    assert np.all(changed.sum(axis=1)[:, :3] == 1)
    assert len(np.unique(scheme.draws)) == (2 * scheme.n_groups if noisy else 1)
    if design == "morris":
        step = np.abs(after - before)[..., :3]
        assert step[step > 0] == pytest.approx(MORRIS_LEVELS / (2 * (MORRIS_LEVELS - 1)))


def test_the_same_seed_gives_the_same_trials_and_another_one_others():
    for design in ("morris", "sobol"):
        first, again, other = (scheme_of(design, 3, True, 200, seed=seed) for seed in (4, 4, 5))
        assert np.array_equal(first.points, again.points)
        assert np.array_equal(first.draws, again.draws)
        assert not np.array_equal(first.points, other.points)
        a, b = (influence_of(one, noise(one) + one.points @ SLOPES[:3]) for one in (first, again))
        assert np.array_equal(a.low, b.low)


@pytest.mark.parametrize("design", ["morris", "sobol"])
def test_groups_without_a_figure_are_left_out_and_counted(design):
    scheme = scheme_of(design, 4, False, 384, seed=0)
    figures = linear(scheme)
    whole = influence_of(scheme, figures)
    figures[[0, 1, 2 * scheme.size + 1]] = np.nan
    found = influence_of(scheme, figures)
    assert (found.left_out, found.groups) == (2, scheme.n_groups)
    assert found.importance == pytest.approx(whole.importance, abs=0.1)
    nothing = influence_of(scheme, np.full(len(figures), np.nan))
    assert np.all(np.isnan(nothing.importance))


def test_a_figure_that_is_lost_at_an_end_of_a_range_stands_first():
    scheme = scheme_of("one-at-a-time", 4, False, 1, seed=0)
    figures = linear(scheme)
    figures[6] = np.nan  # the third at its high end
    found = influence_of(scheme, figures)
    assert list(found.order) == [2, 0, 1, 3]
    assert np.isnan(found.parts["at_high"][2])
    figures[0] = np.nan
    assert np.all(np.isnan(influence_of(scheme, figures).importance))


@pytest.mark.parametrize("design", SENSITIVE)
def test_a_figure_that_never_changes_owes_nothing_to_anything(design):
    scheme = scheme_of(design, 3, False, 200, seed=0)
    assert np.all(influence_of(scheme, np.full(len(scheme.points), 0.1)).importance == 0)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("sobol", 11, False, 200), r"'sobol' of 11 imperfections needs at least 208 samples, 16 groups of 13; got 200"),
        (("morris", 3, True, 19), r"'morris' of 4 imperfections needs at least 20 samples"),
        (("one-at-a-time", 3, True, 13), r"needs at least 14 samples, 2 groups of 7"),
        (("morris", 0, False, 100), "needs an imperfection with a range"),
    ],
)
def test_too_little_to_tell_from_is_refused(asked, said):
    with pytest.raises(ProblemError, match=said):
        scheme_of(*asked, seed=0)


def test_without_salib_it_is_said_in_one_line(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "SALib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "SALib", None)
    with pytest.raises(LinkplanError, match=r"SALib, which is not installed: pip install 'linkplan\[sensitivity\]'"):
        scheme_of("sobol", 3, False, 1000, seed=0)
    assert len(scheme_of("one-at-a-time", 3, False, 1, seed=0).points) == 7
