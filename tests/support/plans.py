"""Plans of the built-in problems with overrides, each made once; the knee's reach that most of them are about."""

from functools import cache
from pathlib import Path

import numpy as np

from linkplan.planner.files.folders import write_whole
from linkplan.planner.plan.folder import write_plan
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion

# Where the knee's reach begins and ends [rad], and its motor's limit [N.m].
START, GOAL = np.radians([-49.07, 56.27])
LIMIT = 100.0


@cache
def problem_of(name: str, *overrides: str) -> Problem:
    """Return a built-in problem with overrides, loaded once."""
    return load_problem(name, overrides)


@cache
def planned(name: str, *overrides: str) -> Plan:
    """Return the plan of a built-in problem with overrides, planned once."""
    return plan_motion(problem_of(name, *overrides))


def optimal(name: str, *overrides: str) -> Plan:
    """Return a plan after making sure that it is one."""
    plan = planned(name, *overrides)
    assert plan.status == "optimal", plan.message
    return plan


def saved_plan(name: str, folder: Path) -> Path:
    """Return where a built-in problem's plan was written: a folder of its name."""
    write_whole(folder / name, lambda new: write_plan(optimal(name), new))
    return folder / name
