"""Passive degrees of freedom: a rod between two ball joints spins about its line independently of everything else."""

import mujoco
import numpy as np

from linkplan.models.closure.rank import numerical_rank
from linkplan.models.tree.coordinates import BALL, joint_label

# A column, moment or weight below this share of the largest is rounding.
_NOTHING = 1e-9


def find_passive_dofs(
    model: mujoco.MjModel, jacobians: list[np.ndarray], moments: list[np.ndarray], weights: list[np.ndarray]
) -> tuple[tuple[int, ...], list[str]]:
    """Return the passive degrees of freedom, coordinates of bodies that spin in a closed loop, and a sentence on each body.

    A degree of freedom is passive where a body's own joints move while all others rest, the loops stay closed, and neither
    an actuator nor gravity acts on the motion.

    Args:
        model: whose bodies they are.
        jacobians: of the closure (n_rows, n_q) at one or more closed poses.
        moments: the actuators' (n_q, n_u) at the same poses.
        weights: gravity's generalised force (n_q,) at the same poses.
    """
    passive_dofs: list[int] = []
    notes = []
    for body in range(1, model.nbody):
        start, n_dofs = int(model.body_dofadr[body]), int(model.body_dofnum[body])
        own = list(range(start, start + n_dofs))
        if n_dofs > 1 and all(_spins(own, *pose) for pose in zip(jacobians, moments, weights, strict=True)):
            passive_dofs += own
            joint = int(model.body_jntadr[body])
            ball = int(model.jnt_type[joint]) == BALL
            name = f"ball joint {joint_label(model, joint)}" if ball else f"body {model.body(body).name or body}"
            notes.append(
                f"{name} can spin while all other joints rest: a passive degree of freedom, which no actuator drives"
            )
    return tuple(passive_dofs), notes


def _spins(own: list[int], jacobian: np.ndarray, moments: np.ndarray, weight: np.ndarray) -> bool:
    """Return whether a body's coordinates have a motion of their own at a pose on which nothing acts."""
    block = jacobian[:, own]
    if np.abs(block).max(initial=0.0) <= _NOTHING * np.abs(jacobian).max(initial=1.0):
        return False  # the loops do not hold the body at all
    rank = numerical_rank(block)
    if rank == len(own):
        return False
    spin = np.linalg.svd(block)[2][rank:]
    driven = np.abs(spin @ moments[own]).max(initial=0.0) > _NOTHING * max(1.0, np.abs(moments).max(initial=0.0))
    falls = np.abs(spin @ weight[own]).max() > _NOTHING * max(1.0, np.abs(weight).max(initial=0.0))
    return not driven and not falls
