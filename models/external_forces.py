"""Forces from outside the model: a load on a foot, a tyre's force, a press's force over its stroke, a fan's over its speed.

A constant force is an actuator without gain in the model itself, so that it is the same in MuJoCo, in the symbolic dynamics
and in an exported model. Its line of action moves with the site; its size and its direction in the world do not change. A
force over time is a parameter of the symbolic dynamics, and a simulation applies it. A load over a place or a speed is a
custom number of the model, which has no such force of its own: the tree reads it as one more passive force, and a simulation
applies it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.errors import ModelError, choose
from linkplan.models.kinematics import clamped_joints


class ForceCurve(Protocol):
    """Columns over time, which may repeat."""

    @property
    def periodic(self) -> bool:
        """Whether the columns repeat."""
        ...

    def derivative(self, time_s: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the derivative of the given order at times (n,) [s], as (n, k)."""
        ...

    def inner_times(self, duration_s: float) -> np.ndarray:
        """Return the times [s] inside a duration at which one cubic ends and the next begins."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class ForcesOverTime:
    """Forces on sites by name; `curve` has the columns (3 n_sites,) [N]: x, y, z in the world of each site in turn."""

    sites: tuple[str, ...]
    curve: ForceCurve


def omitted_forces(forces: ForcesOverTime | None, where: str) -> str | None:
    """Return the note that forces over time, which belong to a motion, are omitted in a study without one, or None."""
    return None if forces is None else f"force_over_time on {', '.join(forces.sites)} is omitted {where}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Load:
    """A force that depends on a place or a speed. It acts on a joint, or on a site along an axis of the world.

    Between the rows it is their monotone cubic (Fritsch & Carlson 1980), beyond them that of the last row. Rows over a whole
    turn of a hinge that end as they begin repeat with every turn.

    Args:
        on: "joint" or "site".
        name: of the joint, a hinge or slide, or of the site.
        over: "position" or "speed", of the length; or the name of another joint, whose position counts.
        axis: (3,) the site's direction, of size 1.
        turns: whether it is over the angle of a hinge.
        at: increasing places [rad or m] or speeds [per second] (n,).
        effort: the force there (n,) [N.m or N], positive along the length.
    """

    on: str
    name: str
    over: str
    turns: bool
    axis: np.ndarray
    at: np.ndarray
    effort: np.ndarray

    @cached_property
    def curve(self) -> Any:
        """The monotone cubic, of `scipy`."""
        from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

        if not self.repeats:
            return PchipInterpolator(self.at, self.effort)
        # The slopes at the ends follow from the rows before and after the turn.
        at = np.concatenate([self.at[:-1] - _TURN, self.at, self.at[1:] + _TURN])
        slopes = PchipInterpolator(at, np.concatenate([self.effort[:-1], self.effort, self.effort[1:]])).derivative()
        return CubicHermiteSpline(self.at, self.effort, slopes(self.at))

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the efforts at places or speeds (n,)."""
        return self.curve(self.at[0] + (x - self.at[0]) % _TURN if self.repeats else np.clip(x, self.at[0], self.at[-1]))

    @property
    def repeats(self) -> bool:
        """Whether the rows repeat with every turn."""
        whole = abs(self.at[-1] - self.at[0] - _TURN) <= _TURN_ROUNDING and self.effort[-1] == self.effort[0]
        return self.turns and self.over != "speed" and bool(whole)

    def expression(self, x: ca.SX) -> ca.SX:
        """Return the effort at a place or a speed: the sum of what each cubic adds, up to the place.

        Rows that repeat with every turn are written for several turns. The expression has a step where these end, which is
        then far from most motions.
        """
        total, turns = ca.SX(float(self.effort[0])), range(_TURNS_OF_WINDOW) if self.repeats else (0,)
        if self.repeats:
            x = x + _TURN  # the window begins a turn before the rows
            x = x - _TURNS_OF_WINDOW * _TURN * ca.floor((x - float(self.at[0])) / (_TURNS_OF_WINDOW * _TURN))
        for turn in turns:
            for first, last, (c3, c2, c1, _) in zip(self.at[:-1], self.at[1:], self.curve.c.T, strict=True):
                begin = float(first) + turn * _TURN
                r = ca.fmin(ca.fmax(x, begin), float(last) + turn * _TURN) - begin
                total += ((float(c3) * r + float(c2)) * r + float(c1)) * r
        return total

    def joint(self, model: mujoco.MjModel) -> int | None:
        """Return the joint whose position or speed counts; None for a site's."""
        name = self.name if self.over in ("position", "speed") else self.over
        return None if self.on == "site" and name == self.name else int(model.joint(name).id)


# A turn [rad], the rounding of rows over one, and the turns of the window in which an expression repeats them.
_TURN, _TURN_ROUNDING, _TURNS_OF_WINDOW = 2 * np.pi, 1e-9, 4
# Loads are custom numbers with this name, then their number, "joint" or "site", its name, and over what they are.
_LOAD_PREFIX = "load|"


