"""The closure gap that MuJoCo's soft loops have while a mechanism is held at home, or moves along a plan."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.period import travel_scales
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.plan.plan import Plan
from linkplan.studies.check.softness import STIFF_KEY, loaded_closures, weight_load

# With a larger gap the simulated mechanism differs from the planned one. At rest the gap is a share of the mechanism's
# extent or an angle [rad], in a motion a share of the travel.
SOFT_GAP = 0.01
SOFT_IN_MOTION = (
    "in simulation, the motion's efforts would open the model's loops by more than 1 % of the joints' travel: they are made"
    f" as stiff as the timestep permits ({STIFF_KEY})"
)


def home_gap(mechanism: Mechanism) -> float:
    """Return the largest closure gap in MuJoCo while the drives hold the weight at home; 0 without loops or drives.

    The gap is a share of the mechanism's extent, or an angle [rad].
    """
    if not mechanism.closures or not mechanism.n_u or not mechanism.dof:
        return 0.0
    return weight_load(mechanism).gap_m / mechanism.extent_m


def planned_gap(plan: Plan) -> float:
    """Return the largest closure gap in MuJoCo, as `home_gap` does, at instants along a plan; 0 without loops."""
    mechanism, trajectory = plan.problem.mechanism, plan.trajectory
    if not mechanism.closures:
        return 0.0
    times = 0.5 * (trajectory.breaks_s[1:] + trajectory.breaks_s[:-1])
    poses = follow(mechanism, trajectory.position_at(times), trajectory.start_pose)
    motion = trajectory.velocity_at(times), trajectory.acceleration_at(times), trajectory.effort_at(times)
    gaps = (loaded_closures(mechanism, *instant).gap_m for instant in zip(poses, *motion, strict=True))
    return max(gaps) / mechanism.extent_m


def travel(plan: Plan) -> float:
    """Return the largest travel of an independent joint along a plan: an angle [rad], or a slide's share of the extent.

    For a motor behind a gear or screw it is approximately the travel of the driven part.
    """
    mechanism, position = plan.problem.mechanism, plan.require_motion("measure").position
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m) * travel_scales(mechanism)
    return float(np.max(np.ptp(position, axis=(0, 1)) / unit, initial=0.0))
