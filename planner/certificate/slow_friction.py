"""Motions so slow that the dry friction they are planned with falls short of the machine's."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.trajectory import Trajectory

# Instants that are looked at, and the share of Coulomb's force below which friction falls short.
_INSTANTS, _SHORT = 400, 0.9
# A joint that moves less than this [rad/s or m/s] stands still: loops hold it.
_STILL = 1e-9
# Shares of a motion below this are its start, its end and where it turns back: not worth a sentence.
SLOW_SHARE = 0.1


def slow_share(mechanism: Mechanism, trajectory: Trajectory) -> tuple[float, str] | None:
    """Return the largest share of a motion during which a joint moves too slowly for its dry friction, and the joint's name.

    Too slowly is where f tanh(v / v_0) is below nine tenths of f. None where no joint has any.
    """
    joints = [one for one in frictions_of(mechanism.model) if one.dof is not None]
    if not joints:
        return None
    time = np.linspace(trajectory.breaks_s[0], trajectory.breaks_s[-1], _INSTANTS)
    poses = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    qvel = mechanism.qvel_of(poses, joint_rates(mechanism, poses, trajectory.velocity_at(time)))
    found = []
    for one in joints:
        speed = np.abs(qvel[:, one.dof])
        fast = np.arctanh(_SHORT) * mechanism.friction_transition * (1.0 if one.turns else mechanism.extent_m)
        found.append((float(np.mean(speed < fast)) if speed.max() > _STILL else 0.0, one.name))
    return max(found)
