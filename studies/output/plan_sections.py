"""The sections of a plan: verdict, motion, limits, certificate, the solves before it, its problem."""

import math
from pathlib import Path

import numpy as np

from linkplan.models.errors import AssemblyError, LinkplanError, ProblemError, counted
from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.kinds import are_efforts_bounded, effort_bounds
from linkplan.planner.limits.samples import Samples
from linkplan.planner.phase_plane.grid import PhasePlane as PhaseGrid
from linkplan.planner.phase_plane.grid import grid_of, plane_of
from linkplan.planner.plan.plan import Plan, not_honoured
from linkplan.planner.problem.build import file_text
from linkplan.planner.search.planning import saved_price
from linkplan.studies.output.animation import animation, frames_of
from linkplan.studies.output.certificate_list import certificate_list
from linkplan.studies.output.document import Axis, Block, Code, Facts, Plane, Plot, Report, Section, Series, Table, Text
from linkplan.studies.output.draw_plan import drawn_motion, force_plots, time_plots
from linkplan.studies.output.lines import TIME, Line, plots
from linkplan.studies.output.numbers import drawn_rows, rounded, rounded_times
from linkplan.studies.output.plan_blocks import (
    demand_blocks,
    facts,
    figure,
    least_margin,
    names_in,
    objective_digits,
    objective_unit,
    proof_blocks,
    sensitivity_blocks,
    solves,
)
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.text import in_brief, notes_of


def group_of(plan: Plan) -> str:
    """Return the name of the cursor of a plan's time axis."""
    return f"time:{plan.problem.name}"


def plan_sections(plan: Plan, *, animated: bool = True, verdict: bool = True) -> list[Section]:
    """Return a plan's sections.

    Args:
        plan: to show, with or without a motion.
        animated: whether the motion is animated; False if a comparison animates it.
        verdict: whether the first section has the plan's name and verdict; False if the page's header shows them.
    """
    title, said, about = f"Plan: {plan.problem.name}" if verdict else "Overview", verdict_sentence(plan), _about(plan)
    first = [Text(text=said[:1].upper() + said[1:], tone="good" if plan.passed else "bad")] if verdict else []
    if plan.trajectory is None or plan.certificate is None:
        return [Section(title=title, blocks=[*first, about, *_notes(plan), _solves(plan), *_problem(plan)])]
    try:
        motion = drawn_motion(plan)
    except AssemblyError as error:
        lost = Text(text=f"The motion cannot be drawn: {error}", tone="bad")
        return [Section(title=title, blocks=[*first, about, *_notes(plan), lost, *_problem(plan)])]
    group, period = group_of(plan), plan.trajectory.duration_s if plan.trajectory.periodic else None
    over_time = [plot for of in time_plots(plan, motion, group, period).values() for plot in of]
    over_time += force_plots(plan, motion, group, period)
    seen: list[Block] = [_animation(plan, group, period)] if animated else []
    phase = phase_plane(plan, motion, group, period)
    robust = robust_section(plan, motion, group, period)
    notes, failures = _notes(plan), plan.certificate.failures
    few = in_brief(notes)
    passes = Text(text=f"The certificate does NOT pass: {'; '.join(failures)}.", tone="bad")
    passes = Text(text="The certificate passes.", tone="good") if plan.certificate.passed else passes
    return [
        Section(title=title, blocks=[*first, *seen, lead_facts(plan, motion), *few]),
        Section(title="Motion and effort", blocks=over_time, depth=2),
        *([] if phase is None else [Section(title="Phase plane", blocks=[phase], depth=2)]),
        *([] if robust is None else [robust]),
        Section(title="Actuators", blocks=demand_blocks(plan, group), depth=2),
        Section(title="Certificate", blocks=[passes, certificate_list(plan, group)], depth=2),
        *([] if plan.proof is None else [Section(title="Proof", blocks=proof_blocks(plan.proof), depth=2)]),
        *([Section(title="Sensitivities", blocks=slopes, depth=2)] if (slopes := sensitivity_blocks(plan)) else []),
        Section(title="Solves and mesh", blocks=[_solves(plan), _mesh(plan, group, period)], depth=2),
        Section(title="Problem", blocks=[about, *(notes if len(few) < len(notes) else []), *_problem(plan)], depth=2),
    ]


def _notes(plan: Plan) -> list[Text]:
    return notes_of([*plan.problem.notes, *not_honoured(plan)], names_in(plan))


