"""A sensitivity as a document: tables and bar charts of the influence of each imperfection on each tracker's figures."""

import math
from collections.abc import Iterator

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
from linkplan.studies.variations.experiment.sensitivity import Influence, Sensitivity

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
