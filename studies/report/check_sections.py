"""The sections of a check: its findings, and the mechanism along its motion or over the reach of its coordinates."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.tree.joints import Joint
from linkplan.studies.check.check_report import effort_unit, inertia_unit, ratio_unit, unheld_sentences, weight_sentences
from linkplan.studies.check.inspection import Inspection, branch, sites_at_home
from linkplan.studies.check.inspection_text import gaps_text
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath, acts
from linkplan.studies.check.refused_model import RefusedModel
from linkplan.studies.check.whole_check import WholeCheck
from linkplan.studies.report.animation import animation, frames_of
from linkplan.studies.report.document import Axis, Block, Code, Facts, Plot, Section, Table, Text
from linkplan.studies.report.lines import TIME, Line, plots
from linkplan.studies.report.numbers import significant

# With more coordinates, the paths are folded, and the plots of a path show its own coordinate only.
_MAX_COORDINATES_DRAWN = 6


def check_sections(whole: WholeCheck, *, depth: int = 1) -> list[Section]:
    """Return the sections of a check."""
    found = whole.found
    first = Section(title=f"Mechanism: {whole.name}", blocks=inspection_blocks(found), depth=depth)
    several = len(whole.paths) > _MAX_COORDINATES_DRAWN
    return [first, *(path_section(path, whole.name, depth=depth + 1, folded=several) for path in whole.paths)]


def inspection_blocks(found: Inspection) -> list[Block]:
    """Return the findings on an assembled mechanism, its problems first."""
    mechanism = found.mechanism
    verdict = [Text(text=problem, tone="bad") for problem in found.problems] or [
        Text(text="No problems found.", tone="good")
    ]
    drives = Table(
        title="Actuators",
        columns=[("actuator", ""), ("acts on", ""), ("least effort", ""), ("most effort", ""), ("unit", "")],
        rows=[[a.name, a.target, significant(a.lower), significant(a.upper), a.unit] for a in mechanism.actuators],
    )
    places = [[name, *(significant(float(x)) for x in place)] for name, place in sites_at_home(mechanism).items()]
    columns = [("site", ""), *((axis, "m") for axis in "xyz")]
    sites = [Table(title="Sites at home", columns=columns, rows=places)] if places else []
    notes = [Text(text=note, tone="note") for note in found.notes]
    return [*verdict, _facts(found), _reaches(found), drives, *sites, *_poses(found), *notes]


def _facts(found: Inspection) -> Facts:
    mechanism = found.mechanism
    n_rows = mechanism.n_closure_rows
    rank = f"{n_rows} row{'s' if n_rows != 1 else ''}, rank {len(mechanism.closure_rows)}"
    rows = [
        ("degrees of freedom", f"{mechanism.dof} ({', '.join(j.name for j in mechanism.independent_joints)} independent)"),
        ("joints", ", ".join(joint.name for joint in mechanism.joints)),
        ("closure", f"{', '.join(mechanism.closure_names) or 'none'}: {rank}, gap {gaps_text(found)}"),
    ]
    if mechanism.closures:
        rows.append(("det J_z at home, in SI units", ", ".join(f"{x:.4g}" for x in branch(mechanism))))
    return Facts(rows=rows)


def _reaches(found: Inspection) -> Table:
    mechanism = found.mechanism
    return Table(
        title="Reach, the other coordinates at home",
        columns=[
            ("coordinate", ""),
            ("home", ""),
            ("from", ""),
            ("to", ""),
            ("unit", ""),
            ("what ends it below", ""),
            ("above", ""),
        ],
        rows=[
            [
                joint.name,
                significant(joint.shown(float(mechanism.home[index]))),
                significant(joint.shown(can.lower.position)),
                significant(joint.shown(can.upper.position)),
                joint.unit,
                can.lower.reason,
                can.upper.reason,
            ]
            for index, joint, can in zip(mechanism.independent, mechanism.independent_joints, found.reaches, strict=True)
        ],
    )


def _poses(found: Inspection) -> list[Table]:
    """Return the table of the poses given with the command."""
    if not found.points:
        return []
    mechanism = found.mechanism
    independent = mechanism.independent_joints
    columns = [(joint.name, joint.unit) for joint in mechanism.joints]
    columns += [(f"inertia {joint.name}", inertia_unit(joint)) for joint in independent]
    columns += [(f"weight alone {joint.name}", effort_unit(joint)) for joint in independent]
    columns += [(f"holds all {joint.name}", effort_unit(joint)) for joint in independent]
    rows = []
    for point in found.points:
        positions = [joint.shown(x) for joint, x in zip(mechanism.joints, point.pose, strict=True)]
        figures = [*positions, *point.reduced_inertia.diagonal(), *point.gravity_effort, *point.holding_effort]
        rows.append([significant(float(x)) for x in figures])
    return [Table(title="At the poses asked for", columns=columns, rows=rows)]


def path_section(path: KinematicLoopPath, name: str, *, depth: int = 2, folded: bool = False) -> Section:
    """Return the section of a path: an animation, and plots of ratios, inertias, efforts and forces."""
    axis, x = _over(path)
    group = f"path:{name}:{path.title}"
    rising = bool(np.all(np.diff(x) > 0))
    order = np.arange(len(x)) if rising else np.argsort(x, kind="stable")
    frames = order[np.unique(np.linspace(0, len(order) - 1, min(len(order), frames_of(path.mechanism))).astype(int))]
    moving = animation(
        path.mechanism,
        f"{name} along {path.title}",
        group,
        x[frames],
        path.poses[frames],
        effort=path.holding_effort[frames],
        effort_limit=path.limit,
        unit=axis.unit,
    )
    said = [Text(text=text, tone="note") for text in (*weight_sentences(path), *unheld_sentences(path))]
    return Section(
        title=f"Along {path.title}, at rest",
        blocks=[moving, *said, *_path_plots(path, axis, x[order], order, group)],
        depth=depth,
        folded=folded,
    )


def _over(path: KinematicLoopPath) -> tuple[Axis, np.ndarray]:
    """Return the horizontal axis of a path and its values (n,): the coordinate, or the time of a motion."""
    if path.coordinate is None and path.time_s is not None:
        return Axis(label="time of the path", unit="s") if path.mechanism.dof > 1 else TIME, path.time_s
    column = path.coordinate or 0
    joint = path.mechanism.independent_joints[column]
    return Axis(label=joint.name, unit=joint.unit), np.array([joint.shown(s) for s in path.positions[:, column]])


def _path_plots(path: KinematicLoopPath, axis: Axis, x: np.ndarray, order: np.ndarray, group: str) -> list[Plot]:
    mechanism = path.mechanism
    joints = list(enumerate(mechanism.independent_joints))
    if path.coordinate is not None and mechanism.dof > _MAX_COORDINATES_DRAWN:
        joints = [joints[path.coordinate]]

    def own(values: np.ndarray, unit, suffix: str = "") -> list[Line]:
        return [_line(f"{joint.name}{suffix}", values[:, i], unit(joint)) for i, joint in joints]

    needed = np.einsum("ksu,ku->ks", path.ratio, path.holding_effort) + path.unheld_effort
    weights = own(needed, effort_unit)
    # Springs that hold less than this share of the effort are rounding errors.
    if np.abs(needed - path.gravity_effort).max() > 1e-9 * max(np.abs(needed).max(), np.finfo(float).tiny):
        weights += own(path.gravity_effort, effort_unit, ", weight alone")
    available: list[Line] = []
    if mechanism.actuators:
        available += own(path.available_effort[:, :, 0], effort_unit, ", least")
        available += own(path.available_effort[:, :, 1], effort_unit, ", most")
        available += own(needed, effort_unit, ", holds it still")
    ratios, felt = _actuator_lines(path, joints)
    dependent = [(int(k), mechanism.joints[int(k)]) for k in mechanism.dependent]
    singular = [_line("least of J_z's blocks", path.singularity, "1")] if mechanism.closure_names else []
    followers = [_line(j.name, j.shown(1.0) * path.poses[:, k], j.unit) for k, j in dependent]
    forces = [_line(name, path.closure_force[:, c], "N") for c, name in enumerate(mechanism.closure_names)]
    kinds: Sequence[tuple[str, str, list[Line], bool]] = (
        ("Dependent joints", "position", followers, False),
        ("Transmission ratio", "ratio", ratios, False),
        ("Reduced inertia", "inertia", own(path.reduced_inertia.diagonal(axis1=1, axis2=2), inertia_unit), True),
        ("Inertia that an actuator feels", "inertia", felt, True),
        ("Effort that holds it still", "effort", weights, False),
        ("Effort within the actuators' limits", "effort", available, False),
        ("Distance from a singular pose", "det J_z over that at home", singular, False),
        ("Closure force at rest", "force", forces, False),
    )
    found = []
    for title, what, lines, may_grow in kinds:
        sorted_lines = [_line(line.name, line.values[order], line.unit) for line in lines]
        log = may_grow and _spans_much(sorted_lines)
        found += plots(
            title, what, axis, x, sorted_lines, group=group, log=log, ends=None if log else inner_ends(sorted_lines)
        )
    return found


def _actuator_lines(path: KinematicLoopPath, joints: list[tuple[int, Joint]]) -> tuple[list[Line], list[Line]]:
    """Return the transmission ratios to the numbered joints and the reflected inertias of the actuators that act on them."""
    mechanism = path.mechanism
    if not mechanism.actuators:
        return [], []
    acting = acts(path)
    drivers = [(j, a) for j, a in enumerate(mechanism.actuators) if acting[[i for i, _ in joints], j].any()]
    ratios = [
        _line(f"{a.name} to {joint.name}", path.ratio[:, i, j], ratio_unit(joint, a.unit))
        for i, joint in joints
        for j, a in drivers
        if acting[i, j]
    ]
    inertias = [_line(a.name, path.reflected_inertia[:, j], "kg m2" if a.unit == "N.m" else "kg") for j, a in drivers]
    return ratios, inertias


def _line(name: str, values: np.ndarray, unit: str) -> Line:
    return Line(name=name, values=values, unit=unit)


def _spans_much(lines: Sequence[Line]) -> bool:
    """Tell if the values are positive and some line changes by more than a factor of five."""
    rows = [line.values[np.isfinite(line.values)] for line in lines]
    return all(len(row) and row.min() > 0 for row in rows) and any(row.max() > 5 * row.min() for row in rows)


def inner_ends(lines: Sequence[Line]) -> tuple[float, float] | None:
    """Return the ends of an axis for the inner 90 % of the values if the whole range is three times as high; else None.

    Quantities grow without bound next to a singular pose. The whole range would press the rest of the line flat.
    """
    if len({line.unit for line in lines}) != 1:
        return None
    known_rows = [row for line in lines if len(row := line.values[np.isfinite(line.values)])]
    if not known_rows:
        return None
    low, high = min(float(row.min()) for row in known_rows), max(float(row.max()) for row in known_rows)
    inner = [np.quantile(row, (0.05, 0.95)) for row in known_rows]
    least, most = float(np.min(inner)), float(np.max(inner))
    if not high - low > 3 * (most - least) > 0:
        return None
    room = 0.3 * (most - least)
    return least - room, most + room


def refused_section(found: RefusedModel) -> Section:
    """Return the section of a model that is not a valid mechanism."""
    blocks: list[Block] = [Text(text=problem, tone="bad") for problem in found.problems]
    blocks.append(Code(title="Further information", text=found.text()))
    return Section(title=f"Model: {found.name}", blocks=blocks)
