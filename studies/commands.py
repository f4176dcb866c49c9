"""What each command does: reads its arguments, runs its study, prints and writes the result."""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.errors import LinkplanError, ModelError, ProblemError
from models.library import BUILT_IN as MODELS
from models.mechanism import Mechanism
from models.names import choose, nearest
from models.payload import BUILT_IN as PAYLOADS
from planner.folders import check_target, plain, write_json, write_whole
from planner.plan import Plan
from planner.plan_folder import read_plan, record, unchecked, write_plan
from planner.planning import plan_motion
from planner.problem_file import mechanism_from_tables, problem_from_tables
from planner.schemes import NAMES as SCHEMES
from planner.tables import BUILT_IN as PROBLEMS
from planner.tables import apply_override, read_tables
from studies.cli import DONE, NO

Say = Callable[[str], None]


def _say(arguments: argparse.Namespace) -> Say:
    def say(text: str) -> None:
        print(f"  {arguments.command}: {text}", file=sys.stderr, flush=True)

    return say


def _show(arguments: argparse.Namespace, said: dict, text: str) -> None:
    """Print a result: one JSON object, or the text for people."""
    print(json.dumps(plain(said), allow_nan=False) if arguments.json else text)


def _output(arguments: argparse.Namespace) -> Path | None:
    """Return the output folder, refused now and not after long work where it cannot be used."""
    if arguments.output is None:
        return None
    if not arguments.output:
        raise ProblemError("-o takes a folder, got an empty name")
    target = Path(arguments.output)
    check_target(target, f"{arguments.command}.json")
    return target


def _positions(arguments: argparse.Namespace, mechanism: Mechanism) -> list[dict[str, float]]:
    """Return the poses of --at-deg: JOINT=ANGLE, several joints joined by commas; a bare angle for a single freedom."""
    poses = []
    for text in arguments.at_deg:
        pose = {}
        for part in text.split(","):
            name, equals, value = part.rpartition("=")
            if not equals and mechanism.dof == 1:
                name = mechanism.independent_joints[0].name
            try:
                number = float(value)
            except ValueError:
                number = np.nan
            if not name or not np.isfinite(number):
                raise ProblemError(f"--at-deg takes JOINT=ANGLE, an angle in degrees (metres for a slide), got '{text}'")
            joint = mechanism.joints[mechanism.joint_index(name.strip(), ProblemError)]
            pose[joint.name] = joint.read(number)
        poses.append(pose)
    return poses


def _tables(source: str, overrides: list[str]) -> tuple[str, dict, Path | None, bool]:
    """Return the tables of a model or a problem with overrides, and whether it is a whole problem."""
    path = Path(source)
    is_problem = source in PROBLEMS or (path.suffix == ".toml" and source not in MODELS)
    if is_problem:
        name, tables, folder = read_tables(source)
    else:
        if source not in MODELS and not path.exists():
            names = [*MODELS, *PROBLEMS]
            raise ModelError(
                f"unknown model '{source}'{nearest(source, names)}: neither a built-in name ({', '.join(names)}) nor a file"
            )
        name, tables, folder = source, {"mechanism": {"model": source}}, None
    for override in overrides:
        apply_override(tables, override)
    return name, tables, folder, is_problem


def _plan(arguments: argparse.Namespace, say: Say) -> Plan:
    """Return the plan that an argument means: a saved one, or one made of a problem now."""
    source, overrides = arguments.plan, arguments.set
    path = Path(source)
    if source in PROBLEMS or path.is_file() or not path.exists():
        if source not in PROBLEMS and not path.is_file():
            raise ProblemError(
                f"unknown plan or problem '{source}'{nearest(source, PROBLEMS)}: neither a plan's folder, nor a problem"
                f" file, nor built-in ({', '.join(PROBLEMS)})"
            )
        name, tables, folder = read_tables(source)
        for override in overrides:
            apply_override(tables, override)
        return plan_motion(problem_from_tables(name, tables, folder), say)
    for override in overrides:
        if not override.startswith("tracking."):
            raise ProblemError(f"--set {override}: a saved plan is fixed; only tracking.* can be set on it")
    plan, note = read_plan(path, overrides), unchecked(path)
    if note is not None:
        say(note)
    return plan


