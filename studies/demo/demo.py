"""All studies of the Optimus knee in one folder: check, plan, track, compare, bode, and the source document's experiment."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.files.folders import write_json, write_whole
from linkplan.planner.plan import Plan
from linkplan.planner.plan_folder import record, versions
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.bode.bode import bode_study
from linkplan.studies.bode.bode_report import bode_record
from linkplan.studies.bode.draw_bode import save_bode
from linkplan.studies.bode.draw_map import map_figure
from linkplan.studies.bode.map_study import map_record, map_study
from linkplan.studies.check.draw_mechanism import inspection_figure
from linkplan.studies.check.inspection import inspection_record
from linkplan.studies.check.whole_check import check_whole
from linkplan.studies.compare.compare import compare, comparison_record, default_mismatch
from linkplan.studies.compare.comparison_text import comparison_text
from linkplan.studies.compare.document import DOCUMENT_KP, document_record, mended_runs, printed_runs
from linkplan.studies.compare.draw_tracking import comparison_figure, document_figure
from linkplan.studies.frequency.excitation import Setup
from linkplan.studies.output.save_plan import save_plan
from linkplan.studies.output.tables import table
from linkplan.studies.report.bode_sections import bode_sections
from linkplan.studies.report.check_sections import check_sections, inspection_blocks
from linkplan.studies.report.columns import columns
from linkplan.studies.report.document import Section, Table, Text
from linkplan.studies.report.loop_sections import map_section
from linkplan.studies.report.plan_sections import plan_sections
from linkplan.studies.report.reports import report_of
from linkplan.studies.report.saving import PAGE, save_report
from linkplan.studies.report.tracking_sections import comparison_sections, document_section

PLANNED = ("knee-sine", "knee-sine-shank", "knee-reach", "knee-sprint", "knee-sprint-bare")
COMPARED = ("knee-sine", "knee-reach", "knee-sine-shank")
LOOPS = tuple(Tracking(kp=200.0, kd=kd, period_s=period) for kd, period in ((1.0, 1e-4), (10.0, 1e-4), (10.0, 1e-5)))
ANGLES_DEG = (-49.07, -20.0, 3.6, 30.0, 56.27)

Say = Callable[[str], None]
Sections = list[Section]


def demo(target: Path, say: Say) -> tuple[dict, str]:
    """Write the demo's folder and return its results, as a record and as text."""
    begin = time.monotonic()
    outcome: dict = {}

    def write(place: Path) -> None:
        outcome.update(_write(place, say))

    write_whole(target, write, "demo.json")
    minutes = (time.monotonic() - begin) / 60
    text = "\n".join(
        [outcome.pop("text"), "", f"{minutes:.1f} minutes; everything is in {target}/", f"open {target}/{PAGE} in a browser"]
    )
    return outcome | {"folder": str(target)}, text


def _write(place: Path, say: Say) -> dict:
    said: dict = {"versions": versions()}
    checks = _checks(place, said, say)
    plans = _plans(place, said, say)
    _infeasible(said, say)
    compared, summary = _comparisons(place, said, plans, say)
    loops = _loops(place, said, say)
    document, text = _document(place, said, plans["knee-sine"], say)
    overview = _overview(said, plans)
    planned = [
        section
        for name in PLANNED
        for section in (*compared.get(name, []), *plan_sections(plans[name], animated=name not in compared))
    ]
    say("report")
    verdict = f"{len(plans)} plans, all certified; {len(compared)} comparisons; {len(LOOPS)} feedback loops"
    passed = all(plan.certificate.passed for plan in plans.values())
    report = report_of("linkplan on the Optimus knee", verdict, passed, [overview, *checks, *planned, *loops, document])
    save_report(report, place, page=True)
    write_json(place / "demo.json", said)
    return said | {"text": "\n\n".join([_plans_text(plans), said["infeasible"]["message"], *summary, text])}


def _plans_text(plans: dict[str, Plan]) -> str:
    return table(["plan", "status", "duration [s]", "peak [N.m]", "certificate"], _rows(plans))


def _rows(plans: dict[str, Plan]) -> list[list]:
    return [
        [
            name,
            plan.status,
            f"{plan.trajectory.duration_s:.8g}",
            float(plan.certificate.peak_effort[0]),
            "passed" if plan.certificate.passed else "NO",
        ]
        for name, plan in plans.items()
    ]


