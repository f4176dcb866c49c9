"""The part of `make bench` on whole plans: the time of each, of first solves and re-solves beside hand-written Opti."""

import itertools
import time
from dataclasses import replace

import numpy as np

from linkplan.planner.certificate.certificate import certify
from linkplan.planner.files.problem_file import load_problem
from linkplan.planner.files.tables import BUILT_IN
from linkplan.planner.planning import plan_motion
from linkplan.planner.replan import Planner
from linkplan.studies.output.tables import table
from tests.bench.opti_peer import build_peer
from tests.bench.timing import EXACT_TIME, GOAL, START, first_solve, median_s, over, own_cache, say


def bench_plans() -> str:
    """Return the time of every built-in plan and the shares of building, solving and certifying in it."""
    rows = []
    for name in BUILT_IN:
        say(f"plan {name}")
        problem = load_problem(name)
        plan_motion(problem)  # what is loaded once
        wall, processor = time.perf_counter(), time.process_time()
        plan = plan_motion(problem)
        certified = time.perf_counter()
        wall, processor = certified - wall, time.process_time() - processor
        certify(problem, plan.trajectory)
        certified = time.perf_counter() - certified
        build, solve = sum(s.build_s for s in plan.history), sum(s.solve_s for s in plan.history)
        shares = [100 * part / wall for part in (build, solve, certified)]
        rows.append([name, 1e3 * processor, *shares, len(plan.history)])
    head = ["plan", "processor [ms]", "build [%]", "solve [%]", "one certificate [%]", "solves"]
    return table(head, rows)


def bench_peer() -> str:
    """Return the time of building and solving beside the same problems in hand-written `casadi.Opti`, and the answers.

    Both at IPOPT tolerance 1e-10; the peer's torque between its nodes is its own quadratic's.
    """
    rows = []
    with own_cache():
        for name, duration in (("knee-reach", 0.16), ("knee-sprint", None)):
            say(f"{name} beside Opti")
            peer, exact = build_peer(40, START, GOAL, duration), EXACT_TIME.get(name)
            solution = peer.solve(GOAL)
            theirs = median_s(lambda duration=duration: build_peer(40, START, GOAL, duration).solve(GOAL))
            again = median_s(lambda peer=peer, solution=solution: peer.solve(GOAL, solution), 20)
            torque = np.array(solution.value(peer.effort)).reshape(-1)
            value = over(float(solution.value(peer.opti.f)), exact)
            rows.append([f"{name}, Opti", 1e3 * theirs, 1.0, value, between_nodes(torque)])
            rows.append([f"{name}, Opti again", 1e3 * again, again / theirs, None, None])
            for mode in ("never", "always"):
                problem = load_problem(name, [f"solver.compile={mode}"])
                plan = plan_motion(problem)
                for solver in ("ipopt", "fatrop"):
                    asked = replace(problem, solver=replace(problem.solver, name=solver))
                    ours = median_s(lambda asked=asked: first_solve(asked))
                    label = "interpreted" if mode == "never" else "compiled, cache warm"
                    row = [f"{name}, {label}, {solver}", 1e3 * ours, ours / theirs]
                    rows.append([*row, over(plan.objective, exact), float(plan.certificate.peak_effort[0])])
            for solver in ("ipopt", "fatrop"):
                asked = replace(problem, solver=replace(problem.solver, name=solver))
                planner, goals = Planner(), itertools.cycle(np.radians([55.0, 56.27]))
                planner.plan(asked)

                def solve_again(planner=planner, problem=asked, goals=goals) -> None:
                    planner.solve_again(replace(problem, motion=replace(problem.motion, goal=np.array([next(goals)]))))

                ours = median_s(solve_again, 20)
                label = f"{name}, goal changed, solved again, {solver}"
                rows.append([label, 1e3 * ours, ours / theirs, None, None])
    head = ["build and solve, 40 intervals", "median [ms]", "of Opti's", "over exact", "largest torque [N.m]"]
    return table(head, rows)


def between_nodes(torque: np.ndarray) -> float:
    """Return the largest size of the quadratics through (node, midpoint, node) values in turn."""
    tau = np.linspace(0, 1, 51)
    left, middle, right = torque[0:-2:2, None], torque[1::2, None], torque[2::2, None]
    curve = left * (1 - tau) * (1 - 2 * tau) + 4 * middle * tau * (1 - tau) + right * tau * (2 * tau - 1)
    return float(np.abs(curve).max())
