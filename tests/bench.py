"""`make bench`: where the time of a plan goes, beside a program written by hand, and what the closed loop costs.

Only ratios within one run mean anything on a shared machine; the medians beside them say what they are ratios of.
"""

import itertools
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
from mujoco.batch import Batch

from controllers.rollout import Loop, run
from controllers.sampling import sampling
from models.assembly import close_at
from models.mechanism import load_mechanism
from planner.certificate import certify
from planner.guess import first_guess
from planner.mesh import uniform
from planner.planning import plan_motion
from planner.problem import Tracking
from planner.problem_file import load_problem
from planner.replan import Planner
from planner.solve import solve
from planner.tables import BUILT_IN
from planner.transcription import transcribe
from studies.compare import build_tracker, tracking_reference
from studies.excitation import Setup
from studies.loops import feedback_loop, law_gain, operating_point
from studies.measure import measure
from studies.tables import table
from tests.peer import build_peer

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


def bench_peer() -> str:
    """Return the time of building and solving beside the same problems in hand-written `casadi.Opti`, and the answers.

    Both at IPOPT tolerance 1e-10; the peer's torque between its nodes is its own quadratic's.
    """
    start, goal = np.radians(-49.07), np.radians(56.27)
    exact = {"knee-sprint": 0.12185126841421788}
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        os.environ["LINKPLAN_CACHE"] = cache
        for name, duration in (("knee-reach", 0.16), ("knee-sprint", None)):
            peer = build_peer(40, start, goal, duration)
            solution = peer.solve(goal)
            theirs = median_s(lambda duration=duration: build_peer(40, start, goal, duration).solve(goal))
            again = median_s(lambda peer=peer, solution=solution: peer.solve(goal, solution))
            torque = np.array(solution.value(peer.effort)).reshape(-1)
            rows.append(
                [
                    f"{name}, Opti",
                    1e3 * theirs,
                    1.0,
                    over(float(solution.value(peer.opti.f)), exact.get(name)),
                    between_nodes(torque),
                ]
            )
            rows.append([f"{name}, Opti again", 1e3 * again, again / theirs, None, None])
            for mode in ("never", "always"):
                problem = load_problem(name, [f"solver.compile={mode}"])
                plan = plan_motion(problem)
                ours = median_s(lambda problem=problem: first_solve(problem))
                answer = over(plan.objective, exact.get(name))
                label = "interpreted" if mode == "never" else "compiled, cache warm"
                rows.append([f"{name}, {label}", 1e3 * ours, ours / theirs, answer, float(plan.certificate.peak_effort[0])])
            planner, goals = Planner(), itertools.cycle(np.radians([55.0, 56.27]))
            planner.plan(problem)

            def solve_again(planner=planner, problem=problem, goals=goals) -> None:
                planner.solve_again(replace(problem, motion=replace(problem.motion, goal=np.array([next(goals)]))))

            ours = median_s(solve_again, 20)
            rows.append([f"{name}, goal changed, solved again", 1e3 * ours, ours / theirs, None, None])
        del os.environ["LINKPLAN_CACHE"]
    head = ["build and solve, 40 intervals", "median [ms]", "of Opti's", "over exact", "largest torque [N.m]"]
    return table(head, rows)


def over(value: float, exact: float | None) -> float | None:
    """Return how far a value is beyond the exact one, relative; None where none is known."""
    return None if exact is None else value / exact - 1


def first_solve(problem) -> None:
    """Transcribe a problem on its first mesh and solve it once: what the peer does too."""
    guess = first_guess(problem, problem_start(problem))
    mesh = uniform(problem.mesh.intervals)
    solve(transcribe(problem, guess, mesh, np.array([guess.duration_s])))


def problem_start(problem) -> np.ndarray:
    """Return the closed pose at a problem's start."""
    return close_at(problem.mechanism, problem.motion.start)


def between_nodes(torque: np.ndarray) -> float:
    """Return the largest size of the quadratics through (node, midpoint, node) values in turn."""
    tau = np.linspace(0, 1, 51)
    left, middle, right = torque[0:-2:2, None], torque[1::2, None], torque[2::2, None]
    curve = left * (1 - tau) * (1 - 2 * tau) + 4 * middle * tau * (1 - tau) + right * tau * (2 * tau - 1)
    return float(np.abs(curve).max())


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


def bench_measurement() -> str:
    """Return the simulated steps a second of a frequency response's measurement beside raw batch stepping of as many."""
    mechanism = load_mechanism("optimus-knee", payload="shank")
    settings = Tracking(kp=200.0, kd=20.0)
    timing = sampling(mechanism, settings.period_s)
    points = [operating_point(mechanism, np.radians([angle])) for angle in (-20.0, 20.0)]
    limit = mechanism.effort_limit
    loops = [feedback_loop(point, law_gain(point, "pd", settings, limit), timing) for point in points]
    rows = []
    for method in ("sinestream", "multisine"):
        frequency, setup = np.geomspace(20.0, 2000.0, 20), Setup(method=method)
        taken = measure(loops, frequency, limit, setup)
        spent = median_s(lambda setup=setup, frequency=frequency: measure(loops, frequency, limit, setup), 2)
        n = 120 if method == "sinestream" else 6
        batch = Batch(mechanism.model, nsim=n)
        calls = max(1, taken.simulated_steps // n)
        raw = median_s(lambda batch=batch, calls=calls: [batch.step() for _ in range(calls)], 2)
        rate, most = taken.simulated_steps / spent, n * calls / raw
        rows.append([f"{method}, {n} simulations", taken.simulated_steps, rate, most, rate / most])
    return table(["measurement", "steps", "steps/s", "raw batch steps/s", "ratio"], rows)


if __name__ == "__main__":
    print(bench_plans(), bench_peer(), bench_loop(), bench_measurement(), sep="\n\n")
