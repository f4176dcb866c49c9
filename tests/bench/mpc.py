"""The part of `make bench` on model predictive control: the time of a control period at an effort limit, beside interpreted.

A shared machine interrupts a call of a tenth of a millisecond in one of a hundred cases. Each period is therefore run some
times from the same state and the quickest counts; medians and percentiles are over the periods, whose programs differ.
"""

import time
from dataclasses import replace

import numpy as np

from linkplan.controllers.trackers.mpc import HORIZON_BLOCKS, MPC
from linkplan.controllers.trackers.prediction import predictor
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker, tracking_reference
from linkplan.studies.output.text import table
from tests.bench.timing import say

_RUNS = 5
# Periods of each plan that are measured, and the errors [deg] that drive the efforts to their limits.
_PERIODS, _ERROR_DEG = 500, 3.0
# The 99th percentile [us] that is aimed at, by degrees of freedom.
_AIMED_AT = {1: 150, 2: 400}


def bench_mpc() -> str:
    """Return the times of a control period of MPC at an effort limit, compiled and interpreted."""
    rows = []
    for name in ("knee-sprint", "five-bar-reach"):
        say(f"mpc on {name}")
        plan = plan_motion(load_problem(name))
        reference = tracking_reference(plan)
        law = build_tracker("mpc", plan, reference)
        block_s = reference.period_s * round(law.weights[0][0, 0] / law.regulator.Q[0, 0])
        programs = {mode: replace(law, predictor=predictor(plan.problem.mechanism, law.kept, HORIZON_BLOCKS, block_s, mode))
                    for mode in ("always", "never")}  # fmt: skip
        found = {mode: periods_us(one) for mode, one in programs.items()}
        fast, slow = (found[mode] for mode in ("always", "never"))
        rows.append([name, plan.problem.mechanism.dof, len(fast), *np.percentile(fast, [50, 99]),
                     _AIMED_AT[plan.problem.mechanism.dof], float(np.median(fast) / np.median(slow))])  # fmt: skip
    heads = [
        "plan",
        "degrees of freedom",
        "periods",
        "median [us]",
        "99th percentile [us]",
        "aimed at",
        "median over interpreted",
    ]
    return table(heads, rows)


def periods_us(law: MPC) -> np.ndarray:
    """Return the times [us] of those control periods in which the quadratic program is solved."""
    reference, random = law.reference, np.random.default_rng(0)
    memory, found = law.start(1), []
    for k in range(0, reference.n, max(1, reference.n // _PERIODS)):
        shape = (1, reference.position_rad.shape[1])
        s = reference.position_rad[k] + np.radians(_ERROR_DEG) * random.standard_normal(shape)
        v = reference.velocity_rad_s[k] * (1 + 0.05 * random.standard_normal(shape))
        times = []
        for _ in range(_RUNS):
            begin = time.perf_counter()
            _, after = law.step(k, s, v, memory)
            times.append(time.perf_counter() - begin)
        memory = after
        if np.isfinite(after).all():
            found.append(1e6 * min(times))
    return np.array(found)
