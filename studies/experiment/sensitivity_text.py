"""What `linkplan experiment` prints of imperfections' influences: tables of eighty columns."""

import math

import numpy as np

from linkplan.studies.experiment.sensitivity import MEASURES, Sensitivity
from linkplan.studies.output.tables import folded, table
from linkplan.studies.sensitivity.scheme import SOBOL

# Imperfections that are shown, and those of them that are named for each metric.
_MOST, _NAMED = 12, 2
# Of more digits after the point than these a number is written with its exponent.
_DIGITS = 6


def sensitivity_text(name: str, sensitivity: Sensitivity, seed: int) -> str:
    """Return the tables of a sensitivity: importances in the rms error, and the most important ones for every metric."""
    groups, size, trackers = sensitivity.groups, sensitivity.size, tuple(sensitivity.influences)
    made = f"{groups} groups of {size} machines" if groups > 1 else f"{size} machines"
    lines = [
        folded(f"{name}: which imperfection matters most ({sensitivity.design}, {made}, seed {seed})"),
        folded(f"importance: {MEASURES[sensitivity.design]}"),
        "",
    ]
    order = shown(sensitivity)
    numbers = {i: k + 1 for k, i in enumerate(order)}
    for metric in sensitivity.mains:
        unit = sensitivity.unit(metric)
        of = f"of the {sensitivity.metrics[metric].text}"
        what = f"shares of the variance {of}" if sensitivity.design == SOBOL else f"{of} [{unit}]"
        rows = [
            [
                f"{numbers[i]:2d} {sensitivity.factors[i].label}",
                *(_said(sensitivity, tracker, metric, i) for tracker in trackers),
            ]
            for i in order
        ]
        if sensitivity.design == SOBOL:
            rows.append(["sum of first-order indices", *(_additive(sensitivity, tracker, metric) for tracker in trackers)])
        lines += [
            f"{what}, with 95 % intervals" if groups > 1 else what,
            "",
            table(["imperfection", *trackers], rows),
            "",
        ]
    hidden = len(sensitivity.factors) - len(order)
    if hidden:
        lines += [f"{hidden} more matter{'s' if hidden == 1 else ''} less for every tracker; the record has them", ""]
    names = [metric for metric in sensitivity.metrics if any(_known(sensitivity, t, metric) for t in trackers)]
    rows = [[metric, *(_foremost(sensitivity, t, metric, numbers) for t in trackers)] for metric in names]
    lines += [
        "what matters most for each figure, by number; - for nothing that is certain",
        "",
        table(["figure", *trackers], rows),
    ]
    return "\n".join([*lines, *_left_out(sensitivity)])


def shown(sensitivity: Sensitivity) -> list[int]:
    """Return the imperfections that are shown, by what they matter in the rms errors at the most, over all trackers."""
    best = np.zeros(len(sensitivity.factors))
    for by_metric in sensitivity.influences.values():
        for metric in sensitivity.mains:
            sizes = np.nan_to_num(by_metric[metric].importance, nan=0.0, posinf=np.inf)
            finite = sizes[np.isfinite(sizes)]
            largest = float(finite.max()) if len(finite) and finite.max() > 0 else 1.0
            best = np.maximum(best, sizes / largest)
    return [int(i) for i in np.argsort(-best, kind="stable")[:_MOST]]


def _known(sensitivity: Sensitivity, tracker: str, metric: str) -> bool:
    sizes = sensitivity.influences[tracker][metric].importance
    return bool(np.any(~np.isnan(sizes) & (sizes > 0)))


def _said(sensitivity: Sensitivity, tracker: str, metric: str, i: int) -> str:
    """Return an importance to the figures that the tracker's largest one has two of: columns are read downwards."""
    one, sizes = sensitivity.importance(tracker, metric, i), sensitivity.influences[tracker][metric].importance
    if math.isinf(one.value):
        return "lost at an end"
    if math.isnan(one.value):
        return "-"
    largest = max((size for size in sizes if math.isfinite(size)), default=0.0)
    digits = max(0, 1 - math.floor(math.log10(largest))) if largest > 0 else 0
    if digits > _DIGITS:
        return f"{one.value:.2g}"
    half = f" ± {one.half:.{digits}f}" if math.isfinite(one.half) and one.half > 0 else ""
    return f"{one.value:.{digits}f}{half}"


def _additive(sensitivity: Sensitivity, tracker: str, metric: str) -> str:
    total = float(np.sum(sensitivity.influences[tracker][metric].parts["first_order"]))
    return f"{total:.2f}" if math.isfinite(total) else "-"


def _foremost(sensitivity: Sensitivity, tracker: str, metric: str, numbers: dict[int, int]) -> str:
    """Return the most important imperfections by number: those that tell from none."""
    one = sensitivity.influences[tracker][metric]
    certain = [i for i in one.order[:_NAMED] if one.importance[i] > 0 and not one.low[i] <= 0]
    return ", ".join(str(numbers[i]) if i in numbers else sensitivity.factors[i].label for i in certain) or "-"


def _left_out(sensitivity: Sensitivity) -> list[str]:
    lines = []
    for tracker, by_metric in sensitivity.influences.items():
        one = by_metric[sensitivity.mains[0]]
        if one.left_out:
            lines.append(
                folded(
                    f"{tracker}: {one.left_out} of {one.groups} groups are left out of the errors, for it failed on one of"
                    " their machines; what it owes failures to, success tells"
                )
            )
    return ["", *lines] if lines else []