def _about(plan: Plan) -> Facts:
    """Return the facts of a plan's problem, and of its motion if it has one."""
    problem, mechanism = plan.problem, plan.problem.mechanism
    payload = "" if mechanism.payload is None else ", with a payload"
    joints = f"{counted(mechanism.dof, 'degree')} of freedom, {counted(mechanism.n_q, 'joint')}{payload}"
    rows = [
        ("mechanism", f"{mechanism.name}, {joints}"),
        ("motion", problem.motion.kind),
        ("objective", problem.objective.name),
    ]
    known = facts(plan) if plan.trajectory is not None and plan.certificate is not None else []
    return Facts(rows=[*rows, *known])


def _animation(plan: Plan, group: str, period: float | None) -> Block:
    problem, trajectory = plan.problem, plan.trajectory
    mechanism = problem.mechanism
    dense = trajectory.dense_times()
    shown = np.linspace(trajectory.breaks_s[0], trajectory.breaks_s[-1], frames_of(mechanism))
    shown[-1] = dense[-1]  # the end of a periodic motion, which would otherwise be mapped to its start
    every, back = np.unique(np.concatenate([dense, shown]), return_inverse=True)
    poses = follow(mechanism, trajectory.position_at(every), trajectory.start_pose)[back[len(dense) :]]
    return animation(
        mechanism,
        mechanism.name if mechanism.name == problem.name else f"{mechanism.name} along {problem.name}",
        group,
        shown,
        poses,
        effort=trajectory.effort_at(shown),
        effort_limit=effort_bounds(problem),
        sites=problem.sites,
        period=period,
    )


def _solves(plan: Plan) -> Block:
    if not plan.history:
        return Text(text="There is no history of solves: the motion needed none, or was saved without it.", tone="note")
    return solves(plan)


def _mesh(plan: Plan, group: str, period: float | None) -> Plot:
    """Return the final mesh as the widths of its intervals over time."""
    breaks = plan.trajectory.breaks_s
    width = np.diff(breaks)
    offset = 1e-6 * width  # the plot needs increasing instants on both sides of a break
    x = np.column_stack([breaks[:-1] + offset, breaks[1:] - offset]).ravel()
    (found,) = plots(
        f"Final mesh: {plan.scheme}, {plan.intervals} intervals",
        "width of the interval",
        TIME,
        x,
        [Line(name="width", values=np.repeat(width, 2), unit="s")],
        group=group,
        period=period,
    )
    return found


def _problem(plan: Plan) -> list[Block]:
    try:
        tables, names = dict(plan.problem.to_dict()), []
        for section, key in (("mechanism", "model"), ("guess", "plan")):  # file names in place of absolute paths
            path = Path(tables.get(section, {}).get(key, ""))
            if path.is_absolute():
                tables[section] = tables[section] | {key: path.name}
                names.append(path.name)
        text = file_text(tables, plan.problem.extras)
    except ProblemError as error:
        return [Text(text=f"The problem cannot be written as a file: {error}", tone="note")]
    beside = f"# Needs {' and '.join(names)} in its folder.\n" if names else ""
    return [Code(title="The problem as a file", text=beside + text)]


def plan_report(plan: Plan) -> Report:
    """Return the report of a plan."""
    title, verdict = f"Plan {plan.problem.name}", verdict_sentence(plan)
    return report_of(title, verdict, plan.passed, plan_sections(plan, verdict=False))


def robust_section(plan: Plan, motion: Samples, group: str, period: float | None) -> Section | None:
    """Return the section of a plan's reserve and corners; None if it has neither."""
    corners, reserve = plan.problem.robust.corners, plan.problem.limits.reserve
    if not corners and not reserve:
        return None
    price = saved_price(plan)
    text = "unknown, because the plan was saved without it" if price is None else price.sentence()
    blocks: list[Block] = [Facts(rows=_reserve_facts(plan)), Text(text=f"{text[:1].upper()}{text[1:]}.")]
    if corners:
        blocks += [_corner_table(plan), *_corner_efforts(plan, motion, group, period)]
    return Section(title="Reserve and corners", blocks=blocks, depth=2)


