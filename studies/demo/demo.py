"""All studies of the Optimus knee in one folder: check, plan, track, compare, bode."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.files.folders import write_json, write_whole
from linkplan.planner.plan.folder import record_of, versions
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.problem.settings import Tracking
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.check.inspection_blocks import inspection_blocks
from linkplan.studies.check.path_plots import inspection_figure
from linkplan.studies.check.whole_check import check_whole
from linkplan.studies.compare.compare import compare, mismatch_of
from linkplan.studies.compare.tracking_result import comparison_sections, tracking_result
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.bode.further_studies import map_study
from linkplan.studies.feedback.bode.loop_blocks import map_blocks
from linkplan.studies.feedback.frequency.excitation import Setup
from linkplan.studies.output.document import Block, Section, Text, table_of
from linkplan.studies.output.draw_plan import save_plan
from linkplan.studies.output.figure import save_figures
from linkplan.studies.output.figure_spec import FigureSpec, panels_of
from linkplan.studies.output.plan_sections import plan_sections
from linkplan.studies.output.report_file import PAGE, report_of, save_report

PLANNED = ("knee-sine", "knee-sine-shank", "knee-reach", "knee-sprint", "knee-sprint-bare")
COMPARED = ("knee-sine", "knee-reach", "knee-sine-shank")
_FIRST_KP, _FIRST_KDS = 200.0, (1.0, 10.0)  # the gains of the source document
LOOPS = tuple(Tracking(kp=_FIRST_KP, kd=kd, period_s=period) for kd, period in ((1.0, 1e-4), (10.0, 1e-4), (10.0, 1e-5)))
ANGLES_DEG = (-49.07, -20.0, 3.6, 30.0, 56.27)

Say = Callable[[str], None]
Sections = list[Section]
STORY = "knee-reach"  # the main plan of the page


def demo(target: Path, say: Say) -> tuple[dict, list[Block]]:
    """Write the demo's folder and return its results, as a record and as a document."""
    begin = time.monotonic()
    outcome: dict = {}

    def write(place: Path) -> None:
        outcome.update(_write(place, say))

    write_whole(target, write, "demo.json")
    minutes = (time.monotonic() - begin) / 60
    end = f"finished in {minutes:.1f} minutes; the results are in {target}/; open {target}/{PAGE} in a browser"
    return outcome | {"folder": str(target)}, [*outcome.pop("blocks"), Text(text=end)]


def _write(place: Path, say: Say) -> dict:
    said: dict = {"versions": versions()}
    checks = _checks(place, said, say)
    plans = _plans(place, said, say)
    _infeasible(said, say)
    compared, summary = _comparisons(place, said, plans, say)
    loops = _loops(place, said, say)
    say("report")
    verdict = f"{len(plans)} plans, all certified; {len(compared)} comparisons; {len(LOOPS)} feedback loops"
    passed = all(plan.certificate.passed for plan in plans.values())
    overview = _overview(said, plans)
    further = []  # collapsed: the other plans, comparisons and loops, and the checks
    for name in (name for name in PLANNED if name != STORY):
        further += [*plan_sections(plans[name], animated=name not in compared), *compared.get(name, [])]
    further += [*(section for sections in loops[1:] for section in sections), *checks]
    folded = [_folded(section) if section.depth == 1 else section for section in further]
    sections = [*_story(plans, compared, loops), overview, *folded]
    report = report_of("linkplan on the Optimus knee", verdict, passed, sections)
    save_report(report, place, page=True)
    write_json(place / "demo.json", said)
    return said | {"blocks": [*overview.blocks, *summary]}


def _story(plans: dict[str, Plan], compared: dict[str, Sections], loops: list[Sections]) -> Sections:
    """Return the open sections of the page: one motion of one mechanism, its tracking, and its feedback loop."""
    plan = plans[STORY]
    intro = Text(
        text=(
            "The Optimus knee is a four-bar linkage: a motor at O turns the crank, and the shank is attached to the crank."
            " The"
            " plan swings the shank from bent to straight with the least effort, within the motor's limit. Below, trackers"
            " follow it in MuJoCo, and the feedback loop with the first gains is analysed. The other studies are in"
            " collapsed sections."
        )
    )
    first, *rest = plan_sections(plan)
    planned = [
        replace(first, title="The swing of the shank", blocks=[intro, *first.blocks]),
        rest[0],
        *map(_folded, rest[1:]),
    ]
    tracked, *over_time = compared[STORY]
    tracked = replace(tracked, title="The swing as tracked in MuJoCo")
    loop, *details = loops[0]
    return [*planned, tracked, *map(_folded, over_time), loop, *map(_folded, details)]