def run_list(arguments: argparse.Namespace) -> int:
    """Print the built-in names."""
    from studies.compare import TRACKERS

    problems = {name: read_tables(name)[1].get("description", "") for name in PROBLEMS}
    said = {
        "models": dict(MODELS),
        "problems": problems,
        "payloads": list(PAYLOADS),
        "schemes": list(SCHEMES),
        "trackers": list(TRACKERS),
    }
    lines = ["models"]
    lines += [f"  {name:20s}  {text}" for name, text in MODELS.items()]
    lines += ["problems", *(f"  {name:20s}  {text}" for name, text in problems.items())]
    lines += [f"payloads: {', '.join(PAYLOADS)}", f"schemes: {', '.join(SCHEMES)}", f"trackers: {', '.join(TRACKERS)}"]
    _show(arguments, said, "\n".join(lines))
    return DONE


def run_check(arguments: argparse.Namespace) -> int:
    """Report on a mechanism and what it does along its way; 1 where problems are found."""
    from studies.check_report import path_text
    from studies.inspection import inspect, inspection_record
    from studies.loop_report import path_record, reach_paths
    from studies.report import inspection_text

    target = _output(arguments)
    mechanism, problem, note = _to_check(*_tables(arguments.model, arguments.set))
    motion, off_path = _motion(problem)
    contacts = "refuse" if problem is None else problem.contacts
    found = inspect(mechanism, _positions(arguments, mechanism), motion=motion, contacts=contacts)
    paths = reach_paths(mechanism, found.reaches) if motion is None else (motion,)
    found = replace(found, notes=(*found.notes, *(text for text in (note, off_path) if text)))
    said = inspection_record(found) | {"along": [path_record(path) for path in paths]}
    if target is not None:
        from studies.draw_mechanism import inspection_figure
        from studies.draw_report import path_figure

        def write(place: Path) -> None:
            write_json(place / "check.json", said)
            inspection_figure(found, place / "mechanism.png")
            for number, path in enumerate(paths, 1):
                path_figure(path, found.reaches, place / f"loop-{number}.png")

        write_whole(target, write, "check.json")
    _show(arguments, said, "\n\n".join([inspection_text(found), *(path_text(path) for path in paths)]))
    return NO if found.problems else DONE


def _to_check(name: str, tables: dict, folder: Path | None, is_problem: bool):
    """Return the mechanism to check, its problem if there is one, and why the problem that there is cannot be used."""
    if not is_problem or "motion" not in tables:
        return mechanism_from_tables(tables, folder), None, None
    try:
        problem = problem_from_tables(name, tables, folder)
    except LinkplanError as error:
        return mechanism_from_tables(tables, folder), None, f"the problem cannot be planned: {error}"
    return problem.mechanism, problem, None


def _motion(problem):
    """Return the path of a problem's motion, or None, and why there is none, if there is a problem."""
    from studies.loop_report import motion_path

    if problem is None:
        return None, None
    try:
        return motion_path(problem), None
    except LinkplanError as error:
        return None, f"no path for the problem's motion: {error}"


def run_plan(arguments: argparse.Namespace) -> int:
    """Plan a motion; 1 where there is none."""
    from studies.report import plan_text

    target, say = _output(arguments), _say(arguments)
    name, tables, folder = read_tables(arguments.problem)
    for override in arguments.set:
        apply_override(tables, override)
    plan = plan_motion(problem_from_tables(name, tables, folder), say)
    if plan.status == "optimal" and target is not None:
        write_whole(target, lambda place: save_plan(plan, place, target))
        say(f"saved in {target}")
    elif target is not None:
        say(f"nothing written: {plan.status}")
    _show(arguments, record(plan), plan_text(plan))
    return DONE if plan.status == "optimal" else NO


def run_batch(arguments: argparse.Namespace) -> int:
    """Plan the cases of a batch file; 1 where one of them has no plan."""
    from studies.batch import run_batch as run

    _output(arguments)
    said, text, whole = run(arguments)
    _show(arguments, said, text)
    return DONE if whole else NO


def save_plan(plan: Plan, place: Path, target: Path | None = None) -> None:
    """Write a plan and its figure into an empty folder, which will stand at `target` where it is to be moved."""
    from studies.draw_plan import plan_figure

    write_plan(plan, place, target)
    plan_figure(plan, place / "plan.png")


def run_track(arguments: argparse.Namespace) -> int:
    """Run one tracker; 1 where the plan has no motion or the loop is unstable."""
    from studies.compare import TRACKERS, comparison_record
    from studies.report import comparison_text

    choose("tracker", arguments.tracker, TRACKERS, ProblemError)
    target, say = _output(arguments), _say(arguments)
    mismatch_given = _check_mismatch(arguments)
    plan = _plan(arguments, say)
    if plan.trajectory is None:
        return _no_plan(arguments, plan)
    comparison = _single(plan, arguments, mismatch_given)
    said = comparison_record(comparison) | {"tracker": arguments.tracker}
    if target is not None:
        write_whole(target, lambda place: _save_tracking(comparison, said, place, "track"), "track.json")
    _show(arguments, said, comparison_text(comparison))
    return DONE if next(iter(comparison.nominal.values())).stable else NO


