"""The result of an experiment, whose fields are the record `experiment.json`: trackers on many machines, pairs, worst."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import field

from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.compare.named_run import NamedRun
from linkplan.studies.output.document import (
    Axis,
    Block,
    Code,
    Facts,
    NumberText,
    Plot,
    Report,
    Section,
    Series,
    Table,
    Text,
    table_of,
)
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.lines import overlaid_width, tracker_colour
from linkplan.studies.output.numbers import rounded
from linkplan.studies.output.plan_sections import plan_sections
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import Result
from linkplan.studies.variations.experiment.block import replay
from linkplan.studies.variations.experiment.experiment import AskedRecord, Experiment, varied
from linkplan.studies.variations.experiment.metrics import Metric
from linkplan.studies.variations.experiment.sensitivity import (
    Sensitivity,
    machines_needed,
    sensitivity_blocks,
    tornado_figures,
)
from linkplan.studies.variations.experiment.statistics import Estimate, Pair, Summary

# The first words of the metrics in the figure, in this order; on a page the distributions of the others are collapsed.
SHOWN = ("rms_error", "max_error", "final_error", "peak_effort", "chatter", "saturated_share")
# The metrics of the second table of trackers, and their heads. Shares are in percent.
_OTHERS = {
    "peak_effort": "peak effort",
    "rms_effort": "rms effort",
    "energy_j": "energy",
    "chatter": "effort's total variation",
    "saturated_share": "at the limit",
    "settling_s": "settling",
    "loop_gap_um": "closure gap",
}


class ExperimentOutcome(Result, Summary, frozen=True, kw_only=True, eq=False, omit_defaults=True):
    """An experiment's inputs, its results as columns, and their summary, whose fields are keys of the JSON.

    `sensitivity` is None without random imperfections, or with too few machines. `folder` has the results, if one was
    given; `again` returns the command that runs a tracker's sample again, for the report.
    """

    name: str = field(name="experiment")
    asked: AskedRecord
    imperfections: dict[str, Any]
    control_period_s: float
    duration_s: float
    notes: list[str]
    sensitivity: Sensitivity | None = None
    experiment: Beside[Experiment] = field(default=NOT_READ, name="(experiment)")
    results: Beside[Mapping[str, np.ndarray]] = NOT_READ  # a row for each run, sample by sample and tracker by tracker
    folder: Beside[Path | None] = NOT_READ
    again: Beside[Callable[[str, int], str] | None] = NOT_READ

    @property
    def passed(self) -> bool:
        """Whether the plan passes."""
        return self.experiment.plan.passed

    def replay(self, tracker: str, sample: int) -> NamedRun:
        """Run one sample again and return the run with its log."""
        return NamedRun.of(replay(self.experiment, tracker, sample)[0], self.experiment.plan.problem.mechanism)

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield the distributions of each tracker's metrics, and the influence of each imperfection."""
        one, metrics = self.experiment, self.metrics
        names = [name for start in SHOWN for name in metrics if name.startswith(start)]
        drawn = distributions(self.results, one.settings.trackers, names, metrics)
        title = f"{one.plan.problem.name}: {self.samples} machines"
        yield "experiment", FigureSpec(panels=drawn, title=title, columns=3, panel_in=(4.0, 3.0))
        if self.sensitivity is not None:
            yield from tornado_figures(self.name, self.sensitivity)

    def blocks(self) -> list[Block]:
        """Return the trackers' metrics, and the influence of every imperfection."""
        made = Text(text=f"{self.name}: {self.samples} machines, means with their 95 % intervals")
        return [made, *summary(self), *pairs(self), worst(self), *sensitivity(self)]

    def document(self) -> Report:
        """Return the report of the experiment and its plan."""
        plan = self.experiment.plan
        best = max(self.trackers.values(), key=lambda one: one.success.value)
        shares = ", ".join(f"{name} {100 * one.success.value:.3g} %" for name, one in self.trackers.items())
        verdict = f"success on {self.samples} machines within {tube_text(self.experiment)}: {shares}"
        sections = [*experiment_sections(self), *plan_sections(plan)]
        title = f"Trackers of {plan.problem.name} on many machines"
        return report_of(title, verdict, None if best.success.value > 0 else False, sections)

    def __repr__(self) -> str:
        return f"ExperimentOutcome({self.name!r}: {self.samples} machines, {', '.join(self.trackers)})"


