"""The quantities along a path of `linkplan check`, for the record, tables and plots.

Each has the `field` of a `KinematicLoopPath`; fields of `PathFigures` are recorded.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from msgspec import Struct

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.poses.body_angles import turning_bodies
from linkplan.models.poses.joint_forces import pins_of
from linkplan.models.tree.dynamics import site_names
from linkplan.models.tree.joints import Joint, inertia_unit_of, shown_by_unit
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath, acts, has_whole_records
from linkplan.studies.check.spring_ratios import sprung_tendons
from linkplan.studies.output.quantities import Curve, Quantity, curves_of

# Fields of a `KinematicLoopPath` that have other names in the record.
_KEYS = {
    "rates": "joint_rate",
    "ratio": "transmission_ratio",
    "singularity": "singularity_ratio",
    "closure_force": "closure_force_n",
    "pin_force": "pin_force_n",
    "pin_moment": "pin_moment_nm",
    "spring_length": "spring_length_m",
    "spring_ratio": "spring_motion_ratio",
}


class PathFigures(Struct, frozen=True, kw_only=True, eq=False):
    """A path's entry in `check.json`: arrays over its samples, by joint, coordinate, actuator or closure."""

    path: str
    coordinate: str | None
    time_s: np.ndarray | None
    q_deg: dict[str, np.ndarray]
    q_m: dict[str, np.ndarray]
    joint_rate: dict[str, dict[str, np.ndarray]]
    transmission_ratio: dict[str, dict[str, np.ndarray]]
    reduced_inertia: np.ndarray
    reflected_inertia: dict[str, np.ndarray]
    gravity_effort: dict[str, np.ndarray]
    holding_effort: dict[str, np.ndarray]
    unheld_effort: dict[str, np.ndarray]
    available_effort: dict[str, np.ndarray]
    singularity_ratio: np.ndarray
    closure_force_n: dict[str, np.ndarray]
    pin_force_n: dict[str, np.ndarray]
    pin_moment_nm: dict[str, np.ndarray]
    site_m: dict[str, np.ndarray]
    body_deg: dict[str, np.ndarray]
    spring_length_m: dict[str, np.ndarray]
    spring_motion_ratio: dict[str, dict[str, np.ndarray]]
    balance: list[dict[str, Any]]


def ratio_unit(joint: Joint, actuator_unit: str) -> str:
    """Return the unit of the effort on a joint per effort of an actuator, for example metres for a force on a hinge."""
    if joint.si_units[1] == actuator_unit:
        return "1"
    return "m" if joint.kind == "hinge" else "1/m"


def _effort(part: Joint | Actuator) -> str:
    return part.si_units[1]


def _inertia(part: Joint | Actuator) -> str:
    return inertia_unit_of(part.si_units[1])


# The plots in their order: the label of the vertical axis by title.
PLOTS = {
    "Dependent joints": "position",
    "Transmission ratio": "ratio",
    "Reduced inertia": "inertia",
    "Inertia that an actuator feels": "inertia",
    "Effort that holds it still": "effort",
    "Effort within the actuators' limits": "effort",
    "Distance from a singular pose": "det J_z over that at home",
    "Force in closures and pins at rest": "force",
    "Motion ratio of springs": "d length / d coordinate",
}
_FOLLOWERS, _RATIO, _INERTIA, _FELT, _HELD, _LIMITED, _SINGULAR, _FORCE, _SPRINGS = PLOTS
LOG_PLOTS = (_INERTIA, _FELT)  # logarithmic if they change by a large factor
REACH_PLOTS = (_FOLLOWERS, _INERTIA, _HELD)  # those in the figure of a mechanism's reach
_JOINT, _MOTOR = ("coordinate",), ("actuator",)
RATIO = Quantity(
    field="ratio",
    of=("coordinate", "actuator"),
    unit=lambda joint, actuator: ratio_unit(joint, actuator.unit),
    column="{1}->{0}",
    plot=_RATIO,
    line="{1} to {0}",
)
INERTIA = Quantity(field="own_inertia", of=_JOINT, unit=_inertia, column="inertia {}", plot=_INERTIA)
FELT_INERTIA = Quantity(field="reflected_inertia", of=_MOTOR, unit=_inertia, column="inertia at {}", plot=_FELT)
WEIGHT = Quantity(
    field="gravity_effort", of=_JOINT, unit=_effort, column="weight alone {}", plot=_HELD, line="{}, weight alone"
)
AVAILABLE = Quantity(field="available_effort", of=_JOINT, unit=_effort, column="available {}", plot=_LIMITED)
SINGULARITY = Quantity(field="singularity", column="det J_z/home", plot=_SINGULAR, line="least of J_z's blocks")
# In the order of a table's columns.
QUANTITIES = (
    RATIO,
    INERTIA,
    FELT_INERTIA,
    Quantity(field="shown_poses", of=("follower",), unit=lambda joint: joint.unit, plot=_FOLLOWERS),
    Quantity(field="needed", of=_JOINT, unit=_effort, plot=_HELD),
    WEIGHT,
    Quantity(field="holding_effort", of=_MOTOR, unit=_effort, column="hold {}"),
    Quantity(field="unheld_effort", of=_JOINT, unit=_effort),
    AVAILABLE,
    Quantity(field="needed", of=_JOINT, unit=_effort, plot=_LIMITED, line="{}, holds it still"),
    SINGULARITY,
    Quantity(field="spring_length", of=("tendon",), unit="m", column="length {}"),
    Quantity(
        field="spring_ratio",
        of=("tendon", "coordinate"),
        unit=lambda _, joint: ratio_unit(joint, "N"),
        column="{} per {}",
        plot=_SPRINGS,
        line="{} per {}",
    ),
    Quantity(field="closure_force", of=("closure",), unit="N", column="force {}", plot=_FORCE),
    Quantity(field="pin_force", of=("pin",), unit="N", plot=_FORCE),
    Quantity(field="pin_moment", of=("pin",), unit="N.m"),
    Quantity(field="rates", of=("joint", "coordinate")),
)


