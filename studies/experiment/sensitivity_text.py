"""The text output of `linkplan experiment` on the influence of imperfections: tables of eighty columns."""

import math

import numpy as np

from linkplan.studies.experiment.sensitivity import MEASURES, Sensitivity
from linkplan.studies.output.tables import folded, table
from linkplan.studies.sensitivity.scheme import SOBOL

# Number of imperfections in the tables.
_MAX_ROWS = 12


def sensitivity_text(name: str, sensitivity: Sensitivity, seed: int) -> str:
    """Return the tables of a sensitivity: importances for the rms error, and the most important ones for every metric."""
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
        lines += [f"{what}, with 95 % intervals" if groups > 1 else what, ""]
        lines += [_importance_table(sensitivity, metric, numbers), ""]
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


def _importance_table(sensitivity: Sensitivity, metric: str, numbers: dict[int, int]) -> str:
    """Return the table of importances for a metric, with imperfections as rows and trackers as columns."""
    trackers = tuple(sensitivity.influences)
    rows = [
        [
            f"{number:2d} {sensitivity.factors[i].label}",
            *(_importance_text(sensitivity, tracker, metric, i) for tracker in trackers),
        ]
        for i, number in numbers.items()
    ]
    if sensitivity.design == SOBOL:
        rows.append(["sum of first-order indices", *(_additive(sensitivity, tracker, metric) for tracker in trackers)])
    return table(["imperfection", *trackers], rows)


def shown(sensitivity: Sensitivity) -> list[int]:
    """Return the indices of the imperfections in tables and figures, by their largest relative importance in a rms error."""
    best = np.zeros(len(sensitivity.factors))
    for by_metric in sensitivity.influences.values():
        for metric in sensitivity.mains:
            sizes = np.nan_to_num(by_metric[metric].importance, nan=0.0, posinf=np.inf)
            finite = sizes[np.isfinite(sizes)]
            largest = float(finite.max()) if len(finite) and finite.max() > 0 else 1.0
            best = np.maximum(best, sizes / largest)
    return [int(i) for i in np.argsort(-best, kind="stable")[:_MAX_ROWS]]


def _known(sensitivity: Sensitivity, tracker: str, metric: str) -> bool:
    sizes = sensitivity.influences[tracker][metric].importance
    return bool(np.any(~np.isnan(sizes) & (sizes > 0)))


def _importance_text(sensitivity: Sensitivity, tracker: str, metric: str, i: int) -> str:
    """Return an importance as text, with the decimals that give the tracker's largest importance two significant digits."""
    one, sizes = sensitivity.importance(tracker, metric, i), sensitivity.influences[tracker][metric].importance
    if math.isinf(one.value):
        return "lost at an end"
    if math.isnan(one.value):
        return "-"
    largest = max((size for size in sizes if math.isfinite(size)), default=0.0)
    digits = max(0, 1 - math.floor(math.log10(largest))) if largest > 0 else 0
    if digits > 6:
        return f"{one.value:.2g}"
    half = f" ± {one.half:.{digits}f}" if math.isfinite(one.half) and one.half > 0 else ""
    return f"{one.value:.{digits}f}{half}"


def _additive(sensitivity: Sensitivity, tracker: str, metric: str) -> str:
    total = float(np.sum(sensitivity.influences[tracker][metric].parts["first_order"]))
    return f"{total:.2f}" if math.isfinite(total) else "-"


def _foremost(sensitivity: Sensitivity, tracker: str, metric: str, numbers: dict[int, int]) -> str:
    """Return the numbers of the two most important imperfections, if their importance is significant."""
    one = sensitivity.influences[tracker][metric]
    certain = [i for i in one.order[:2] if one.importance[i] > 0 and not one.low[i] <= 0]
    return ", ".join(str(numbers[i]) if i in numbers else sensitivity.factors[i].label for i in certain) or "-"


def _left_out(sensitivity: Sensitivity) -> list[str]:
    lines = []
    for tracker, by_metric in sensitivity.influences.items():
        one = by_metric[sensitivity.mains[0]]
        if one.left_out:
            lines.append(
                folded(
                    f"{tracker}: {one.left_out} of {one.groups} groups are left out of the errors, because it failed on one"
                    " of their machines; the figure 'success' shows the causes of failures"
                )
            )
    return ["", *lines] if lines else []
