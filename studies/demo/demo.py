"""The whole path on the Optimus knee, in one folder: check, plan, track, compare, bode, and the source document redone."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.files.folders import write_json, write_whole
from linkplan.planner.files.plan_folder import record, versions
from linkplan.planner.files.problem_file import load_problem
from linkplan.planner.plan import Plan
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.bode.bode import bode_study
from linkplan.studies.bode.bode_report import bode_record, bode_text
from linkplan.studies.bode.draw_bode import save_bode
from linkplan.studies.bode.draw_map import map_figure
from linkplan.studies.bode.map_study import map_record, map_study, map_text
from linkplan.studies.check.draw_mechanism import inspection_figure
from linkplan.studies.check.inspection import inspect, inspection_record
from linkplan.studies.check.inspection_text import inspection_text
from linkplan.studies.compare.compare import compare, comparison_record, default_mismatch
from linkplan.studies.compare.comparison_text import comparison_text
from linkplan.studies.compare.document import KP, document_record, mended_runs, printed_runs
from linkplan.studies.compare.draw_tracking import comparison_figure, document_figure
from linkplan.studies.frequency.excitation import Setup
from linkplan.studies.output.html import Page
from linkplan.studies.output.plan_text import plan_text
from linkplan.studies.output.save_plan import save_plan
from linkplan.studies.output.tables import table

PLANNED = ("knee-sine", "knee-sine-shank", "knee-reach", "knee-sprint", "knee-sprint-bare")
COMPARED = ("knee-sine", "knee-reach", "knee-sine-shank")
LOOPS = tuple(Tracking(kp=200.0, kd=kd, period_s=period) for kd, period in ((1.0, 1e-4), (10.0, 1e-4), (10.0, 1e-5)))
ANGLES_DEG = (-49.07, -20.0, 3.6, 30.0, 56.27)

Say = Callable[[str], None]


def demo(target: Path, say: Say) -> tuple[dict, str]:
    """Write the demo's folder and return what it found, as a record and as text."""
    begin = time.monotonic()
    outcome: dict = {}

    def write(place: Path) -> None:
        outcome.update(_write(place, say))

    write_whole(target, write, "demo.json")
    minutes = (time.monotonic() - begin) / 60
    text = "\n".join(
        [
            outcome.pop("text"),
            "",
            f"{minutes:.1f} minutes; everything is in {target}/, begin with {target}/report.html",
        ]
    )
    return outcome | {"folder": str(target)}, text


def _write(place: Path, say: Say) -> dict:
    page = Page("linkplan on the Optimus knee")
    said: dict = {"versions": versions()}
    _checks(place, page, said, say)
    plans = _plans(place, page, said, say)
    _infeasible(page, said, say)
    summary = [_comparisons(place, page, said, plans, say)]
    _loops(place, page, said, say)
    summary.append(_document(place, page, said, plans["knee-sine"], say))
    page.note(f"Made by linkplan demo with {', '.join(f'{k} {v}' for k, v in said['versions'].items())}.")
    page.save(place / "report.html")
    write_json(place / "demo.json", said)
    head = [["plan", "status", "duration [s]", "peak [N.m]", "certificate"]]
    rows = [
        [
            name,
            p.status,
            f"{p.trajectory.duration_s:.8g}",
            float(p.certificate.peak_effort[0]),
            "passed" if p.certificate.passed else "NO",
        ]
        for name, p in plans.items()
    ]
    return said | {"text": "\n\n".join([table(head[0], rows), said["infeasible"]["message"], *summary])}


def _checks(place: Path, page: Page, said: dict, say: Say) -> None:
    page.heading("Check: the mechanism and its kinematic loop")
    said["check"] = {}
    for name in ("optimus-knee", "optimus-knee-source"):
        say(f"check {name}")
        found = inspect(load_mechanism(name), [])
        folder = place / "check" / name
        folder.mkdir(parents=True)
        said["check"][name] = inspection_record(found)
        write_json(folder / "check.json", said["check"][name])
        inspection_figure(found, folder / "mechanism.png")
        page.text(inspection_text(found))
        if name == "optimus-knee":
            page.figure(
                f"check/{name}/mechanism.png", "The four-bar over its reach; dotted red: singular pose; dotted grey: toggle"
            )


