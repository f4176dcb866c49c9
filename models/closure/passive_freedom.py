"""Passive degrees of freedom: bodies that can spin about a line through their centres while all other bodies rest.

Examples are a rod between two ball joints and a rod on a hinge along its own line. In the kernel of the closure such a spin
is a motion in which every body rests or turns about its own centre of mass, and on which no actuator and no spring acts.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from linkplan.models.closure.rank import FILE_ROUNDING_SHARE, ROUNDING_SHARE
from linkplan.models.kinematics import data_at
from linkplan.models.tree.coordinates import Coordinates
from linkplan.models.tree.joints import Joint

# A centre of mass no farther from its body's line of spin, as a share of the mechanism's size, moves other bodies little: a
# millimetre on a leg. Exported rods are half a millimetre off.
_OFFSET_SHARE = 1e-3


def find_passive_dofs(
    model: mujoco.MjModel,
    joints: Sequence[Joint],
    coordinates: Coordinates,
    dynamics,
    independent: np.ndarray,
    poses: Sequence[np.ndarray],
    extent_m: float,
) -> tuple[tuple[int, ...], list[str]]:
    """Return the independent coordinates that are passive degrees of freedom, and a note on each.

    Args:
        model: the compiled model.
        joints: of the mechanism.
        coordinates: of the mechanism.
        dynamics: its reduced dynamics.
        independent: coordinates (n_s,).
        poses: closed poses (n_q,), one or more.
        extent_m: the mechanism's size [m].
    """
    found: list[int] = []
    notes: list[str] = []
    if not dynamics.closure.size1_out(0):
        return (), []
    rates = [np.array(dynamics.velocity_map(q)) for q in poses]
    still = np.zeros(len(joints))
    springs = [np.array(dynamics.passive(q, still)).reshape(-1, 1) for q in poses]
    acting = [
        np.hstack([np.array(dynamics.effort_matrix(q)).reshape(len(q), -1), spring])
        for q, spring in zip(poses, springs, strict=True)
    ]
    for column, index in enumerate(independent.tolist()):
        spinning = [
            _spinning(model, coordinates, q, gamma[:, column], efforts, extent_m)
            for q, gamma, efforts in zip(poses, rates, acting, strict=True)
        ]
        if not spinning or not all(spinning):
            continue
        found.append(index)
        chart = joints[index].chart
        ball = chart is not None and len(spinning[0]) == 1 and not any(joint.name == f"{chart}_x" for joint in joints)
        name = f"ball joint {chart}" if ball else " and ".join(f"body {model.body(b).name or b}" for b in spinning[0])
        notes.append(f"{name} can spin while all other joints rest: a passive degree of freedom, which no actuator drives")
    return tuple(found), notes


def _spinning(
    model: mujoco.MjModel, coordinates: Coordinates, q: np.ndarray, gamma: np.ndarray, acting: np.ndarray, extent_m: float
) -> list[int]:
    """Return the bodies that spin as coordinates move at rates `gamma` (n_q,), empty if that is not a passive spin.

    `acting` (n_q, n_u + 1): the efforts on the coordinates of each actuator and of springs.
    """
    least = ROUNDING_SHARE * max(1.0, float(np.abs(acting).max())) * np.abs(gamma).max()
    if np.abs(acting.T @ gamma).max() > least:
        return []
    data = data_at(model, coordinates.qpos_of(q))
    qvel = coordinates.qvel_of(q, gamma)
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    speeds, turns = np.zeros(model.nbody), np.zeros(model.nbody)
    for body in np.flatnonzero(model.body_mass > 0):
        mujoco.mj_jacBodyCom(model, data, linear, angular, body)
        speeds[body], turns[body] = np.linalg.norm(linear @ qvel), np.linalg.norm(angular @ qvel)
    moment, whole = speeds @ model.body_mass, model.body_mass[model.body_weldid > 0].sum()
    # Farther off, a light rod still moves the others little: a bent rod of 10 g in a leg of 10 kg.
    least = _OFFSET_SHARE * extent_m * turns.max()
    if speeds.max() > least and moment > 0.01 * whole * least:
        return []
    return np.flatnonzero(turns > ROUNDING_SHARE * turns.max()).tolist()


def round_spins(dynamics, home: np.ndarray, passive: np.ndarray) -> np.ndarray:
    """Return a mask (n_s,) of the `passive` coordinates that leave the inertia unchanged one radian from the home pose."""
    inertia, found = np.array(dynamics.reduced_inertia(home)), np.array(passive)
    for column in np.flatnonzero(passive):
        turned = home + np.array(dynamics.velocity_map(home))[:, column]
        found[column] = (
            np.abs(np.array(dynamics.reduced_inertia(turned)) - inertia).max() <= FILE_ROUNDING_SHARE * inertia.max()
        )
    return found