def sensitivity(outcome: ExperimentOutcome) -> list[Block]:
    """Return the influence of each imperfection, or the number of machines that it needs; nothing without imperfections."""
    if outcome.sensitivity is not None:
        return sensitivity_blocks(outcome.sensitivity)
    factors = outcome.experiment.section.factors
    text = f"the influence of each imperfection needs {machines_needed(factors)} machines or more"
    return [Text(text=text, tone="note")] if varied(factors) else []


def summary(outcome: ExperimentOutcome) -> list[Block]:
    """Return what was simulated, each tracker's means, and the failures."""
    notes = [Text(text=note, tone="note") for note in outcome.notes]
    failures = [
        Text(text=f"{tracker}: {count} of {outcome.samples} runs failed: {text}", tone="bad")
        for tracker, one in outcome.trackers.items()
        for text, count in one.failures.items()
    ]
    return [_facts(outcome), *_tables(outcome), *failures, *notes]


def tube_text(experiment: Experiment) -> str:
    """Return the tube of success as text, for hinges, slides or both."""
    kinds = {joint.kind for joint in experiment.plan.problem.mechanism.independent_joints}
    settings = experiment.settings
    texts = {"hinge": f"{settings.tube_deg:g} deg", "slide": f"{settings.tube_m:g} m"}
    return " and ".join(text for kind, text in texts.items() if kind in kinds)


def estimated(one: Estimate) -> str:
    """Return a mean ± half of its interval, rounded to the first significant digit of the interval."""
    if not math.isfinite(one.value):
        return NumberText.of("-", math.nan)
    if not math.isfinite(one.half) or one.half == 0:
        return NumberText.of(f"{one.value:.3g}", one.value)
    digits = max(0, -math.floor(math.log10(one.half)))
    text = f"{one.value:.{digits}f} ± {one.half:.{digits}f}" if digits <= 6 else f"{one.value:.3g} ± {one.half:.1g}"
    return NumberText.of(text, one.value, one.half, words=("", "±"))


def _facts(outcome: ExperimentOutcome) -> Facts:
    experiment, settings = outcome.experiment, outcome.experiment.settings
    reference = experiment.reference
    rows = [
        ("machines", f"{experiment.n}, the same for every tracker"),
        ("design", f"{settings.design}, seed {settings.seed}"),
        ("success", f"always within {tube_text(experiment)} of the path"),
        ("simulated", f"{reference.period_s * reference.n:.4g} s each, control period {reference.period_s:g} s"),
    ]
    return Facts(rows=rows)


def _tables(outcome: ExperimentOutcome) -> list[Table]:
    errors = [(name, metric.text, metric.unit) for name, metric in outcome.metrics.items() if "_error_" in name]
    largest = [(name, f"95th percentile of the {word}", unit) for name, word, unit in errors if name.startswith("max")]
    heads = ["tracker", "success [%]", "its 95 % interval [%]", "failed", *((word, unit) for _, word, unit in errors)]
    rows = [
        [
            tracker,
            100 * one.success.value,
            _interval(one.success),
            sum(one.failures.values()),
            *(estimated(one.means[name]) for name, _, _ in errors),
            *(one.percentile95[name] for name, _, _ in largest),
        ]
        for tracker, one in outcome.trackers.items()
    ]
    title = "Trackers: means with half of their 95 % confidence intervals"
    first = table_of(title, [*heads, *((word, unit) for _, word, unit in largest)], rows, digits=3)
    units = {name: "%" if (unit := outcome.metrics[name].unit) == "1" else unit for name in _OTHERS}
    others = ["tracker", *((head, units[name]) for name, head in _OTHERS.items())]
    rows = [
        [tracker, *((100.0 if unit == "%" else 1.0) * one.means[name].value for name, unit in units.items())]
        for tracker, one in outcome.trackers.items()
    ]
    return [first, table_of("Efforts, energy and closure, means", others, rows)]


def pairs(outcome: ExperimentOutcome) -> list[Table]:
    """Return the table of pairs of trackers, if there are several trackers."""
    if not outcome.pairs:
        return []
    metric = outcome.metrics[outcome.pairs[0].metric]
    heads = ["first", "second", ("first less second", metric.unit), "first wins [%]", "its 95 % interval [%]"]
    rows = [
        [p.first, p.second, estimated(p.difference), 100 * p.wins.value, _interval(p.wins), _decided(p)]
        for p in outcome.pairs
    ]
    title = (
        f"Comparison of the {metric.text} sample by sample: mean difference, and share of machines on which the first is"
        " better"
    )
    return [table_of(title, [*heads, "the better one"], rows, digits=3)]


