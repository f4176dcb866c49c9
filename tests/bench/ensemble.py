"""The part of `make bench` on many closed loops at once: with the tracker in the loop, beside MuJoCo's batch stepping.

The times are the wall's, since threads are what is measured: the least of some in turn, for what others take on a shared
machine is never negative.
"""

import time
from collections.abc import Callable

import mujoco
import numpy as np
from mujoco.batch import Batch

from linkplan.controllers.imperfections.imperfections import Imperfections
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker, tracking_reference
from linkplan.studies.output.text import table
from tests.bench.timing import say

SIMULATIONS, THREADS, REPEATS = 256, 2, 7


def bench_ensemble() -> str:
    """Return what trackers leave of the rate of raw batch stepping, and how often a Python loop's they make."""
    say("many closed loops")
    plan = plan_motion(load_problem("knee-sine", ["tracking.duration_s=0.1"]))  # the bare knee
    mechanism, reference = plan.problem.mechanism, tracking_reference(plan)
    limit = np.array(plan.problem.limits.effort)
    machines = [Imperfections()] * SIMULATIONS
    plant = MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=limit), threads=THREADS)
    each = 1e6 / (SIMULATIONS * reference.n)
    rows = []
    for name in ("pd", "pd+ff", "lqr"):
        tracker = build_tracker(name, plan, reference)
        driven = simulate(plant, tracker, reference, machines[:1]).applied[:, 0]
        raw, looped, python = _least_s(
            [
                lambda driven=driven: _raw(mechanism, reference, driven),
                lambda tracker=tracker: simulate(plant, tracker, reference, machines),
                lambda tracker=tracker: _python(mechanism, reference, tracker, limit),
            ]
        )
        own = 1e6 * python / reference.n
        rows.append([name, raw * each, looped * each, own, 100 * raw / looped, own / (looped * each)])
    head = [
        f"{SIMULATIONS} simulations, {THREADS} threads",
        "raw [us]",
        "with tracker [us]",
        "Python loop [us]",
        "of raw [%]",
        "over Python loop",
    ]
    return table(head, rows)


def _least_s(works: list[Callable[[], object]]) -> list[float]:
    """Return the least wall time [s] of each work, done in turn after one run to warm up."""
    times: list[list[float]] = [[] for _ in works]
    for _ in range(REPEATS + 1):
        for taken, work in zip(times, works, strict=True):
            begin = time.perf_counter()
            work()
            taken.append(time.perf_counter() - begin)
    return [min(taken[1:]) for taken in times]


def _raw(mechanism, reference, driven: np.ndarray) -> None:
    """Step the same motion by MuJoCo alone: the efforts are known."""
    batch = Batch(mechanism.model, nsim=SIMULATIONS, nthread=THREADS)
    batch.bind("qpos")[:] = reference.pose_rad[0]
    batch.bind("qvel")[:] = np.array(mechanism.dynamics.velocity_map(reference.pose_rad[0])) @ reference.velocity_rad_s[0]
    ctrl = batch.bind("ctrl")
    for effort in driven:
        ctrl[:] = effort
        batch.step()


def _python(mechanism, reference, tracker, limit: np.ndarray) -> None:
    """Run one simulation as one would write it down."""
    model, data, (joint,) = mechanism.model, mujoco.MjData(mechanism.model), mechanism.independent
    data.qpos[:] = reference.pose_rad[0]
    data.qvel[:] = np.array(mechanism.dynamics.velocity_map(reference.pose_rad[0])) @ reference.velocity_rad_s[0]
    for k in range(reference.n):
        effort = tracker.effort(k, data.qpos[joint : joint + 1], data.qvel[joint : joint + 1])
        data.ctrl[:] = np.clip(effort, limit[:, 0], limit[:, 1])
        mujoco.mj_step(model, data)
