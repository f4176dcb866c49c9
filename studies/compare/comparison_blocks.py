"""Trackers' runs on a plan as a document: a table for each case, errors and efforts over time, and notes."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from linkplan.controllers.integrator import shares_in_a_step
from linkplan.controllers.rollout import Rollout
from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.models.errors import listed
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.contacts import exclusion
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.certificate.further_checks import geom_names
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.default_gains import tracking_of
from linkplan.studies.check.holding import why_no_loop
from linkplan.studies.check.softness import gap_sentence, softness_error
from linkplan.studies.compare.compare import (
    ERRORS,
    Comparison,
    actuated_by_unit,
    error_figures,
    gap_units,
    run_figures,
    tracking_reference,
)
from linkplan.studies.output.document import Block, Plot, Table, Text, table_of
from linkplan.studies.output.figure_spec import FigureSpec, one_screen, side_by_side
from linkplan.studies.output.lines import TIME, Line, overlaid_width, plots, tracker_colour
from linkplan.studies.output.text import brief_rows

# With more actuators, their peak efforts have a separate table.
MAX_PEAK_COLUMNS = 3


def comparison_blocks(comparison: Comparison) -> list[Block]:
    """Return a table of the trackers for each case, and notes."""
    tables = [table for title, runs in comparison.cases for table in _tables(comparison, title, runs)]
    return [*tables, *(Text(text=note, tone="note") for note in comparison_notes(comparison))]


def comparison_figure(comparison: Comparison, *, every_joint: bool = False) -> FigureSpec:
    """Return the figure of every tracker's motion, error and effort.

    It is at most one screen high, with the two independent joints and the two actuators that have the largest errors and
    efforts; with `every_joint` it has all joints, dependent ones too, and all actuators. The left column has the runs as
    modelled, the right column those with the mismatch.
    """
    mechanism, cases = comparison.plan.problem.mechanism, comparison.cases
    most = max(mechanism.dof, mechanism.n_u) if every_joint else 2
    chosen, pushed = largest([run for _, runs in cases for run in runs.values()], most)
    columns = [
        [
            *joint_plots(comparison, runs, chosen),
            *(follower_plots(comparison, runs) if every_joint else []),
            *site_plots(comparison, runs),
            *effort_plots(comparison, runs, pushed),
        ]
        for _, runs in cases
    ]
    panels, size = side_by_side(*columns), (5.8, 2.6)
    size = size if every_joint else one_screen(len(panels), len(cases), size)
    title, heads = f"{comparison.plan.problem.name}: tracked in MuJoCo", [title for title, _ in cases]
    return FigureSpec(panels=panels, title=title, columns=len(cases), heads=heads, panel_in=size)


def largest(runs: Iterable[Rollout], most: int) -> tuple[list[int], list[int]]:
    """Return up to `most` independent joints and actuators, those with the largest errors and efforts, in order."""
    peaks = [[np.abs(values).max(axis=0) for values in (run.error_rad, run.applied)] for run in runs]
    sizes = [np.nan_to_num(np.max(of, axis=0), nan=np.inf) for of in zip(*peaks, strict=True)]
    joints, actuators = (sorted(np.argsort(size, kind="stable")[::-1][:most].tolist()) for size in sizes)
    return joints, actuators


def _tables(comparison: Comparison, title: str, runs: Mapping[str, Rollout]) -> list[Table]:
    """Return the table of trackers and, for many actuators, a second one of their peak efforts."""
    plan = comparison.plan
    units = [*actuated_by_unit(plan.problem.mechanism)]
    actuators = plan.problem.mechanism.actuators
    few, (lengths, angles) = actuators if len(actuators) <= MAX_PEAK_COLUMNS else [], gap_units(comparison.plan)
    heads = [
        "tracker",
        *((words, unit) for unit in units for words in ERRORS.values()),
        *((f"peak of {actuator.name}", actuator.unit) for actuator in few),
        "saturated [%]",
        *(["closure gap [um]"] if lengths else []),
        *(["closure gap [urad]"] if angles else []),
        "contacts",
        "stable",
    ]
    rows = []
    for name, run in runs.items():
        said = run_figures(plan, run)
        errors = [said.get(f"{which}_error_{unit}") for unit in units for which in ERRORS]
        gaps = [1e6 * gap for gap, there in zip(run.largest_gaps, (lengths, angles), strict=True) if there]
        peaks = [said["peak_effort"][actuator.name] for actuator in few]
        rows.append([name, *errors, *peaks, 100 * said["saturated_fraction"], *gaps, said["contacts"], said["stable"]])
    conditions = _conditions_text(next(iter(runs.values())).conditions)
    found = [table_of(f"{plan.problem.name}, {title}: {conditions}", heads, rows)]
    return found if few else [*found, _peak_table(comparison, title, runs)]


def _conditions_text(conditions: Mapping) -> str:
    delay = conditions["delay_periods"]
    return (
        f"MuJoCo {conditions['mujoco']}, {conditions.get('integrator', '')}, step {conditions['timestep_s']:g} s,"
        f" control period {conditions['control_period_s']:g} s, delay {delay:g} period{'' if delay == 1 else 's'}"
    )


def _peak_table(comparison: Comparison, title: str, runs: Mapping[str, Rollout]) -> Table:
    plan = comparison.plan
    records = [run_figures(plan, run)["peak_effort"] for run in runs.values()]
    actuators, limits = plan.problem.mechanism.actuators, _longest(runs).effort_limit
    rows = [[a.name, *(peaks[a.name] for peaks in records), a.unit] for a in actuators]
    peaks = [max(row[1:-1]) for row in rows]
    margins = [(-peak / (np.abs(ends).max() or np.inf), -peak) for peak, ends in zip(peaks, limits, strict=True)]
    brief = brief_rows(rows, margins, [a.unit for a in actuators], [a.name for a in actuators])
    return table_of(f"Peak efforts, {title}", ["actuator", *((name, "") for name in runs), "unit"], rows, brief=brief)


def joint_plots(comparison: Comparison, runs: Mapping[str, Rollout], chosen: Sequence[int]) -> list[Plot]:
    """Return the plots of the motion and the error of independent joints, by joint index."""
    joints, longest, found = comparison.plan.problem.mechanism.independent_joints, _longest(runs), []
    for k in chosen:
        joint = joints[k]
        desired = Line(
            name="desired", values=joint.shown(longest.reference_rad[:, k]), unit=joint.unit, look="dash", colour=None
        )
        positions = {name: joint.shown(run.position_rad[:, k]) for name, run in runs.items()}
        # On the logarithmic axis, errors below the simulator's rounding, about 1e-7 deg or m, are drawn at that value.
        errors = {name: np.maximum(np.abs(joint.shown(run.error_rad[:, k])), 1e-7) for name, run in runs.items()}
        title = f"{joint.name}, desired and tracked"
        found += _plots(comparison, runs, title, "position", joint.unit, positions, extra=[desired])
        found += _plots(comparison, runs, f"Size of the error of {joint.name}", "error", joint.unit, errors, log=True)
    return found


def follower_plots(comparison: Comparison, runs: Mapping[str, Rollout]) -> list[Plot]:
    """Return the plots of the motion of dependent joints."""
    mechanism, found = comparison.plan.problem.mechanism, []
    for index in mechanism.dependent.tolist():
        joint = mechanism.joints[index]
        positions = {name: joint.shown(run.pose_rad[:, index]) for name, run in runs.items()}
        found += _plots(comparison, runs, f"{joint.name}, tracked", "position", joint.unit, positions)
    return found


def effort_plots(comparison: Comparison, runs: Mapping[str, Rollout], pushed: Sequence[int]) -> list[Plot]:
    """Return the plots of the effort of actuators, by actuator index."""
    actuators, limits, found = comparison.plan.problem.mechanism.actuators, _longest(runs).effort_limit, []
    for j in pushed:
        ends = (float(limits[j][0]), float(limits[j][1]))
        efforts = {name: run.applied[:, j] for name, run in runs.items()}
        title = f"Effort of {actuators[j].name}"
        found += _plots(comparison, runs, title, "effort", actuators[j].unit, efforts, limits=ends)
    return found


def site_plots(comparison: Comparison, runs: Mapping[str, Rollout]) -> list[Plot]:
    """Return the plots of the distances of the problem's sites from their planned places, in millimetres."""
    mechanism, found = comparison.plan.problem.mechanism, []
    for name, index in comparison.plan.problem.sites.items():
        planned = places_of(mechanism, index, tracking_reference(comparison.plan).pose_rad)
        errors = {
            key: 1e3
            * np.linalg.norm(places_of(mechanism, index, np.nan_to_num(run.pose_rad)) - planned[: len(run.pose_rad)], axis=1)
            for key, run in runs.items()
        }
        found += _plots(comparison, runs, f"Distance of {name} from the plan", "distance", "mm", errors)
    return found


