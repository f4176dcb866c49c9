"""The figures of `linkplan bode`: figures of responses, Nyquist curves and margins along a line."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.studies.feedback.bode.bode_blocks import margins_along, nyquist, responses, sensitivities
from linkplan.studies.feedback.bode.bode_result import BodePoint, BodeStudy

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_bode(study: BodeStudy, place: Path) -> None:
    """Draw every figure of a study into a folder: bode.png, nyquist.png, sensitivity.png and margins.png."""
    from linkplan.studies.output.figure import figure_of

    joints, title = study.mechanism.independent_joints, f"{study.mechanism.name}, {study.law.name}: {study.loop_name}"
    channels = study.mechanism.channels
    suffixes = {channel: f"-{joints[channel].name}" if len(channels) > 1 else "" for channel in channels}
    for channel, suffix in suffixes.items():
        entries = [entry for entry in study.points if entry.channel == channel]
        bode_figure(study, entries, place / f"bode{suffix}.png")
        figure_of([nyquist(study, entries)], place / f"nyquist{suffix}.png", title=title, panel_in=(6.4, 7.0))
        figure_of(sensitivities(entries, ""), place / f"sensitivity{suffix}.png", title=title, columns=3)
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
