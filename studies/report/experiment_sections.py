"""An experiment's part of a report: trackers on many machines, in pairs, how their figures lie, the worst cases."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from linkplan.planner.keys.quantities import QUANTITIES
from linkplan.planner.problem.imperfections import Factor
from linkplan.studies.experiment.experiment import Experiment
from linkplan.studies.experiment.experiment_text import estimated, tube_text
from linkplan.studies.experiment.metrics import Metric
from linkplan.studies.experiment.statistics import Estimate, Pair
from linkplan.studies.experiment.study import Outcome
from linkplan.studies.output.drawing import SERIES, TRACKER_COLOURS
from linkplan.studies.report.cause_sections import sensitivity_section
from linkplan.studies.report.document import Axis, Block, Code, Facts, Plot, Section, Series, Table, Text
from linkplan.studies.report.numbers import rounded

# The command that runs a tracker's sample again.
Again = Callable[[str, int], str]
# Distributions that are drawn beside the trackers' table, of metrics that begin so; those of the others are folded away.
_FIRST = ("rms_error", "max_error", "final_error", "peak_effort", "chatter", "saturated_share")
# Places of a distribution's line: shares of the machines, from none to all.
_PLACES = 101
# A figure that grows by more than this factor from its fifth percentile on is drawn on a logarithmic axis.
_LOGARITHMIC, _LOW = 20.0, 0.05
_WORDS = (("rms", "rms"), ("max", "largest"), ("final", "final"))
# Widths of the first tracker's lines and of the last one's [px]: what lies beneath is still seen.
_WIDEST, _THINNEST = 3.4, 1.2
# The columns that a table of trackers has beside the errors: metric, head, unit, factor.
_OTHERS = (
    ("peak_effort", "peak effort", "", 1.0),
    ("rms_effort", "rms effort", "", 1.0),
    ("energy_j", "energy", "J", 1.0),
    ("chatter", "effort's total variation", "", 1.0),
    ("saturated_share", "at the limit", "%", 100.0),
    ("settling_s", "settling", "s", 1.0),
    ("loop_gap_um", "closure gap", "um", 1.0),
)


def experiment_sections(outcome: Outcome, again: Again | None, *, depth: int = 1) -> list[Section]:
    """Return the sections of an experiment; `again` says how a sample is run again, where there is a way to say it."""
    experiment, below = outcome.experiment, depth + 1
    sensitivity = outcome.record.get("sensitivity")  # of a design that tells imperfections' influences apart
    drawn = [name for start in _FIRST for name in outcome.summary.metrics if name.startswith(start)]
    others = [name for name in outcome.summary.metrics if name not in drawn]
    lie = [  # means and distributions are those of machines that lie as the imperfections do
        Section(title="How the figures are distributed", blocks=_plots(outcome, drawn), depth=below),
        Section(title="Distributions of the other figures", blocks=_plots(outcome, others), depth=below, folded=True),
    ]
    pairs = [Section(title="Trackers in pairs", blocks=[_pairs(outcome)], depth=below)] if outcome.summary.pairs else []
    tables = _tables(outcome) if outcome.distributed else []
    return [
        Section(
            title=f"Experiment: {experiment.plan.problem.name}",
            blocks=[_facts(outcome), *tables, *_failures(outcome)],
            depth=depth,
        ),
        *([*pairs, *lie] if outcome.distributed else []),
        *([sensitivity_section(sensitivity, depth=below)] if sensitivity else []),
        *([Section(title="Worst cases", blocks=_worst(outcome, again), depth=below)] if outcome.distributed else []),
        Section(title="Imperfections of the machines", blocks=[_imperfections(experiment)], depth=below),
    ]


def _facts(outcome: Outcome) -> Facts:
    experiment, settings = outcome.experiment, outcome.experiment.settings
    reference = experiment.reference
    rows = [
        ("machines", f"{experiment.n}, the same for every tracker"),
        ("design", f"{settings.design}, seed {settings.seed}"),
        ("success", f"within {tube_text(experiment)} of the path all the way"),
        ("simulated", f"{reference.period_s * reference.n:.4g} s each, control period {reference.period_s:g} s"),
    ]
    return Facts(rows=rows)


def _tables(outcome: Outcome) -> list[Block]:
    summary = outcome.summary
    units = [name.removeprefix("rms_error_") for name in summary.metrics if name.startswith("rms_error_")]
    errors = [(f"{which}_error_{unit}", f"{word} error", unit) for unit in units for which, word in _WORDS]
    first = Table(
        title="Trackers: means with half of their 95 % confidence intervals",
        columns=[("tracker", ""), ("success", "%"), ("its 95 % interval", "%"), *((word, unit) for _, word, unit in errors)]
        + [(f"95th percentile of the {word}", unit) for name, word, unit in errors if name.startswith("max")],
        rows=[
            [
                one.name,
                _known(100 * one.success.value, 3),
                _interval(one.success),
                *(estimated(one.means[name]) for name, _, _ in errors),
                *(_known(one.percentile95[name], 3) for name, _, _ in errors if name.startswith("max")),
            ]
            for one in summary.trackers
        ],
    )
    second = Table(
        title="Efforts, energy and closure, means",
        columns=[("tracker", ""), *((head, unit or summary.metrics[name].unit) for name, head, unit, _ in _OTHERS)],
        rows=[
            [one.name, *(_known(factor * one.means[name].value, 3) for name, _, _, factor in _OTHERS)]
            for one in summary.trackers
        ],
    )
    return [first, second]


def _failures(outcome: Outcome) -> list[Block]:
    said = [
        f"{one.name}: {count} of {outcome.summary.samples} runs failed: {text}"
        for one in outcome.summary.trackers
        for text, count in one.failures.items()
    ]
    return [Text(text=text, tone="bad") for text in said]


def _pairs(outcome: Outcome) -> Table:
    metric = outcome.summary.metrics[outcome.summary.pairs[0].metric]
    return Table(
        title=f"Sample by sample, by the {metric.text}: the mean difference, and the share of machines that the first wins",
        columns=[
            ("first", ""),
            ("second", ""),
            ("first less second", metric.unit),
            ("first wins", "%"),
            ("its 95 % interval", "%"),
            ("the better one", ""),
        ],
        rows=[
            [
                pair.first,
                pair.second,
                estimated(pair.difference),
                _known(100 * pair.wins.value, 3),
                _interval(pair.wins),
                _decided(pair),
            ]
            for pair in outcome.summary.pairs
        ],
    )


def _decided(pair: Pair) -> str:
    if pair.wins.n and pair.wins.low > 0.5:
        return f"{pair.first}, on most machines"
    if pair.wins.n and pair.wins.high < 0.5:
        return f"{pair.second}, on most machines"
    return "not decided"


def _interval(one: Estimate) -> str | None:
    if not math.isfinite(one.value):
        return None
    return f"{math.floor(1000 * one.low) / 10:g} to {math.ceil(1000 * one.high) / 10:g}"


def _plots(outcome: Outcome, names: list[str]) -> list[Block]:
    trackers = outcome.experiment.settings.trackers
    found = [_distribution(outcome.population, trackers, name, outcome.summary.metrics[name]) for name in names]
    return [plot for plot in found if plot is not None]


def _distribution(results: Mapping[str, np.ndarray], trackers: tuple[str, ...], name: str, metric: Metric) -> Plot | None:
    """Return the share of machines whose figure is at most so large, by tracker; None where there is but one figure."""
    columns = {tracker: results[name][results["tracker"] == tracker].astype(float) for tracker in trackers}
    known = {tracker: np.sort(values[np.isfinite(values)]) for tracker, values in columns.items()}
    some = [values for values in known.values() if len(values)]
    if not some or np.ptp(np.concatenate(some)) == 0:
        return None
    low, high = min(float(values[int(_LOW * len(values))]) for values in some), max(float(values[-1]) for values in some)
    log = low > 0 and high > _LOGARITHMIC * low
    series = []
    for k, (tracker, values) in enumerate(known.items()):
        if not len(values):
            continue
        rows = np.unique(np.linspace(0, len(values) - 1, _PLACES).astype(int))
        share = 100 * (rows + 1) / len(columns[tracker])
        x = values[rows]
        last = np.append(np.diff(x) > 0, x[-1] < high) & ((x > 0) | (not log))  # of equal figures the largest share
        series.append(
            Series(
                name=tracker,
                x=rounded(np.append(x[last], high), log=log),
                y=rounded(np.append(share[last], share[-1])),
                colour=_colour(tracker, k),
                width=round(_WIDEST - (_WIDEST - _THINNEST) * k / max(1, len(known) - 1), 2),
            )
        )
    ends = [x for one in series for x in (one.x[0], one.x[-1])]
    return Plot(
        title=f"{metric.text[:1].upper()}{metric.text[1:]}",
        group="",
        x_axis=Axis(label=metric.text, unit=metric.unit, log=log),
        y_axis=Axis(label="machines", unit="%", ends=(0.0, 102.0)),
        x=[min(ends), max(ends)],
        series=series,
    )


def _colour(tracker: str, k: int) -> int:
    """Return a tracker's colour, the same as in the figures."""
    return SERIES.index(TRACKER_COLOURS[tracker]) if tracker in TRACKER_COLOURS else (k + 3) % len(SERIES)