def gap_plots(comparison: Comparison, runs: Mapping[str, Rollout]) -> list[Plot]:
    """Return the plots of the closure gaps."""
    if not comparison.plan.problem.mechanism.closures:
        return []
    found: list[Plot] = []
    kinds = (("Gap of the kinematic loops", "um", "gap_m"), ("Gap of the angles that closures tie", "urad", "gap_rad"))
    for (title, unit, field), there in zip(kinds, gap_units(comparison.plan), strict=True):
        if there:
            gaps = {name: 1e6 * getattr(run, field) for name, run in runs.items()}
            found += _plots(comparison, runs, title, "gap", unit, gaps)
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
    time = _longest(runs).time_s
    lines = [
        Line(
            name=name,
            values=np.pad(column, (0, len(time) - len(column)), constant_values=np.nan),  # NaN after its end
            unit=unit,
            colour=_colour(runs, name),
            look="line",
            width=overlaid_width(k, len(runs)),
            limits=limits,
        )
        for k, (name, column) in enumerate(values.items())
    ]
    return plots(title, what, TIME, time, [*lines, *extra], group=f"time:{comparison.plan.problem.name}", log=log)


def _colour(runs: Mapping[str, Rollout], name: str) -> int:
    """Return a tracker's colour: its own, or for a user's tracker the next unused one."""
    others = [other for other in runs if other not in BUILT_IN]
    taken = {BUILT_IN[other].colour for other in runs if other in BUILT_IN}
    left = [k for k in range(7) if k not in taken] or list(range(7))
    return tracker_colour(name, left[others.index(name) % len(left)] if name in others else 0)


