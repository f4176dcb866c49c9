"""A path of `linkplan check` as a document: a table of a few poses, and the quantities that are the same at all poses."""

from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.poses.body_angles import turning_bodies
from linkplan.models.tree.dynamics import site_names
from linkplan.models.tree.joints import where
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath, acts
from linkplan.studies.check.path_quantities import FELT_INERTIA, INERTIA, QUANTITIES, shown_curves
from linkplan.studies.output.document import Block, Facts, Table, Text, table_of


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Column:
    """A quantity along a path: its head, its unit, and its values (n,) or intervals (n, 2)."""

    head: str
    unit: str
    values: np.ndarray
    scale: float  # the largest value of its kind along the path; values far below it are rounding errors

    @property
    def is_constant(self) -> bool:
        """Whether the value is the same at every pose, except for rounding errors."""
        if not np.isfinite(self.values).all():
            return bool(np.all(self.values == self.values[0]))
        return bool(np.all(np.ptp(self.values, axis=0) <= ROUNDING_SHARE * self.scale))

    def cell(self, k: int) -> float | str:
        """Return the entry of sample k, with rounding errors as zero."""
        value = np.where(np.abs(self.values[k]) > ROUNDING_SHARE * self.scale, self.values[k], 0.0)
        return float(value) if self.values.ndim == 1 else f"{value[0]:.4g} to {value[1]:.4g}"

    def text(self) -> str:
        """Return the constant value in words."""
        value = self.cell(0)
        text = value if isinstance(value, str) else f"{value:.4g}"
        return f"{self.head} {text}{'' if self.unit == '1' else f' {self.unit}'}"


def path_blocks(path: KinematicLoopPath, *, brief: bool = False) -> list[Block]:
    """Return the table of a path, the constant quantities, and the poses at which the actuators cannot hold the weight.

    A brief document has only the table with the quantities of the swept coordinate, its actuators and the closures. The
    document is empty if none of them changes.
    """
    mechanism, model, names = path.mechanism, path.mechanism.model, None
    if brief and path.coordinate is not None:
        acting = np.flatnonzero(acts(path)[path.coordinate])
        names = {mechanism.independent_joints[path.coordinate].name, *(mechanism.actuators[j].name for j in acting)}
    columns = quantities(path, names)
    table = _table(path, columns, f"along {path.title}, at rest")
    changing = brief and path.coordinate != 0
    said = [*weight_sentences(path, changing=changing), *unheld_sentences(path, changing=changing), *balance_sentences(path)]
    sentences = [Text(text=text, tone="note") for text in said]
    if brief:
        return [*table, *sentences] if table or sentences else []
    constant = [column.text() for column in columns if column.is_constant]
    if not acts(path).all():
        constant.append("all other ratios 0")
    hold = "hold and force include" if mechanism.actuators else "force includes"
    weight = Text(text=f"'weight alone' omits springs; {hold} weight, springs and constant forces, at rest")
    same = [Facts(rows=[("the same at every pose", ", ".join(constant))])] if constant else []
    sites = [
        Column(head=f"{name} {axis}", unit="m", values=path.places[:, row, model.site(name).id], scale=mechanism.extent_m)
        for name in site_names(model)
        for row, axis in enumerate("xyz")
    ]
    bodies = [
        Column(head=name, unit="deg", values=np.degrees(path.poses @ sigma), scale=float(np.degrees(1.0)))
        for name, sigma in turning_bodies(mechanism).items()
    ]
    moving = (("sites", sites), ("angles of bodies", bodies))
    further = [table for title, values in moving for table in _table(path, values, f"{title} along {path.title}")]
    return [*table, weight, *same, *further, *sentences]


def largest_forces(path: KinematicLoopPath) -> dict[str, tuple[float, float, str]]:
    """Return the largest force [N] and moment [N.m] at rest in each closure and pin, and the pose of the force.

    At a singular pose forces are not finite, and are left out.
    """
    loads, found = path.joint_forces, {}
    for name, force in loads.force.items():
        known, moment = (np.where(np.isfinite(of), of, 0.0) for of in (force, loads.moment.get(name, 0 * force)))
        at = int(np.argmax(known >= (1 - ROUNDING_SHARE) * known.max()))
        found[name] = float(known[at]), float(moment.max()), _pose(path, at)
    return found


def pin_table(found: Iterable[dict[str, tuple[float, float, str]]], most: int | None = None) -> list[Table]:
    """Return the table of the largest forces along several paths, of the `most` loaded pins first if there are more."""
    largest: dict[str, tuple[float, float, str]] = {}
    for name, (force, moment, at) in (item for path in found for item in path.items()):
        before = largest.get(name, (-1.0, 0.0, ""))
        largest[name] = max(force, before[0]), max(moment, before[1]), at if force > before[0] else before[2]
    chosen = sorted(largest, key=lambda name: -largest[name][0])[:most]
    rows = [[name, *largest[name]] for name in largest if name in chosen]
    heads = [("pin", ""), ("force", "N"), ("moment", "N.m"), ("largest force at", "")]
    if not any(moment for _, _, moment, _ in rows):  # as in every planar mechanism
        rows, heads = [[*row[:2], row[3]] for row in rows], [*heads[:2], heads[3]]
    title = "largest forces in pins, at rest under the efforts that hold it"
    title += f" (the {most} most loaded of {len(largest)} pins)" if len(rows) < len(largest) else ""
    return [table_of(title, heads, rows)] if rows else []


