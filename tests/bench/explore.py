"""The part of `make bench` on `linkplan explore`: what one moved slider costs: its certified plan, and the page."""

import statistics
import time

from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.explore.session import Session
from linkplan.studies.output.text import table
from tests.bench.timing import median_s, say

PROBLEM = "knee-reach"
# The shares of a slider's range between its value and its far end to which it is moved, one after another.
STEPS = (0.02, 0.05, 0.1, 0.15, 0.2)


def bench_explore() -> str:
    """Return the table of moved sliders: the median time of plan and report, beside a plan of the same problem alone."""
    problem = load_problem(PROBLEM)
    alone = median_s(lambda: plan_motion(problem))
    session = Session(first=problem)
    session.report({}, None)
    rows = []
    for slider in session.sliders():
        say(f"explore: {slider.label}")
        far = slider.low if slider.value == slider.high else slider.high
        plans, whole = [], []
        for step in STEPS:
            begin = time.process_time()
            _, said = session.report({slider.key: slider.value + step * (far - slider.value)}, None)
            whole.append(time.process_time() - begin)
            plans.append(said["plan_s"])
        planned, all_of_it = statistics.median(plans), statistics.median(whole)
        rows.append([slider.label, 1e3 * planned, 1e3 * all_of_it, planned / alone])
    head = ["slider", "plan [ms]", "plan, tracking and page [ms]", "plan / a plan alone"]
    return f"explore, {PROBLEM}: medians of {len(STEPS)} moves\n" + table(head, rows)
