"""The commands about loops: `bode` and `tune`."""

import argparse
from pathlib import Path

import numpy as np

from linkplan.controllers.trackers.names import LINEAR
from linkplan.models.errors import LinkplanError, ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.build import mechanism_from_tables, tracking_from_tables
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import Tracking, number, whole
from linkplan.studies.cli.common import deliver, output_folder, poses_asked, selection_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import Progress, progress
from linkplan.studies.output.document import Block, Section

_EXTRA_TITLES = {"map": "Stability map", "large": "Large signals", "along": "Along the motion"}


def run_bode(arguments: argparse.Namespace) -> int:
    """Report on a loop's frequency response, predicted and measured; 1 if it is unstable at a pose."""
    from linkplan.studies.bode.bode import bode_study
    from linkplan.studies.bode.bode_blocks import summary
    from linkplan.studies.bode.bode_report import bode_record
    from linkplan.studies.bode.poses import loop_poses
    from linkplan.studies.frequency.excitation import Setup
    from linkplan.studies.frequency.feedback_loops import refuse_several_freedoms

    choose("tracker", arguments.tracker, LINEAR, ProblemError)
    target, say = output_folder(arguments), progress(arguments)
    problem, mechanism, settings, limit = _loop_of(arguments)
    if arguments.along and problem is None:
        raise ProblemError("--along needs a problem, for its motion; a model has none")
    amplitude = _amplitude(arguments, mechanism)
    setup = Setup(amplitude=amplitude) if arguments.measure else None
    for name, what in (("map", "--map"), ("large", "--large")):
        if getattr(arguments, name):
            refuse_several_freedoms(mechanism, what)
    looked = loop_poses(mechanism, problem, limit, poses_asked(arguments, mechanism))
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
        note=looked.note,
    )
    said, blocks, extras = bode_record(study), summary(study), {}
    for name, title in _EXTRA_TITLES.items():
        if getattr(arguments, name):
            said[name], drawn = _extra(name, study, problem, say)
            extras[name] = Section(title=title, blocks=drawn, depth=2)
            blocks += drawn

    def draw(place: Path) -> None:
        from linkplan.studies.bode.bode_report import save_bode
        from linkplan.studies.output.figure import figure_of, panels_of

        save_bode(study, place)
        for name, section in extras.items():
            figure_of(panels_of(section.blocks), place / f"{name}.png", title=section.title, columns=3, panel_in=(6.0, 4.6))

    sections = list(extras.values())
    deliver(arguments, target, said, blocks, lambda reports: reports.bode_report(study, sections), draw)
    return DONE if study.stable else NO


def _amplitude(arguments: argparse.Namespace, mechanism: Mechanism) -> float | None:
    """Return the amplitude [rad or m] of --amplitude-deg, None without it or without a measurement."""
    amplitude = arguments.amplitude_deg
    if amplitude is None or arguments.measure == "none":
        return None
    return mechanism.independent_joints[0].read(number(amplitude, "--amplitude-deg", positive=True))


def run_tune(arguments: argparse.Namespace) -> int:
    """Find gains for requirements; 1 if there are none."""
    from linkplan.studies.bode.poses import loop_poses
    from linkplan.studies.frequency.feedback_loops import operating_point, sampled_law
    from linkplan.studies.tune.judged import LEAST_DAMPING_RATIO, Wanted
    from linkplan.studies.tune.tune import tune
    from linkplan.studies.tune.tune_report import tracking_table, tune_blocks, tune_figure, tune_record

    choose("tracker", arguments.tracker, LINEAR, ProblemError)
    target, say = output_folder(arguments), progress(arguments)
    problem, mechanism, settings, limit = _loop_of(arguments)
    wanted = Wanted(
        settling_s=arguments.settling_s,
        damping_ratio=LEAST_DAMPING_RATIO if arguments.damping_ratio is None else arguments.damping_ratio,
        stiffness=arguments.stiffness,
        bandwidth_hz=arguments.bandwidth_hz,
        phase_margin_deg=arguments.phase_margin_deg,
        sensitivity_peak=np.inf if arguments.sensitivity_peak is None else arguments.sensitivity_peak,
    )
    looked = loop_poses(mechanism, problem, limit, poses_asked(arguments, mechanism))
    points = [operating_point(mechanism, position, limit) for position in looked.positions]
    law = sampled_law(mechanism, arguments.tracker, settings, limit)
    found = tune(points, wanted, law, say=say, line=looked.line, note=looked.note)

    def draw(place: Path) -> None:
        (place / "tracking.toml").write_text(tracking_table(found), encoding="utf-8")
        tune_figure(found, place / "tune.png")

    deliver(arguments, target, tune_record(found), tune_blocks(found), lambda reports: reports.tune_report(found), draw)
    return DONE if found.found else NO


def _loop_of(arguments: argparse.Namespace) -> tuple[Problem | None, Mechanism, Tracking, np.ndarray]:
    """Return the problem or None, the mechanism, the tracking settings and the effort limits."""
    name, tables, folder, is_problem = tables_of(arguments.model, arguments.set, selection_asked(arguments))
    if is_problem:
        problem: Problem | None = Problem.from_tables(name, tables, folder)
        mechanism, settings, limit = problem.mechanism, problem.tracking, problem.limits.actuators_effort
    else:
        problem, mechanism = None, mechanism_from_tables(tables, folder)
        settings, limit = tracking_from_tables(tables, mechanism), mechanism.effort_limit
    return problem, mechanism, _settings(arguments, settings), limit


def _settings(arguments: argparse.Namespace, settings: Tracking) -> Tracking:
    from dataclasses import replace

    asked = {name: getattr(arguments, name, None) for name in ("kp", "kd", "period_s", "delay_periods")}
    asked = {name: value for name, value in asked.items() if value is not None}
    for name, value in asked.items():
        number(value, f"--{name.replace('_', '-')}", positive=name == "period_s", at_least_zero=True)
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
    whole(count, "--frequencies", 2, 1000)
    if high > nyquist:
        raise ProblemError(
            f"--to-hz {high:g} is above the Nyquist frequency, {nyquist:g} Hz at a control period of {settings.period_s:g} s"
        )
    return np.geomspace(low, high, count)


def _extra(name: str, study, problem: Problem | None, say: Progress) -> tuple[dict, list[Block]]:
    """Return the record and the document of the stability map, of large signals, or of the loop along a motion."""
    from linkplan.studies.bode import along_motion, large_study, loop_blocks, map_study

    if name == "map":
        gains = map_study.map_study(study, say)
        return map_study.map_record(gains), loop_blocks.map_blocks(gains)
    if name == "large":
        signals = large_study.large_study(study, None if problem is None else problem.limits, say)
        return large_study.large_study_record(signals), loop_blocks.large_blocks(signals)
    assert problem is not None  # --along asks for one
    plan = plan_motion(problem, say)
    if plan.trajectory is None:
        raise LinkplanError(f"--along: {problem.name} has no motion: {plan.message}")
    found = along_motion.along_motion(plan, study.law.name, study.law.settings, say)
    return along_motion.along_record(found), loop_blocks.along_blocks(found)
