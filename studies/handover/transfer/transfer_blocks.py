"""A transfer table as a document: the verdict, the linkage at home, the ends of the map, errors, curves and polytopes."""

import numpy as np

from linkplan.models.external_forces import omitted_forces
from linkplan.models.transfer.polytope import effort_box, effort_corners
from linkplan.models.transfer.table import REFINED
from linkplan.studies.handover.transfer.columns import QUANTITIES, curves
from linkplan.studies.handover.transfer.serial_study import error_plots, serial_blocks
from linkplan.studies.handover.transfer.serial_urdf import urdf_notes
from linkplan.studies.handover.transfer.study import CONVENTION, Transfer, carried_gains
from linkplan.studies.output.document import Axis, Block, Facts, Plane, Plot, Series, Text, table_of
from linkplan.studies.output.lines import Line, plots
from linkplan.studies.output.numbers import rounded

_PLOT_SAMPLES = 201


def transfer_blocks(transfer: Transfer) -> list[Block]:
    """Return a transfer table as blocks."""
    tone = "good" if transfer.kept else "bad"
    return [
        Text(text=transfer.message, tone=tone),
        Text(text=CONVENTION),
        Facts(rows=_facts(transfer)),
        _home_table(transfer),
        _ends_table(transfer),
        _error_table(transfer),
        *[Text(text=note, tone="note") for note in notes(transfer)],
        *serial_blocks(transfer.serial, transfer.serial_note),
        *([] if transfer.serial is None else [Text(text=f"URDF: {note}", tone="note") for note in urdf_notes(transfer)]),
        *table_plots(transfer),
    ]


def notes(transfer: Transfer) -> list[str]:
    """Return sentences on what the table omits."""
    table, outputs = transfer.table, transfer.outputs
    mechanism = outputs.mechanism
    forces = omitted_forces(mechanism.forces, "in the table, whose efforts are those at rest")
    found = [] if forces is None else [forces]
    off = int(np.sum(~table.known))
    if off:
        found.append(f"{off} of {table.known.size} nodes are outside the map; the column status has the reason")
    if table.inverse is None:
        found.append(f"no table from motor to joint positions: {table.inverse_note}")
    for motor, position in table.dead_centres:
        joint = outputs.joints[0]
        found.append(
            f"dead centre: motor {outputs.actuators[motor].name} has no moment arm at {joint.name} ="
            f" {joint.text(position, 5)} {joint.unit}"
        )
    others = [
        joint.name
        for k, joint in enumerate(mechanism.independent_joints)
        if k not in outputs.columns and mechanism.independent[k] not in mechanism.passive_dofs
    ]
    if others:
        found.append(f"the table holds {', '.join(others)} at home, at rest")
    ratio = np.array(mechanism.dynamics.effort_map(mechanism.home)).T
    for place, motor in enumerate(outputs.motors):
        also = [j.name for k, j in enumerate(mechanism.independent_joints) if k not in outputs.columns and ratio[motor, k]]
        if also:
            found.append(f"motor {outputs.actuators[place].name} also moves with {', '.join(also)}")
    return found


def _facts(transfer: Transfer) -> list[tuple[str, str]]:
    table = transfer.table
    rows = [(f"range of {j.name}", f"{j.text(a.position, 5)} to {j.text(b.position, 5)} {j.unit}")
            for j, (a, b) in zip(transfer.outputs.joints, table.ends, strict=True)]  # fmt: skip
    if table.inverse is not None:
        size = " x ".join(str(len(axis)) for axis in table.inverse.axes)
        error = table.inverse.errors["joint_position"]
        text = f"{size} nodes, error {error:.2g} of the largest position"
        text += f", covers {100 * table.inverse.answered:.4g} % of {table.inverse.checked} reachable positions"
        rows.append(("table from motor to joint positions", text))
    for name, gains in carried_gains(transfer, transfer.home.ratio).items():
        said = [f"{'-'.join(one.names)} {one.values[0]:.5g} {one.unit}" for one in curves(transfer, name, gains)]
        rows.append((f"{name} at home", ", ".join(said)))
    return rows


def _home_table(transfer: Transfer):
    outputs, home = transfer.outputs, transfer.home
    box = effort_box(home.ratio, transfer.effort_limit)[0]
    heads: list = ["output joint", "unit of effort"]
    heads += [(f"G of {motor.name}", f"{motor.si_units[0]} per joint unit") for motor in outputs.actuators]
    heads += ["inertia", "of it armature", "damping", "dry friction", "gravity", "hold", "least effort", "largest effort"]
    rows = []
    for k, joint in enumerate(outputs.joints):
        position, effort = joint.si_units
        rows.append(
            [f"{joint.name} [{position}]", effort, *home.ratio[0, :, k], home.inertia[0, k, k], home.armature[0, k, k],
             home.damping[0, k, k], home.friction[0, k], home.gravity[0, k], home.hold[0, k], *box[k]]
        )  # fmt: skip
    return table_of(
        "At home, each joint's own share (inertia over acceleration, damping over velocity)", heads, rows, digits=5
    )