def _table(path: KinematicLoopPath, columns: list[Column], title: str) -> list[Table]:
    """Return the table of the columns that change, at nine poses; an empty list if none does."""
    at = np.unique(np.linspace(0, len(path.poses) - 1, num=9).astype(int))
    shown = [column for column in columns if not column.is_constant]
    if not shown:
        return []
    positions = [
        Column(head=joint.name, unit=joint.unit, values=np.array([float(joint.text(x, 17)) for x in s]), scale=1.0)
        for column, (joint, s) in enumerate(zip(path.mechanism.independent_joints, path.positions.T, strict=True))
        if path.coordinate in (None, column)
    ]
    shown = [*positions, *shown]
    rows = [[column.cell(k) for column in shown] for k in at]
    heads = [(column.head, column.unit) for column in shown]
    return [table_of(f"{title} ({len(at)} of {len(path.poses)} poses)", heads, rows)]


def _scale(values: np.ndarray) -> float:
    """Return the largest finite absolute value; 1 if all are zero."""
    known = np.abs(values[np.isfinite(values)])
    return float(known.max(initial=0.0)) or 1.0


def quantities(path: KinematicLoopPath, names: AbstractSet[str] | None = None) -> list[Column]:
    """Return the quantities of the table; with `names`, of joints and actuators only those with these names.

    The inertia at an actuator has its own column if it differs from the inertia of every coordinate.
    """
    own, felt = path.own_inertia, path.reflected_inertia
    with np.errstate(invalid="ignore"):
        same = np.all(np.abs(felt[:, None, :] - own[:, :, None]) <= ROUNDING_SHARE * own[:, :, None], axis=0)
    named, pairs = path.mechanism.independent_joints, zip(path.mechanism.actuators, same.T, strict=True)
    joints = {actuator.name: named[int(np.argmax(of))].name for actuator, of in pairs if of.any()}
    found = []
    for quantity in QUANTITIES:
        scale = _scale(getattr(path, quantity.field))
        for curve in shown_curves(path, quantity, path.mechanism.channels) if quantity.column else ():
            own = {name for kind, name in zip(quantity.of, curve.names, strict=True) if kind in ("coordinate", "actuator")}
            others = names is not None and not own <= names
            if others or (quantity is FELT_INERTIA and curve.names[0] in joints):
                continue
            head = quantity.column.format(*curve.names)
            if quantity is INERTIA:
                head += "".join(f" = at {actuator}" for actuator, joint in joints.items() if joint == curve.names[0])
            if quantity in (INERTIA, FELT_INERTIA):
                scale = _scale(curve.values)
            found.append(Column(head=head, unit=curve.unit, values=curve.values, scale=scale))
    return found


def _pose(path: KinematicLoopPath, k: int) -> str:
    """Return the position of the swept coordinate or, for a motion, of all coordinates."""
    leading = slice(None) if path.coordinate is None else slice(path.coordinate, path.coordinate + 1)
    return where(path.mechanism.independent_joints[leading], path.positions[k][leading])


def balance_sentences(path: KinematicLoopPath) -> list[str]:
    """Return a sentence on the poses of a coordinate's path at which it needs no effort."""
    if path.coordinate is None or not path.balances:
        return []
    joint = path.mechanism.independent_joints[path.coordinate]
    at = [f"{joint.text(one.position, 5)} {joint.unit} ({'' if one.stable else 'un'}stable)" for one in path.balances]
    return [f"{joint.name} is in balance, without effort, at {', '.join(at)}"]


def weight_sentences(path: KinematicLoopPath, *, changing: bool = False) -> list[str]:
    """Return a sentence for each actuator whose limit does not hold weight and springs at some pose of a path.

    With `changing`, actuators whose effort is the same at all poses are omitted.
    """
    said = []
    for j, actuator in enumerate(path.mechanism.actuators):
        effort, (low, high) = path.holding_effort[:, j], path.limit[j]
        excess = np.maximum(low - effort, effort - high)
        beyond = excess > ROUNDING_SHARE * max(_scale(effort), _scale(path.limit[j]))
        if beyond.any() and not (changing and np.ptp(effort) <= ROUNDING_SHARE * _scale(effort)):
            k = int(np.argmax(excess))
            said.append(
                f"at {_pose(path, k)} actuator {actuator.name} would need {effort[k]:.4g} {actuator.unit} to hold still,"
                f" beyond its limits {low:g} to {high:g} {actuator.unit} ({int(beyond.sum())} of {len(excess)} poses)"
            )
    return said


def unheld_sentences(path: KinematicLoopPath, *, changing: bool = False) -> list[str]:
    """Return a sentence for each coordinate that no effort of the actuators holds still at some pose of a path.

    With `changing`, coordinates whose missing effort is the same at all poses are omitted. Rods that spin about their own
    axis are always omitted: their missing effort is a rounding error.
    """
    said, least = [], ROUNDING_SHARE * _scale(path.gravity_effort)
    for i, joint in enumerate(path.mechanism.independent_joints):
        if not path.mechanism.actuated[i]:
            continue
        missing = np.abs(path.unheld_effort[:, i])
        beyond = missing > least
        if beyond.any() and not (changing and np.ptp(missing) <= ROUNDING_SHARE * _scale(missing)):
            k = int(np.argmax(missing))
            said.append(
                f"no actuator holds {joint.name} still in {int(beyond.sum())} of {len(missing)} poses:"
                f" {missing[k]:.4g} {joint.si_units[1]} are missing at {_pose(path, k)}"
            )
    return said