def _reserve_facts(plan: Plan) -> list[tuple[str, str]]:
    problem, robust = plan.problem, plan.problem.robust
    joints = {joint.name: joint for joint in problem.mechanism.joints}
    rows = []
    if problem.limits.reserve:
        rows.append(("left to feedback", f"{100 * problem.limits.reserve:.3g} % of every effort range"))
        for actuator, (low, high), (least, most) in zip(
            problem.mechanism.actuators, effort_bounds(problem), problem.limits.actuators_effort, strict=True
        ):
            said = f"{low:.5g} to {high:.5g} {actuator.unit} (actuator: {least:.5g} to {most:.5g})"
            rows.append((f"limits of the plan for {actuator.name}", said))
    for name, (low, high) in (("payload", robust.payload_factor), ("torque constant", robust.torque_constant_factor)):
        if low != high or low != 1:
            rows.append((f"factor on the {name}", f"{low:g} to {high:g}"))
    friction = (
        ("viscous friction", robust.viscous_friction, ("N.m.s/rad", "N.s/m")),
        ("dry friction", robust.coulomb_friction, ("N.m", "N")),
    )
    for name, ranges, (turning, sliding) in friction:
        for joint, (low, high) in ranges.items():
            unit = turning if joints[joint].kind == "hinge" else sliding
            rows.append((f"{name} at {joint}", f"{low:g} to {high:g} {unit}"))
    return rows


