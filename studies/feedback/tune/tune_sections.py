"""The sections of gains for requirements, and their report."""

from linkplan.studies.feedback.tune.tune_report import tracking_table, tune_blocks
from linkplan.studies.feedback.tune.tuning import Tuning
from linkplan.studies.output.document import Block, Code, Facts, Report, Section
from linkplan.studies.output.report_file import report_of


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
    if wanted.sensitivity_peak is not None:
        rows.append(("wanted peak of |S|", f"{wanted.sensitivity_peak:g} at most"))
    blocks: list[Block] = [
        Facts(rows=rows),
        Code(title="Gains as the [tracking] table of a problem file", text=tracking_table(found)),
        *tune_blocks(found, verdict=False),
    ]
    return [Section(title=f"Gains for {mechanism.name}", blocks=blocks)]


def tune_report(found: Tuning) -> Report:
    """Return the report of gains for requirements."""
    return report_of(f"Gains for {found.mechanism.name}", found.message, found.found, tune_sections(found))
