"""Problems of arms whose sites have places to go to and to stay in, and where sites are along plans, by MuJoCo."""

import copy
from functools import cache

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.arms import arm

# Past the hip from above to below it: the shortest way leads through a place that walls may keep clear of.
ABOVE, BELOW = [0.3, 0.0, 0.35], [0.3, 0.0, -0.35]


@cache
def arm_of(*lengths: float) -> Mechanism:
    """Return an arm, loaded once."""
    return load_mechanism(arm(*lengths))


def site_problem(mechanism: Mechanism, motion: dict, site: dict | None = None, **tables: dict) -> Problem:
    """Return the problem of a reach, of limits.site where they are given, and of other tables of a file."""
    said = {"motion": {"kind": "reach", **motion}, "limits": {}, **tables}
    if site is not None:
        said["limits"] = {**said["limits"], "site": site}
    return Problem.from_tables("sites", copy.deepcopy(said), mechanism=mechanism)


def plan_of(mechanism: Mechanism, motion: dict, site: dict | None = None, **tables: dict) -> Plan:
    """Return the plan of such a problem after making sure that it is one."""
    plan = plan_motion(site_problem(mechanism, motion, site, **tables))
    assert plan.status == "optimal", plan.message
    return plan


def places_along(plan: Plan, site: str = "foot", per_interval: int = 40) -> np.ndarray:
    """Return where MuJoCo has a site (n, 3) [m] along a plan, close together between its nodes, both ends included."""
    mechanism, motion = plan.problem.mechanism, plan.trajectory
    poses = follow(mechanism, motion.position_at(motion.dense_times(per_interval)), motion.start_pose)
    data, found = mujoco.MjData(mechanism.model), []
    for qpos in mechanism.qpos_of(poses):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(mechanism.model, data)
        found.append(np.array(data.site_xpos[mechanism.model.site(site).id]))
    return np.array(found)
