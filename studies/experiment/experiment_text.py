"""The text output of `linkplan experiment`: tables of eighty columns."""

import math
from collections.abc import Sequence

from linkplan.studies.experiment.experiment import Experiment
from linkplan.studies.experiment.statistics import Estimate
from linkplan.studies.experiment.summary import Summary
from linkplan.studies.output.tables import table


def experiment_text(name: str, summary: Summary, design: str, seed: int, tube: str, notes: Sequence[str] = ()) -> str:
    """Return an experiment's tables: trackers with 95 % intervals, pairs of trackers, the worst samples, and notes."""
    errors = [metric.removeprefix("rms_error_") for metric in summary.metrics if metric.startswith("rms_error_")]
    lines = [
        f"{name}: {summary.samples} machines ({design}, seed {seed}), the same for every tracker",
        f"means with their 95 % intervals; success: within {tube} of the path all the way",
        "",
    ]
    for unit in errors:
        head = ["tracker", f"rms [{unit}]", f"max [{unit}]", f"final [{unit}]", "success [%]", "failed"]
        rows = []
        for one in summary.trackers:
            means = [estimated(one.means[f"{which}_error_{unit}"]) for which in ("rms", "max", "final")]
            rows.append([one.name, *means, _share(one.success), str(sum(one.failures.values()))])
        lines += [table(head, rows), ""]
    effort = summary.metrics["peak_effort"].unit
    head = [
        "tracker",
        f"peak [{effort}]",
        "energy [J]",
        f"chatter [{effort}]",
        "at limit [%]",
        "gap [um]",
    ]
    rows = [
        [
            one.name,
            *(one.means[metric].value for metric in ("peak_effort", "energy_j", "chatter")),
            100 * one.means["saturated_share"].value,
            one.means["loop_gap_um"].value,
        ]
        for one in summary.trackers
    ]
    lines += [table(head, rows)]
    if summary.pairs:
        unit = summary.metrics[summary.pairs[0].metric].unit
        head = ["pair, sample by sample", f"rms, first - second [{unit}]", "first is better [%]"]
        rows = [[f"{p.first}, {p.second}", estimated(p.difference), _share(p.wins)] for p in summary.pairs]
        lines += ["", table(head, rows)]
    lines += ["", "worst samples: " + "; ".join(f"{one.name} {', '.join(map(str, one.worst))}" for one in summary.trackers)]
    for one in summary.trackers:
        lines += [f"{one.name}, {count} failed: {text}" for text, count in one.failures.items()]
    lines += [f"note: {note}" for note in notes]
    return "\n".join(lines)


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


def _share(one: Estimate) -> str:
    if not math.isfinite(one.value):
        return "-"
    return f"{100 * one.value:.0f} ({math.floor(100 * one.low)}-{math.ceil(100 * one.high)})"