def _overview(said: dict, plans: dict[str, Plan]) -> Section:
    heads = columns("plan", "status", "duration [s]", "peak effort [N.m]", "certificate")
    rows = [[name, status, float(duration), round(peak, 4), passed] for name, status, duration, peak, passed in _rows(plans)]
    infeasible = Text(text=f"An infeasible problem: {said['infeasible']['message']}.")
    return Section(
        title="Overview", blocks=[Table(title="Plans within the effort limit", columns=heads, rows=rows), infeasible]
    )


def _checks(place: Path, said: dict, say: Say) -> Sections:
    said["check"], sections = {}, []
    for name in ("optimus-knee", "optimus-knee-source"):
        say(f"check {name}")
        whole = check_whole(load_mechanism(name), None)
        folder = place / "check" / name
        folder.mkdir(parents=True)
        said["check"][name] = inspection_record(whole.found)
        write_json(folder / "check.json", said["check"][name])
        inspection_figure(whole.found, folder / "mechanism.png")
        if name == "optimus-knee":
            sections += check_sections(whole)
        else:
            sections.append(Section(title=f"Mechanism as printed: {name}", blocks=inspection_blocks(whole.found)))
    return sections


def _plans(place: Path, said: dict, say: Say) -> dict[str, Plan]:
    said["plans"], plans = {}, {}
    for name in PLANNED:
        say(f"plan {name}")
        plan = plan_motion(load_problem(name)).require()
        folder = place / "plans" / name
        folder.mkdir(parents=True)
        save_plan(plan, folder)
        plans[name], said["plans"][name] = plan, record(plan)
    return plans


def _infeasible(said: dict, say: Say) -> None:
    say("plan knee-sine with the shank, followed exactly")
    plan = plan_motion(load_problem("knee-sine", ["mechanism.payload=shank"]))
    said["infeasible"] = {"status": plan.status, "message": f"knee-sine with the shank: {plan.message}"}


def _comparisons(place: Path, said: dict, plans: dict[str, Plan], say: Say) -> tuple[dict[str, Sections], list[str]]:
    """Return the sections of every comparison by its plan's name, and their texts."""
    said["compare"], sections, texts = {}, {}, []
    for name in COMPARED:
        plan = plans[name]
        comparison = compare(plan, default_mismatch(plan), lambda text, name=name: say(f"compare {name}: {text}"))
        folder = place / "compare" / name
        folder.mkdir(parents=True)
        said["compare"][name] = comparison_record(comparison)
        write_json(folder / "compare.json", said["compare"][name])
        comparison_figure(comparison, folder / "compare.png")
        texts.append(comparison_text(comparison))
        sections[name] = comparison_sections(comparison)
    return sections, texts


def _loops(place: Path, said: dict, say: Say) -> Sections:
    mechanism = load_mechanism("optimus-knee")
    joint = mechanism.independent_joints[0]
    said["bode"], sections = [], []
    for gains in LOOPS:
        label = f"kp-{gains.kp:g}-kd-{gains.kd:g}-period-{gains.period_s:g}"
        study = bode_study(
            mechanism,
            np.array([[joint.read(angle)] for angle in ANGLES_DEG]),
            gains,
            mechanism.effort_limit,
            lambda text, label=label: say(f"bode {label}: {text}"),
            setup=Setup(),
        )
        folder = place / "bode" / label
        folder.mkdir(parents=True)
        said["bode"].append(bode_record(study))
        write_json(folder / "bode.json", said["bode"][-1])
        save_bode(study, folder)
        sections += bode_sections(study, f"kp = {gains.kp:g}, kd = {gains.kd:g} every {1e3 * gains.period_s:g} ms")
        if gains is LOOPS[0]:
            found = map_study(study, lambda text: say(f"stability map: {text}"))
            marked = [(f"the document's KP = {g.kp:g}, KD = {g.kd:g}", g.kp, g.kd) for g in LOOPS[:2]]
            map_figure(found, place / "stability_map.png", marked)
            said["stability_map"] = map_record(found)
            sections.append(map_section(found, marked))
    return sections


def _document(place: Path, said: dict, plan: Plan, say: Say) -> tuple[Section, str]:
    runs = printed_runs(plan.problem.reference, say) | mended_runs(plan, say)
    said["document"] = document_record(runs)
    document_figure(runs, DOCUMENT_KP, place / "desired_and_actual.png")
    section = document_section(runs, said["document"], DOCUMENT_KP)
    shown = section.blocks[0]
    assert isinstance(shown, Table)
    heads = [f"{head} [{unit}]" if unit else head for head, unit in shown.columns]
    return section, "the source document's experiment\n" + table(heads, [list(row) for row in shown.rows])