def path_curves(path: KinematicLoopPath, quantity: Quantity, columns: Sequence[int]) -> Iterator[Curve]:
    """Yield the curves of a quantity, of coordinates those of the given columns."""
    mechanism, rounding = path.mechanism, ROUNDING_SHARE * np.ptp(path.poses)
    parts: dict[str, list[tuple[int, Any]]] = {
        "coordinate": [(k, mechanism.independent_joints[k]) for k in columns],
        "joint": list(enumerate(mechanism.joints)),
        "follower": [(k, mechanism.joints[k]) for k in mechanism.dependent.tolist() if np.ptp(path.poses[:, k]) > rounding],
        "actuator": list(enumerate(mechanism.actuators)),
        "closure": list(enumerate(mechanism.closure_names)),
        "pin": list(enumerate(pin.name for pin in pins_of(mechanism))),
        "tendon": list(enumerate(sprung_tendons(mechanism.model))),
    }
    return curves_of(quantity, parts, getattr(path, quantity.field))


def shown_curves(path: KinematicLoopPath, quantity: Quantity, columns: Sequence[int]) -> list[Curve]:
    """Return the curves in tables and plots: those of what the mechanism has and of actuators that act on the columns."""
    mechanism, found = path.mechanism, list(path_curves(path, quantity, columns))
    if (quantity is AVAILABLE and not mechanism.actuators) or (quantity is SINGULARITY and not len(mechanism.dependent)):
        return []
    acting = acts(path)[list(columns)]
    shown = {id(RATIO): acting.ravel(), id(FELT_INERTIA): acting.any(axis=0)}.get(id(quantity))
    return found if shown is None else [curve for curve, acts_on in zip(found, shown, strict=True) if acts_on]


def path_figures(path: KinematicLoopPath) -> PathFigures:
    """Return the record of a path; if it is too large (`has_whole_records`), only with the path's own coordinate."""
    mechanism, own = path.mechanism, path.coordinate
    of = list(range(mechanism.dof)) if own is None or has_whole_records(mechanism) else [own]
    joint = mechanism.independent_joints[own or 0]
    positions, keys = shown_by_unit(mechanism.joints, path.poses.T), PathFigures.__struct_fields__
    return PathFigures(
        path=path.title,
        coordinate=None if own is None else joint.name,
        time_s=path.time_s,
        q_deg=positions["deg"],
        q_m=positions["m"],
        reduced_inertia=path.reduced_inertia[:, of][:, :, of],
        **{key: _by_name(path, one, of) for one in QUANTITIES if (key := _KEYS.get(one.field, one.field)) in keys},
        body_deg={name: np.degrees(path.poses @ sigma) for name, sigma in turning_bodies(mechanism).items()},
        site_m={name: path.places[:, :, mechanism.model.site(name).id] for name in site_names(mechanism.model)},
        balance=[{"position": joint.shown(one.position), "unit": joint.unit, "stable": one.stable} for one in path.balances],
    )


def _by_name(path: KinematicLoopPath, quantity: Quantity, columns: Sequence[int]) -> Any:
    """Return a quantity's arrays by the names of its parts, a coordinate's name last; without parts, the array itself."""
    found: dict[str, Any] = {}
    for curve in path_curves(path, quantity, columns):
        names = curve.names if quantity.of[:1] != _JOINT else curve.names[::-1]
        if not names:
            return curve.values
        inner = found if len(names) == 1 else found.setdefault(names[0], {})
        inner[names[-1]] = curve.values
    return found
