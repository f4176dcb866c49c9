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
    if not dynamics.closure.size1_out(0):
        return (), []
    spins = [_spinning_bodies(model, coordinates, dynamics, q, extent_m) for q in poses]
    passive = np.flatnonzero(np.logical_and.reduce([one.any(axis=0) for one in spins]))
    notes = []
    for column in passive:
        bodies, chart = np.flatnonzero(spins[0][:, column]), joints[independent[column]].chart
        ball = chart is not None and len(bodies) == 1 and not any(joint.name == f"{chart}_x" for joint in joints)
        name = f"ball joint {chart}" if ball else " and ".join(f"body {model.body(b).name or b}" for b in bodies)
        notes.append(f"{name} can spin while all other joints rest: a passive degree of freedom, which no actuator drives")
    return tuple(independent[passive].tolist()), notes


def _spinning_bodies(
    model: mujoco.MjModel, coordinates: Coordinates, dynamics, q: np.ndarray, extent_m: float
) -> np.ndarray:
    """Return a mask (n_body, n_s) of the bodies that spin as an independent coordinate moves, if that is a passive spin."""
    gamma = np.array(dynamics.velocity_map(q))
    spring = np.array(dynamics.passive(q, np.zeros(len(q)))).reshape(-1, 1)
    acting = np.hstack([np.array(dynamics.effort_matrix(q)).reshape(len(q), -1), spring])
    scale = ROUNDING_SHARE * max(1.0, float(np.abs(acting).max()))
    free = np.abs(acting.T @ gamma).max(axis=0) <= scale * np.abs(gamma).max(axis=0)
    speeds, turns = _body_rates(model, coordinates, q, gamma * free)
    moment, whole = model.body_mass @ speeds, model.body_mass[model.body_weldid > 0].sum()
    # Farther off, a light rod still moves the others little: a bent rod of 10 g in a leg of 10 kg.
    least = _OFFSET_SHARE * extent_m * turns.max(axis=0)
    spins = free & ((speeds.max(axis=0) <= least) | (moment <= 0.01 * whole * least))
    return spins & (turns > ROUNDING_SHARE * turns.max(axis=0))


def _body_rates(
    model: mujoco.MjModel, coordinates: Coordinates, q: np.ndarray, rates: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the speeds of centres [m/s] and the turning speeds [rad/s] (n_body, n) at rates (n_q, n); 0 without mass."""
    data, qvel = data_at(model, coordinates.qpos_of(q)), coordinates.qvel_of(np.broadcast_to(q, rates.T.shape), rates.T).T
    linear, angular = np.zeros((2, model.nbody, 3, model.nv))
    for body in np.flatnonzero(model.body_mass > 0):
        mujoco.mj_jacBodyCom(model, data, linear[body], angular[body], body)
    return np.linalg.norm(linear @ qvel, axis=1), np.linalg.norm(angular @ qvel, axis=1)


def round_spins(dynamics, home: np.ndarray, passive: np.ndarray) -> np.ndarray:
    """Return a mask (n_s,) of the `passive` coordinates that leave the inertia unchanged one radian from the home pose."""
    inertia, found = np.array(dynamics.reduced_inertia(home)), np.array(passive)
    for column in np.flatnonzero(passive):
        turned = home + np.array(dynamics.velocity_map(home))[:, column]
        found[column] = (
            np.abs(np.array(dynamics.reduced_inertia(turned)) - inertia).max() <= FILE_ROUNDING_SHARE * inertia.max()
        )
    return found
