"""The closure gap that MuJoCo's soft loops have while a mechanism is held at home, or moves along a plan.

With J the rows of the equality constraints, the constraint force f of a motion follows from J^T f = M q'' + h - tau.
MuJoCo's law J q'' + R f = -K d r, in which J q'' is small, gives the gap r (`linkplan.studies.check.softness`).
"""

import mujoco
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.felt_inertia import equality_rows
from linkplan.models.poses.period import travel_scales
from linkplan.models.tree.joints import unit_steps
from linkplan.models.tree.passive import simulated_gas_springs
from linkplan.planner.plan import Plan
from linkplan.studies.check.softness import STIFF_KEY, steady_gap

# A larger gap is another mechanism than the planned one: a share of the mechanism's extent or an angle [rad] at rest, and a
# share of the travel in a motion.
SOFT_GAP = 0.01
SOFT_IN_MOTION = (
    "the model's own loops are too soft for the motion's efforts, which would open them by more than 1 % of what the joints"
    f" travel in simulation: they are as stiff as its timestep admits ({STIFF_KEY})"
)


def held_gap(mechanism: Mechanism) -> float:
    """Return the largest closure gap in MuJoCo while the drives hold the weight at home; 0 without loops or drives.

    The gap is a share of the mechanism's extent, or an angle [rad].
    """
    if not mechanism.closures or not mechanism.n_u or not mechanism.dof:
        return 0.0
    still = np.zeros(mechanism.dof)
    hold = needed_effort(mechanism, mechanism.home[None], still[None], still[None])[0][0]
    return _gap(mechanism, mechanism.home, still, still, hold)


def planned_gap(plan: Plan) -> float:
    """Return the largest closure gap in MuJoCo, as `held_gap` does, at instants along a plan; 0 without loops."""
    mechanism, trajectory = plan.problem.mechanism, plan.trajectory
    if not mechanism.closures:
        return 0.0
    times = 0.5 * (trajectory.breaks_s[1:] + trajectory.breaks_s[:-1])
    poses = follow(mechanism, trajectory.position_at(times), trajectory.start_pose)
    motion = trajectory.velocity_at(times), trajectory.acceleration_at(times), trajectory.effort_at(times)
    return max(_gap(mechanism, *instant) for instant in zip(poses, *motion, strict=True))


def travel(plan: Plan) -> float:
    """Return the largest travel of an independent joint along a plan: an angle [rad], or a slide's share of the extent.

    For a motor behind a gear or screw it is about that of what it drives.
    """
    mechanism, position = plan.problem.mechanism, plan.require_motion("measure").position
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m) * travel_scales(mechanism)
    return float(np.max(np.ptp(position, axis=(0, 1)) / unit, initial=0.0))


def _gap(mechanism: Mechanism, pose: np.ndarray, speed: np.ndarray, acceleration: np.ndarray, effort: np.ndarray) -> float:
    """Return the largest gap at a pose (n_q,) with independent speeds and accelerations (n_s,) under efforts (n_u,).

    The dependent joints' accelerations are those at low speeds, Gamma s''.
    """
    model = mechanism.model
    data, gamma = mujoco.MjData(model), np.array(mechanism.dynamics.velocity_map(pose))
    data.qpos[:], data.qvel[:] = mechanism.qpos_of(pose), mechanism.qvel_of(pose, gamma @ speed)
    mujoco.mj_forward(model, data)
    rows, free = equality_rows(model, data)
    springs = data.qfrc_passive + simulated_gas_springs(model, data)
    pushed = rows @ free @ (springs - data.qfrc_bias + _joint_efforts(mechanism, pose, effort))
    pushed -= rows @ mechanism.qvel_of(pose, gamma @ acceleration)
    force = np.linalg.lstsq(rows @ free @ rows.T, -pushed, rcond=ROUNDING_SHARE)[0]
    stiffness, _, impedance, _ = data.efc_KBIP.reshape(-1, 4)[: data.ne].T
    push = np.abs(force) * data.efc_R[: data.ne] * impedance / (1 - impedance)
    laws = zip(push, stiffness, model.eq_solimp[data.efc_id[: data.ne]], strict=True)
    gap = np.array([steady_gap(*law) for law in laws])
    return float(np.max(gap * _lengths(mechanism, data), initial=0.0)) / mechanism.extent_m


def _joint_efforts(mechanism: Mechanism, pose: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Return the forces (nv,) on MuJoCo's degrees of freedom by the actuators' efforts (n_u,) at a pose (n_q,)."""
    on_joints = np.array(mechanism.dynamics.effort_matrix(pose)).reshape(mechanism.n_q, -1) @ effort
    units = np.array([mechanism.qvel_of(pose, unit) for unit in np.eye(mechanism.n_q)])
    return units.T @ on_joints


def _lengths(mechanism: Mechanism, data: mujoco.MjData) -> np.ndarray:
    """Return the gap [m] of one unit of each equality row; of a weld's rows the first three are lengths, others angles."""
    owner = np.array(data.efc_id[: data.ne])
    number = np.array([np.sum(owner[:k] == owner[k]) for k in range(data.ne)], dtype=int)
    scale = {closure.index: closure.scale for closure in mechanism.closures if closure.kind in ("joint", "tendon")}
    angle = (mechanism.model.eq_type[owner] == mujoco.mjtEq.mjEQ_WELD) & (number >= 3)
    return np.where(angle, mechanism.extent_m, [scale.get(int(index), 1.0) for index in owner])
