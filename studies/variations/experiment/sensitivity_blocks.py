"""A sensitivity as a document: tables and bar charts of the influence of each imperfection on each tracker's figures."""

import math
from collections.abc import Iterator, Mapping

from linkplan.studies.output.document import (
    LOWERING_COLOUR,
    RAISING_COLOUR,
    TOTAL_COLOUR,
    Axis,
    Bar,
    Bars,
    Block,
    Span,
    Table,
    Text,
    table_of,
)
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.variations.experiment.sensitivity import MetricInfluence, Sensitivity
from linkplan.studies.variations.sensitivity.scheme import SOBOL

# Number of imperfections in tables and charts.
_MAX_ROWS = 12


def sensitivity_blocks(name: str, study: Sensitivity, seed: int) -> list[Block]:
    """Return the importances for the rms errors as tables and charts, and the most important ones for every metric."""
    groups, size, mains = study.groups, study.group_size, study.mains
    made = f"{groups} groups of {size} machines" if groups > 1 else f"{size} machines"
    blocks: list[Block] = [
        Text(text=f"{name}: which imperfection matters most ({study.design}, {made}, seed {seed})"),
        Text(text=f"importance: {study.measure}"),
    ]
    shown = _foremost(study, mains[0])
    for metric in mains:
        blocks += [_importances(study, metric, shown), *sensitivity_charts(study, metric)]
    hidden = len(study.imperfections) - len(shown)
    if hidden:
        text = (
            f"{hidden} more {'has' if hidden == 1 else 'have'} less influence on every tracker; the record has"
            f" {'it' if hidden == 1 else 'them'}"
        )
        blocks.append(Text(text=text))
    said = {metric: [_most_important(one[metric], shown) for one in study.trackers.values()] for metric in study.metrics}
    rows = [[metric, *cells] for metric, cells in said.items() if any(cells)]
    title = "Numbers of the most influential imperfections for each figure; -: no influence is significant"
    return [
        *blocks,
        table_of(title, ["figure", *((tracker, "") for tracker in study.trackers)], rows),
        *_left_out(study),
    ]


def tornado_figures(name: str, study: Sensitivity) -> Iterator[tuple[str, FigureSpec]]:
    """Yield the figure of each rms error by its name: "sensitivity", and a second one for hinges and slides together."""
    for i, metric in enumerate(study.mains):
        yield "sensitivity" if i == 0 else f"sensitivity_{metric}", tornado_figure(name, study, metric)


def tornado_figure(name: str, study: Sensitivity, metric: str) -> FigureSpec:
    """Return the figure of the imperfections' influences on a metric of a plan's runs."""
    charts, machines = sensitivity_charts(study, metric), study.groups * study.group_size
    text = study.metrics[metric]["text"]
    title = f"{name}: influence of each imperfection on the {text} ({study.design}, {machines} machines)"
    height_in = 1.4 + 0.33 * len(charts[0].rows)
    return FigureSpec(panels=charts, title=title, columns=2, panel_in=(6.5, height_in))


def sensitivity_charts(study: Sensitivity, metric: str) -> list[Bars]:
    """Return a chart for each tracker of the influence of each imperfection on a metric."""
    found = []
    for tracker, by_metric in study.trackers.items():
        axis, rows, line = _CHARTS[study.design](study, metric, by_metric[metric], _foremost(study, metric))
        title = f"{tracker}: influence of each imperfection on the {study.metrics[metric]['text']}"
        name = "" if line == 0 else f"all in the middle, {_text(line)}"
        beside = "total" if study.design == SOBOL else f"change [{axis.unit}]"
        found.append(Bars(title=title, axis=axis, rows=rows, line=line, line_name=name, note_name=beside))
    return found


def _importances(study: Sensitivity, metric: str, shown: list[str]) -> Table:
    """Return the table of importances for a metric, with imperfections as rows and trackers as columns."""
    one, trackers = study.metrics[metric], study.trackers.values()
    rows = [
        [f"{k} {label}", *(_importance(by_metric[metric].effects, label) for by_metric in trackers)]
        for k, label in enumerate(shown, 1)
    ]
    shares = study.design == SOBOL
    if shares:
        sums = [[effect["first_order"] for effect in by_metric[metric].effects.values()] for by_metric in trackers]
        totals = [None if None in values else f"{sum(values):.2f}" for values in sums]
        rows.append(["sum of first-order indices", *totals])
    of = f"of the {one['text']}"
    what = f"Shares of the variance {of}" if shares else f"Importance for the {one['text']} [{one['unit']}]"
    return table_of(
        f"{what}, with 95 % intervals" if study.groups > 1 else what,
        ["imperfection", *((tracker, "") for tracker in study.trackers)],
        rows,
    )


def _importance(effects: Mapping, label: str) -> str | None:
    """Return an importance as text, with the decimals that give the tracker's largest importance two significant digits."""
    effect = effects[label]
    if effect["importance"] is None:
        return "failed at an end" if None in (effect.get("at_low", 0), effect.get("at_high", 0)) else None
    largest = max(one["importance"] for one in effects.values() if one["importance"] is not None)
    digits = max(0, 1 - math.floor(math.log10(largest))) if largest > 0 else 0
    if digits > 6:
        return f"{effect['importance']:.2g}"
    low, high = effect["interval95"]
    half = 0.0 if low is None or high is None else (high - low) / 2
    return f"{effect['importance']:.{digits}f}" + (f" ± {half:.{digits}f}" if half > 0 else "")