def _worst(outcome: Outcome, again: Again | None) -> list[Block]:
    results = outcome.results
    largest = next(name for name in outcome.summary.metrics if name.startswith("max_error"))
    rows, commands = [], []
    for one in outcome.summary.trackers:
        for sample in one.worst:
            (row,) = np.flatnonzero((results["tracker"] == one.name) & (results["sample"] == sample))
            failure = results["failure"][row]
            error = _known(float(results[largest][row]), 4)
            rows.append([one.name, sample, error, bool(results["success"][row]), failure])
            commands += [] if again is None else [again(one.name, sample)]
    heads = [("tracker", ""), ("sample", ""), ("largest error", outcome.summary.metrics[largest].unit), ("success", "")]
    title = "Each tracker's worst machines: failed, or else of the largest error"
    found: list[Block] = [Table(title=title, columns=[*heads, ("failed", "")], rows=rows)]
    if commands:
        text = "\n".join(commands)
        found.append(Code(title="To run them again, to the same bits, each with its whole log", text=text))
    return found


def machine_section(sample: Mapping) -> Section:
    """Return the section of one sample's machine: what was wrong with it; `sample` is the record of its run."""
    units = [QUANTITIES[name.partition(".")[0]].unit for name in sample["imperfections"]]
    rows = [
        [name, float(f"{value:.6g}"), None if unit == "1" else unit]
        for (name, value), unit in zip(sample["imperfections"].items(), units, strict=True)
    ]
    table = Table(title="What is wrong with it", columns=[("imperfection", ""), ("value", ""), ("unit", "")], rows=rows)
    return Section(title=f"Machine {sample['sample']}", blocks=[table])


def _imperfections(experiment: Experiment) -> Table:
    return Table(
        title="What is drawn from where; the rest is as modelled",
        columns=[("imperfection", ""), ("distribution", ""), ("unit", "")],
        rows=[
            [factor.label, _spread(factor), factor.quantity.unit if factor.quantity.unit != "1" else None]
            for factor in experiment.section.factors
        ],
    )


def _spread(factor: Factor) -> str:
    spread = factor.spread
    if spread.kind == "uniform":
        return f"even between {spread.first:.4g} and {spread.second:.4g}"
    if spread.kind == "normal":
        return f"normal about {spread.first:.4g}, standard deviation {spread.second:.4g}"
    return f"{spread.first:.4g}"


def _known(value: float, digits: int) -> float | None:
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None
