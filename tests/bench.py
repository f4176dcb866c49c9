"""`make bench`: where the time of a plan goes, and what the closed loop costs beside raw MuJoCo steps.

Only ratios within one run mean anything on a shared machine; the medians beside them say what they are ratios of.
"""

import statistics
import time
from collections.abc import Callable

import mujoco

from controllers.rollout import Loop, run
from planner.certificate import certify
from planner.planning import plan_motion
from planner.problem_file import load_problem
from planner.tables import BUILT_IN
from studies.compare import build_tracker, tracking_reference
from studies.tables import table

_REPEATS = 5


def median_s(work: Callable[[], object], repeats: int = _REPEATS) -> float:
    """Return the median wall time [s] of `work` after one run to warm up."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def bench_plans() -> str:
    """Return the time of every built-in plan and the shares of building, solving and certifying in it."""
    rows = []
    for name in BUILT_IN:
        problem = load_problem(name)
        plan = plan_motion(problem)
        whole = median_s(lambda problem=problem: plan_motion(problem))
        certificate = median_s(lambda problem=problem, plan=plan: certify(problem, plan.trajectory))
        build, solve = sum(s.build_s for s in plan.history), sum(s.solve_s for s in plan.history)
        rows.append([name, 1e3 * whole, 100 * build / whole, 100 * solve / whole, 100 * certificate / whole])
    return table(["plan", "median [ms]", "build [%]", "solve [%]", "certificate [%]"], rows)


def bench_loop() -> str:
    """Return the time of a tracked run over that of the same number of raw MuJoCo steps."""
    plan = plan_motion(load_problem("knee-sine"))
    mechanism, reference = plan.problem.mechanism, tracking_reference(plan)
    data = mujoco.MjData(mechanism.model)
    raw = median_s(lambda: [mujoco.mj_step(mechanism.model, data) for _ in range(reference.n)])
    rows = []
    for name in ("pd", "pd+ff", "lqr"):
        tracker = build_tracker(name, plan, reference)
        loop = median_s(
            lambda tracker=tracker: run(mechanism, reference, tracker, Loop(effort_limit=plan.problem.limits.effort))
        )
        rows.append([name, 1e3 * loop, loop / raw])
    return table([f"{reference.n} periods", "median [ms]", "over raw mj_step"], rows)


if __name__ == "__main__":
    print(bench_plans(), bench_loop(), sep="\n\n")
