"""The influence of each imperfection on each tracker and figure, by regression of ranks over an experiment's machines.

A figure's ranks are regressed on the ranks of every imperfection's values and on those of the values' distances from their
median, because a figure often grows to both sides of the nominal value. All ranks are standardised, so coefficients are
between about -1 and 1, and their squares are approximate shares of the variance (Iman and Conover, Technometrics 21, 1979).
Intervals follow from a bootstrap over machines (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 9).
"""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec import Struct

from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.structs import Number
from linkplan.planner.problem.imperfections import Factor
from linkplan.studies.output.document import (
    RAISING_COLOUR,
    TOTAL_COLOUR,
    Axis,
    Bar,
    Bars,
    Block,
    NumberText,
    Span,
    Text,
    table_of,
)
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.variations.experiment.experiment import Experiment, ends_of, varied
from linkplan.studies.variations.experiment.metrics import Metric, metrics_of
from linkplan.studies.variations.experiment.statistics import Estimate

_SUCCESS = Metric(text="success", unit="1", better="more")
# Fewest machines for each coefficient.
_MACHINES_EACH = 3
_N_RESAMPLES = 400
# Machines are resampled in at most this number of groups, whose sums of products are computed once.
_MAX_GROUPS = 400
# Values that agree to this number of digits are equal except for rounding and get the same rank.
_EQUAL_DIGITS = 12


class Varied(Struct, frozen=True, kw_only=True):
    """An imperfection that differs between machines: its unit and the ends of its range."""

    unit: str
    range: tuple[float, float]


class Influence(Struct, frozen=True, kw_only=True):
    """The standardised coefficients of an imperfection: of its value, and of its distance from the median."""

    by_value: Estimate
    by_distance: Estimate

    @property
    def strongest(self) -> Estimate:
        """The larger coefficient."""
        return max(self.by_value, self.by_distance, key=lambda one: np.nan_to_num(abs(one.value)))

    @property
    def significant(self) -> bool:
        """True if the interval of the larger coefficient does not contain 0."""
        return bool(self.strongest.low > 0 or self.strongest.high < 0)


class FigureInfluence(Struct, frozen=True, kw_only=True, eq=False):
    """The influences on one figure of one tracker, by label; `ranking` has the labels, the strongest first.

    `explained` is the share of the variance of ranks due to all of them together. The rest is noise and interactions.
    """

    explained: Number
    ranking: tuple[str, ...]
    effects: dict[str, Influence]


class Sensitivity(Struct, frozen=True, kw_only=True, eq=False):
    """The influence of every imperfection on every figure, by tracker and name of the figure."""

    imperfections: dict[str, Varied]
    metrics: dict[str, Metric]
    trackers: dict[str, dict[str, FigureInfluence]]

    @property
    def mains(self) -> tuple[str, ...]:
        """The rms errors, of hinges and of slides."""
        return tuple(name for name in self.metrics if name.startswith("rms_error"))


def machines_needed(factors: Sequence[Factor]) -> int:
    """Return the least number of machines for the influences of factors."""
    return _MACHINES_EACH * (2 * len(varied(factors)) + 1)


def sensitivity_of(experiment: Experiment, results: Mapping[str, np.ndarray]) -> Sensitivity | None:
    """Return the influences from the columns of results; None without imperfections or with too few machines."""
    factors, mechanism = experiment.section.factors, experiment.plan.problem.mechanism
    which, least = varied(factors), machines_needed(factors)
    if not which or experiment.n < least:
        return None
    named = [factors[i] for i in which]
    values, metrics = experiment.values[:, which], {**metrics_of(mechanism), "success": _SUCCESS}
    x = np.column_stack([values, np.abs(values - np.median(values, axis=0))])
    labels, found = [factor.label for factor in named], {}
    for tracker in experiment.settings.trackers:
        rows = results["tracker"] == tracker
        y = np.column_stack([results[name][rows].astype(float) for name in metrics])
        found[tracker] = dict(zip(metrics, _influences(x, y, labels, least, experiment.settings.seed), strict=True))
    return Sensitivity(
        imperfections={one.label: Varied(unit=_unit(one, mechanism), range=ends_of(one)) for one in named},
        metrics=metrics,
        trackers=found,
    )


