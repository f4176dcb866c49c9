"""The sections of an experiment: trackers on many machines, pairs of trackers, distributions of metrics, worst cases."""

from collections.abc import Callable

from linkplan.planner.problem.imperfections import Factor
from linkplan.studies.output.document import Block, Code, Report, Section, Table, table_of
from linkplan.studies.output.plan_sections import plan_sections
from linkplan.studies.output.report_file import report_of
from linkplan.studies.variations.experiment.distributions import SHOWN, distributions
from linkplan.studies.variations.experiment.experiment import Experiment
from linkplan.studies.variations.experiment.experiment_blocks import pairs, sensitivity, summary, tube_text, worst
from linkplan.studies.variations.experiment.study import ExperimentOutcome

# The command that runs a tracker's sample again.
Again = Callable[[str, int], str]


def experiment_sections(outcome: ExperimentOutcome, again: Again | None) -> list[Section]:
    """Return the sections of an experiment; `again` returns the command that runs a sample again, if there is one."""
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
    found += section("Worst cases", [worst(outcome), *_commands(outcome, again)])
    return [*found, *section("Imperfections of the machines", [_imperfections(experiment)])]


def _commands(outcome: ExperimentOutcome, again: Again | None) -> list[Code]:
    if again is None:
        return []
    commands = [again(name, sample) for name, one in outcome.trackers.items() for sample in one.worst]
    return [Code(title="Commands that repeat these runs exactly, with their whole logs", text="\n".join(commands))]


def _imperfections(experiment: Experiment) -> Table:
    rows = [
        [factor.label, _spread(factor), factor.quantity.unit if factor.quantity.unit != "1" else None]
        for factor in experiment.section.factors
    ]
    title = "Distributions of the imperfections; everything else is nominal"
    return table_of(title, ["imperfection", "distribution", "unit"], rows)


def _spread(factor: Factor) -> str:
    spread = factor.spread
    if spread.kind == "uniform":
        return f"even between {spread.first:.4g} and {spread.second:.4g}"
    if spread.kind == "normal":
        return f"normal about {spread.first:.4g}, standard deviation {spread.second:.4g}"
    return f"{spread.first:.4g}"


def experiment_report(outcome: ExperimentOutcome, again: Again | None = None) -> Report:
    """Return the report of an experiment and its plan; `again` returns the command that runs a sample again."""
    plan = outcome.experiment.plan
    best = max(outcome.trackers.values(), key=lambda one: one.success.value)
    shares = ", ".join(f"{name} {100 * one.success.value:.3g} %" for name, one in outcome.trackers.items())
    verdict = f"success on {outcome.samples} machines within {tube_text(outcome.experiment)}: {shares}"
    sections = [*experiment_sections(outcome, again), *plan_sections(plan)]
    title = f"Trackers of {plan.problem.name} on many machines"
    return report_of(title, verdict, None if best.success.value > 0 else False, sections)