def _single(plan: Plan, arguments: argparse.Namespace, mismatch_given: bool):
    """Return one tracker's run as a comparison with itself alone, under the mismatch if one was given."""
    from studies.compare import Comparison, default_mismatch, track

    mismatch = default_mismatch(plan, arguments.mass_factor, arguments.delay_periods) if mismatch_given else None
    rollout = track(plan, arguments.tracker, mismatch)
    title = "nominal" if mismatch is None else mismatch.name
    return Comparison(plan=plan, nominal={arguments.tracker: rollout}, mismatch=None, mismatched={}, title=title)


def _check_mismatch(arguments: argparse.Namespace) -> bool:
    """Return whether a mismatch is asked for, its numbers checked."""
    factor, delay = arguments.mass_factor, arguments.delay_periods
    if not (np.isfinite(factor) and factor > 0):
        raise ProblemError(f"--mass-factor is a positive number, got {factor:g}")
    if not 0 <= delay <= 1000:
        raise ProblemError(f"--delay-periods is a whole number from 0 to 1000, got {delay}")
    return factor != 1.0 or delay != 0


def _no_plan(arguments: argparse.Namespace, plan: Plan) -> int:
    _show(arguments, record(plan), f"{plan.problem.name}: {plan.message}")
    return NO


def run_compare(arguments: argparse.Namespace) -> int:
    """Run all trackers; 1 where the plan has no motion or no tracker is stable as modelled."""
    from studies.compare import compare, comparison_record, default_mismatch
    from studies.document import document_record, is_the_documents, mended_runs
    from studies.report import comparison_text

    target, say = _output(arguments), _say(arguments)
    mismatch_given = _check_mismatch(arguments)
    plan = _plan(arguments, say)
    if plan.trajectory is None:
        return _no_plan(arguments, plan)
    mismatch = default_mismatch(plan, arguments.mass_factor, arguments.delay_periods) if mismatch_given else None
    comparison = compare(plan, mismatch, say)
    said = comparison_record(comparison)
    document = {}
    if is_the_documents(plan):
        document = mended_runs(plan, say)
        said["document"] = document_record(document)
    if target is not None:
        write_whole(target, lambda place: _save_tracking(comparison, said, place, "compare", document), "compare.json")
    _show(arguments, said, comparison_text(comparison))
    return DONE if any(rollout.stable for rollout in comparison.nominal.values()) else NO


def _save_tracking(comparison, said: dict, place: Path, name: str, document: dict | None = None) -> None:
    from studies.document import KP
    from studies.draw_tracking import comparison_figure, document_figure

    write_json(place / f"{name}.json", said)
    comparison_figure(comparison, place / f"{name}.png")
    if document:
        document_figure(document, KP, place / "desired_and_actual.png")


def run_view(arguments: argparse.Namespace) -> int:
    """Play a tracked plan in the viewer; 1 where the plan has no motion."""
    from controllers.playback import has_screen, play
    from studies.compare import TRACKERS, track

    choose("tracker", arguments.tracker, TRACKERS, ProblemError)
    for name in ("slow", "seconds"):
        value = getattr(arguments, name)
        if value is not None and not (np.isfinite(value) and value > 0):
            raise ProblemError(f"--{name} is a positive number, got {value:g}")
    say = _say(arguments)
    plan = _plan(arguments, say)
    if plan.trajectory is None:
        return _no_plan(arguments, plan)
    if not has_screen():
        raise ProblemError("view needs a screen, and none is there: neither DISPLAY nor WAYLAND_DISPLAY is set")
    rollout = track(plan, arguments.tracker)
    say(f"{plan.problem.name} tracked by {arguments.tracker}, {arguments.slow:g} times slower; close the window to end")
    play(plan.problem.mechanism, rollout, arguments.slow, arguments.seconds)
    if arguments.json:
        print(json.dumps({"plan": plan.problem.name, "tracker": arguments.tracker, "stable": rollout.stable}))
    return DONE


def run_demo(arguments: argparse.Namespace) -> int:
    """Run the whole path on the knee."""
    from studies.demo import demo

    arguments.output = "linkplan-demo" if arguments.output is None else arguments.output
    target = _output(arguments)
    said, text = demo(target, _say(arguments))
    _show(arguments, said, text)
    return DONE
