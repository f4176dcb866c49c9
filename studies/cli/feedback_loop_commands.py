"""The commands about loops: `bode` and `tune`."""

import argparse
from pathlib import Path

import numpy as np

from linkplan.controllers.trackers.names import LINEAR
from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.names import choose
from linkplan.planner.files.folders import write_json, write_whole
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.build import mechanism_from_tables, tracking_from_tables
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.cli.common import output_folder, poses_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress, show
from linkplan.studies.cli.progress import Progress
from linkplan.studies.frequency.method_names import METHODS


def run_bode(arguments: argparse.Namespace) -> int:
    """Report on a loop's frequency response, predicted and measured; 1 if it is unstable at a pose."""
    from linkplan.studies.bode.bode import bode_study
    from linkplan.studies.bode.bode_report import bode_record, bode_text
    from linkplan.studies.bode.poses import loop_poses
    from linkplan.studies.frequency.excitation import Setup
    from linkplan.studies.frequency.feedback_loops import refuse_several_freedoms

    choose("tracker", arguments.tracker, LINEAR, ProblemError)
    choose("way to measure", arguments.measure, (*METHODS, "none"), ProblemError)
    target, say = output_folder(arguments), progress(arguments)
    problem, mechanism, settings, limit = _loop_of(arguments)
    if arguments.along and problem is None:
        raise ProblemError("--along needs a problem, for its motion; a model has none")
    amplitude = _amplitude(arguments, mechanism)
    setup = None if arguments.measure == "none" else Setup(method=arguments.measure, amplitude=amplitude)
    for name, what in (("map", "--map"), ("large", "--large")):
        if getattr(arguments, name):
            refuse_several_freedoms(mechanism, what)
    looked = loop_poses(mechanism, problem, limit, poses_asked(arguments, mechanism))
    note = looked.note
    study = bode_study(
        mechanism,
        looked.positions,
        settings,
        limit,
        say,
        law=arguments.tracker,
        setup=setup,
        frequency_hz=_frequencies(arguments, settings),
        line=looked.line,
    )
    said, texts = bode_record(study), [bode_text(study)]
    said["note"] = note
    texts += [f"note: {note}"] if note else []
    extras = [name for name in ("map", "large", "along") if getattr(arguments, name)]
    drawers, others = [], []
    for name in extras:
        other, record, text, draw = _EXTRAS[name](study, problem, say)
        others.append(other)
        said[name] = record
        texts.append(text)
        drawers.append(draw)
    if target is not None:
        from linkplan.studies.bode.draw_bode import save_bode
        from linkplan.studies.report.reports import bode_report
        from linkplan.studies.report.saving import save_report

        def write(place: Path) -> None:
            write_json(place / "bode.json", said)
            save_report(bode_report(study, others, note), place, page=arguments.report)
            save_bode(study, place)
            for draw in drawers:
                draw(place)

        write_whole(target, write, "bode.json")
    show(arguments, said, "\n\n".join(texts))
    return DONE if study.stable else NO


def _amplitude(arguments: argparse.Namespace, mechanism: Mechanism) -> float | None:
    """Return the amplitude [rad or m] of --amplitude-deg, None without it or without a measurement."""
    amplitude = arguments.amplitude_deg
    if amplitude is None or arguments.measure == "none":
        return None
    if not (np.isfinite(amplitude) and amplitude > 0):
        raise ProblemError(f"--amplitude-deg is a positive number, got {amplitude:g}")
    return mechanism.independent_joints[0].read(amplitude)


def run_tune(arguments: argparse.Namespace) -> int:
    """Find gains for requirements; 1 if there are none."""
    from linkplan.controllers.sampling import sampling
    from linkplan.studies.bode.poses import loop_poses
    from linkplan.studies.frequency.feedback_loops import operating_point
    from linkplan.studies.tune.tune import Wanted, tune
    from linkplan.studies.tune.tune_report import tune_record, tune_text

    choose("tracker", arguments.tracker, LINEAR, ProblemError)
    target, say = output_folder(arguments), progress(arguments)
    problem, mechanism, settings, limit = _loop_of(arguments)
    wanted = Wanted(
        bandwidth_hz=arguments.bandwidth_hz,
        phase_margin_deg=arguments.phase_margin_deg,
        sensitivity_peak=np.inf if arguments.sensitivity_peak is None else arguments.sensitivity_peak,
    )
    if mechanism.dof != 1:
        raise ProblemError(f"tune needs a mechanism of one degree of freedom; '{mechanism.name}' has {mechanism.dof}")
    looked = loop_poses(mechanism, problem, limit, poses_asked(arguments, mechanism))
    note = looked.note
    points = [operating_point(mechanism, position, limit) for position in looked.positions]
    timing = sampling(mechanism, settings.period_s, settings.delay_periods)
    found = tune(points, wanted, settings, timing, limit, law=arguments.tracker, say=say, line=looked.line)
    said, text = tune_record(found) | {"note": note}, tune_text(found) + (f"\nnote: {note}" if note else "")
    if target is not None:
        from linkplan.studies.report.reports import tune_report
        from linkplan.studies.report.saving import save_report
        from linkplan.studies.tune.draw_tune import tune_figure
        from linkplan.studies.tune.tune_report import tracking_table

        def write(place: Path) -> None:
            write_json(place / "tune.json", said)
            save_report(tune_report(found, note), place, page=arguments.report)
            (place / "tracking.toml").write_text(tracking_table(found), encoding="utf-8")
            tune_figure(found, place / "tune.png")

        write_whole(target, write, "tune.json")
    show(arguments, said, text)
    return DONE if found.found else NO


