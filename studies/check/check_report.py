"""What `linkplan check` prints of a mechanism along its way: a table of a few poses and what holds at all of them."""

from dataclasses import dataclass

import numpy as np

from linkplan.models.tree.joints import Joint
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath, acts
from linkplan.studies.output.tables import table

# Poses in a table: few enough for one look.
_ROWS = 9
# A quantity that changes by less than this share of its largest value along a path is said once and not at every pose.
_CONSTANT = 1e-9
# ... and one below this share of the largest of its kind is printed as zero.
_ZERO = 1e-12
# Digits that leave a number as it is.
_EXACT = 17
# An effort is beyond a limit from this share of it on: rounding.
_BEYOND = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Column:
    """A quantity along a path: its head with the unit, its values (n,) or, of intervals, (n, 2)."""

    head: str
    unit: str
    values: np.ndarray
    scale: float  # the largest of its kind along the path: far below it is rounding

    @property
    def is_constant(self) -> bool:
        """Whether it is the same at every pose, but for rounding."""
        if not np.isfinite(self.values).all():
            return bool(np.all(self.values == self.values[0]))
        return bool(np.all(np.ptp(self.values, axis=0) <= _CONSTANT * self.scale))

    @property
    def title(self) -> str:
        """The head with its unit."""
        return f"{self.head} [{self.unit}]" if self.unit != "1" else self.head

    def cell(self, k: int) -> float | str:
        """Return the entry of sample k."""
        value = np.where(np.abs(self.values[k]) > _ZERO * self.scale, self.values[k], 0.0)
        return float(value) if self.values.ndim == 1 else f"{value[0]:.4g} to {value[1]:.4g}"

    def said(self) -> str:
        """Return the constant value in words."""
        value = self.cell(0)
        text = value if isinstance(value, str) else f"{value:.4g}"
        return f"{self.head} {text}{'' if self.unit == '1' else f' {self.unit}'}"


def effort_unit(joint: Joint) -> str:
    """Return the unit of the effort on a joint."""
    return "N.m" if joint.kind == "hinge" else "N"


def inertia_unit(joint: Joint) -> str:
    """Return the unit of the inertia along a joint."""
    return "kg m2" if joint.kind == "hinge" else "kg"


def ratio_unit(joint: Joint, actuator_unit: str) -> str:
    """Return the unit of the effort on a joint per an actuator's effort: an arm in metres where a force turns a hinge."""
    if effort_unit(joint) == actuator_unit:
        return "1"
    return "m" if joint.kind == "hinge" else "1/m"


def path_text(path: KinematicLoopPath, *, brief: bool = False) -> str:
    """Return the table of a path, the quantities that stay the same, and where its weight cannot be held.

    A brief one of a reach is the table of the coordinate's own quantities, its actuators' and the closures'; empty without.
    """
    mechanism = path.mechanism
    at = np.unique(np.linspace(0, len(path.poses) - 1, _ROWS).astype(int))
    where = [
        Column(head=joint.name, unit=joint.unit, values=shown, scale=1.0)
        for column, (joint, s) in enumerate(zip(mechanism.independent_joints, path.positions.T, strict=True))
        if path.coordinate in (None, column)
        for shown in [np.array([float(joint.said(x, _EXACT)) for x in s])]
    ]
    columns = quantities(path)
    if brief and path.coordinate is not None:
        columns = _own(path, columns)
    varying = [*where, *(column for column in columns if not column.is_constant)]
    constant = [column.said() for column in columns if column.is_constant]
    if brief:
        lines = [f"along {path.title}:", table([c.title for c in varying], [[c.cell(k) for c in varying] for k in at])]
        said = [
            *weight_sentences(path, changing=path.coordinate != 0),
            *unheld_sentences(path, changing=path.coordinate != 0),
        ]
        changes = len(varying) > len(where)
        return "\n".join([*lines[: 1 + changes], *said]) if said or changes else ""
    lines = [f"along {path.title}, at rest ({len(at)} of {len(path.poses)} poses):"]
    if len(varying) > len(where):
        lines.append(table([column.title for column in varying], [[column.cell(k) for column in varying] for k in at]))
    if not acts(path).all():
        constant.append("all other ratios 0")
    hold = "hold and force are" if mechanism.actuators else "force is"
    lines.append(f"weight alone is without springs; {hold} with everything at rest, weight and springs")
    if constant:
        lines.append(f"the same at every pose: {', '.join(constant)}")
    return "\n".join([*lines, *weight_sentences(path), *unheld_sentences(path)])


def _own(path: KinematicLoopPath, columns: list[Column]) -> list[Column]:
    """Return the quantities that are the leading coordinate's own, one of its actuators', or a closure's."""
    of = np.flatnonzero(acts(path)[path.coordinate])
    names = [path.mechanism.independent_joints[path.coordinate].name, *(path.mechanism.actuators[j].name for j in of)]
    ends = tuple(f" {name}" for name in names)
    return [column for column in columns if column.head.startswith(("det", "force")) or column.head.endswith(ends)]


def _scale(values: np.ndarray) -> float:
    """Return the largest finite size among values; 1 where all are zero."""
    known = np.abs(values[np.isfinite(values)])
    return float(known.max(initial=0.0)) or 1.0