def loads_of(model: mujoco.MjModel) -> list[Load]:
    """Return the loads of a compiled model."""
    found = []
    for k in range(model.nnumeric):
        if not (name := model.numeric(k).name).startswith(_LOAD_PREFIX):
            continue
        _, _, on, target, over = name.split("|")
        first = int(model.numeric_adr[k])
        data = np.array(model.numeric_data[first : first + int(model.numeric_size[k])])
        at, effort = data[3:].reshape(2, -1)
        load = Load(on=on, name=target, over=over, turns=False, axis=data[:3], at=at, effort=effort)
        joint = load.joint(model)
        hinge = joint is not None and int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        found.append(replace(load, turns=hinge))
    return found


def add_loads(spec: mujoco.MjSpec, loads: Sequence[Mapping[str, Any]]) -> list[str]:
    """Add loads over a place or a speed, tables of mechanism.load, to a specification, and return a note on each.

    Raises:
        ModelError: for an unknown name, or rows that are no function of a place or a speed.
    """
    of = {"joint": {joint.name: joint for joint in spec.joints}, "site": {site.name: site for site in spec.sites}}
    notes = []
    for k, asked in enumerate(loads):
        where = f"mechanism.load[{k}]"
        on, over = "joint" if asked.get("joint") else "site", asked.get("over")
        if bool(asked.get("joint")) == bool(asked.get("site")) or (on == "site") != bool(asked.get("direction")):
            raise ModelError(f"{where} needs a joint, or a site and its direction")
        name = choose(f"{on} in {where}", asked[on], of[on])
        axis = np.array(asked.get("direction") or [0.0, 0.0, 0.0], dtype=float)
        if on == "site" and not np.any(axis):
            raise ModelError(f"{where}.direction must not be zero")
        given = [key for key in ("at_deg", "at_m", "at_deg_s", "at_m_s") if asked.get(key)]
        measured = of["joint"][choose(f"joint in {where}.over", over, of["joint"])] if over else of[on][name]
        for joint in (measured, of[on][name]):
            if joint in spec.joints and joint.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                raise ModelError(f"{where}: joint '{joint.name}' is neither a hinge nor a slide")
        turns = measured in spec.joints and measured.type == mujoco.mjtJoint.mjJNT_HINGE
        legal = ["at_deg" if turns else "at_m"] + ([] if over else ["at_deg_s" if turns else "at_m_s"])
        if len(given) != 1 or given[0] not in legal:
            raise ModelError(f"{where} needs one list {' or '.join(legal)}, got {', '.join(given) or 'none'}")
        at, effort = np.array(asked[given[0]], dtype=float), np.array(asked["effort"], dtype=float)
        if len(at) < 2 or np.any(np.diff(at) <= 0) or len(at) != len(effort):
            raise ModelError(f"{where}: {given[0]} must increase over two rows or more, with as many values of effort")
        at, axis = np.radians(at) if turns else at, axis / (np.linalg.norm(axis) or 1.0)
        kind = over or ("speed" if given[0].endswith("_s") else "position")
        data = np.concatenate([axis, at, effort])
        spec.add_numeric(name=f"{_LOAD_PREFIX}{k}|{on}|{name}|{kind}", data=data, size=len(data))
        along = f"the position of {over}" if over else f"its {kind}"
        notes.append(f"load on {on} {name} over {along}: the monotone cubic through {len(at)} rows")
    return notes


# The site at the world's origin whose axes are those of the forces.
_AXES_NAME = "world axes"


def add_forces(spec: mujoco.MjSpec, forces: Mapping[str, Sequence[float]]) -> None:
    """Add constant forces (3,) [N] on sites by name to a specification.

    Raises:
        ModelError: for an unknown site, or one that a joint moves whose actuatorfrcrange would clamp the force too.
    """
    sites = {site.name: site for site in spec.sites if site.name}
    acting = {choose("site in mechanism.force", name, sites): force for name, force in forces.items() if np.any(force)}
    for name, force in acting.items():
        if _AXES_NAME not in sites:
            sites[_AXES_NAME] = spec.worldbody.add_site(name=_AXES_NAME)
        one = spec.add_actuator(name=f"force on {name}", target=name, trntype=mujoco.mjtTrn.mjTRN_SITE, refsite=_AXES_NAME)
        one.gear = [*force, 0.0, 0.0, 0.0]
        one.gaintype, one.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        one.gainprm[0], one.biasprm[0] = 0.0, 1.0
    model = spec.compile() if acting else None
    for name in acting:
        for joint in clamped_joints(model, model.site(name).id):
            raise ModelError(
                f"mechanism.force on site '{name}': the actuatorfrcrange of joint '{model.joint(joint).name}' would clamp"
                " the force with the motors' efforts; limit the motors by their forcerange or ctrlrange instead"
            )