def _loop_of(arguments: argparse.Namespace) -> tuple[Problem | None, Mechanism, Tracking, np.ndarray]:
    """Return the problem or None, the mechanism, the tracking settings and the effort limits."""
    name, tables, folder, is_problem = tables_of(arguments.model, arguments.set)
    if is_problem:
        problem: Problem | None = Problem.from_tables(name, tables, folder)
        mechanism, settings, limit = problem.mechanism, problem.tracking, problem.limits.actuators_effort
    else:
        problem, mechanism = None, mechanism_from_tables(tables, folder)
        settings, limit = tracking_from_tables(tables, mechanism), mechanism.effort_limit
    return problem, mechanism, _settings(arguments, settings), limit


def _settings(arguments: argparse.Namespace, settings: Tracking) -> Tracking:
    """Return the tracking settings with the values of the command line."""
    from dataclasses import replace

    asked = {name: getattr(arguments, name, None) for name in ("kp", "kd", "period_s", "delay_periods")}
    asked = {name: value for name, value in asked.items() if value is not None}
    for name in ("kp", "kd"):
        if name in asked and not (np.isfinite(asked[name]) and asked[name] >= 0):
            raise ProblemError(f"--{name} is a number of at least 0, got {asked[name]:g}")
    if "period_s" in asked and not (np.isfinite(asked["period_s"]) and asked["period_s"] > 0):
        raise ProblemError(f"--period-s is a positive number, got {asked['period_s']:g}")
    if "delay_periods" in asked and not (np.isfinite(asked["delay_periods"]) and 0 <= asked["delay_periods"] <= 1000):
        raise ProblemError(f"--delay-periods is a number from 0 to 1000, got {asked['delay_periods']:g}")
    settings = replace(settings, **asked)
    if not settings.acts:
        raise ProblemError("--kp and --kd are both 0: there is no feedback")
    return settings


def _frequencies(arguments: argparse.Namespace, settings: Tracking) -> np.ndarray | None:
    """Return the frequencies of the options [Hz], or None without them."""
    low, high, count = arguments.from_hz, arguments.to_hz, arguments.frequencies
    if low is None and high is None and count is None:
        return None
    nyquist = 0.5 / settings.period_s
    low = nyquist / 500 if low is None else low
    high = 0.9 * nyquist if high is None else high
    count = 20 if count is None else count
    if not (np.isfinite(low) and np.isfinite(high) and 0 < low < high):
        raise ProblemError(f"--from-hz is positive and below --to-hz, got {low:g} and {high:g}")
    if not 2 <= count <= 1000:
        raise ProblemError(f"--frequencies is from 2 to 1000, got {count}")
    if high > nyquist:
        raise ProblemError(
            f"--to-hz {high:g} is above the Nyquist frequency, {nyquist:g} Hz at a control period of {settings.period_s:g} s"
        )
    return np.geomspace(low, high, count)


def _map(study, problem: Problem | None, say: Progress):
    """Return the stability map, its record, text and drawer."""
    from linkplan.studies.bode.draw_map import map_figure
    from linkplan.studies.bode.map_study import map_record, map_study, map_text

    del problem
    found = map_study(study, say)
    return found, map_record(found), map_text(found), lambda place: map_figure(found, place / "map.png")


def _large(study, problem: Problem | None, say: Progress):
    """Return the large signals, their record, text and drawer."""
    from linkplan.studies.bode.draw_large import large_figure
    from linkplan.studies.bode.large_study import large_study, large_study_record, large_text

    found = large_study(study, None if problem is None else problem.limits, say)
    return found, large_study_record(found), large_text(found), lambda place: large_figure(found, place / "large.png")


def _along(study, problem: Problem | None, say: Progress):
    """Return the loop along the problem's motion, its record, text and drawer."""
    from linkplan.studies.bode.along_motion import along_motion, along_record, along_text
    from linkplan.studies.bode.draw_along import along_figure

    plan = plan_motion(problem, say)
    if plan.trajectory is None:
        raise LinkplanError(f"--along: {problem.name} has no motion: {plan.message}")
    found = along_motion(plan, study.law, study.settings, say)
    return found, along_record(found), along_text(found), lambda place: along_figure(found, place / "along.png")


_EXTRAS = {"map": _map, "large": _large, "along": _along}
