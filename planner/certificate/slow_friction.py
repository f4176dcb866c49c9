"""Motions so slow that the smoothed dry friction of the plan is less than the machine's."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.trajectory import Trajectory

# Slow shares of a motion below this are its start, end and turning points, and not worth a sentence.
SLOW_SHARE = 0.1


def slow_share(mechanism: Mechanism, trajectory: Trajectory) -> tuple[float, str] | None:
    """Return the largest share of a motion during which a joint moves too slowly for its dry friction, and the joint's name.

    Too slow means that f tanh(v / v_0) is below 0.9 f. None if no joint has dry friction.
    """
    joints = [one for one in frictions_of(mechanism.model) if one.dof is not None]
    if not joints:
        return None
    time = np.linspace(trajectory.breaks_s[0], trajectory.breaks_s[-1], 400)
    poses = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    qvel = mechanism.qvel_of(poses, joint_rates(mechanism, poses, trajectory.velocity_at(time)))
    found = []
    for one in joints:
        speed = np.abs(qvel[:, one.dof])
        fast = np.arctanh(0.9) * mechanism.friction_transition * (1.0 if one.turns else mechanism.extent_m)
        found.append((float(np.mean(speed < fast)) if speed.max() > 1e-9 else 0.0, one.name))  # the loops may hold the joint
    return max(found)
