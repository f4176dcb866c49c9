"""The findings of `linkplan check` on an assembled mechanism as a document."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import counted, listed
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.body_angles import sum_text, turning_bodies
from linkplan.models.poses.reach import Reach
from linkplan.models.tree.joints import where
from linkplan.studies.check.inspection import Inspection
from linkplan.studies.output.document import Block, Facts, NumberText, Table, Text, table_of
from linkplan.studies.output.plan_blocks import figure


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