def _corner_table(plan: Plan) -> Table:
    """Return the table of corners, each with its effort nearest to a limit, from the certificate."""
    problem, n_u = plan.problem, plan.problem.mechanism.n_u
    rows = []
    for item, corner in enumerate(problem.robust.corners):
        of_it = [one for one in plan.certificate.margins if one.what == "robust" and one.item // n_u == item]
        for worst in sorted(of_it, key=lambda one: one.left)[:1]:
            actuator = problem.mechanism.actuators[worst.item % n_u]
            places = 4 - math.floor(math.log10(abs(worst.limit) or 1.0))  # five digits of the limit
            figures = [round(x, places) + 0.0 for x in (worst.value, worst.limit, worst.left_shown)]
            at = float(f"{worst.time_s:.5g}")
            rows.append([corner.description, worst.kept, actuator.name, *figures, actuator.unit, at])
    heads = [(head, "") for head in ("machine", "passed", "nearest to its limit", "effort", "limit", "left", "unit")]
    return Table(title="Corners of the ranges, each certified between the nodes", columns=[*heads, ("at", "s")], rows=rows)


def _corner_efforts(plan: Plan, motion: Samples, group: str, period: float | None) -> list[Plot]:
    """Return the plots of the effort of each actuator, for every corner and the nominal model."""
    problem, mechanism = plan.problem, plan.problem.mechanism
    corners = problem.robust.corners
    drawn = []
    for j, actuator in enumerate(mechanism.actuators):
        bounds = tuple(effort_bounds(problem)[j])
        needed, unit = motion.u[:, j], actuator.unit
        nominal = Line(name="nominal", values=needed, unit=unit, limits=bounds, colour=None, width=2.4)
        lines = [
            Line(name=corner.description, values=np.asarray(motion.corner_efforts[:, item, j]), unit=unit, limits=bounds)
            for item, corner in enumerate(corners)
        ]
        title = f"Effort of {actuator.name} that each machine needs for the motion"
        drawn += plots(title, "effort", TIME, motion.time, [*lines, nominal], group=group, period=period)
    return drawn


def phase_plane(plan: Plan, motion: Samples, group: str, period: float | None) -> Plane | None:
    """Return the phase plane of a plan; None for several degrees of freedom."""
    mechanism = plan.problem.mechanism
    if mechanism.dof != 1:
        return None
    joint = mechanism.independent_joints[0]
    s, v = motion.q[:, mechanism.independent[0]], motion.v[:, 0]
    rows = drawn_rows(np.column_stack([s, v]))
    path = Series(name="planned", x=rounded(joint.shown(s[rows])), y=rounded(joint.shown(v[rows])), colour=None, width=2.2)
    most = 2.5 * float(np.abs(v).max()) or 1.0  # limit curves are unbounded next to singular poses
    limits = [] if not are_efforts_bounded(plan.problem) else _limit_curves(plan, motion, most)
    curves = [
        Series(name=name, x=rounded(joint.shown(x)), y=rounded(joint.shown(y)), look=look, colour=colour)
        for name, x, y, look, colour in limits
    ]
    return Plane(
        title=f"Phase plane of {joint.name}",
        x_axis=Axis(label=joint.name, unit=joint.unit),
        y_axis=Axis(label=f"speed of {joint.name}", unit=f"{joint.unit}/s"),
        curves=[*curves, path],
        group=group,
        track=len(curves),
        track_times=rounded_times(motion.time[rows]),
        period=period,
    )


def _limit_curves(plan: Plan, motion: Samples, most: float) -> list[tuple[str, np.ndarray, np.ndarray, str, int]]:
    """Return the limit curves (name, positions, signed speeds, look, colour); none if the grid cannot cover the motion."""
    problem = plan.problem
    s = motion.q[:, problem.mechanism.independent[0]]
    places = np.array([s[0], s.max(), s.min(), s[-1]])
    try:
        gridded = grid_of(problem, places, motion.q[0], 600)
    except LinkplanError:
        return []
    if gridded is None:
        return []
    grid = plane_of(problem, *gridded)
    found = []
    if problem.motion.kind == "reach" and abs(s[-1] - s[0]) > 1e-9:
        way = int(np.sign(s[-1] - s[0]))
        speeds = motion.v[[0, -1], 0]
        for name, start, v, step, effort, back, colour in (
            ("full effort from the start", s[0], speeds[0], way, way, False, 2),
            ("full braking into the goal", s[-1], speeds[1], -way, -way, True, 4),
        ):
            index = grid.at(start)
            leg = grid.leg(index, 0.5 * v**2, step, effort, backwards=back)
            at = grid.s[index + step * np.arange(len(leg))]
            found.append((name, at, _cut(way * np.sqrt(2 * leg), most), "dash", colour))
    return [*found, *_speed_limits(grid, s, most)]


def _speed_limits(grid: PhaseGrid, s: np.ndarray, most: float) -> list:
    """Return the curves of the largest speeds from which full effort can satisfy the joints' speed limits, if any."""
    near = (grid.s >= s.min()) & (grid.s <= s.max())
    found = []
    for way in (1, -1):
        top = way * np.sqrt(2 * np.array(grid.top[way]))
        top = np.where(np.abs(top) <= most, top, np.nan)
        if np.isfinite(top[near]).any():
            found.append(("speed limit" if way > 0 else "", grid.s[near], top[near], "dots", 1))
    return found


def _cut(speed: np.ndarray, most: float) -> np.ndarray:
    """Return speeds; NaN from the first speed above `most` on."""
    beyond = np.flatnonzero(np.abs(speed) > most)
    return np.where(np.arange(len(speed)) < (beyond[0] if len(beyond) else len(speed)), speed, np.nan)


def verdict_sentence(plan: Plan) -> str:
    """Return the verdict of a plan in one sentence."""
    if plan.certificate is None or not plan.passed:
        return plan.message
    return f"{plan.message}; every limit is satisfied at the nodes and between them"


def lead_facts(plan: Plan, motion: Samples) -> Facts:
    """Return the main facts of a plan with a motion."""
    problem, digits = plan.problem, objective_digits(plan)
    rows = [_peak_effort(plan, motion), least_margin(plan)]
    rows.append(("duration", f"{figure(plan.trajectory.duration_s, digits)} s"))
    if plan.objective is not None:
        value = f"{figure(plan.objective, digits)}{objective_unit(problem)}"
        rows.append(("objective", f"{problem.objective.name}: {value}"))
    return Facts(rows=[row for row in rows if row is not None])


def _peak_effort(plan: Plan, motion: Samples) -> tuple[str, str] | None:
    """Return the largest effort as a share of its limit, with its instant; without limits, the largest effort."""
    actuators = plan.problem.mechanism.actuators
    if not actuators:
        return None
    limits = effort_bounds(plan.problem)
    side = np.where(motion.u < 0, -limits[:, 0], limits[:, 1])
    share = np.abs(motion.u) / np.where(np.isfinite(side) & (side > 0), side, np.inf)
    size = share if share.any() else np.abs(motion.u)
    at, j = np.unravel_index(int(np.argmax(size)), size.shape)
    actuator, value = actuators[j], motion.u[at, j]
    limit = limits[j, 0] if value < 0 else limits[j, 1]
    known = f" of {limit:.5g} {actuator.unit} ({100 * share[at, j]:.3g} %)"
    of = known if np.isfinite(limit) else f" {actuator.unit}, no limit"
    return "peak effort", f"{value:.4g}{of}, {actuator.name} at {motion.time[at]:.4g} s"
