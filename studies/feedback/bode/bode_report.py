"""The figures, the sections and the report of a feedback loop."""

from collections.abc import Iterator, Sequence

from msgspec.structs import replace

from linkplan.studies.feedback.bode.bode_blocks import margins_along, nyquist, plants, responses, sensitivities, summary
from linkplan.studies.feedback.bode.bode_result import BodePoint, BodeStudy
from linkplan.studies.output.document import Block, Report, Section
from linkplan.studies.output.figure_spec import FigureSpec, side_by_side
from linkplan.studies.output.report_file import report_of


def bode_figures(study: BodeStudy) -> Iterator[tuple[str, FigureSpec]]:
    """Yield the figures of a study by their names: "bode", "nyquist", "sensitivity" and "margins".

    If undriven joints move along, "plant" has the plant to the loop's joint and to these joints.
    """
    joints, title = study.mechanism.independent_joints, f"{study.mechanism.name}, {study.law.name}: {study.loop_name}"
    channels = study.mechanism.channels
    suffixes = {channel: f"-{joints[channel].name}" if len(channels) > 1 else "" for channel in channels}
    for channel, suffix in suffixes.items():
        entries = [entry for entry in study.points if entry.channel == channel]
        yield f"bode{suffix}", bode_figure(study, entries)
        yield f"nyquist{suffix}", FigureSpec(panels=[nyquist(study, entries)], title=title, panel_in=(6.4, 7.0))
        yield f"sensitivity{suffix}", FigureSpec(panels=sensitivities(entries, ""), title=title, columns=3)
        if moved := plants(entries, ""):
            yield f"plant{suffix}", FigureSpec(panels=moved, title=title, columns=2, panel_in=(6.0, 2.9))
    for scan in study.scans:
        panels = margins_along(study, scan, "")
        yield f"margins{suffixes[scan.channel]}", FigureSpec(panels=panels, title=title, panel_in=(8.0, 3.5))


def bode_figure(study: BodeStudy, entries: Sequence[BodePoint]) -> FigureSpec:
    """Return the figure of the open-loop and closed-loop responses at every pose."""
    how = "line: predicted, sampled; dotted: continuous"
    how += "; dots: MuJoCo, sinestream" if any(entry.responses for entry in entries) else ""
    title = f"{study.mechanism.name}, {study.law.name}: {study.message}; {how}"
    panels = side_by_side(*responses(study, entries, "").values())
    return FigureSpec(panels=panels, title=title, columns=2, panel_in=(6.0, 2.9))


def bode_sections(study: BodeStudy, name: str) -> list[Section]:
    """Return the sections of a bode study, the first with the verdict; `name` is for titles and the cursor."""
    group, joints, channels = f"frequency:{name}", study.mechanism.independent_joints, study.mechanism.channels
    found: list[tuple[str, list[Block]]] = [(f"Feedback loop: {name}", summary(study))]
    for channel in channels:
        of = "" if len(channels) == 1 else f" of {joints[channel].name}"
        entries = [entry for entry in study.points if entry.channel == channel]
        plots = [plot for both in responses(study, entries, group).values() for plot in both]
        further = [nyquist(study, entries), *sensitivities(entries, group), *plants(entries, group)]
        found.append((f"Frequency response{of}", [*plots, *further]))
    for scan in study.scans:
        joint = joints[scan.channel]
        of = "" if len(channels) == 1 else f" of the loop of {joint.name}"
        found.append((f"Margins{of} over {scan.line.name}", [*margins_along(study, scan, f"{name}:{joint.name}")]))
    return [Section(title=title, blocks=blocks, depth=1 + (k > 0)) for k, (title, blocks) in enumerate(found)]


def bode_report(study: BodeStudy, extras: Sequence[Section] = ()) -> Report:
    """Return the report of a feedback loop; `extras` are the sections of further studies of it."""
    first, *rest = bode_sections(study, f"{study.mechanism.name}, {study.law.name}")
    sections = [replace(first, blocks=first.blocks[1:]), *rest, *extras]  # the page's header has the verdict
    return report_of(f"Feedback loop of {study.mechanism.name}", study.message, study.stable, sections)
