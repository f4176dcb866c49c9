"""Whole reports: of a plan, a comparison, a decomposition, a feedback loop, gains, a check."""

from collections.abc import Mapping, Sequence

from msgspec.structs import replace

from linkplan.planner.plan import Plan
from linkplan.planner.plan_folder import versions
from linkplan.studies.bode.bode import BodeStudy
from linkplan.studies.check.refused_model import RefusedModel
from linkplan.studies.check.whole_check import WholeCheck
from linkplan.studies.compare.compare import Comparison
from linkplan.studies.decompose.decompose import Decomposition
from linkplan.studies.decompose.decomposition_blocks import decomposition_blocks
from linkplan.studies.experiment.experiment_blocks import tube_text
from linkplan.studies.experiment.study import Outcome
from linkplan.studies.output.document import Animation, Report, Section
from linkplan.studies.report.check_sections import check_sections
from linkplan.studies.report.experiment_sections import Again, experiment_sections, machine_section
from linkplan.studies.report.lead import verdict_sentence
from linkplan.studies.report.loop_sections import bode_sections, tune_sections
from linkplan.studies.report.plan_sections import plan_sections
from linkplan.studies.report.tracking_sections import comparison_sections, whole_comparison
from linkplan.studies.transfer.study import Transfer
from linkplan.studies.transfer.transfer_blocks import transfer_blocks
from linkplan.studies.tune.tune import Tuning


def report_of(title: str, verdict: str, passed: bool | None, sections: Sequence[Section]) -> Report:
    """Return a report with the versions of this installation."""
    verdict = verdict[:1].upper() + verdict[1:]
    return Report(title=title, verdict=verdict, passed=passed, versions=versions(), sections=list(sections))


def plan_report(plan: Plan) -> Report:
    """Return the report of a plan."""
    title, verdict = f"Plan {plan.problem.name}", verdict_sentence(plan)
    return report_of(title, verdict, plan.passed, plan_sections(plan, verdict=False))


def comparison_report(comparison: Comparison, document: Section | None = None) -> Report:
    """Return the report of trackers' runs on a plan; `document` is the section of the source document's experiment."""
    stable = [name for name, run in comparison.nominal.items() if run.stable]
    lost = [name for name in comparison.nominal if name not in stable]
    verdict = f"{comparison.title}: {', '.join(stable) or 'no tracker'} stable"
    verdict += f", {', '.join(lost)} NOT" if lost else ""
    sections = [*whole_comparison(comparison), *([] if document is None else [document])]
    return report_of(f"Trackers on {comparison.plan.problem.name}", verdict, bool(stable), sections)


def explored_report(plan: Plan, comparison: Comparison) -> Report:
    """Return the report of an explored plan: its tracked motion with the facts of the plan, then the plan's sections."""
    first, *rest = plan_sections(plan, verdict=False)
    moving, *tables = comparison_sections(comparison)[0].blocks
    blocks = [moving if isinstance(block, Animation) else block for block in first.blocks]
    tracked = Section(title="Tracking", blocks=tables, depth=2)
    title, verdict = f"Plan {plan.problem.name}", verdict_sentence(plan)
    return report_of(title, verdict, plan.passed, [replace(first, blocks=blocks), rest[0], tracked, *rest[1:]])


def replay_report(comparison: Comparison, sample: Mapping) -> Report:
    """Return the report of a repeated sample of an experiment; `sample` is its record."""
    (tracker,) = comparison.nominal
    failure = sample["failure"]
    result = failure or ("success" if sample["success"] else "outside the tube")
    verdict = f"{tracker} on machine {sample['sample']}: {result}"
    sections = [machine_section(sample), *whole_comparison(comparison)]
    passed = bool(sample["success"]) and failure is None
    return report_of(f"A machine of the experiment on {comparison.plan.problem.name}", verdict, passed, sections)


def experiment_report(outcome: Outcome, again: Again | None = None) -> Report:
    """Return the report of an experiment and its plan; `again` returns the command that runs a sample again."""
    plan, summary = outcome.experiment.plan, outcome.summary
    best = max(summary.trackers, key=lambda one: one.success.value)
    shares = ", ".join(f"{one.name} {100 * one.success.value:.3g} %" for one in summary.trackers)
    verdict = f"success on {summary.samples} machines within {tube_text(outcome.experiment)}: {shares}"
    if not outcome.distributed:
        verdict = f"what matters most for the rms error: {_foremost(outcome)}"
    sections = [*experiment_sections(outcome, again), *plan_sections(plan)]
    title = f"Trackers of {plan.problem.name} on many machines"
    return report_of(title, verdict, None if best.success.value > 0 or not outcome.distributed else False, sections)


def _foremost(outcome: Outcome) -> str:
    """Return each tracker's imperfection with the largest influence on the first rms error."""
    found = outcome.sensitivity
    return ", ".join(f"{found.ranking(tracker, found.mains[0])[0]} ({tracker})" for tracker in found.influences)


def decomposition_report(found: Decomposition) -> Report:
    """Return the report of the causes of trackers' errors on a plan."""
    split = [one.name for one in found.trackers if one.machines]
    lost = [one.name for one in found.trackers if not one.machines]
    verdict = f"split: {', '.join(split) or 'no tracker'}" + (f"; lost: {', '.join(lost)}" if lost else "")
    name = found.plan.problem.name
    first = Section(title=f"Where the error comes from: {name}", blocks=decomposition_blocks(found))
    return report_of(first.title, verdict, found.found, [first, *plan_sections(found.plan)])


def bode_report(study: BodeStudy, extras: Sequence[Section] = ()) -> Report:
    """Return the report of a feedback loop; `extras` are the sections of further studies of it."""
    sections = [*bode_sections(study, f"{study.mechanism.name}, {study.law.name}", verdict=False), *extras]
    return report_of(f"Feedback loop of {study.mechanism.name}", study.message, study.stable, sections)


def tune_report(found: Tuning) -> Report:
    """Return the report of gains for requirements."""
    return report_of(f"Gains for {found.mechanism.name}", found.message, found.found, tune_sections(found))


def transfer_report(found: Transfer) -> Report:
    """Return the report of a transfer table."""
    joints = ", ".join(joint.name for joint in found.outputs.joints)
    first = Section(title=f"Motors and {joints}", blocks=transfer_blocks(found)[1:])
    return report_of(f"Transfer table of {found.outputs.mechanism.name}", found.message, found.kept, [first])


def check_report(found: WholeCheck | RefusedModel) -> Report:
    """Return the report of a check."""
    n = len(found.problems)
    verdict = f"{n} problem{'s' if n != 1 else ''} found" if n else "no problems found"
    if isinstance(found, RefusedModel):
        sections = [Section(title=f"Model: {found.name}", blocks=found.blocks())]
    else:
        sections = check_sections(found)
    return report_of(f"Check of {found.name}", verdict, not n, sections)