def _influences(x: np.ndarray, y: np.ndarray, labels: list[str], least: int, seed: int) -> list[FigureInfluence]:
    """Return the influences on each figure in y (n, m); unknown with fewer than `least` machines that have the figure."""
    known, found = np.isfinite(y), {}
    for kept in np.unique(known, axis=1).T:  # most figures are known on the same machines
        columns, n = np.flatnonzero((known == kept[:, None]).all(axis=0)), int(np.sum(kept))
        unknown = np.full((4, x.shape[1], len(columns)), np.nan)
        numbers = regressed(x[kept], y[np.ix_(kept, columns)], seed) if n >= least else unknown
        found |= {int(column): _by_label(numbers[..., k], n, labels) for k, column in enumerate(columns)}
    return [found[column] for column in range(y.shape[1])]


def regressed(x: np.ndarray, y: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return rows (4, p, m): coefficients of the ranks of x (n, p) for those of y (n, m), their intervals, explained shares.

    The intervals are the two ends of the 95 % interval. The share of the variance of the ranks of y that all coefficients
    explain together (adjusted R^2) is the same for each of them. A constant column has no influence.
    """
    n, p = x.shape
    table = np.column_stack([np.ones(n), *map(_ranked, [*x.T, *y.T])])
    groups = np.array_split(table, min(n, _MAX_GROUPS))
    sums = np.array([group.T @ group for group in groups])
    picks = np.random.default_rng(seed).multinomial(len(groups), np.full(len(groups), 1 / len(groups)), size=_N_RESAMPLES)
    value, explained = _solved(sums.sum(axis=0), p)
    drawn, _ = _solved(np.tensordot(picks, sums, axes=1), p)
    explained = np.maximum(0.0, 1.0 - (1.0 - explained) * (n - 1) / (n - p - 1))
    return np.array([value, *np.percentile(drawn, (2.5, 97.5), axis=0), np.broadcast_to(explained, value.shape)])


def _ranked(column: np.ndarray) -> np.ndarray:
    """Return the ranks (n,) of values (n,) from -1 to 1; equal values have equal ranks."""
    from scipy.stats import rankdata

    size = np.abs(column).max(initial=0.0) or 1.0
    return 2.0 * rankdata(np.round(column / size, _EQUAL_DIGITS)) / (len(column) + 1) - 1.0


def _solved(sums: np.ndarray, p: int) -> tuple[np.ndarray, np.ndarray]:
    """Return standardised coefficients (..., p, m) and explained shares (..., m).

    `sums` (..., q, q) are sums of products of rows [1, x (p,), y (m,)]. Without a unique solution, the norm is least.
    """
    mean = sums[..., :1, 1:] / sums[..., :1, :1]
    covariance = sums[..., 1:, 1:] / sums[..., :1, :1] - mean.swapaxes(-1, -2) * mean
    size = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0))
    size = np.where(size > 1e-6, size, np.inf)  # of ranks from -1 to 1: a smaller one is rounding
    correlation = covariance / size[..., :, None] / size[..., None, :]
    to_y = correlation[..., :p, p:]
    value = np.linalg.pinv(correlation[..., :p, :p], hermitian=True) @ to_y
    return value, np.sum(value * to_y, axis=-2)


def _by_label(numbers: np.ndarray, n: int, labels: Sequence[str]) -> FigureInfluence:
    """Return the influences by label from `regressed`, whose columns are the values and then the distances."""
    each = [Estimate(value=value, interval95=(low, high), n=n) for value, low, high, _ in numbers.T.tolist()]
    pairs = zip(labels, each[: len(labels)], each[len(labels) :], strict=True)
    effects = {label: Influence(by_value=value, by_distance=distance) for label, value, distance in pairs}
    ranking = sorted(labels, key=lambda label: -np.nan_to_num(abs(effects[label].strongest.value)))
    return FigureInfluence(explained=float(numbers[3, 0]), ranking=tuple(ranking), effects=effects)


def _unit(factor: Factor, mechanism: Mechanism) -> str:
    """Return the unit of a factor's values, for a hinge or for a slide."""
    rotary, _, linear = factor.quantity.unit.partition(" or ")
    kinds = {joint.name: joint.kind == "slide" for joint in mechanism.joints} if factor.quantity.of == "joint" else {}
    if factor.quantity.of == "actuator":
        kinds = {actuator.name: actuator.unit == "N" for actuator in mechanism.actuators}
    return linear if linear and kinds.get(factor.name) else rotary if factor.name in kinds else factor.quantity.unit


# Number of imperfections in tables and charts.
_MAX_ROWS = 12


def sensitivity_blocks(study: Sensitivity) -> list[Block]:
    """Return the influences on the rms errors as tables and charts, and the strongest ones for every figure."""
    blocks: list[Block] = [
        Text(text="which imperfection matters most: coefficients of ranks, ± half their 95 % intervals"),
        Text(text="+: grows with the value; -: falls with it; both: with its distance from the middle"),
    ]
    heads = ["imperfection", *((tracker, "") for tracker in study.trackers)]
    for metric in study.mains:
        shown = _foremost(study, metric)
        rows = [[label, *(_cell(one[metric].effects[label]) for one in study.trackers.values())] for label in shown]
        shares = [one[metric].explained for one in study.trackers.values()]
        rows.append(
            ["all together explain", *(None if math.isnan(x) else NumberText.of(f"{100 * x:.0f} %", x) for x in shares)]
        )
        title = f"Influence on the {study.metrics[metric].text}; -: not significant"
        blocks += [table_of(title, heads, rows), *sensitivity_charts(study, metric)]
        if len(study.imperfections) > len(shown):
            blocks.append(
                Text(text=f"the other {len(study.imperfections) - len(shown)} have less influence: see the record")
            )
    said = [(metric, [_strongest(study, tracker, metric) for tracker in study.trackers]) for metric in study.metrics]
    rows = [[metric, *cells] for metric, cells in said if any(cells)]
    return [*blocks, table_of("The strongest influence on each figure", ["figure", *heads[1:]], rows)]


def tornado_figures(name: str, study: Sensitivity) -> Iterator[tuple[str, FigureSpec]]:
    """Yield the figure of each rms error by its name: "sensitivity", and a second one for hinges and slides together."""
    for i, metric in enumerate(study.mains):
        charts, title = sensitivity_charts(study, metric), f"{name}: influence on the {study.metrics[metric].text}"
        height_in = 1.4 + 0.33 * len(charts[0].rows)
        figure = FigureSpec(panels=charts, title=title, columns=2, panel_in=(6.5, height_in))
        yield "sensitivity" if i == 0 else f"sensitivity_{metric}", figure


def sensitivity_charts(study: Sensitivity, metric: str) -> list[Bars]:
    """Return a chart for each tracker of the influence of each imperfection on a metric."""
    shown, axis = _foremost(study, metric), Axis(label="coefficient of ranks", unit="1")
    return [
        Bars(
            title=f"{tracker}: influence of each imperfection on the {study.metrics[metric].text}",
            axis=axis,
            rows=[Bar(label=_named(study, label), spans=_spans(found[metric].effects[label])) for label in shown],
        )
        for tracker, found in study.trackers.items()
    ]


def _spans(one: Influence) -> list[Span]:
    """Return the bars of both coefficients with their intervals; none for unknown ones."""
    parts = (("of the value", one.by_value, RAISING_COLOUR), ("of its distance", one.by_distance, TOTAL_COLOUR))
    return [
        Span(name=name, start=0.0, end=of.value, colour=colour, low=of.low, high=of.high)
        for name, of, colour in parts
        if math.isfinite(of.value)
    ]


def _cell(influence: Influence) -> str | None:
    """Return the strongest coefficient as text, if it is significant."""
    strongest = influence.strongest
    both = " both" if strongest is influence.by_distance else ""
    text = f"{strongest.value:+.2f} ± {strongest.half:.2f}{both}"
    return NumberText.of(text, strongest.value, strongest.half, words=("", "±")) if influence.significant else None


def _strongest(study: Sensitivity, tracker: str, metric: str) -> str | None:
    """Return the label of the imperfection with the strongest influence on a figure, if it is significant."""
    found = study.trackers[tracker][metric]
    return found.ranking[0] if found.effects[found.ranking[0]].significant else None


def _foremost(study: Sensitivity, metric: str) -> list[str]:
    """Return the imperfections that matter most for any tracker, in the order of the first tracker's ranking."""
    rankings = [by_metric[metric].ranking for by_metric in study.trackers.values()]
    places = {label: min(ranking.index(label) for ranking in rankings) for label in study.imperfections}
    kept = set(sorted(places, key=lambda label: places[label])[:_MAX_ROWS])
    return [label for label in rankings[0] if label in kept]


def _named(study: Sensitivity, label: str) -> str:
    one = study.imperfections[label]
    unit = "" if one.unit in ("", "1") else f" {one.unit}"
    low, high = one.range
    # Three digits of the range's width: four of the values hid how far 1.0002 is from 1.
    digits = 4 if low == high else max(4, 3 + math.ceil(math.log10(max(abs(low), abs(high)) / (high - low))))
    return f"{label}, {low:.{digits}g} to {high:.{digits}g}{unit}"
