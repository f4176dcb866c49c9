"""The sections of a comparison: animation of the tracked motions, table of trackers, errors and efforts over time."""

from collections.abc import Mapping, Sequence

import numpy as np

from linkplan.controllers.rollout import Rollout
from linkplan.models.mechanism import Mechanism
from linkplan.studies.compare.compare import Comparison, comparison_notes, gap_units, rollout_record, tracking_reference
from linkplan.studies.output.drawing import SERIES, TRACKER_COLOURS
from linkplan.studies.report.animation import Run, animation, frames_of
from linkplan.studies.report.columns import columns
from linkplan.studies.report.document import Block, Plot, Section, Table, Text
from linkplan.studies.report.lines import TIME, Line, overlaid_width, plots
from linkplan.studies.report.numbers import significant
from linkplan.studies.report.plan_sections import group_of, plan_sections

# With more joints or actuators, those with the largest errors and efforts are shown and the others are folded.
_MAX_JOINTS_SHOWN = 6
# The peak efforts of more actuators have a table of their own.
_MAX_PEAK_COLUMNS = 3


def comparison_sections(comparison: Comparison, *, depth: int = 1) -> list[Section]:
    """Return the sections of trackers' runs on a plan, without those of the plan."""
    plan, below = comparison.plan, depth + 1
    cases = [(comparison.title, comparison.nominal)]
    if comparison.mismatch is not None:
        cases.append((comparison.mismatch.name, comparison.mismatched))
    notes = [Text(text=note, tone="note") for note in comparison_notes(comparison)]
    tables = [table for title, runs in cases for table in _tables(comparison, title, runs)]
    first = Section(
        title=f"Tracking: {plan.problem.name}", blocks=[_animation(comparison, cases), *tables, *notes], depth=depth
    )
    return [first, *(section for title, runs in cases for section in _over_time(comparison, title, runs, depth=below))]


def whole_comparison(comparison: Comparison) -> list[Section]:
    """Return the sections of a comparison and those of its plan."""
    return [*comparison_sections(comparison), *plan_sections(comparison.plan, animated=False)]


def _tables(comparison: Comparison, title: str, runs: Mapping[str, Rollout]) -> list[Table]:
    """Return the table of trackers and, for many actuators, a second one of their peak efforts."""
    plan = comparison.plan
    units = list(dict.fromkeys(joint.unit for joint in plan.problem.mechanism.independent_joints))
    actuators = plan.problem.mechanism.actuators
    few, (lengths, angles) = actuators if len(actuators) <= _MAX_PEAK_COLUMNS else [], gap_units(comparison.plan)
    heads = [
        ("tracker", ""),
        *((f"{which} error", unit) for unit in units for which in ("rms", "largest", "final")),
        *((f"peak of {actuator.name}", actuator.unit) for actuator in few),
        ("saturated", "%"),
        *([("closure gap", "um")] if lengths else []),
        *([("closure gap", "urad")] if angles else []),
        ("contacts", ""),
        ("stable", ""),
    ]
    rows = []
    for name, run in runs.items():
        said = rollout_record(plan, run)
        errors = [said.get(f"{which}_error_{unit}") for unit in units for which in ("rms", "max", "final")]
        gaps = [1e6 * gap for gap, there in zip(run.largest_gaps, (lengths, angles), strict=True) if there]
        peaks = [said["peak_effort"][actuator.name] for actuator in few]
        numbers = [*errors, *peaks, 100 * said["saturated_fraction"], *gaps]
        rows.append([name, *(significant(x) for x in numbers), said["contacts"], said["stable"]])
    conditions = _conditions_text(next(iter(runs.values())).conditions)
    found = [Table(title=f"{title[:1].upper()}{title[1:]}: {conditions}", columns=heads, rows=rows)]
    return found if few else [*found, _peak_table(comparison, title, runs)]


def _conditions_text(conditions: Mapping) -> str:
    delay = conditions["delay_periods"]
    return (
        f"MuJoCo {conditions['mujoco']}, {conditions.get('integrator', '')}, step {conditions['timestep_s']:g} s,"
        f" control period {conditions['control_period_s']:g} s, delay {delay} period{'' if delay == 1 else 's'}"
    )


def _peak_table(comparison: Comparison, title: str, runs: Mapping[str, Rollout]) -> Table:
    plan = comparison.plan
    records = [rollout_record(plan, run)["peak_effort"] for run in runs.values()]
    actuators = plan.problem.mechanism.actuators
    rows = [[a.name, *(significant(peaks[a.name]) for peaks in records), a.unit] for a in actuators]
    columns = [("actuator", ""), *((name, "") for name in runs), ("unit", "")]
    return Table(title=f"Peak efforts, {title}", columns=columns, rows=rows)


