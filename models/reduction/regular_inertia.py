"""Reduced inertias that are singular: some motion of the joints has no kinetic energy."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import InertiaError
from linkplan.models.tree.joints import Joint, where

# M_r, scaled to a unit diagonal, is singular if its least eigenvalue is below this. Accelerations would have less than four
# correct digits; rounding leaves 1e-16.
_SINGULAR_EIGENVALUE = 1e-12


def is_regular(inertia: np.ndarray) -> np.ndarray:
    """Return a mask (...) of the reduced inertias (..., n_s, n_s) that are finite and positive definite beyond rounding."""
    diagonal = np.diagonal(inertia, axis1=-2, axis2=-1)
    usable = np.asarray(np.isfinite(inertia).all(axis=(-2, -1)) & (diagonal > 0).all(axis=-1))
    scale = np.sqrt(np.where(usable[..., None], diagonal, 1.0))
    scaled = np.where(usable[..., None, None], inertia, np.eye(inertia.shape[-1])) / (
        scale[..., :, None] * scale[..., None, :]
    )
    try:  # a Cholesky factor of all exists if all are regular, in a tenth of the time of their eigenvalues
        np.linalg.cholesky(scaled - _SINGULAR_EIGENVALUE * np.eye(inertia.shape[-1]))
        return usable
    except np.linalg.LinAlgError:
        return usable & (np.linalg.eigvalsh(scaled)[..., 0] > _SINGULAR_EIGENVALUE)


def without_inertia(inertia: np.ndarray) -> list[int]:
    """Return the coordinates with a large part in the motion without kinetic energy of a singular inertia (n_s, n_s)."""
    diagonal = inertia.diagonal()
    bad = ~np.isfinite(inertia).all(axis=1) | ~(diagonal > 0)
    if bad.any():
        return np.flatnonzero(bad).tolist()
    scale = np.sqrt(diagonal)
    share = np.abs(np.linalg.eigh(inertia / np.outer(scale, scale))[1][:, 0])
    return np.flatnonzero(share >= 0.1 * share.max()).tolist()


def singular_inertia_text(joints: Sequence[Joint], inertia: np.ndarray) -> str:
    """Return a clause that names the independent joints (n_s,) that move without kinetic energy."""
    names = [joints[column].name for column in without_inertia(inertia)]
    if len(names) == 1:
        return f"joint {names[0]} moves without moving any mass"
    return f"joints {', '.join(names[:-1])} and {names[-1]} move together without moving any mass"


def refuse_singular_inertia(name: str, joints: Sequence[Joint], independent: np.ndarray, dynamics, pose: np.ndarray) -> None:
    """Refuse a mechanism whose reduced inertia is singular at its home pose (n_q,).

    Raises:
        InertiaError: if it is singular; the message names the coordinates that move without kinetic energy.
    """
    inertia = np.array(dynamics.reduced_inertia(pose))
    if len(inertia) == 0 or is_regular(inertia):
        return
    of = [joints[index] for index in independent]
    raise InertiaError(
        f"mechanism '{name}' has a singular inertia at home ({where(of, pose[independent])}):"
        f" {singular_inertia_text(of, inertia)}, so that no effort fixes their acceleration. Give a joint an armature or its"
        " bodies mass off its axis; remove all but one of several joints on one axis; or choose another home pose, if axes"
        " coincide at this pose only",
        len(inertia),
    )
