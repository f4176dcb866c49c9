"""The pace of a first motion: its duration, and feedback gains that the model's own simulation can follow."""

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.equilibrium import sprung_freedoms
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.problem.problem import Problem
from linkplan.studies.new.hanging import GRAVITY_M_S2, driven_columns, hanging_columns


def moderate_duration(problem: Problem) -> tuple[float, bool]:
    """Return a duration [s] in two digits, and True if only the model's own simulation makes it that long.

    It is some times the shortest one on a smooth path, so that the efforts are moderate.

    With hanging joints it is at least two swings of a pendulum of the mechanism's size, else at least 0.1 s. The model's own
    simulation must be able to follow it.
    """
    mechanism = problem.mechanism
    shortest = first_guess(problem, problem.start_pose()).duration_s
    swing = 2 * np.pi * np.sqrt(mechanism.extent_m / GRAVITY_M_S2)
    least = 2 * swing if hanging_columns(mechanism) else 0.1
    longer = 4 if sprung_freedoms(mechanism) else 2  # quick motions let undriven springs ring
    followed = _eight_cycles(_fastest_feedback(problem))
    moderate = max(longer * shortest, least)
    return float(f"{max(moderate, followed):.2g}"), followed > moderate


def _eight_cycles(given: float) -> float:
    """Return the duration [s] of eight cycles of a frequency [rad/s], or the frequency of eight cycles in a duration."""
    return 8 * 2 * np.pi / given


def _fastest_feedback(problem: Problem) -> float:
    """Return the largest natural frequency [rad/s] of tracking errors that the model's own simulation admits.

    A PD law sampled with period T is stable up to about kd = 2 J / T: a fifth of that gives omega = 0.2 / T. A soft closure
    with time constant tau (solref, at least two timesteps) has the natural frequency 1 / tau: twice that is followed.
    """
    mechanism = problem.mechanism
    time_constants = [2 * float(mechanism.model.opt.timestep)]
    for index in dict.fromkeys(closure.index for closure in mechanism.closures):
        first = float(mechanism.model.eq_solref[index, 0])
        time_constants.append(first if first >= 0 else (-first) ** -0.5)  # MuJoCo reads a negative number as a stiffness
    return min(0.2 / problem.tracking.period_s, 2 / max(time_constants))


def critical_gains(mechanism: Mechanism, problem: Problem, duration: float) -> dict:
    """Return PD gains for a duration: critically damped with the inertia at the start, zero for undriven coordinates.

    The natural frequency has eight cycles in the duration, or fewer if the simulation admits no feedback that quick.
    """
    inertia = felt_inertia(mechanism, problem.start_pose())
    inertia = np.where(np.isin(np.arange(mechanism.dof), driven_columns(mechanism)), inertia, 0.0)
    frequency = min(_eight_cycles(duration), _fastest_feedback(problem))
    gains = {"kp": inertia * frequency**2, "kd": 2 * inertia * frequency}
    names = [joint.name for joint in mechanism.independent_joints]
    found = {key: [float(f"{value:.2g}") for value in values] for key, values in gains.items()}
    return {key: v[0] if len(v) == 1 else dict(zip(names, v, strict=True)) for key, v in found.items()}


def felt_inertia(mechanism: Mechanism, pose: np.ndarray) -> np.ndarray:
    """Return what the model's own simulation lets a force on each independent coordinate accelerate (n_s,) [kg.m2 or kg].

    All other coordinates are free, as between two control instants. Loops that are closed exactly leave 1 / (M^-1)_ii.
    Behind a soft loop, a drive at first moves little more than its own link, and feedback for the whole leg would be
    unstable. With the rows J and the regularisation R of MuJoCo's equality constraints, a force f accelerates by
    (M^-1 - M^-1 J^T (J M^-1 J^T + R)^-1 J M^-1) f (MuJoCo, "Computation", constraint model).
    """
    model = mechanism.model
    data = mujoco.MjData(model)
    data.qpos[:] = mechanism.qpos_of(pose)
    mujoco.mj_forward(model, data)
    rows, free = equality_rows(model, data)
    held = free @ rows.T @ np.linalg.solve(rows @ free @ rows.T + np.diag(data.efc_R[: data.ne]), rows @ free)
    found = np.empty(mechanism.dof)
    for column, index in enumerate(mechanism.independent.tolist()):
        unit = np.zeros(mechanism.n_q)
        unit[index] = 1.0
        found[column] = 1.0 / mechanism.rates_of(pose, (free - held) @ mechanism.qvel_of(pose, unit))[index]
    return found


def equality_rows(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows J (n, nv) of MuJoCo's equality constraints, and M^-1 (nv, nv), at the pose of a forward pass."""
    mass, rows = np.zeros((model.nv, model.nv)), np.zeros((data.nefc, model.nv))
    mujoco.mj_fullM(model, data, mass)
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(rows, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    else:
        rows[:] = data.efc_J.reshape(rows.shape)
    return rows[: data.ne], np.linalg.inv(mass)


def is_large(mechanism: Mechanism) -> bool:
    """Tell if a mechanism has the size of a robot's leg, or loops solved by all rows: each digit then costs seconds."""
    return mechanism.n_q > 10 or mechanism.dof > 5 or bool(mechanism.projected)


def many_hang(mechanism: Mechanism) -> bool:
    """Tell if several joints hang, so that a motion excites several swings at once."""
    return len(hanging_columns(mechanism)) > 1
