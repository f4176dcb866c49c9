"""An experiment as a document: trackers on many machines, pairs of trackers, worst machines."""

import math

import numpy as np

from linkplan.studies.output.document import Block, Facts, Table, Text, table_of
from linkplan.studies.variations.experiment.design import varied
from linkplan.studies.variations.experiment.experiment import Experiment
from linkplan.studies.variations.experiment.sensitivity import machines_needed
from linkplan.studies.variations.experiment.sensitivity_blocks import sensitivity_blocks
from linkplan.studies.variations.experiment.statistics import Estimate, Pair
from linkplan.studies.variations.experiment.study import ExperimentOutcome

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


def outcome_blocks(outcome: ExperimentOutcome) -> list[Block]:
    """Return the tables of an outcome."""
    made = Text(text=f"{outcome.name}: {outcome.samples} machines, means with their 95 % intervals")
    return [made, *summary(outcome), *pairs(outcome), worst(outcome), *sensitivity(outcome)]


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
    return [_facts(outcome), *_tables(outcome), *_failures(outcome), *notes]


def tube_text(experiment: Experiment) -> str:
    """Return the tube of success as text, for hinges, slides or both."""
    kinds = {joint.kind for joint in experiment.plan.problem.mechanism.independent_joints}
    settings = experiment.settings
    texts = {"hinge": f"{settings.tube_deg:g} deg", "slide": f"{settings.tube_m:g} m"}
    return " and ".join(text for kind, text in texts.items() if kind in kinds)


def estimated(one: Estimate) -> str:
    """Return a mean ± half of its interval, rounded to the first significant digit of the interval."""
    if not math.isfinite(one.value):
        return "-"
    if not math.isfinite(one.half) or one.half == 0:
        return f"{one.value:.3g}"
    digits = max(0, -math.floor(math.log10(one.half)))
    if digits > 6:
        return f"{one.value:.3g} ± {one.half:.1g}"
    return f"{one.value:.{digits}f} ± {one.half:.{digits}f}"


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


def _failures(outcome: ExperimentOutcome) -> list[Text]:
    said = [
        f"{tracker}: {count} of {outcome.samples} runs failed: {text}"
        for tracker, one in outcome.trackers.items()
        for text, count in one.failures.items()
    ]
    return [Text(text=text, tone="bad") for text in said]


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
    return f"{math.floor(1000 * one.low) / 10:g} to {math.ceil(1000 * one.high) / 10:g}"


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
