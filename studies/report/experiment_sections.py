"""The sections of an experiment: trackers on many machines, pairs of trackers, distributions of metrics, worst cases."""

from collections.abc import Callable, Mapping

from linkplan.planner.keys.kinds import QUANTITIES
from linkplan.planner.problem.imperfections import Factor
from linkplan.studies.experiment.distributions import SHOWN, distributions
from linkplan.studies.experiment.experiment import Experiment
from linkplan.studies.experiment.experiment_blocks import pairs, sensitivity, summary, worst
from linkplan.studies.experiment.study import Outcome
from linkplan.studies.output.document import Block, Code, Section, Table, table_of

# The command that runs a tracker's sample again.
Again = Callable[[str, int], str]


def experiment_sections(outcome: Outcome, again: Again | None) -> list[Section]:
    """Return the sections of an experiment; `again` returns the command that runs a sample again, if there is one."""
    experiment, metrics = outcome.experiment, outcome.summary.metrics
    drawn = [name for start in SHOWN for name in metrics if name.startswith(start)]
    others = [name for name in metrics if name not in drawn]

    def section(title: str, blocks: list, *, folded: bool = False) -> list[Section]:
        return [Section(title=title, blocks=blocks, depth=2, folded=folded)] if blocks else []

    def distributed(names: list[str]) -> list[Block]:
        return list(distributions(outcome.population, experiment.settings.trackers, names, metrics))

    found = [Section(title=f"Experiment: {experiment.plan.problem.name}", blocks=summary(outcome))]
    if outcome.distributed:  # else the machines do not have the distributions of the imperfections
        found += section("Trackers in pairs", pairs(outcome))
        found += section("How the figures are distributed", distributed(drawn))
        found += section("Distributions of the other figures", distributed(others), folded=True)
    found += section("Which imperfection matters most", sensitivity(outcome))
    if outcome.distributed:
        found += section("Worst cases", [worst(outcome), *_commands(outcome, again)])
    return [*found, *section("Imperfections of the machines", [_imperfections(experiment)])]


def _commands(outcome: Outcome, again: Again | None) -> list[Code]:
    if again is None:
        return []
    commands = [again(one.name, sample) for one in outcome.summary.trackers for sample in one.worst]
    return [Code(title="Commands that repeat these runs exactly, with their whole logs", text="\n".join(commands))]


def machine_section(sample: Mapping) -> Section:
    """Return the section of one sample's machine with its imperfections; `sample` is the record of its run."""
    units = [QUANTITIES[name.partition(".")[0]].unit for name in sample["imperfections"]]
    values = zip(sample["imperfections"].items(), units, strict=True)
    rows = [[name, value, None if unit == "1" else unit] for (name, value), unit in values]
    table = table_of("Imperfections", ["imperfection", "value", "unit"], rows, digits=6)
    return Section(title=f"Machine {sample['sample']}", blocks=[table])


def _imperfections(experiment: Experiment) -> Table:
    rows = [
        [factor.label, _spread(factor), factor.quantity.unit if factor.quantity.unit != "1" else None]
        for factor in experiment.section.factors
    ]
    title = "Distributions of the imperfections; all else is as modelled"
    return table_of(title, ["imperfection", "distribution", "unit"], rows)


def _spread(factor: Factor) -> str:
    spread = factor.spread
    if spread.kind == "uniform":
        return f"even between {spread.first:.4g} and {spread.second:.4g}"
    if spread.kind == "normal":
        return f"normal about {spread.first:.4g}, standard deviation {spread.second:.4g}"
    return f"{spread.first:.4g}"