def quantities(path: KinematicLoopPath) -> list[Column]:
    """Return the quantities of the table, in its order."""
    mechanism = path.mechanism
    independent, actuators = list(enumerate(mechanism.independent_joints)), list(enumerate(mechanism.actuators))
    columns: list[Column] = []

    def add(head: str, unit: str, values: np.ndarray, scale: float) -> None:
        columns.append(Column(head=head, unit=unit, values=values, scale=scale))

    at_all = acts(path)
    for j, actuator in actuators:
        scale = _scale(path.ratio[..., j])
        for i, joint in independent:
            if at_all[i, j]:
                add(
                    f"{actuator.name}->{joint.name}",
                    ratio_unit(joint, actuator.unit),
                    path.ratio[:, i, j],
                    scale,
                )
    own = path.reduced_inertia.diagonal(axis1=1, axis2=2)
    felt = _same(own, path.reflected_inertia)
    for i, joint in independent:
        also = "".join(f" = at {actuator.name}" for j, actuator in actuators if felt[j] == i)
        add(f"inertia {joint.name}{also}", inertia_unit(joint), own[:, i], _scale(own[:, i]))
    for j, actuator in actuators:
        if felt[j] is None:
            values = path.reflected_inertia[:, j]
            add(f"inertia at {actuator.name}", "kg m2" if actuator.unit == "N.m" else "kg", values, _scale(values))
    weight, hold, available = (_scale(x) for x in (path.gravity_effort, path.holding_effort, path.available_effort))
    for i, joint in independent:
        add(f"weight alone {joint.name}", effort_unit(joint), path.gravity_effort[:, i], weight)
    for j, actuator in actuators:
        add(f"hold {actuator.name}", actuator.unit, path.holding_effort[:, j], hold)
    for i, joint in independent:
        if actuators:
            add(f"available {joint.name}", effort_unit(joint), path.available_effort[:, i], available)
    if len(mechanism.dependent):
        add("det J_z/home", "1", path.singularity, _scale(path.singularity))
    force = _scale(path.closure_force)
    for c, name in enumerate(mechanism.closure_names):
        add(f"force {name}", "N", path.closure_force[:, c], force)
    return columns


def _same(own: np.ndarray, felt: np.ndarray) -> list[int | None]:
    """Return the coordinate whose inertia (n, n_s) each actuator feels as it is (n, n_u), or None."""
    with np.errstate(invalid="ignore"):
        same = np.all(np.abs(felt[:, None, :] - own[:, :, None]) <= _CONSTANT * own[:, :, None], axis=0)
    return [int(np.argmax(of)) if of.any() else None for of in same.T]


def _pose(path: KinematicLoopPath, k: int) -> str:
    """Return where the path's coordinate stands, the others being at home; of a motion, where all of them do."""
    leading = slice(None) if path.coordinate is None else slice(path.coordinate, path.coordinate + 1)
    joints = zip(path.mechanism.independent_joints[leading], path.positions[k][leading], strict=True)
    return ", ".join(f"{joint.name} = {joint.said(x)} {joint.unit}" for joint, x in joints)


def weight_sentences(path: KinematicLoopPath, *, changing: bool = False) -> list[str]:
    """Return a sentence for each actuator whose limit does not hold weight and springs at some pose of a path.

    Of those alone that are asked for more at one pose than at another, if `changing`.
    """
    said = []
    for j, actuator in enumerate(path.mechanism.actuators):
        effort, (low, high) = path.holding_effort[:, j], path.limit[j]
        over = np.maximum(low - effort, effort - high)
        beyond = over > _BEYOND * max(_scale(effort), _scale(path.limit[j]))
        if beyond.any() and not (changing and np.ptp(effort) <= _CONSTANT * _scale(effort)):
            k = int(np.argmax(over))
            said.append(
                f"holding weight and springs asks {actuator.name} for {effort[k]:.4g} {actuator.unit} at {_pose(path, k)},"
                f" beyond its limit of {low:g} to {high:g} {actuator.unit}; so in {int(beyond.sum())} of {len(over)} poses"
            )
    return said


def unheld_sentences(path: KinematicLoopPath, *, changing: bool = False) -> list[str]:
    """Return a sentence for each coordinate that no effort of the actuators holds still at some pose of a path.

    Of those alone of which more is missing at one pose than at another, if `changing`. Rods that spin about their own line
    are left out: it is rounding that is missing there.
    """
    said, least = [], _BEYOND * _scale(path.gravity_effort)
    for i, joint in enumerate(path.mechanism.independent_joints):
        if int(path.mechanism.independent[i]) in path.mechanism.passive_dofs:
            continue
        missing = np.abs(path.unheld_effort[:, i])
        beyond = missing > least
        if beyond.any() and not (changing and np.ptp(missing) <= _CONSTANT * _scale(missing)):
            k = int(np.argmax(missing))
            said.append(
                f"no actuator holds {joint.name} still in {int(beyond.sum())} of {len(missing)} poses:"
                f" {missing[k]:.4g} {effort_unit(joint)} are missing at {_pose(path, k)}"
            )
    return said
