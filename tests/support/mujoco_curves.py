"""One degree of freedom's equation of motion by MuJoCo alone: poses by Newton's method on its own constraint rows."""

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from tests.support.least_time import Curves

_POSES = 2001
_ITERATIONS, _CLOSED_M = 30, 1e-13
_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Poses:
    """Closed poses (n, n_q) at places (n,) of the first joint, their slopes, and the least singular value by the way.

    `clear` (n,) is the least singular value of the loops' derivative by the joints that follow, over its size at home.
    """

    place: np.ndarray
    q: np.ndarray
    slope: np.ndarray
    clear: np.ndarray


def closed_poses(model: mujoco.MjModel, start: float, goal: float) -> Poses | None:
    """Return poses from one place of joint 0 to another, begun at home; None where the loops do not close on the way."""
    model.opt.jacobian = int(mujoco.mjtJacobian.mjJAC_DENSE)
    data = mujoco.MjData(model)
    place = np.linspace(start, goal, _POSES)
    begin = _carried(model, data, np.array(model.qpos0), np.linspace(0.0, start, 201))
    if begin is None:
        return None
    found = _carried(model, data, begin[0][-1], place)
    if found is None:
        return None
    home = _rows(model, data, np.array(model.qpos0))[1]
    least = np.linalg.svd(home[:, 1:], compute_uv=False)[_rank(model)]
    return Poses(place=place, q=found[0], slope=found[1], clear=found[2] / least)


def curves_of_poses(model: mujoco.MjModel, poses: Poses) -> Curves:
    """Return M a = still + square v^2 + linear v + effort u along the poses, of an MJCF with a motor on joint 0."""
    data = mujoco.MjData(model)
    n = len(poses.place)
    inertia, still, linear = np.empty(n), np.empty(n), np.empty(n)
    full = np.empty((model.nv, model.nv))
    for k in range(n):
        way = poses.slope[k]
        data.qpos[:], data.qvel[:] = poses.q[k], 0.0
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia[k] = way @ full @ way
        still[k] = way @ (data.qfrc_passive - data.qfrc_bias)
        data.qvel[:] = way
        mujoco.mj_fwdVelocity(model, data)
        linear[k] = way @ data.qfrc_damper
    order = slice(None, None, 1 if poses.place[-1] > poses.place[0] else -1)
    M, h, c = (CubicSpline(poses.place[order], values[order]) for values in (inertia, still, linear))
    d, gear = CubicSpline(M.x, -0.5 * M.derivative()(M.x)), float(model.actuator_gear[0, 0])
    return Curves(inertia=M, effort=lambda s: gear * np.ones_like(s), still=h, square=d, linear=c)


def _rows(model: mujoco.MjModel, data: mujoco.MjData, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much loops gape at a pose [m], and the derivative of that."""
    data.qpos[:] = q
    mujoco.mj_fwdPosition(model, data)
    ours = data.efc_type == _EQUALITY
    return data.efc_pos[ours].copy(), data.efc_J.reshape(-1, model.nv)[ours].copy()


def _rank(model: mujoco.MjModel) -> int:
    return model.nv - 2  # of the joints that follow, the last singular value


def _carried(model, data, q: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    q, before, found = q.copy(), q[0], []
    slope = np.zeros(model.nv)
    for place in places:
        q = q + slope * (place - before)
        q[0], before = place, place
        for _ in range(_ITERATIONS):
            gap, J = _rows(model, data, q)
            if np.abs(gap).max() < _CLOSED_M:
                break
            q[1:] -= np.linalg.lstsq(J[:, 1:], gap, rcond=1e-9)[0]
        else:
            return None
        slope = np.append(1.0, -np.linalg.lstsq(J[:, 1:], J[:, 0], rcond=1e-9)[0])
        found.append((q.copy(), slope, np.linalg.svd(J[:, 1:], compute_uv=False)[_rank(model)]))
    return tuple(np.array(one) for one in zip(*found, strict=True))
