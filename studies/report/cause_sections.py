"""Bar charts of the causes of tracking errors, from the records of a decomposition and of a sensitivity study."""

import math
from collections.abc import Mapping

from linkplan.studies.decompose.decomposition_text import whole_column
from linkplan.studies.report.document import Axis, Bar, Bars, Block, Section, Span, Text

# Indices of the colours of causes that raise a figure, lower it, or act together with others; the same in all figures.
_RAISING_COLOUR, _LOWERING_COLOUR, _TOTAL_COLOUR = 1, 0, 5


def decomposition_charts(record: Mapping) -> list[Bars]:
    """Return a chart for each tracker and unit of a decomposition's record; each part starts at the end of the last one.

    The record has "parts" (name to words) and, by tracker and unit, "rms_error" with its "parts" in that unit.
    """
    words, found = record["parts"], []
    for tracker, said in record["trackers"].items():
        for unit, shares in said.items():
            if not isinstance(shares, Mapping) or "rms_error" not in shares:
                continue
            rows, end = [], 0.0
            *notes, whole_note = whole_column([*shares["parts"].values(), shares["rms_error"]])
            for (name, part), note in zip(shares["parts"].items(), notes, strict=True):
                begin, end = end, end + part
                sign, colour = ("adds to it", _RAISING_COLOUR) if part >= 0 else ("takes away", _LOWERING_COLOUR)
                span = Span(name=sign, start=begin, end=end, colour=colour)
                rows.append(Bar(label=words[name].partition(":")[0], spans=[span], note=note))
            whole = Span(name="rms error", start=0.0, end=shares["rms_error"], colour=None)
            rows.append(Bar(label="rms error", spans=[whole], note=whole_note))
            axis = Axis(label="part of the rms error", unit=unit)
            title = f"{tracker}: parts of the rms error"
            found.append(Bars(title=title, axis=axis, rows=rows, note_name=f"[{unit}]"))
    return found


def sensitivity_section(record: Mapping, *, depth: int = 2) -> Section:
    """Return the section of a sensitivity's record: the influence of each imperfection on each tracker's rms error.

    The record is "sensitivity" of an experiment. By tracker and metric it has "middle" and "effects": the importance of each
    imperfection, its interval, and the values specific to the design.
    """
    mains = [name for name in record["metrics"] if name.startswith("rms_error")]
    machines = record["groups"] * record["group_size"]
    blocks: list[Block] = [Text(text=f"Importance: {record['measure']}; {machines} machines.")]
    for metric in mains:
        shown = _foremost(record, metric)
        for tracker, by_metric in record["trackers"].items():
            draw = _CHARTS[record["design"]]
            axis, rows, line = draw(record, metric, by_metric[metric], shown)
            title = f"{tracker}: what the {record['metrics'][metric]['text']} due to each imperfection"
            name = "" if line == 0 else f"all in the middle, {_said(line)}"
            beside = "total" if record["design"] == "sobol" else f"change [{axis.unit}]"
            chart = Bars(title=title, axis=axis, rows=rows, line=line, line_name=name, note_name=beside)
            blocks.append(chart)
    return Section(title="Which imperfection matters most", blocks=blocks, depth=depth)


def _foremost(record: Mapping, metric: str) -> list[str]:
    """Return the twelve imperfections that matter most for any tracker, in the order of the first tracker's ranking."""
    rankings = [by_metric[metric]["ranking"] for by_metric in record["trackers"].values()]
    places = {label: min(ranking.index(label) for ranking in rankings) for label in record["imperfections"]}
    kept = set(sorted(places, key=lambda label: places[label])[:12])
    return [label for label in rankings[0] if label in kept]


def _ends(record: Mapping, metric: str, found: Mapping, shown: list[str]) -> tuple[Axis, list[Bar], float]:
    """Return the change due to each end of an imperfection's range, with all others in the middle of theirs."""
    middle, rows = found["middle"] or 0.0, []
    for label in shown:
        effect = found["effects"][label]
        ends = (("low", effect.get("at_low"), _LOWERING_COLOUR), ("high", effect.get("at_high"), _RAISING_COLOUR))
        spans = [
            Span(name=f"at the {name} end", start=middle, end=value, colour=colour)
            for name, value, colour in ends
            if value is not None
        ]
        lost = [f"lost at the {name} end" for name, value, _ in ends if value is None]
        rows.append(Bar(label=_named(record, label), spans=spans, note=", ".join(lost) or _said(effect["importance"])))
    text = record["metrics"][metric]
    return Axis(label=text["text"], unit=text["metric_unit"]), rows, middle


def _effects(record: Mapping, metric: str, found: Mapping, shown: list[str]) -> tuple[Axis, list[Bar], float]:
    """Return Morris' mean absolute effect, split into the effects that raise the figure and those that lower it."""
    rows = []
    for label in shown:
        effect = found["effects"][label]
        size, mean = effect["importance"], effect["mean"]
        if size is None or mean is None:
            rows.append(Bar(label=_named(record, label), spans=[], note="unknown"))
            continue
        spans = [
            Span(name="raises it, from the low to the high end", start=0.0, end=(size + mean) / 2, colour=_RAISING_COLOUR),
            Span(name="lowers it", start=0.0, end=-(size - mean) / 2, colour=_LOWERING_COLOUR),
        ]
        rows.append(Bar(label=_named(record, label), spans=spans, note=_with_interval(effect)))
    text = record["metrics"][metric]
    return Axis(label=f"mean change of the {text['text']}", unit=text["metric_unit"]), rows, 0.0


def _shares(record: Mapping, _metric: str, found: Mapping, shown: list[str]) -> tuple[Axis, list[Bar], float]:
    """Return Sobol's first-order and total indices as shares of the variance."""
    rows = []
    for label in shown:
        effect = found["effects"][label]
        spans = []
        for name, value, low, high, colour in (
            ("by itself or with others (total index)", effect["importance"], *effect["interval95"], _TOTAL_COLOUR),
            ("by itself (first-order index)", effect["first_order"], *_about(effect), _LOWERING_COLOUR),
        ):
            if value is not None:
                ends = [None if x is None else 100 * x for x in (low, high)]
                end = 100 * max(value, 0.0)
                spans.append(Span(name=name, start=0.0, end=end, colour=colour, low=ends[0], high=ends[1]))
        total = effect["importance"]
        rows.append(Bar(label=_named(record, label), spans=spans, note="" if total is None else f"{100 * total:.0f} %"))
    return Axis(label="share of the variance", unit="%"), rows, 0.0


_CHARTS = {"one-at-a-time": _ends, "morris": _effects, "sobol": _shares}


def _about(effect: Mapping) -> tuple[float | None, float | None]:
    value, half = effect["first_order"], effect["first_order_half"]
    return (None, None) if value is None or half is None else (value - half, value + half)


def _named(record: Mapping, label: str) -> str:
    """Return an imperfection's name with its range."""
    one = record["imperfections"][label]
    if one["range"] is None:
        return label
    unit = "" if one["unit"] in ("", "1") else f" {one['unit']}"
    return f"{label}, {one['range'][0]:.4g} to {one['range'][1]:.4g}{unit}"


def _with_interval(effect: Mapping) -> str:
    low, high = effect["interval95"]
    half = "" if low is None or high is None else f" ± {(high - low) / 2:.1g}"
    return f"{_said(effect['importance'])}{half}"


def _said(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:.3g}"