def _animation(comparison: Comparison, cases) -> Block:
    """Return the animation of the planned motion over the tracked time, with every run as a ghost."""
    plan = comparison.plan
    mechanism, reference = plan.problem.mechanism, tracking_reference(plan)
    n_runs = sum(len(runs) for _, runs in cases)
    frames = np.unique(np.linspace(0, reference.n - 1, frames_of(mechanism, 1 + n_runs)).astype(int))
    ghosts = {}
    for k, (_, runs) in enumerate(cases):
        for name, run in runs.items():
            ghosts[name if k == 0 else f"{name}, with the mismatch"] = _run(run, frames)
    return animation(
        mechanism,
        f"{mechanism.name} along {plan.problem.name}, planned and as tracked",
        group_of(plan),
        reference.time_s[frames],
        reference.pose[frames],
        effort=reference.effort[frames],
        effort_limit=np.array(plan.problem.limits.effort),
        ghosts=ghosts,
        sites=plan.problem.sites,
    )


def _run(run: Rollout, frames: np.ndarray) -> Run:
    """Return a run at control instants; a diverged run keeps its last finite pose, with zero effort."""
    seen = np.flatnonzero(np.isfinite(run.pose).all(axis=1))
    last = int(seen[-1]) if len(seen) else 0
    at = np.minimum(frames, last)
    return Run(poses=np.nan_to_num(run.pose[at]), effort=np.where((frames <= last)[:, None], run.applied[at], 0.0))


def _over_time(comparison: Comparison, title: str, runs: Mapping[str, Rollout], *, depth: int) -> list[Section]:
    """Return the plots over time: joints and actuators with the largest figures, and the others in a folded section."""
    mechanism = comparison.plan.problem.mechanism
    chosen = _largest(np.max([np.abs(run.error).max(axis=0) for run in runs.values()], axis=0))
    pushed = _largest(np.max([np.abs(run.applied).max(axis=0) for run in runs.values()], axis=0))
    others = [k for k in range(mechanism.dof) if k not in chosen], [j for j in range(mechanism.n_u) if j not in pushed]
    blocks = [*_joint_plots(comparison, runs, chosen), *_effort_plots(comparison, runs, pushed), *_gap(comparison, runs)]
    found = [Section(title=f"Over time: {title}", blocks=[*_left_out(mechanism, *others), *blocks], depth=depth)]
    if any(others):
        blocks = [*_joint_plots(comparison, runs, others[0]), *_effort_plots(comparison, runs, others[1])]
        found.append(Section(title=f"Other joints: {title}", blocks=blocks, depth=depth, folded=True))
    return found


def _joint_plots(comparison: Comparison, runs: Mapping[str, Rollout], chosen: list[int]) -> list[Plot]:
    joints, longest, found = comparison.plan.problem.mechanism.independent_joints, _longest(runs), []
    for k in chosen:
        joint, factor = joints[k], joints[k].shown(1.0)
        desired = Line(name="desired", values=factor * longest.reference[:, k], unit=joint.unit, look="dash", colour=None)
        positions = {name: factor * run.position[:, k] for name, run in runs.items()}
        # On the logarithmic axis, errors below the simulator's rounding, about 1e-7 deg or m, are drawn at that value.
        errors = {name: np.maximum(np.abs(factor * run.error[:, k]), 1e-7) for name, run in runs.items()}
        title = f"{joint.name}, desired and tracked"
        found += _plots(comparison, runs, title, "position", joint.unit, positions, extra=[desired])
        found += _plots(comparison, runs, f"Size of the error of {joint.name}", "error", joint.unit, errors, log=True)
    return found


def _effort_plots(comparison: Comparison, runs: Mapping[str, Rollout], pushed: list[int]) -> list[Plot]:
    actuators, limits, found = comparison.plan.problem.mechanism.actuators, _longest(runs).effort_limit, []
    for j in pushed:
        ends = (float(limits[j][0]), float(limits[j][1]))
        efforts = {name: run.applied[:, j] for name, run in runs.items()}
        title = f"Effort of {actuators[j].name}"
        found += _plots(comparison, runs, title, "effort", actuators[j].unit, efforts, limits=ends)
    return found


