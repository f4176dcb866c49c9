"""The joints that a first motion locks: on stops, held by dry friction, and the spins of rods."""

import mujoco
import numpy as np

from linkplan.models.closure.rank import FILE_ROUNDING_SHARE, ROUNDING_SHARE
from linkplan.models.foreign.rod_spins import spin_refusal
from linkplan.models.kinematics import data_at, rod_line
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import RANGE_ROUNDING, demanded, sliding_friction
from linkplan.models.poses.assembly import in_loops
from linkplan.models.poses.contacts import contact_pairs
from linkplan.models.poses.reach import reach
from linkplan.models.tree.coordinates import joint_label
from linkplan.models.tree.joints import unit_steps
from linkplan.studies.check.drives import pressed_joints, sprung_stops
from linkplan.studies.check.new.hanging import driven_at_home, hanging_columns, is_equilibrium, least_energy_pose

# An effort of this multiple of the holding effort at home also suffices in motion: the rest accelerates the joints, or
# resists the motion of others.
HOLD_MULTIPLE = 2.0


def pressed(mechanism: Mechanism) -> dict[str, float]:
    """Return the positions [deg or m] of the hinges and slides that rest on their stops, by name."""
    resting = [*pressed_joints(mechanism), *sprung_stops(mechanism)]
    return {joint.name: joint.shown(x) + 0.0 for joint, x in resting if joint.chart is None}


def fixed_by_range(mechanism: Mechanism) -> dict[str, float]:
    """Return the midpoint [deg or m] of each range of zero width by joint: some authors fix joints this way.

    Such a range is at most a thousandth of a radian or of the mechanism's size wide. Joints of loops are not locked.
    """
    columns = np.flatnonzero(~in_loops(mechanism))
    joints = [mechanism.joints[index] for index in mechanism.independent[columns].tolist()]
    spans = np.array([joint.upper - joint.lower for joint in joints]) / unit_steps(joints, mechanism.extent_m)
    fixed = [joint for joint, span in zip(joints, spans, strict=True) if joint.chart is None and span < 1e-3]
    return {joint.name: joint.shown(0.5 * (joint.lower + joint.upper)) for joint in fixed}


def held_by_friction(mechanism: Mechanism) -> dict[str, float]:
    """Return the home positions [deg or m] of the undriven joints that dry friction holds over their whole reach, by name.

    Half of the friction must hold weight and springs; the other half resists the motion of other joints.
    """
    held: dict[str, float] = {}
    for column in hanging_columns(mechanism):
        joint = mechanism.independent_joints[column]
        if joint.chart is not None or not sliding_friction(mechanism, mechanism.home[None], column).any():
            continue
        poses = reach(mechanism, column).poses_once
        still = np.zeros((len(poses), mechanism.dof))
        needed = np.abs(demanded(mechanism, poses, still, still)[0][:, column])
        if np.all(HOLD_MULTIPLE * needed <= sliding_friction(mechanism, poses, column)):
            held[joint.name] = joint.shown(float(mechanism.home[mechanism.independent[column]])) + 0.0
    return held


def dropped(mechanism: Mechanism) -> dict[str, float]:
    """Return the home positions [deg or m] of the undriven joints that weight drops onto stops or into contact, by name.

    An example is the boom of a hopper that stands on its foot: without the ground's force it has no pose at rest.
    """
    home, dropped_joints = mechanism.home, {}
    hanging = hanging_columns(mechanism)
    if not hanging or is_equilibrium(mechanism, home):
        return dropped_joints
    if (pose := least_energy_pose(mechanism, home, driven_at_home(mechanism))) is None:
        return dropped_joints
    before, after = ({pair.bodies for pair in contact_pairs(mechanism, place[None])} for place in (home, pose))
    for index in mechanism.independent[hanging].tolist():
        joint, x, falls_to = mechanism.joints[index], float(home[index]), float(pose[index])
        stopped = min(joint.upper - falls_to, falls_to - joint.lower) < RANGE_ROUNDING
        if joint.chart is None and abs(falls_to - x) > RANGE_ROUNDING and (stopped or after - before):
            dropped_joints[joint.name] = joint.shown(x) + 0.0
    return dropped_joints