def _plans(place: Path, page: Page, said: dict, say: Say) -> dict[str, Plan]:
    page.heading("Plan: motions within the torque limit")
    said["plans"], plans = {}, {}
    for name in PLANNED:
        say(f"plan {name}")
        plan = plan_motion(load_problem(name)).require()
        folder = place / "plans" / name
        folder.mkdir(parents=True)
        save_plan(plan, folder)
        plans[name], said["plans"][name] = plan, record(plan)
        page.text(plan_text(plan))
        page.figure(f"plans/{name}/plan.png", f"{name}: motion and torque")
    return plans


def _infeasible(page: Page, said: dict, say: Say) -> None:
    say("plan knee-sine with the shank, followed exactly")
    plan = plan_motion(load_problem("knee-sine", ["mechanism.payload=shank"]))
    said["infeasible"] = {"status": plan.status, "message": f"knee-sine with the shank: {plan.message}"}
    page.text(said["infeasible"]["message"])


def _comparisons(place: Path, page: Page, said: dict, plans: dict[str, Plan], say: Say) -> str:
    page.heading("Track and compare: three trackers in MuJoCo")
    said["compare"], texts = {}, []
    for name in COMPARED:
        plan = plans[name]
        comparison = compare(plan, default_mismatch(plan), lambda text, name=name: say(f"compare {name}: {text}"))
        folder = place / "compare" / name
        folder.mkdir(parents=True)
        said["compare"][name] = comparison_record(comparison)
        write_json(folder / "compare.json", said["compare"][name])
        comparison_figure(comparison, folder / "compare.png")
        texts.append(comparison_text(comparison))
        page.text(texts[-1])
        page.figure(f"compare/{name}/compare.png", f"{name}: pd, pd+ff and lqr, nominal and with a mismatch")
    return "\n\n".join(texts)


def _loops(place: Path, page: Page, said: dict, say: Say) -> None:
    page.heading("Bode: margins of the feedback loop")
    mechanism = load_mechanism("optimus-knee")
    joint = mechanism.independent_joints[0]
    said["bode"] = []
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
        page.text(bode_text(study))
        page.figure(f"bode/{label}/bode.png", study.message)
        page.figure(f"bode/{label}/margins.png", "Sensitivity and margins over the angle, the worst marked")
        if gains is LOOPS[0]:
            found = map_study(study, lambda text: say(f"stability map: {text}"))
            marked = [(f"the document's KP = {g.kp:g}, KD = {g.kd:g}", g.kp, g.kd) for g in LOOPS[:2]]
            map_figure(found, place / "stability_map.png", marked)
            said["stability_map"] = map_record(found)
            page.text(map_text(found))
            page.figure(
                "stability_map.png",
                "Stable gains at 0.1 ms over all angles, checked in MuJoCo next to the stability boundary",
            )


def _document(place: Path, page: Page, said: dict, plan: Plan, say: Say) -> str:
    page.heading("The source document, as printed and mended")
    runs = printed_runs(plan.problem.reference, say) | mended_runs(plan, say)
    said["document"] = document_record(runs)
    document_figure(runs, KP, place / "desired_and_actual.png")
    head = [
        "model",
        "KP",
        "KD",
        "rms error [deg]",
        "closure gap, mean [um]",
        "closure gap, max [um]",
        "contacts",
        "at the limit [%]",
        "stable",
    ]
    rows = [
        [
            row["model"],
            row["kp"],
            row["kd"],
            row["rms_error_deg"],
            1e6 * row["steady_gap_mean_m"],
            1e6 * row["steady_gap_max_m"],
            row["contacts"],
            100 * row["at_limit_fraction"],
            row["stable"],
        ]
        for row in said["document"]
    ]
    text = "the source document's experiment\n" + table(head, rows)
    page.text(text)
    page.figure("desired_and_actual.png", "Desired dashed, actual solid, for both of the document's gain sets")
    return text