def _decided(pair: Pair) -> str:
    if pair.wins.n and pair.wins.low > 0.5:
        return f"{pair.first}, on most machines"
    if pair.wins.n and pair.wins.high < 0.5:
        return f"{pair.second}, on most machines"
    return "not decided"


def _interval(one: Estimate) -> str | None:
    if not math.isfinite(one.value):
        return None
    ends = math.floor(1000 * one.low) / 10, math.ceil(1000 * one.high) / 10
    return NumberText.of(f"{ends[0]:g} to {ends[1]:g}", *ends, words=("from", "to"))


def worst(outcome: ExperimentOutcome) -> Table:
    """Return the table of each tracker's worst machines."""
    results, rows = outcome.results, []
    largest = next(name for name in outcome.metrics if name.startswith("max_error"))
    for tracker, one in outcome.trackers.items():
        for sample in one.worst:
            (row,) = np.flatnonzero((results["tracker"] == tracker) & (results["sample"] == sample))
            cells = [float(results[largest][row]), bool(results["success"][row]), results["failure"][row]]
            rows.append([tracker, sample, *cells])
    heads = ["tracker", "sample", ("largest error", outcome.metrics[largest].unit), "success", "failed"]
    return table_of("Each tracker's worst machines: failed ones, then those with the largest error", heads, rows)


def experiment_sections(outcome: ExperimentOutcome) -> list[Section]:
    """Return the sections of an experiment."""
    experiment, metrics = outcome.experiment, outcome.metrics
    drawn = [name for start in SHOWN for name in metrics if name.startswith(start)]
    others = [name for name in metrics if name not in drawn]

    def section(title: str, blocks: list, *, folded: bool = False) -> list[Section]:
        return [Section(title=title, blocks=blocks, depth=2, folded=folded)] if blocks else []

    def distributed(names: list[str]) -> list[Block]:
        return list(distributions(outcome.results, experiment.settings.trackers, names, metrics))

    found = [Section(title=f"Experiment: {experiment.plan.problem.name}", blocks=summary(outcome))]
    found += section("Trackers in pairs", pairs(outcome))
    found += section("Distributions of the main figures", distributed(drawn))
    found += section("Distributions of the other figures", distributed(others), folded=True)
    found += section("Which imperfection matters most", sensitivity(outcome))
    cases: list[Block] = [worst(outcome)]
    if outcome.again is not None:
        commands = [outcome.again(name, sample) for name, one in outcome.trackers.items() for sample in one.worst]
        cases.append(Code(title="Commands that repeat these runs exactly, with their whole logs", text="\n".join(commands)))
    found += section("Worst cases", cases)
    rows = []
    for factor in experiment.section.factors:
        first, second, unit = factor.spread.first, factor.spread.second, factor.quantity.unit
        said = {
            "uniform": f"even between {first:.4g} and {second:.4g}",
            "normal": f"normal about {first:.4g}, standard deviation {second:.4g}",
            "fixed": f"{first:.4g}",
        }
        rows.append([factor.label, said[factor.spread.kind], unit if unit != "1" else None])
    title = "Distributions of the imperfections; everything else is nominal"
    table = table_of(title, ["imperfection", "distribution", "unit"], rows)
    return [*found, *section("Imperfections of the machines", [table])]


def distributions(
    results: Mapping[str, np.ndarray], trackers: Sequence[str], names: Sequence[str], metrics: Mapping[str, Metric]
) -> list[Plot]:
    """Return the distributions of metrics, without metrics that have the same value on all machines."""
    drawn = [_distribution(results, trackers, name, metrics[name]) for name in names]
    return [plot for plot in drawn if plot is not None]


def _distribution(results: Mapping[str, np.ndarray], trackers: Sequence[str], name: str, metric: Metric) -> Plot | None:
    """Return the cumulative distribution of a metric for every tracker; None if all values are equal.

    Failures keep it below 100 %. The axis is logarithmic if the largest value is more than 20 times the fifth percentile.
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
        shown = (x > 0) | (not log)
        last = np.append(np.diff(x) > 0, x[-1] < high) & shown  # equal values: the largest share
        series.append(
            Series(
                name=tracker,
                x=rounded(np.concatenate([x[shown][:1], x[last], [high]]), log=log),
                y=rounded(np.concatenate([[0.0], share[last], share[-1:]])),
                look="steps",
                colour=tracker_colour(tracker, k + 3),
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
