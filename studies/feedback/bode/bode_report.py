"""The figures, the sections and the report of a feedback loop."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from linkplan.studies.feedback.bode.bode_blocks import margins_along, nyquist, plants, responses, sensitivities, summary
from linkplan.studies.feedback.bode.bode_result import BodePoint, BodeStudy
from linkplan.studies.output.document import Block, Report, Section
from linkplan.studies.output.report_file import report_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_bode(study: BodeStudy, place: Path) -> None:
    """Draw every figure of a study into a folder: bode.png, nyquist.png, sensitivity.png and margins.png.

    Where joints move along that no actuator drives, plant.png has the plant to the loop's joint and to those.
    """
    from linkplan.studies.output.figure import figure_of

    joints, title = study.mechanism.independent_joints, f"{study.mechanism.name}, {study.law.name}: {study.loop_name}"
    channels = study.mechanism.channels
    suffixes = {channel: f"-{joints[channel].name}" if len(channels) > 1 else "" for channel in channels}
    for channel, suffix in suffixes.items():
        entries = [entry for entry in study.points if entry.channel == channel]
        bode_figure(study, entries, place / f"bode{suffix}.png")
        figure_of([nyquist(study, entries)], place / f"nyquist{suffix}.png", title=title, panel_in=(6.4, 7.0))
        figure_of(sensitivities(entries, ""), place / f"sensitivity{suffix}.png", title=title, columns=3)
        if moved := plants(entries, ""):
            figure_of(moved, place / f"plant{suffix}.png", title=title, columns=2, panel_in=(6.0, 2.9))
    for scan in study.scans:
        panels = margins_along(study, scan, "")
        figure_of(panels, place / f"margins{suffixes[scan.channel]}.png", title=title, panel_in=(8.0, 3.5))


def bode_figure(study: BodeStudy, entries: Sequence[BodePoint], path: Path | None = None) -> "Figure":
    """Return the figure of open and closed loop at every pose, saved at `path` if given."""
    from linkplan.studies.output.figure import figure_of, side_by_side

    how = "line: predicted, sampled; dotted: continuous"
    how += "; dots: MuJoCo, sinestream" if any(entry.responses for entry in entries) else ""
    title = f"{study.mechanism.name}, {study.law.name}: {study.message}; {how}"
    return figure_of(
        side_by_side(*responses(study, entries, "").values()), path, title=title, columns=2, panel_in=(6.0, 2.9)
    )


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