# With less travel [deg or m] a motion is at rest, so errors cannot be compared with its travel.
_STANDS_STILL = 1e-9


def gap_note(plan: Plan, rollout: Rollout) -> str | None:
    """Return the sentence on a run's closure gap and its effect on the joints, or None if the gap is small."""
    mechanism = plan.problem.mechanism
    if not (rollout.finite and gap_sentence(mechanism, *rollout.largest_gaps)):
        return None
    return gap_sentence(mechanism, *rollout.largest_gaps, softness_error(mechanism, rollout.pose_rad))


def contact_note(plan: Plan, rollout: Rollout) -> str | None:
    """Return the sentence on contacts in a run that its plan omits, or None if there were none."""
    met = plan.certificate.contacts if plan.certificate is not None else ()
    if not (rollout.contacts and met):
        return None
    pairs = listed([geom_names(meeting).removeprefix("geoms ") for meeting in met], 3)
    exclusions = " ".join(dict.fromkeys(exclusion(meeting.bodies) for meeting in met[:3]))
    return (
        f"{pairs} touch in MuJoCo, at up to {rollout.contacts} points at once. Plans have no contact forces, and these"
        f" forces open the kinematic loops. {exclusions} in the model's <contact> lets links pass side by side"
    )


def _gap_share(plan: Plan, rollout: Rollout) -> float:
    """Return a run's largest gap: a length divided by the mechanism's extent, or an angle [rad]."""
    gap_m, gap_rad = rollout.largest_gaps
    return max(gap_m / plan.problem.mechanism.extent_m, gap_rad)


