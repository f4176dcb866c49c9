"""What `linkplan decompose` prints: causes down, trackers across, in tables of eighty columns."""

import math

from linkplan.studies.decompose.decompose import Decomposition
from linkplan.studies.decompose.ladder import RUNGS
from linkplan.studies.output.tables import folded, table

# Figures of the whole error; its parts have as many decimals, so that a column can be added up.
_FIGURES = 4


def decomposition_text(found: Decomposition) -> str:
    """Return the parts of every tracker's rms error, a table for each unit, and what the machines are."""
    experiment = found.experiment
    n, period = experiment.n, experiment.reference.period_s
    machines = "1 machine" if n == 1 else f"{n} machines, seed {experiment.settings.seed}"
    duration = period * experiment.reference.n
    lines = [f"{found.plan.problem.name}: parts of the rms error over {duration:.4g} s, {machines}, period {period:g} s"]
    for unit in dict.fromkeys(unit for one in found.trackers for unit in one.shares):
        ours = {one.name: one.shares[unit] for one in found.trackers if unit in one.shares}
        columns = [whole_column([*shares.parts, shares.rms]) for shares in ours.values()]
        labels = [*(text.partition(":")[0] for text in RUNGS.values()), "rms error"]
        rows = [[label, *cells] for label, *cells in zip(labels, *columns, strict=True)]
        lines += ["", table([f"switched on [{unit}]", *ours], rows)]
    lines += ["", *(folded(said) for said in notes(found))]
    return "\n".join(lines)


def notes(found: Decomposition) -> list[str]:
    """Return how the parts are to be read, and why machines were left out."""
    said = ["What is switched on stays on. The parts add up to the rms error; a negative one takes error away."]
    for one in found.trackers:
        said += [f"{one.name}, {n} of {found.experiment.n} machines left out: {why}" for why, n in one.failures.items()]
    return said


def whole_column(values: list[float]) -> list[str]:
    """Return numbers with as many decimals as give the last of them, the whole, its figures; an exact zero as "0"."""
    whole = abs(values[-1])
    decimals = max(0, _FIGURES - 1 - math.floor(math.log10(whole))) if whole > 0 else 0
    form = f".{_FIGURES - 2}e" if decimals > 2 * _FIGURES else f".{decimals}f"
    return ["0" if value == 0 else _unsigned_zero(f"{value:{form}}") for value in values]


def _unsigned_zero(text: str) -> str:
    """Return a number's text without the sign that its digits do not have."""
    return text.lstrip("-") if float(text) == 0 else text
