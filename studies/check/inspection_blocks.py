"""The findings of `linkplan check` on an assembled mechanism as a document, and in at most thirty lines."""

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from linkplan.models.errors import counted, listed, shortened
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.body_angles import sum_text, turning_bodies
from linkplan.models.poses.reach import Reach
from linkplan.models.tree.joints import where
from linkplan.studies.check.drives import floating_columns
from linkplan.studies.check.inspection import Inspection
from linkplan.studies.output.document import Block, Facts, NumberText, Table, Text, table_of
from linkplan.studies.output.plan_blocks import figure
from linkplan.studies.output.text import by_kind, limits_text


def inspection_blocks(found: Inspection) -> list[Block]:
    """Return the findings on an assembled mechanism, its problems first."""
    mechanism = found.mechanism
    verdict = [Text(text=f"PROBLEM: {problem}", tone="bad") for problem in found.problems]
    verdict = verdict or [Text(text="no problems found", tone="good")]
    limits = [[a.name, a.target, a.lower, a.upper, a.unit] for a in mechanism.actuators]
    drives = table_of("Actuators", ["actuator", "acts on", "least effort", "most effort", "unit"], limits)
    notes = [Text(text=note, tone="note") for note in found.notes]
    return [
        headline(mechanism, mechanism.dof),
        *verdict,
        _facts(found),
        reach_table(found, found.reaches),
        drives,
        *_sites(found),
        *_bodies(found),
        *_poses(found),
        *notes,
    ]


def headline(mechanism: Mechanism, most: int) -> Text:
    """Return the line on a mechanism's degrees of freedom, with the names of at most `most` independent joints."""
    independent = listed([joint.name for joint in mechanism.independent_joints], most)
    freedoms = f"{counted(mechanism.dof, 'degree')} of freedom"
    return Text(text=f"{mechanism.name}: {freedoms} ({independent} independent of {counted(mechanism.n_q, 'joint')})")


def _facts(found: Inspection) -> Facts:
    mechanism = found.mechanism
    rank = f"{counted(mechanism.n_closure_rows, 'row')}, rank {len(mechanism.closure_rows)}"
    units = sorted({closure.unit for closure in mechanism.closures}) or ["m"]
    gaps = " and ".join(f"{figure(getattr(found, f'closure_gap_{unit}'), 2)} {unit}" for unit in units)
    rows = [
        ("closure", f"{', '.join(mechanism.closure_names) or 'none'}: {rank}, gap {gaps}"),
        ("home", where(mechanism.joints, mechanism.home, 5)),
    ]
    if mechanism.closures:
        rows.append(("branch", f"that of home, where det J_z is {', '.join(f'{x:.4g}' for x in found.branch)}"))
    return Facts(rows=rows)


def reach_table(found: Inspection, reaches: Sequence[Reach], more: str = "") -> Table:
    """Return the table of coordinates' reaches; `more` is appended to its title."""
    heads = ["coordinate", "from", "to", "unit", "what ends it below", "above"]
    rows = [
        [
            joint.name,
            NumberText.of(joint.text(can.lower.position, 5), joint.shown(can.lower.position)),
            NumberText.of(joint.text(can.upper.position, 5), joint.shown(can.upper.position)),
            joint.unit,
            can.lower.reason,
            can.upper.reason,
        ]
        for can in reaches
        for joint in [found.mechanism.independent_joints[can.coordinate]]
    ]
    return table_of(f"Reach, the other coordinates at home{more}", heads, rows)


def _sites(found: Inspection) -> list[Table]:
    """Return the table of the sites at home, with rounding errors as zero."""
    least = 1e-12 * found.mechanism.extent_m
    rows = [[name, *np.where(np.abs(place) < least, 0.0, place)] for name, place in found.sites_at_home_m.items()]
    return [table_of("Sites at home", ["site", "x [m]", "y [m]", "z [m]"], rows, digits=6)] if rows else []


def _bodies(found: Inspection) -> list[Table]:
    """Return the table of the angles of bodies that several hinges turn, at home."""
    sums = {name: sum_text(found.mechanism, sigma) for name, sigma in turning_bodies(found.mechanism).items()}
    rows = [[name, sums[name], 0.0 if abs(x) < 1e-9 else x] for name, x in found.bodies_at_home_deg.items()]
    return [table_of("Angles of bodies at home", ["body", "sum of hinges", "angle [deg]"], rows, digits=6)] if rows else []