def comparison_notes(comparison: Comparison) -> list[str]:
    """Return the sentences on omitted trackers, on runs that ended early, on default gains, and on the nominal runs."""
    runs = sorted(comparison.nominal.items(), key=lambda item: -_gap_share(comparison.plan, item[1]))
    pushed = [note for _, run in runs if (note := contact_note(comparison.plan, run)) is not None]
    found = [(name, note) for name, run in runs if (note := gap_note(comparison.plan, run)) is not None]
    slow = servo_note(comparison.plan.problem.mechanism)
    soft = [f"{name}, {note}" for name, note in found[:1]]
    told = [
        *comparison.left_out,
        *ended_early(comparison),
        *default_gains(comparison),
        *lost_notes(comparison),
        *left_notes(comparison),
    ]
    return [*told, *pushed[:1], *([] if slow is None else [slow]), *soft]


def ended_early(comparison: Comparison) -> list[str]:
    """Return a sentence on each run that ended before the motion did, with the reason."""
    return [
        f"{name}, {case}, ended at t = {run.time_s[-1]:.4g} s: {run.failure}"
        for case, runs in comparison.cases
        for name, run in runs.items()
        if run.failure is not None
    ]


def default_gains(comparison: Comparison) -> list[str]:
    """Return the sentence on PD gains that are default ones, if a tracker runs with them."""
    problem = comparison.plan.problem
    run = [name for name in ("pd", "pd+ff") if name in comparison.nominal]
    if not run or None not in (problem.tracking.kp, problem.tracking.kd):
        return []
    gains = tracking_of(problem).gains_text(problem.mechanism.independent_joints)
    ran = f"gains from the inertia at the start: {' and '.join(run)} used {gains}"
    time = comparison.plan.trajectory.dense_times(1)
    positions = comparison.plan.trajectory.position_at(time)
    why = why_no_loop(problem.mechanism, positions, problem.limits.actuators_effort)
    if why is not None:
        return [f"{ran}; set gains in [tracking], because no tuning can find them: {why}"]
    return [f"{ran}; `linkplan tune` finds gains for a bandwidth and margins"]


def lost_notes(comparison: Comparison) -> list[str]:
    """Return a sentence for each unit in which stable nominal runs have errors larger than the motion's whole travel."""
    mechanism, notes = comparison.plan.problem.mechanism, []
    errors = {name: error_figures(mechanism, run.error_rad) for name, run in comparison.nominal.items() if run.stable}
    reference = next(iter(comparison.nominal.values())).reference_rad
    travels = error_figures(mechanism, reference - reference[0])
    for unit in actuated_by_unit(mechanism):
        largest, travel = f"max_error_{unit}", travels[f"max_error_{unit}"]
        lost = {name: found[largest] for name, found in errors.items() if found[largest] > travel > _STANDS_STILL}
        if lost:
            said = ", ".join(f"{name} by {error:.3g} {unit}" for name, error in lost.items())
            notes.append(
                f"the motion, which travels {travel:.3g} {unit}, is not followed: the largest errors are {said}; 'stable'"
                " only means that a run stays finite and does not oscillate between the effort limits"
            )
    return notes


def left_notes(comparison: Comparison) -> list[str]:
    """Return the sentence on trackers that do not return to a pose at rest."""
    left = {name: None for _, runs in comparison.cases for name, run in runs.items() if not run.returns}
    if not left:
        return []
    return [f"unstable: a machine that starts beside the held pose moves away from it, under {', '.join(left)}"]


def servo_note(mechanism: Mechanism) -> str | None:
    """Return the sentence on servos whose damping more than halves an effort's acceleration in a step, or None."""
    shares = shares_in_a_step(mechanism)
    column = int(np.argmin(shares))
    if shares[column] > 0.5:
        return None
    return (
        "servos slow feedback down in simulation: the model's integrator counts their damping in a step's inertia, which"
        f" leaves {100 * shares[column]:.2g} % of a feedback's acceleration at {mechanism.independent_joints[column].name};"
        ' the planned efforts are unaffected; with integrator="Euler" in the model\'s <option> feedback acts in full'
    )
