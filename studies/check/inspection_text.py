"""The text of `linkplan check` on an assembled mechanism."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.studies.check.inspection import Inspection, branch, sites_at_home
from linkplan.studies.output.digits import error_figure
from linkplan.studies.output.tables import table


def inspection_text(found: Inspection) -> str:
    """Return the report on an assembled mechanism."""
    mechanism = found.mechanism
    n_rows = mechanism.n_closure_rows
    rows = f"{n_rows} row{'s' if n_rows != 1 else ''}"
    lines = [
        f"{mechanism.name}: {mechanism.dof} degree{'s' if mechanism.dof != 1 else ''} of freedom"
        f" ({', '.join(j.name for j in mechanism.independent_joints)} independent of {mechanism.n_q} joints)",
        f"closure: {', '.join(mechanism.closure_names) or 'none'}: {rows}, rank {len(mechanism.closure_rows)},"
        f" gap {gaps_text(found)}",
        "home: "
        + ", ".join(f"{j.name} = {j.said(x, 5)} {j.unit}" for j, x in zip(mechanism.joints, mechanism.home, strict=True)),
    ]
    if found.mechanism.closures:
        lines.append(f"branch: that of home, where det J_z is {', '.join(f'{x:.4g}' for x in branch(mechanism))}")
    for joint, can in zip(mechanism.independent_joints, found.reaches, strict=True):
        lines.append(
            f"reach: {joint.name} from {joint.said(can.lower.position, 5)} ({can.lower.reason})"
            f" to {joint.said(can.upper.position, 5)} {joint.unit} ({can.upper.reason})"
        )
    lines += [f"actuator: {a.name} on {a.target}, {a.lower:g} to {a.upper:g} {a.unit}" for a in mechanism.actuators]
    lines += _site_lines(mechanism)
    lines += [f"note: {note}" for note in found.notes]
    if found.points:
        lines += ["", _points_table(found)]
    lines += ["", *(f"PROBLEM: {problem}" for problem in found.problems)] if found.problems else ["no problems found"]
    return "\n".join(lines)


def _site_lines(mechanism: Mechanism) -> list[str]:
    """Return the line with the sites at home, with rounding errors as zero; an empty list without sites."""
    shown = []
    for name, place in sites_at_home(mechanism).items():
        rounded = np.where(np.abs(place) < 1e-12 * mechanism.extent_m, 0.0, place)
        shown.append(f"{name} [{', '.join(f'{x:.6g}' for x in rounded)}]")
    return [f"sites at home [m]: {', '.join(shown)}"] if shown else []


def gaps_text(found: Inspection) -> str:
    """Return the largest closure gap of each unit."""
    return " and ".join(f"{error_figure(gap)} {unit}" for unit, gap in found.closure_gaps.items())


def _points_table(found: Inspection) -> str:
    mechanism = found.mechanism
    independent = mechanism.independent_joints
    head = [f"{j.name} [{j.unit}]" for j in mechanism.joints]
    head += [f"M_{a.name}{b.name}" for i, a in enumerate(independent) for b in independent[i:]]
    head += [f"gravity alone {j.name} [{'N.m' if j.kind == 'hinge' else 'N'}]" for j in independent]
    head += [f"hold all {j.name} [{'N.m' if j.kind == 'hinge' else 'N'}]" for j in independent]
    head += [f"{a.name}->{j.name}" for a in mechanism.actuators for j in independent]
    rows = []
    for point in found.points:
        upper = point.reduced_inertia[np.triu_indices(mechanism.dof)]
        positions = [float(j.said(x, 17)) for j, x in zip(mechanism.joints, point.pose, strict=True)]
        efforts = [*point.gravity_effort, *point.holding_effort, *point.effort_map.T.ravel()]
        rows.append([float(x) for x in [*positions, *upper, *efforts]])
    return table(head, rows)