def _gap(comparison: Comparison, runs: Mapping[str, Rollout]) -> list[Plot]:
    if not comparison.plan.problem.mechanism.closures:
        return []
    lengths, angles = gap_units(comparison.plan)
    found: list[Plot] = []
    if lengths:
        gaps = {name: 1e6 * run.gap_m for name, run in runs.items()}
        found += _plots(comparison, runs, "Gap of the kinematic loops", "gap", "um", gaps)
    if angles:
        gaps = {name: 1e6 * run.gap_rad for name, run in runs.items()}
        found += _plots(comparison, runs, "Gap of the angles that closures tie", "gap", "urad", gaps)
    return found


def _longest(runs: Mapping[str, Rollout]) -> Rollout:
    return max(runs.values(), key=lambda run: len(run.time_s))


def _plots(
    comparison: Comparison,
    runs: Mapping[str, Rollout],
    title: str,
    what: str,
    unit: str,
    values: Mapping[str, np.ndarray],
    *,
    log: bool = False,
    extra: Sequence[Line] = (),
    limits: tuple[float, float] = (-np.inf, np.inf),
) -> list[Plot]:
    """Return the plots of a quantity of every run over time."""
    time = _longest(runs).time_s
    lines = [
        Line(
            name=name,
            values=_padded(column, len(time)),
            unit=unit,
            colour=_colour(runs, name),
            look="line",
            width=overlaid_width(k, len(runs)),
            limits=limits,
        )
        for k, (name, column) in enumerate(values.items())
    ]
    return plots(title, what, TIME, time, [*lines, *extra], group=group_of(comparison.plan), log=log)


def _left_out(mechanism: Mechanism, joints: list[int], actuators: list[int]) -> list[Text]:
    if not joints and not actuators:
        return []
    said = (
        f"Drawn are the {mechanism.dof - len(joints)} of {mechanism.dof} joints with the largest errors and the"
        f" {mechanism.n_u - len(actuators)} of {mechanism.n_u} actuators with the largest efforts; the others are in the"
        " folded section below."
    )
    return [Text(text=said, tone="note")]


def _largest(sizes: np.ndarray) -> list[int]:
    """Return the indices of the largest sizes, in ascending order."""
    return sorted(np.argsort(np.nan_to_num(sizes, nan=np.inf))[::-1][:_MAX_JOINTS_SHOWN].tolist())


def _padded(values: np.ndarray, n: int) -> np.ndarray:
    """Return values (m,) as (n,), NaN after the end of a run."""
    return np.concatenate([values, np.full(n - len(values), np.nan)])


def _colour(runs: Mapping[str, Rollout], name: str) -> int:
    """Return a tracker's colour, the same as in the figures."""
    own = {tracker: SERIES.index(colour) for tracker, colour in TRACKER_COLOURS.items()}
    others = [other for other in runs if other not in own]
    taken = {own[other] for other in runs if other in own}
    left = [k for k in range(len(SERIES)) if k not in taken] or list(range(len(SERIES)))
    return own[name] if name in own else left[others.index(name) % len(left)]


def document_section(runs: Mapping[tuple[str, float], Rollout], rows: list[dict], kp: float, *, depth: int = 1) -> Section:
    """Return the section of the source document's experiment.

    Args:
        runs: by (model, KD).
        rows: their figures, from `document_record`.
        kp: the common gain [N.m/rad].
        depth: of the section's title.
    """
    heads = columns("model", "KP [N.m/rad]", "KD [N.m.s/rad]", "rms error [deg]", "closure gap, mean [um]")
    heads += columns("closure gap, largest [um]", "contacts", "at the limit [%]", "stable")
    table = Table(
        title="The source document's experiment, as printed and on the mended model",
        columns=heads,
        rows=[
            [
                row["model"],
                row["kp"],
                row["kd"],
                significant(row["rms_error_deg"]),
                significant(1e6 * row["steady_gap_mean_m"]),
                significant(1e6 * row["steady_gap_max_m"]),
                row["contacts"],
                significant(100 * row["at_limit_fraction"]),
                row["stable"],
            ]
            for row in rows
        ],
    )
    return Section(
        title="The source document, as printed and mended", blocks=[table, *_document_plots(runs, kp)], depth=depth
    )


def _document_plots(runs: Mapping[tuple[str, float], Rollout], kp: float) -> list[Plot]:
    found = []
    for (model, kd), run in runs.items():
        lines = [
            Line(name="actual", values=np.degrees(run.position[:, 0]), unit="deg", look="line", colour=1),
            Line(name="desired", values=np.degrees(run.reference[:, 0]), unit="deg", look="dash", colour=0),
        ]
        title = f"{model}: KP = {kp:g} N.m/rad, KD = {kd:g} N.m.s/rad"
        found += plots(title, "joint O", TIME, run.time_s, lines, group="time:document")
    return found
