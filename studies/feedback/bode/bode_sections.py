"""The sections of a feedback loop, and its report."""

from collections.abc import Sequence

from linkplan.studies.feedback.bode.bode_blocks import margins_along, nyquist, responses, sensitivities, summary
from linkplan.studies.feedback.bode.bode_result import BodeStudy
from linkplan.studies.output.document import Block, Report, Section
from linkplan.studies.output.report_file import report_of


def bode_sections(study: BodeStudy, name: str, *, verdict: bool = True) -> list[Section]:
    """Return the sections of a bode study.

    Args:
        study: with predicted responses, and measured ones if there are any.
        name: of this loop in the report, for titles and its cursor.
        verdict: whether the first section starts with the verdict; False if the page's header shows it.
    """
    group, joints, channels = f"frequency:{name}", study.mechanism.independent_joints, study.mechanism.channels
    found: list[tuple[str, list[Block]]] = [(f"Feedback loop: {name}", summary(study, verdict=verdict))]
    for channel in channels:
        of = "" if len(channels) == 1 else f" of {joints[channel].name}"
        entries = [entry for entry in study.points if entry.channel == channel]
        plots = [plot for both in responses(study, entries, group).values() for plot in both]
        found.append((f"Frequency response{of}", [*plots, nyquist(study, entries), *sensitivities(entries, group)]))
    for scan in study.scans:
        joint = joints[scan.channel]
        of = "" if len(channels) == 1 else f" of the loop of {joint.name}"
        found.append((f"Margins{of} over {scan.line.name}", [*margins_along(study, scan, f"{name}:{joint.name}")]))
    return [Section(title=title, blocks=blocks, depth=1 + (k > 0)) for k, (title, blocks) in enumerate(found)]


def bode_report(study: BodeStudy, extras: Sequence[Section] = ()) -> Report:
    """Return the report of a feedback loop; `extras` are the sections of further studies of it."""
    sections = [*bode_sections(study, f"{study.mechanism.name}, {study.law.name}", verdict=False), *extras]
    return report_of(f"Feedback loop of {study.mechanism.name}", study.message, study.stable, sections)
