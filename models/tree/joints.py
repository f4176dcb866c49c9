"""Joints as internal coordinates: hinges, slides, and the three rotations of a ball joint; ranges of ball joints.

A ball joint's range bounds the angle alpha of its rotation, which MuJoCo measures from the joint's zero quaternion. Alpha
has no derivative at zero, so limits use sin^2(alpha / 2) = 1 - w^2 of the unit quaternion (w, x, y, z).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.errors import ModelError, nearest
from linkplan.models.tree.coordinates import BALL, FREE, HINGE, Coordinates, joint_label, turned_quaternion
from linkplan.models.tree.passive import limits_off

Shown = TypeVar("Shown", float, np.ndarray)
# Positions below this are zero to rounding [rad or m]: assembly closes loops to about 1e-12.
POSITION_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BallRange:
    """The largest angle [rad] of a ball joint, less its margin."""

    name: str
    joint: int  # of MuJoCo's model
    largest: float


def limited_balls(model: mujoco.MjModel) -> tuple[BallRange, ...]:
    """Return the ranges of a model's ball joints; a range of half a turn or more limits nothing."""
    if limits_off(model):
        return ()
    limited = [j for j in range(model.njnt) if int(model.jnt_type[j]) == BALL and model.jnt_limited[j]]
    largest = [float(model.jnt_range[j].max() - model.jnt_margin[j]) for j in limited]
    named = zip(limited, largest, strict=True)
    return tuple(BallRange(name=joint_label(model, j), joint=j, largest=angle) for j, angle in named if angle < np.pi)


def ball_turns(model: mujoco.MjModel, coordinates: Coordinates, q: ca.SX) -> ca.SX:
    """Return sin^2(alpha / 2) (n_balls,) of the limited ball joints at coordinates q (n_q,)."""
    charts, turns = {chart.joint: chart for chart in coordinates.charts}, []
    for ball in limited_balls(model):
        chart = charts[ball.joint]
        w, x, y, z = ca.vertsplit(turned_quaternion(chart, q))
        real = chart.centre[0] * w - (chart.centre[1] * x + chart.centre[2] * y + chart.centre[3] * z)
        turns.append(1 - real**2)
    return ca.vertcat(ca.SX(0, 1), *turns)


def inertia_unit_of(effort_unit: str, coupled_unit: str | None = None) -> str:
    """Return the unit of an inertia moved by an effort in "N.m" or "N", or of one that couples two joints' efforts."""
    turning = sum(unit == "N.m" for unit in (effort_unit, coupled_unit or effort_unit))
    return ("kg", "kg m", "kg m2")[turning]


def gain_units_of(effort_unit: str) -> tuple[str, str]:
    """Return the units of a stiffness and of a damping that give an effort in "N.m" or "N"."""
    return ("N.m/rad", "N.m.s/rad") if effort_unit == "N.m" else ("N/m", "N.s/m")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Joint:
    """A coordinate: a hinge [rad] or slide [m] with its range, infinite where the model sets none.

    A ball joint `rod` has three coordinates of kind "hinge": `rod_rx`, `rod_ry` and `rod_rz`. A free joint has three slides
    `_x`, `_y` and `_z` before them. `chart` then holds the joint's name, and the range is the chart's validity (see
    `linkplan.models.tree.charts`), not a mechanical stop.
    """

    name: str
    kind: str  # "hinge" or "slide"
    lower: float
    upper: float
    chart: str | None = None

    @property
    def turns(self) -> bool:
        """True if the coordinate repeats after a whole turn: a hinge, or a rod's azimuth or spin."""
        return self.kind == "hinge" and (self.chart is None or not np.isfinite([self.lower, self.upper]).any())

    @property
    def unit(self) -> str:
        """The unit of the joint's position in files and messages."""
        return "deg" if self.kind == "hinge" else "m"

    @property
    def si_units(self) -> tuple[str, str]:
        """The SI units of a position and of an effort."""
        return ("rad", "N.m") if self.kind == "hinge" else ("m", "N")

    @property
    def inertia_unit(self) -> str:
        """The unit of an inertia along the joint."""
        return inertia_unit_of(self.si_units[1])

    @property
    def gain_units(self) -> tuple[str, str]:
        """The units of a stiffness and of a damping."""
        return gain_units_of(self.si_units[1])

    def shown(self, position: Shown) -> Shown:
        """Return a position, or an array of them, [rad or m] in the unit of files and messages."""
        return self._in(np.degrees, position)

    def text(self, position: float, digits: int = 4) -> str:
        """Return a position [rad or m] as text in the unit of files and messages, rounded to `digits` digits."""
        return f"{0.0 if abs(position) < POSITION_ROUNDING else self.shown(position):.{digits}g}"

    def read(self, value: Shown) -> Shown:
        """Return a value, or an array of them, in the unit of files and messages as a position [rad or m]."""
        return self._in(np.radians, value)

    def _in(self, of_angles: Any, value: Any) -> Any:
        found = of_angles(value) if self.kind == "hinge" else value
        return found if np.ndim(found) else float(found)


