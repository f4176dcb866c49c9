"""Least times of one coordinate under limits on efforts, accelerations and speeds, as a program over a grid in (s, s'^2).

The unknowns are x = s'^2 at the ends of cells. In a cell s'' = dx / (2 ds) is constant, and limits hold at its middle. The
time is the sum of 2 ds / (s' + s''): x is linear in s, so rests at the ends are exact. Inertia, weight and places come from
MuJoCo, and derivatives from splines. At a rest the error of a cell is a share of its time, so the error falls with the power
1.5 of the cells' width (measured).
"""

import casadi as ca
import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from linkplan.models.poses.assembly import follow
from linkplan.planner.problem.problem import Problem

_POSES = 4001


def least_time_on_grid(problem: Problem, n_cells: int) -> float:
    """Return the least time [s] of a reach from rest to rest that does not turn back, extrapolated from two grids."""
    coarse, fine = (_least_time(problem, n) for n in (n_cells, 2 * n_cells))
    return fine + (fine - coarse) / (2**1.5 - 1)


def _curves(problem: Problem) -> dict[str, CubicSpline]:
    """Return splines over s of poses, places of sites (n, 3 n_sites), inertia, potential energy and damping."""
    mechanism, model = problem.mechanism, problem.mechanism.model
    data = mujoco.MjData(model)
    start, goal = float(problem.motion.start[0]), float(problem.motion.goal[0])
    s = np.linspace(start, goal, _POSES)
    q = follow(mechanism, s[:, None], problem.start_pose())
    order = slice(None, None, 1 if goal > start else -1)
    poses = CubicSpline(s[order], q[order])
    rates, sites, values = poses(s, 1), [], []
    for pose, rate in zip(q, rates, strict=True):
        data.qpos[:], data.qvel[:] = pose, 0.0
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        sites.append(data.site_xpos.ravel().copy())
        values.append((rate @ inertia @ rate, data.energy[0], rate @ (model.dof_damping * rate)))
    names, columns = ("inertia", "energy", "damping"), np.array(values)[order].T
    curves = {name: CubicSpline(s[order], column) for name, column in zip(names, columns, strict=True)}
    return {"poses": poses, "sites": CubicSpline(s[order], np.array(sites)[order]), **curves}


def _least_time(problem: Problem, n_cells: int) -> float:
    mechanism, limits, curves = problem.mechanism, problem.limits, _curves(problem)
    ends = np.linspace(float(problem.motion.start[0]), float(problem.motion.goal[0]), n_cells + 1)
    way, ds, at = np.sign(ends[-1] - ends[0]), abs(ends[1] - ends[0]), 0.5 * (ends[1:] + ends[:-1])
    inner = ca.SX.sym("x", n_cells - 1)
    x = ca.vertcat(0, inner, 0)
    a, y = way * (x[1:] - x[:-1]) / (2 * ds), 0.5 * (x[1:] + x[:-1])
    rows, low, high = [], [], []

    def keep(value: ca.SX, least: float, most: float, size: float) -> None:
        rows.append(value / size)
        low.extend([least / size] * n_cells)
        high.extend([most / size] * n_cells)

    actuator = mechanism.actuators[0]
    lever = actuator.gear * curves["poses"](at, 1)[:, actuator.joint]
    inertia, slope, weight, drag = (
        curves[name](at, order) for name, order in (("inertia", 0), ("inertia", 1), ("energy", 1), ("damping", 0))
    )
    effort = (inertia * a + 0.5 * slope * y + weight + way * drag * ca.sqrt(y)) / lever
    keep(effort, *limits.effort[0], np.abs(limits.effort[0]).max())
    for joint in np.flatnonzero(np.isfinite(limits.acceleration).any(axis=1)):
        first, second = (curves["poses"](at, order)[:, joint] for order in (1, 2))
        keep(first * a + second * y, *limits.acceleration[joint], limits.acceleration[joint].max())
    for joint in np.flatnonzero(np.isfinite(limits.speed).any(axis=1)):
        keep(
            curves["poses"](at, 1)[:, joint] ** 2 * y,
            -np.inf,
            limits.speed[joint].max() ** 2,
            limits.speed[joint].max() ** 2,
        )
    for name, most in limits.site_acceleration.items():
        own = slice(3 * mechanism.model.site(name).id, 3 * mechanism.model.site(name).id + 3)
        first, second = (curves["sites"](at, order)[:, own] for order in (1, 2))
        keep(sum((first[:, k] * a + second[:, k] * y) ** 2 for k in range(3)), -np.inf, most**2, most**2)
    speed = ca.sqrt(x)
    program = {"x": inner, "f": ca.sum1(2 * ds / (speed[1:] + speed[:-1])), "g": ca.vertcat(*rows)}
    options = {"print_time": 0, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "max_iter": 500}}
    solver = ca.nlpsol("grid", "ipopt", program, options)
    share = np.linspace(0, 1, n_cells + 1)[1:-1]
    found = solver(x0=share * (1 - share), lbx=1e-12, ubx=np.inf, lbg=low, ubg=high)
    assert solver.stats()["success"], solver.stats()["return_status"]
    return float(found["f"])
