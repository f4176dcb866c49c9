"""The part of `make bench` on the closed loop: a tracked run beside raw MuJoCo steps."""

import mujoco

from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate_one
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker, tracking_reference
from linkplan.studies.output.text import table
from tests.bench.timing import median_s, say


def bench_loop() -> str:
    """Return the time of a tracked run over that of the same number of raw MuJoCo steps."""
    say("closed loop")
    plan = plan_motion(load_problem("knee-sine"))
    mechanism, reference = plan.problem.mechanism, tracking_reference(plan)
    data = mujoco.MjData(mechanism.model)
    raw = median_s(lambda: [mujoco.mj_step(mechanism.model, data) for _ in range(reference.n)], 3)
    rows, machine = [], MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=plan.problem.limits.effort))
    for name in ("pd", "pd+ff", "lqr"):
        tracker = build_tracker(name, plan, reference)
        loop = median_s(lambda tracker=tracker: simulate_one(machine, tracker, reference), 3)
        rows.append([name, 1e3 * loop, loop / raw])
    return table([f"{reference.n} periods", "median [ms]", "over raw mj_step"], rows)