def read_joints(name: str, model: mujoco.MjModel, coordinates: Coordinates) -> tuple[Joint, ...]:
    """Return the coordinates of a model as joints, one for every degree of freedom of its tree, in MuJoCo's order."""
    joints: list[Joint] = []
    unlimited = limits_off(model)
    for index in range(model.njnt):
        label, kind = joint_label(model, index), int(model.jnt_type[index])
        if kind in (BALL, FREE):
            if kind == FREE:
                joints += [
                    Joint(name=f"{label}_{axis}", kind="slide", lower=-np.inf, upper=np.inf, chart=label) for axis in "xyz"
                ]
            joints += [
                Joint(name=f"{label}_r{axis}", kind="hinge", lower=float(low), upper=float(high), chart=label)
                for axis, (low, high) in zip("xyz", coordinates.chart_of(index).rotation.limits, strict=True)
            ]
            continue
        lower, upper = _free_range(name, label, model, index) if not unlimited else (-np.inf, np.inf)
        joints.append(Joint(name=label, kind="hinge" if kind == HINGE else "slide", lower=lower, upper=upper))
    names = [joint.name for joint in joints]
    for joint in joints:
        if names.count(joint.name) > 1:
            raise ModelError(
                f"model '{name}' has two coordinates '{joint.name}': one of joint '{joint.chart}' and a joint of that name"
            )
    return tuple(joints)


def _free_range(name: str, label: str, model: mujoco.MjModel, index: int) -> tuple[float, float]:
    """Return a joint's range less its margin at either end [rad or m]; MuJoCo's limit force acts within the margin."""
    if not model.jnt_limited[index]:
        return -np.inf, np.inf
    margin = float(model.jnt_margin[index])
    lower, upper = (float(end) for end in model.jnt_range[index])
    if lower + margin > upper - margin:
        raise ModelError(
            f"model '{name}' leaves joint {label} no position: a margin of {margin:g} at either end leaves nothing of its"
            f" range {lower:g} to {upper:g} (rad or m)"
        )
    return lower + margin, upper - margin


def shown_by_unit(joints: Iterable[Joint], values: Iterable) -> dict[str, dict[str, Any]]:
    """Return joints' values by unit and by name, in that unit: "deg" for hinges, "m" for slides.

    Args:
        joints: hinges and slides.
        values: a number or an array of each [rad or m].
    """
    found: dict[str, dict[str, Any]] = {"deg": {}, "m": {}}
    for joint, value in zip(joints, values, strict=True):
        found[joint.unit][joint.name] = joint.shown(value)
    return found


def shown_by_name(joints: Iterable[Joint], values: np.ndarray) -> dict[str, np.ndarray]:
    """Return joints' values (n, n_joints) [rad or m] by name, in the unit of files and messages."""
    return {joint.name: joint.shown(column) for joint, column in zip(joints, values.T, strict=True)}


def unit_steps(joints: Sequence[Joint], extent_m: float) -> np.ndarray:
    """Return a unit step of each joint (n_joints,): 1 rad on a hinge, the mechanism's extent [m] on a slide."""
    return np.array([1.0 if joint.kind == "hinge" else extent_m for joint in joints])


def index_of(mechanism: str, joints: tuple[Joint, ...], name: str, error: type[Exception] = ModelError) -> int:
    """Return the index of a joint by name.

    Raises:
        error: if there is no such joint; the message lists the joints.
    """
    names = [joint.name for joint in joints]
    if name not in names:
        raise error(f"joint '{name}' is not in mechanism '{mechanism}'{nearest(name, names)}; joints are {', '.join(names)}")
    return names.index(name)


def where(joints: Iterable[Joint], positions: Iterable[float], digits: int = 4) -> str:
    """Return the positions [rad or m] of joints as text, rounded to `digits` digits: "O = 10 deg, B = 0.2 m"."""
    placed = zip(joints, positions, strict=True)
    return ", ".join(f"{joint.name} = {joint.text(x, digits)} {joint.unit}" for joint, x in placed)