def _ends_table(transfer: Transfer):
    rows = []
    for joint, both in zip(transfer.outputs.joints, transfer.table.ends, strict=True):
        for word, end in zip(("lower", "upper"), both, strict=True):
            rows.append([joint.name, word, joint.shown(end.position), joint.unit, end.reason, joint.shown(end.margin)])
    heads = ["joint", "end", "position", "unit", "the map ends there because of", "margin"]
    return table_of("Where the map ends, other outputs at home", heads, rows, digits=6)


def _error_table(transfer: Transfer):
    grid = transfer.table.grid
    names = [*REFINED, "ratio_slope", "armature", "damping", "friction"]
    rows = [[name, grid.scale[name], grid.errors[name], grid.errors[name] * grid.scale[name]] for name in names]
    heads = ["quantity", "largest size [SI]", "error, relative", "error [SI]"]
    return table_of(f"Error of linear interpolation, measured at {grid.checked} points between the nodes", heads, rows)


def transfer_plots(transfer: Transfer) -> list[Plot | Plane]:
    """Return the curves of the table, and the errors of its serial equivalent along a motion, if there is one."""
    serial = transfer.serial
    return [*table_plots(transfer), *([] if serial is None or serial.errors is None else error_plots(serial))]


def table_plots(transfer: Transfer) -> list[Plot | Plane]:
    """Return curves over each joint's range with the other outputs at home, and the polytope of efforts of two joints."""
    found: list[Plot | Plane] = []
    for k in range(len(transfer.outputs.joints)):
        found += _curves(transfer, k)
    if len(transfer.outputs.joints) == 2 and np.isfinite(transfer.effort_limit).all():
        found.append(_polytope(transfer))
    return found


def _curves(transfer: Transfer, k: int) -> list[Plot]:
    grid, outputs = transfer.table.grid, transfer.outputs
    joint, several = outputs.joints[k], len(outputs.joints) > 1
    points = np.tile(outputs.home, (_PLOT_SAMPLES, 1))
    points[:, k] = np.linspace(grid.axes[k][0], grid.axes[k][-1], _PLOT_SAMPLES)
    x = joint.shown(points[:, k])
    found = []
    for one in filter(lambda one: one.plot, QUANTITIES.values()):
        lines = [
            # "A and B" for the coupling of two joints, else "A"
            Line(
                name=one.line.format(*curve.names) if one.line != "{}" else " and ".join(dict.fromkeys(curve.names)),
                values=curve.values,
                unit=curve.unit,
            )
            for curve in curves(transfer, one.field, grid.at(one.field, points))
        ]
        of = f" over {joint.name}" + (", other outputs at home" if several else "")
        axis = Axis(label=joint.name, unit=joint.unit)
        found += plots(f"{one.plot}{of}", one.label, axis, x, lines, group=f"transfer:{joint.name}")
    return found


def _polytope(transfer: Transfer) -> Plane:
    """Return the polytope of joint efforts at home and at the ends of each axis."""
    import scipy.spatial

    grid, (first, second) = transfer.table.grid, transfer.outputs.joints
    home = transfer.outputs.home
    places = [("at home", home)]
    for k, joint in enumerate((first, second)):
        for end in (0, -1):
            place = home.copy()
            place[k] = grid.axes[k][end]
            places.append((f"{joint.name} = {joint.text(place[k])} {joint.unit}", place))
    curves = []
    for colour, (name, place) in enumerate(places):
        ratio = grid.at("ratio", place[None])
        if not np.isfinite(ratio).all():
            continue
        corners = effort_corners(ratio, transfer.effort_limit)[0]
        if np.linalg.matrix_rank(corners - corners[0]) < 2:
            continue
        around = corners[scipy.spatial.ConvexHull(corners).vertices]
        around = np.concatenate([around, around[:1]])
        curves.append(Series(name=name, x=rounded(around[:, 0]), y=rounded(around[:, 1]), colour=colour))
    axes = [Axis(label=f"effort on {joint.name}", unit=joint.si_units[1]) for joint in (first, second)]
    return Plane(title="Efforts that the motors can give", x_axis=axes[0], y_axis=axes[1], curves=curves)