def spins(mechanism: Mechanism) -> dict[str, float]:
    """Return the home positions [deg or m] of the independent hinges about which undriven rods and wheels spin, by name."""
    swings = [k for k in hanging_columns(mechanism) if _is_spin(mechanism, k) or _is_wheel(mechanism, k)]
    spins = [*_passive_columns(mechanism), *swings]
    joints = {int(mechanism.independent[column]): mechanism.independent_joints[column] for column in sorted(spins)}
    return {
        joint.name: joint.shown(float(mechanism.home[index]))
        for index, joint in joints.items()
        if joint.chart is None and joint.kind == "hinge"
    }


def _is_wheel(mechanism: Mechanism, column: int) -> bool:
    """Tell if the bodies on a hinge outside loops are balanced like a wheel, to a hundredth of their radius of gyration."""
    model, joint = mechanism.model, mechanism.independent_joints[column]
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint.name)
    if number < 0 or joint.kind != "hinge" or in_loops(mechanism)[column]:
        return False
    data, body, dof = data_at(model, mechanism.qpos_of(mechanism.home)), model.jnt_bodyid[number], model.jnt_dofadr[number]
    arm = np.cross(data.xaxis[number], data.subtree_com[body] - data.xanchor[number])
    inertia = model.dof_M0[dof] - model.dof_armature[dof]
    return bool(model.body_subtreemass[body] * arm @ arm <= 1e-4 * inertia)


def _passive_columns(mechanism: Mechanism) -> list[int]:
    return np.flatnonzero(np.isin(mechanism.independent, mechanism.passive_dofs)).tolist()


def rods_on_balls(mechanism: Mechanism) -> list[str]:
    """Return the ball joints of rods that spin about their own lines and whose spins can be locked, by name.

    The coordinate of a rod's spin may be an angle of another ball joint, so the bodies determine which rod spins.
    """
    model, rods = mechanism.model, []
    lines = {j: rod_line(model, j) for j in range(model.njnt) if spin_refusal(model, j) is None}
    data = data_at(model, mechanism.qpos_of(mechanism.home))
    for column in _passive_columns(mechanism):
        rates = np.array(mechanism.dynamics.velocity_map(mechanism.home))[:, column]
        data.qvel[:] = mechanism.qvel_of(mechanism.home, rates)
        mujoco.mj_comVel(model, data)
        least = FILE_ROUNDING_SHARE * np.abs(data.cvel[:, :3]).max()
        for j, line in lines.items():
            body = int(model.jnt_bodyid[j])
            turn = data.xmat[body].reshape(3, 3).T @ data.cvel[body, :3]
            if line is not None and np.linalg.norm(turn) > least > np.linalg.norm(np.cross(turn, line)):
                rods.append(joint_label(model, j))
    return list(dict.fromkeys(rods))


def _is_spin(mechanism: Mechanism, column: int) -> bool:
    """Tell if all bodies that an independent coordinate of a loop moves at home turn about one line, like a single rod.

    Bodies of less than a thousandth of the moving mass, as the crosses of universal joints, do not count.
    """
    if not in_loops(mechanism)[column]:
        return False
    model = mechanism.model
    data = data_at(model, mechanism.qpos_of(mechanism.home))
    qvel = mechanism.qvel_of(mechanism.home, np.array(mechanism.dynamics.velocity_map(mechanism.home))[:, column])
    rows, twists = np.zeros((6, model.nv)), np.zeros((model.nbody, 6))
    for body in range(1, model.nbody):
        mujoco.mj_jac(model, data, rows[:3], rows[3:], np.zeros(3), body)  # of the point at the world's origin
        twists[body] = rows @ qvel
    moves = np.abs(twists).max(axis=1) > ROUNDING_SHARE * np.abs(twists).max()
    heavy = twists[moves & (model.body_mass > 1e-3 * model.body_mass[moves].sum())]
    speed, turn = heavy[0, :3], heavy[0, 3:]
    same = np.abs(heavy - heavy[0]).max() < ROUNDING_SHARE * np.abs(heavy).max()
    about = abs(float(speed @ turn)) <= ROUNDING_SHARE * np.linalg.norm(turn) * np.linalg.norm(speed)  # no sliding
    return bool(same and about and turn.any())
