"""The sections of an experiment: trackers on many machines, pairs of trackers, distributions of metrics, worst cases."""

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
from linkplan.studies.report.lines import overlaid_width
from linkplan.studies.report.numbers import rounded, significant

# The command that runs a tracker's sample again.
Again = Callable[[str, int], str]
# The distributions of metrics with these first words are shown; those of the others are folded.
_FIRST = ("rms_error", "max_error", "final_error", "peak_effort", "chatter", "saturated_share")
_WORDS = (("rms", "rms"), ("max", "largest"), ("final", "final"))
# The columns of the second table of trackers: metric, head, unit, factor.
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
    """Return the sections of an experiment; `again` returns the command that runs a sample again, if there is one."""
    experiment, below = outcome.experiment, depth + 1
    sensitivity = outcome.record.get("sensitivity")  # of a design of sensitivity analysis
    drawn = [name for start in _FIRST for name in outcome.summary.metrics if name.startswith(start)]
    others = [name for name in outcome.summary.metrics if name not in drawn]
    distributions = [  # meaningful only if the machines are drawn from the distributions of the imperfections
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
        *([*pairs, *distributions] if outcome.distributed else []),
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
                significant(100 * one.success.value, 3),
                _interval(one.success),
                *(estimated(one.means[name]) for name, _, _ in errors),
                *(significant(one.percentile95[name], 3) for name, _, _ in errors if name.startswith("max")),
            ]
            for one in summary.trackers
        ],
    )
    second = Table(
        title="Efforts, energy and closure, means",
        columns=[("tracker", ""), *((head, unit or summary.metrics[name].unit) for name, head, unit, _ in _OTHERS)],
        rows=[
            [one.name, *(significant(factor * one.means[name].value, 3) for name, _, _, factor in _OTHERS)]
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
                significant(100 * pair.wins.value, 3),
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
    """Return the cumulative distribution of a metric for every tracker; None if all values are equal.

    The axis is logarithmic if the largest value is more than 20 times the fifth percentile.
    """
    columns = {tracker: results[name][results["tracker"] == tracker].astype(float) for tracker in trackers}
    known = {tracker: np.sort(values[np.isfinite(values)]) for tracker, values in columns.items()}
    some = [values for values in known.values() if len(values)]
    if not some or np.ptp(np.concatenate(some)) == 0:
        return None
    low, high = min(float(values[int(0.05 * len(values))]) for values in some), max(float(values[-1]) for values in some)
    log = low > 0 and high > 20 * low
    series = []
    for k, (tracker, values) in enumerate(known.items()):
        if not len(values):
            continue
        rows = np.unique(np.linspace(0, len(values) - 1, num=101).astype(int))
        share = 100 * (rows + 1) / len(columns[tracker])
        x = values[rows]
        last = np.append(np.diff(x) > 0, x[-1] < high) & ((x > 0) | (not log))  # equal values: the largest share
        series.append(
            Series(
                name=tracker,
                x=rounded(np.append(x[last], high), log=log),
                y=rounded(np.append(share[last], share[-1])),
                colour=_colour(tracker, k),
                width=overlaid_width(k, len(known)),
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
            error = significant(float(results[largest][row]))
            rows.append([one.name, sample, error, bool(results["success"][row]), failure])
            commands += [] if again is None else [again(one.name, sample)]
    heads = [("tracker", ""), ("sample", ""), ("largest error", outcome.summary.metrics[largest].unit), ("success", "")]
    title = "Each tracker's worst machines: failed, or else of the largest error"
    found: list[Block] = [Table(title=title, columns=[*heads, ("failed", "")], rows=rows)]
    if commands:
        text = "\n".join(commands)
        found.append(Code(title="Commands that repeat these runs exactly, with their whole logs", text=text))
    return found


def machine_section(sample: Mapping) -> Section:
    """Return the section of one sample's machine with its imperfections; `sample` is the record of its run."""
    units = [QUANTITIES[name.partition(".")[0]].unit for name in sample["imperfections"]]
    rows = [
        [name, float(f"{value:.6g}"), None if unit == "1" else unit]
        for (name, value), unit in zip(sample["imperfections"].items(), units, strict=True)
    ]
    table = Table(title="Imperfections", columns=[("imperfection", ""), ("value", ""), ("unit", "")], rows=rows)
    return Section(title=f"Machine {sample['sample']}", blocks=[table])


def _imperfections(experiment: Experiment) -> Table:
    return Table(
        title="Distributions of the imperfections; all else is as modelled",
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
