"""A closed pose as text: a keyframe of the model, or keys of a problem's [mechanism] table."""

import json
import re
from collections.abc import Sequence

import numpy as np

from linkplan.models.closure.locked import locked_by
from linkplan.models.closure.nearest_pose import nearest_closed_pose
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.errors import AssemblyError, LockedError, UnassembledError
from linkplan.models.tree.coordinates import Coordinates
from linkplan.models.tree.joints import Joint

# Decimals of an angle [deg] in a problem file; assembly removes the rounding. Lengths [m] have three more.
_ANGLE_DECIMALS = 6
# Significant digits of a keyframe: its loops then close to a nanometre without assembly.
_KEYFRAME_DIGITS = 10


def keyframe_of(coordinates: Coordinates, pose: np.ndarray) -> str:
    """Return the MJCF keyframe "home" of a pose (n_q,)."""
    qpos = np.where(np.abs(values := coordinates.qpos_of(pose)) < 10.0**-_KEYFRAME_DIGITS, 0.0, values)
    return f'<keyframe><key name="home" qpos="{" ".join(f"{x:.{_KEYFRAME_DIGITS}g}" for x in qpos)}"/></keyframe>'


def home_of(joints: Sequence[Joint], pose: Sequence[float] | np.ndarray) -> dict[str, dict[str, float]]:
    """Return the tables home_deg and home_m of joints at positions [rad or m], without empty ones."""
    tables: dict[str, dict[str, float]] = {}
    for joint, x in zip(joints, pose, strict=True):
        decimals = _ANGLE_DECIMALS if joint.kind == "hinge" else _ANGLE_DECIMALS + 3
        tables.setdefault(f"home_{joint.unit}", {})[joint.name] = round(joint.shown(x), decimals) + 0.0
    return tables


def home_text(tables: dict[str, dict[str, float]]) -> str:
    """Return home_deg and home_m as lines of a problem file's [mechanism] table."""
    rows = []
    for key, table in tables.items():
        values = ", ".join(f"{_key(joint)} = {x:.10g}" for joint, x in table.items())
        rows.append(f"{key} = {{ {values} }}")
    return "\n".join(rows)


def _key(name: str) -> str:
    """Return a name as a TOML key, quoted if it contains anything but letters, digits, dashes and underscores."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)


def with_closed_pose(error: UnassembledError, loop: KinematicLoop, reference: np.ndarray) -> UnassembledError:
    """Return an error that offers the closed pose nearest to `reference` (n_q,), or states why there is none to offer."""
    return _offering(error, loop, nearest_closed_pose(loop, reference))


def _offering(error: UnassembledError, loop: KinematicLoop, pose: np.ndarray | None) -> UnassembledError:
    if pose is None:
        hint = (
            "no closed pose was found near it: the links may be too short, or rounded, which"
            f" mechanism.closure_tolerance_m = {1.01 * error.gap_m:.3g} accepts; else name a pose with mechanism.home_deg"
        )
        return UnassembledError(f"{error}; {hint}", error.gap_m)
    home = home_of(loop.joints, pose)
    if loop.rank(pose) == len(loop.joints):
        hint = "at the nearest closed pose found, the loops lock every joint"
        return UnassembledError(f"{error}; {hint}: {'; '.join(home_text(home).splitlines())}", error.gap_m)
    hint = f"nearest closed pose found: mechanism.{' and mechanism.'.join(home_text(home).splitlines())}"
    return UnassembledError(f"{error}; {hint}", error.gap_m, keyframe_of(loop.coordinates, pose), home)


def locked_or_singular(error: LockedError, loop: KinematicLoop, pose: np.ndarray) -> AssemblyError:
    """Return the error for a pose (n_q,) at which a joint cannot move.

    At a singular pose (a flat parallelogram) the error offers a regular closed pose. Otherwise the mechanism is locked (a
    flat truss) and the error names the closures that lock it.
    """
    other = nearest_closed_pose(loop, pose)
    if other is not None and loop.rank(pose) < loop.rank(other) < len(loop.joints):
        return _offering(UnassembledError(str(error)), loop, other)
    return locked_by(error, loop, pose)
