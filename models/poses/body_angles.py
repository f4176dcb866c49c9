"""Angles of bodies: the orientation of a body that only turns about one axis, as the sum of its hinges' angles.

Between the world and the body there are hinges about parallel axes, and slides. The body's angle is

    theta = sum over these hinges of sigma_j q_j,

with sigma_j = 1 where a hinge's axis points like that of the first one, next to the world, and -1 where it points the other
way. Theta is 0 where all of these hinges are at 0. It is linear in q, so it counts whole turns. In a planar mechanism every
body has one.
"""

import functools

import mujoco
import numpy as np

from linkplan.models.closure.rank import FILE_ROUNDING_SHARE
from linkplan.models.errors import ModelError, choose
from linkplan.models.kinematics import data_at, joints_of, path_to
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.coordinates import BALL, FREE, HINGE, joint_label


def body_index(model: mujoco.MjModel, name: str, what: str, error: type[Exception] = ModelError) -> int:
    """Return a body's index by name.

    Raises:
        error: if there is no such body; the message contains `what` and lists the bodies.
    """
    names = [model.body(body).name for body in range(1, model.nbody)]
    return int(model.body(choose(f"body in {what}", name, filter(None, names), error)).id)


@functools.lru_cache(maxsize=64)
def turning(mechanism: Mechanism, body: int, what: str, error: type[Exception] = ModelError) -> np.ndarray:
    """Return the coefficients sigma (n_q,) of a body's angle, each 1, -1 or 0.

    Args:
        mechanism: the mechanism.
        body: the body's index in its model.
        what: the key that asks for the angle, for messages.
        error: what is raised if the body has no angle.

    Raises:
        error: if no hinge turns the body, or if it turns about several axes.
    """
    model, label = mechanism.model, f"{what} of body '{mechanism.model.body(body).name}'"
    chain = [joint for one in path_to(model, body) for joint in joints_of(model, one)]
    for joint in chain:
        if int(model.jnt_type[joint]) in (BALL, FREE):
            kind = "ball" if int(model.jnt_type[joint]) == BALL else "free"
            raise error(f"{label}: it has no single angle, since {kind} joint '{joint_label(model, joint)}' turns it")
    hinges = [joint for joint in chain if int(model.jnt_type[joint]) == HINGE]
    if not hinges:
        raise error(f"{label}: it has no angle, since no hinge turns it")
    axes = np.array(data_at(model).xaxis)[hinges]
    for joint, axis in zip(hinges, axes, strict=True):
        if np.linalg.norm(np.cross(axes[0], axis)) > FILE_ROUNDING_SHARE:
            first, other = (joint_label(model, j) for j in (hinges[0], joint))
            raise error(f"{label}: it has no single angle, since hinges '{first}' and '{other}' are not parallel")
    sigma = np.zeros(mechanism.n_q)
    for joint, axis in zip(hinges, axes, strict=True):
        sigma[mechanism.joint_index(joint_label(model, joint))] = np.sign(axis @ axes[0])
    sigma.flags.writeable = False
    return sigma


@functools.lru_cache(maxsize=16)
def turning_bodies(mechanism: Mechanism) -> dict[str, np.ndarray]:
    """Return the coefficients sigma (n_q,) by name of the bodies whose angle is the sum of two or more hinges' angles.

    Bodies that are fixed in their parent are left out.
    """
    found = {}
    for body in range(1, mechanism.model.nbody):
        name = mechanism.model.body(body).name
        if not name or not mechanism.model.body_jntnum[body]:
            continue
        try:
            sigma = turning(mechanism, body, "the angle")
        except ModelError:
            continue
        if np.count_nonzero(sigma) > 1:
            found[name] = sigma
    return found


def sum_text(mechanism: Mechanism, sigma: np.ndarray) -> str:
    """Return the sum that is a body's angle as text, such as "hip - knee"."""
    terms = [("-" if sigma[j] < 0 else "+", mechanism.joints[j].name) for j in np.flatnonzero(sigma)]
    return " ".join(f"{sign} {name}" for sign, name in terms).removeprefix("+ ")