def _poses(found: Inspection) -> list[Table]:
    if not found.points:
        return []
    mechanism = found.mechanism
    independent = mechanism.independent_joints
    heads: list = [(joint.name, joint.unit) for joint in mechanism.joints]
    heads += [
        (f"M_{a.name}{b.name}", a.inertia_unit if a is b else "") for i, a in enumerate(independent) for b in independent[i:]
    ]
    heads += [(f"weight alone {joint.name}", joint.si_units[1]) for joint in independent]
    heads += [(f"hold all {joint.name}", joint.si_units[1]) for joint in independent]
    heads += [(f"{a.name}->{joint.name}", "") for a in mechanism.actuators for joint in independent]
    rows = []
    for point in found.points:
        upper = point.reduced_inertia_kgm2[np.triu_indices(mechanism.dof)]
        pose = point.q_deg | point.q_m
        positions = [float(joint.text(joint.read(pose[joint.name]), 17)) for joint in mechanism.joints]
        ratios = [ratio for column in point.effort_map.values() for ratio in column.values()]
        rows.append([*positions, *upper, *point.gravity_effort.values(), *point.holding_effort.values(), *ratios])
    return [table_of("At the requested poses", heads, rows)]


# Largest numbers of problems, coordinates and notes: the summary, with two lines on the next step, fits on a screen.
MOST_PROBLEMS, MOST_COORDINATES, MOST_NOTES = 7, 8, 4
# A sentence of the summary is cut at this length, so that it takes at most three lines of a narrow terminal.
_MOST_CHARACTERS = 240


def summary_blocks(found: Inspection) -> list[Block]:
    """Return the summary, which leaves room for lines on the next step."""
    mechanism = found.mechanism
    problems = grouped(mechanism, found.problems)
    verdict: list[Block] = [
        Text(text=f"PROBLEM: {text}", tone="bad") for text in _first(problems, MOST_PROBLEMS, "problems")
    ]
    notes = [Text(text=text, tone="note") for text in _first(grouped(mechanism, found.notes), MOST_NOTES, "notes")]
    drives = listed([f"{a.name} ({limits_text(a.lower, a.upper, a.unit)})" for a in mechanism.actuators], MOST_COORDINATES)
    rank = f"{mechanism.n_closure_rows} rows of rank {len(mechanism.closure_rows)}"
    facts = Facts(
        rows=[
            ("loops", f"{listed(mechanism.closure_names, MOST_COORDINATES)}: {rank}" if mechanism.closure_names else "none"),
            ("driven by", drives or "nothing"),
        ]
    )
    first = headline(mechanism, MOST_COORDINATES)
    return [first, *(verdict or [Text(text="no problems found", tone="good")]), facts, *_reaches(found), *notes]


def grouped(mechanism: Mechanism, sentences: Iterable[str]) -> list[str]:
    """Return one sentence of each kind, with the number of the others; a kind is the same but for names and numbers."""
    said = []
    for alike in by_kind(sentences, _names(mechanism)):
        more = f" (and {len(alike) - 1} more of this kind)" if len(alike) > 1 else ""
        said.append(shortened(alike[0], _MOST_CHARACTERS - len(more)) + more)
    return said


def _names(mechanism: Mechanism) -> set[str]:
    model = mechanism.model
    sizes = {
        mujoco.mjtObj.mjOBJ_BODY: model.nbody,
        mujoco.mjtObj.mjOBJ_GEOM: model.ngeom,
        mujoco.mjtObj.mjOBJ_SITE: model.nsite,
        mujoco.mjtObj.mjOBJ_JOINT: model.njnt,
        mujoco.mjtObj.mjOBJ_ACTUATOR: model.nactuator,
        mujoco.mjtObj.mjOBJ_EQUALITY: model.neq,
        mujoco.mjtObj.mjOBJ_TENDON: model.ntendon,
    }
    names = {mujoco.mj_id2name(model, kind, i) for kind, size in sizes.items() for i in range(size)}
    return names | {joint.name for joint in mechanism.joints} | set(mechanism.closure_names)


def _first(sentences: Sequence[str], most: int, what: str) -> list[str]:
    """Return the first sentences, and one that states how many were omitted."""
    if len(sentences) <= most:
        return list(sentences)
    return [*sentences[: most - 1], f"{len(sentences) - most + 1} more kinds of {what}"]


def _reaches(found: Inspection) -> list[Block]:
    """Return the table of the first coordinates' reach, without a floating base and rods' spins."""
    mechanism, floating = found.mechanism, floating_columns(found.mechanism)
    grounded = [can for can in found.reaches if can.coordinate not in floating]
    of = [can for can in grounded if mechanism.actuated[can.coordinate]]
    more = f"; the first {MOST_COORDINATES} of {len(of)} coordinates" if len(of) > MOST_COORDINATES else ""
    return [reach_table(found, of[:MOST_COORDINATES], more)] if of else []
