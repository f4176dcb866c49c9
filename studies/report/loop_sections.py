"""The sections of a feedback loop, of further studies of it, and of tuned gains."""

import numpy as np

from linkplan.studies.bode.bode import BodeStudy
from linkplan.studies.bode.bode_blocks import margins_along, nyquist, responses, sensitivities, summary
from linkplan.studies.output.document import Block, Code, Facts, Section
from linkplan.studies.tune.tune import Tuning
from linkplan.studies.tune.tune_report import tracking_table, tune_blocks


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


def tune_sections(found: Tuning) -> list[Section]:
    """Return the sections of gains for requirements."""
    mechanism, wanted, law = found.mechanism, found.wanted, found.best.law
    rows = [
        ("mechanism", mechanism.name),
        ("tracker", law.name),
        ("wanted bandwidth", f"{wanted.bandwidth_hz:g} Hz at least"),
        ("wanted phase margin", f"{wanted.phase_margin_deg:g} deg at least"),
        ("control period", f"{law.timing.period_s:g} s, delay {law.timing.delay_s:g} s"),
    ]
    if np.isfinite(wanted.sensitivity_peak):
        rows.append(("wanted peak of |S|", f"{wanted.sensitivity_peak:g} at most"))
    blocks: list[Block] = [
        Facts(rows=rows),
        Code(title="Gains as the [tracking] table of a problem file", text=tracking_table(found)),
        *tune_blocks(found, verdict=False),
    ]
    return [Section(title=f"Gains for {mechanism.name}", blocks=blocks)]
