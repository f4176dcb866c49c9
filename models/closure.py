"""Loop closure: the equations phi(q) = 0 of a model's `connect` constraints, and which of them are independent.

A connect asks two body-fixed points to coincide: phi = p_world_1 - p_world_2, three rows, MuJoCo's own residual. A
planar loop has rank 2 in them, and repeated pins add rows without rank; rank and rows come from pivoted QR
(Golub & Van Loan, Matrix Computations, 5.4.2), never from counting.
"""

from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np
import scipy.linalg

from models.errors import ModelError
from models.tree import Tree

# Singular values below this share of the largest count as zero. An exact planar loop shows 1e-16; a pose within
# a millionth of a link length of singular still shows 1e-6.
RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Closure:
    """One `connect`: its name, the bodies that it ties, and its three residuals [m] as expressions of q."""

    name: str
    index: int  # of MuJoCo's equality constraint
    residual: ca.SX


def read_closures(model: mujoco.MjModel, tree: Tree) -> tuple[Closure, ...]:
    """Return the active loop closures of a model.

    Raises:
        ModelError: for an active equality constraint of another kind than `connect`.
    """
    closures = []
    off = mujoco.mjtDisableBit.mjDSBL_EQUALITY.value | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
    disabled = model.opt.disableflags & off
    for index in range(model.neq):
        if not model.eq_active0[index] or disabled:
            continue
        kind = mujoco.mjtEq(int(model.eq_type[index]))
        if kind != mujoco.mjtEq.mjEQ_CONNECT:
            raise ModelError(
                f"equality constraint '{equality_name(model, index)}' is of kind"
                f" '{kind.name.removeprefix('mjEQ_').lower()}'; the planner closes loops by 'connect' only"
            )
        closures.append(_connect(model, tree, index))
    return tuple(closures)


def equality_name(model: mujoco.MjModel, index: int) -> str:
    """Return the constraint's own name, or one made of the sites or bodies that it ties."""
    name = model.equality(index).name
    if name:
        return name
    kind = mujoco.mjtEq(int(model.eq_type[index]))
    elements = {mujoco.mjtEq.mjEQ_JOINT: model.joint, mujoco.mjtEq.mjEQ_TENDON: model.tendon}
    at_sites = int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE)
    element = elements.get(kind, model.site if at_sites else model.body)
    if kind not in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD, *elements):
        return f"equality {index}"
    tied = [int(i) for i in (model.eq_obj1id[index], model.eq_obj2id[index]) if i >= 0]
    return "-".join(element(i).name or str(i) for i in tied)


def _connect(model: mujoco.MjModel, tree: Tree, index: int) -> Closure:
    first, second = connect_ends(model, index)
    residual = tree.point(*first) - tree.point(*second)
    return Closure(name=equality_name(model, index), index=index, residual=residual)


def connect_ends(model: mujoco.MjModel, index: int) -> list[tuple[int, np.ndarray]]:
    """Return the two points that a connect ties, each as its body and its place (3,) [m] in that body's frame."""
    first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    if int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE):
        return [(int(model.site_bodyid[site]), model.site_pos[site]) for site in (first, second)]
    return [(first, model.eq_data[index, 0:3]), (second, model.eq_data[index, 3:6])]


def numerical_rank(jacobian: np.ndarray) -> int:
    """Return the rank of a matrix by its singular values."""
    if jacobian.size == 0:
        return 0
    values = np.linalg.svd(jacobian, compute_uv=False)
    return int(np.sum(values > RANK_TOLERANCE * max(values[0], np.finfo(float).tiny)))


def independent_rows(jacobian: np.ndarray, rank: int) -> np.ndarray:
    """Return the indices (rank,) of rows that span the row space, in file order."""
    if rank == 0:
        return np.zeros(0, dtype=int)
    pivots = scipy.linalg.qr(jacobian.T, mode="economic", pivoting=True)[-1]
    return np.sort(np.asarray(pivots)[:rank])


def dependent_columns(jacobian: np.ndarray, rank: int, last: list[int]) -> np.ndarray:
    """Return the columns (rank,) to solve for: a well-conditioned set that avoids those in `last` where it can.

    Gram-Schmidt with pivoting, first over the columns outside `last` and then over `last`, so that the joints in `last`
    (the actuated ones) stay independent wherever the rest can carry the loop.
    """
    work = np.array(jacobian, dtype=float)
    floor = RANK_TOLERANCE * max(np.linalg.norm(work, axis=0).max(initial=0.0), np.finfo(float).tiny)
    chosen: list[int] = []
    for group in ([c for c in range(work.shape[1]) if c not in last], list(last)):
        candidates = list(group)
        while candidates and len(chosen) < rank:
            norms = np.linalg.norm(work[:, candidates], axis=0)
            best = int(np.argmax(norms))
            if norms[best] <= floor:
                break
            column = candidates.pop(best)
            chosen.append(column)
            direction = work[:, column] / norms[best]
            work -= np.outer(direction, direction @ work)
    return np.array(sorted(chosen), dtype=int)