def _folded(section: Section) -> Section:
    return replace(section, folded=True)


def _overview(said: dict, plans: dict[str, Plan]) -> Section:
    heads = ["plan", "status", "duration [s]", "peak effort [N.m]", "certificate"]
    rows = [
        [
            name,
            plan.status,
            f"{plan.trajectory.duration_s:.8g}",
            plan.certificate.peak_effort[0],
            "passed" if plan.certificate.passed else "NO",
        ]
        for name, plan in plans.items()
    ]
    infeasible = Text(text=f"An infeasible problem: {said['infeasible']['message']}.")
    table = table_of("Plans within the effort limit", heads, rows)
    return Section(title="Further motions of the knee", blocks=[table, infeasible])


def _checks(place: Path, said: dict, say: Say) -> Sections:
    said["check"], sections = {}, []
    for name in ("optimus-knee", "optimus-knee-source"):
        say(f"check {name}")
        whole = check_whole(load_mechanism(name), None)
        folder = place / "check" / name
        folder.mkdir(parents=True)
        said["check"][name] = whole
        write_json(folder / "check.json", whole)
        save_figures([("mechanism", inspection_figure(whole))], folder)
        if name == "optimus-knee":
            sections += whole.sections()
        else:
            sections.append(Section(title=f"Mechanism as printed: {name}", blocks=inspection_blocks(whole)))
    return sections


def _plans(place: Path, said: dict, say: Say) -> dict[str, Plan]:
    said["plans"], plans = {}, {}
    for name in PLANNED:
        say(f"plan {name}")
        plan = plan_motion(load_problem(name)).require()
        folder = place / "plans" / name
        folder.mkdir(parents=True)
        save_plan(plan, folder)
        plans[name], said["plans"][name] = plan, record_of(plan)
    return plans


def _infeasible(said: dict, say: Say) -> None:
    say("plan knee-sine with the shank, followed exactly")
    plan = plan_motion(load_problem("knee-sine", ["mechanism.payload=shank"]))
    said["infeasible"] = {"status": plan.status, "message": f"knee-sine with the shank: {plan.message}"}


def _comparisons(place: Path, said: dict, plans: dict[str, Plan], say: Say) -> tuple[dict[str, Sections], list[Block]]:
    """Return the sections of every comparison by its plan's name, and their tables."""
    said["compare"], sections, texts = {}, {}, []
    for name in COMPARED:
        plan = plans[name]
        found = compare(plan, mismatch_of(plan, 1.2, 1), lambda text, name=name: say(f"compare {name}: {text}"))
        folder = place / "compare" / name
        folder.mkdir(parents=True)
        said["compare"][name] = compared = tracking_result(found)
        write_json(folder / "compare.json", compared)
        save_figures(compared.figure_specs(), folder)
        texts += compared.blocks()
        sections[name] = comparison_sections(found)
    return sections, texts


def _loops(place: Path, said: dict, say: Say) -> list[Sections]:
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
        said["bode"].append(study)
        write_json(folder / "bode.json", study)
        save_figures(study.figure_specs(), folder)
        sections.append(study.sections(f"kp = {gains.kp:g}, kd = {gains.kd:g} every {1e3 * gains.period_s:g} ms"))
        if gains is LOOPS[0]:
            found = map_study(study, lambda text: say(f"stability map: {text}"))
            marked = [(f"KP = {_FIRST_KP:g}, KD = {kd:g}", _FIRST_KP, kd) for kd in _FIRST_KDS]
            said["stability_map"], blocks = found, map_blocks(found, marked)
            spec = FigureSpec(panels=panels_of(blocks), columns=2, panel_in=(6.5, 5.0))
            save_figures([("stability_map", spec)], place)
            sections[0].append(Section(title="Stability map", blocks=blocks, depth=2))
    return sections