def _most_important(found: MetricInfluence, shown: list[str]) -> str | None:
    """Return the numbers of the two most important imperfections, if their importance is significant."""
    certain = [
        label
        for label in found.ranking[:2]
        if (found.effects[label]["importance"] or 0) > 0 and not (found.effects[label]["interval95"][0] or 1) <= 0
    ]
    return ", ".join(str(shown.index(label) + 1) if label in shown else label for label in certain) or None


def _left_out(study: Sensitivity) -> list[Text]:
    main, notes = study.mains[0], []
    for tracker, by_metric in study.trackers.items():
        if by_metric[main].left_out:
            text = (
                f"{tracker}: {by_metric[main].left_out} of {study.groups} groups are omitted from the errors, because it"
                " failed on one of their machines; the influences on 'success' show the causes of failures"
            )
            notes.append(Text(text=text, tone="note"))
    return notes


def _foremost(study: Sensitivity, metric: str) -> list[str]:
    """Return the imperfections that matter most for any tracker, in the order of the first tracker's ranking."""
    rankings = [by_metric[metric].ranking for by_metric in study.trackers.values()]
    places = {label: min(ranking.index(label) for ranking in rankings) for label in study.imperfections}
    kept = set(sorted(places, key=lambda label: places[label])[:_MAX_ROWS])
    return [label for label in rankings[0] if label in kept]


def _ends(study: Sensitivity, metric: str, found: MetricInfluence, shown: list[str]) -> tuple[Axis, list[Bar], float]:
    """Return the change due to each end of an imperfection's range, with all others in the middle of theirs."""
    middle, rows = found.middle or 0.0, []
    for label in shown:
        effect = found.effects[label]
        ends = (("low", effect.get("at_low"), LOWERING_COLOUR), ("high", effect.get("at_high"), RAISING_COLOUR))
        spans = [
            Span(name=f"at the {name} end", start=middle, end=value, colour=colour)
            for name, value, colour in ends
            if value is not None
        ]
        lost = [f"failed at the {name} end" for name, value, _ in ends if value is None]
        rows.append(Bar(label=_named(study, label), spans=spans, note=", ".join(lost) or _text(effect["importance"])))
    text = study.metrics[metric]
    return Axis(label=text["text"], unit=text["metric_unit"]), rows, middle


def _effects(study: Sensitivity, metric: str, found: MetricInfluence, shown: list[str]) -> tuple[Axis, list[Bar], float]:
    """Return Morris' mean absolute effect, split into the effects that raise the figure and those that lower it."""
    rows = []
    for label in shown:
        effect = found.effects[label]
        size, mean = effect["importance"], effect["mean"]
        if size is None or mean is None:
            rows.append(Bar(label=_named(study, label), spans=[], note="unknown"))
            continue
        spans = [
            Span(name="increases it, from the low to the high end", start=0.0, end=(size + mean) / 2, colour=RAISING_COLOUR),
            Span(name="lowers it", start=0.0, end=-(size - mean) / 2, colour=LOWERING_COLOUR),
        ]
        rows.append(Bar(label=_named(study, label), spans=spans, note=_with_interval(effect)))
    text = study.metrics[metric]
    return Axis(label=f"mean change of the {text['text']}", unit=text["metric_unit"]), rows, 0.0


def _shares(study: Sensitivity, _metric: str, found: MetricInfluence, shown: list[str]) -> tuple[Axis, list[Bar], float]:
    """Return Sobol's first-order and total indices as shares of the variance."""
    rows = []
    for label in shown:
        effect = found.effects[label]
        spans = []
        for name, value, low, high, colour in (
            ("by itself or with others (total index)", effect["importance"], *effect["interval95"], TOTAL_COLOUR),
            ("by itself (first-order index)", effect["first_order"], *_about(effect), LOWERING_COLOUR),
        ):
            if value is not None:
                ends = [None if x is None else 100 * x for x in (low, high)]
                end = 100 * max(value, 0.0)
                spans.append(Span(name=name, start=0.0, end=end, colour=colour, low=ends[0], high=ends[1]))
        total = effect["importance"]
        rows.append(Bar(label=_named(study, label), spans=spans, note="" if total is None else f"{100 * total:.0f} %"))
    return Axis(label="share of the variance", unit="%"), rows, 0.0


_CHARTS = {"one-at-a-time": _ends, "morris": _effects, "sobol": _shares}


def _about(effect: Mapping) -> tuple[float | None, float | None]:
    value, half = effect["first_order"], effect["first_order_half"]
    return (None, None) if value is None or half is None else (value - half, value + half)


def _named(study: Sensitivity, label: str) -> str:
    one = study.imperfections[label]
    if one.range is None:
        return label
    unit = "" if one.unit in ("", "1") else f" {one.unit}"
    return f"{label}, {one.range[0]:.4g} to {one.range[1]:.4g}{unit}"


def _with_interval(effect: Mapping) -> str:
    low, high = effect["interval95"]
    half = "" if low is None or high is None else f" ± {(high - low) / 2:.1g}"
    return f"{_text(effect['importance'])}{half}"


def _text(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:.3g}"
