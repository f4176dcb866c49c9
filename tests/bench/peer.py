"""The part of `make bench` on whole plans: the time of each, and beside other people's programs, first and again."""

import itertools
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from linkplan.planner.certificate.certificate import certify
from linkplan.planner.files.tables import BUILT_IN
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.replan import Replanner
from linkplan.studies.output.text import table
from tests.bench.packages import installed
from tests.bench.shares import timed_solves
from tests.bench.timing import EXACT_TIME, GOAL, REPEATS, first_solve, medians_s, over, own_cache, say

# Of the knee's problems the duration [s] that the peers are given, and how many times its solves a whole plan may take.
_PROBLEMS = (("knee-reach", 0.16, 2.5), ("knee-sprint", None, 4.0))
# Of the quickest peer's second solve: a whole plan again, and its program alone.
_AGAIN, _AGAIN_ALONE = 1.0, 0.5
# Of what Python takes to load the three packages that a plan stands on.
_COMMAND = 1.5
_LOADED = "import casadi, mujoco, scipy"
_RE_SOLVES = 20
_PLAN, _ALONE = "linkplan, whole plan", "linkplan, its program alone"


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
    """Return the times of whole plans, first and again, beside other programs for the same problems, and the command's.

    All by IPOPT at the same tolerance, on one thread, in turn; linkplan's alone are certified, but where it says "alone".
    """
    texts, held = [], []
    with own_cache():
        for name, duration, most in _PROBLEMS:
            texts += [_first(name, duration, most, held), _again(name, duration, held)]
    spent, loaded = command_s(["-m", "linkplan", "plan", "knee-reach"], ["-c", _LOADED])
    rows = [["linkplan plan knee-reach", 1e3 * spent], [_LOADED, 1e3 * loaded]]
    texts.append(table(["command, least of five", "processor [ms]"], rows))
    held.append(target(f"linkplan plan knee-reach, of '{_LOADED}'", spent / loaded, _COMMAND))
    texts.append(table(["target", "ratio", "at most", "holds"], held))
    return "\n\n".join(texts)


def target(what: str, ratio: float, most: float) -> list[object]:
    """Return a row: what is compared, how many times as long it takes, how many it may, and whether it does."""
    return [what, ratio, most, ratio <= most]


def _first(name: str, duration: float | None, most: float, held: list[list[object]]) -> str:
    """Return the table of what leads from nothing to an answer, and add to `held` what a whole plan's time is held to."""
    say(f"{name}, from nothing")
    there, missing = installed()
    exact, problem = EXACT_TIME.get(name), load_problem(name, ["solver.compile=always"])
    plan_motion(problem)  # what is compiled once
    spent_in_solver = []

    def whole(goal: float) -> None:
        with timed_solves() as solves:
            plan_motion(_to(problem, goal))
        spent_in_solver.append(sum(solves))

    works: dict[str, Callable[[], object]] = {
        peer: lambda solve=solve, duration=duration: solve(duration) for peer, solve in there.items()
    }
    works[_PLAN] = _in_turn(whole)
    programs = {f"{_ALONE}, interpreted": load_problem(name, ["solver.compile=never"]), f"{_ALONE}, compiled": problem}
    works |= {label: lambda asked=asked: first_solve(asked) for label, asked in programs.items()}
    times = medians_s(works)
    solver = float(np.median(spent_in_solver[-REPEATS:]))
    quickest = min(times[peer] for peer in there)
    answers = {peer: solve(duration) for peer, solve in there.items()}
    plan = plan_motion(problem)
    found = {peer: (over(answer.objective, exact), answer.largest) for peer, answer in answers.items()}
    found[_PLAN] = (over(plan.objective, exact), float(plan.certificate.peak_effort[0]))
    found |= {label: (over(first_solve(asked).objective, exact), None) for label, asked in programs.items()}
    rows = [[label, 1e3 * times[label], times[label] / quickest, *found[label]] for label in times]
    rows += [["its solves", 1e3 * solver, solver / quickest, None, None]]
    rows += [[f"{peer}: {words}", None, None, None, None] for peer, words in missing.items()]
    held.append(target(f"{name}, whole plan, of its solves", times[_PLAN] / solver, most))
    held.append(target(f"{name}, whole plan, of the quickest peer's build and solve", times[_PLAN] / quickest, 1.0))
    head = [f"{name}, from nothing", "median [ms]", "of the quickest peer's", "over exact", "largest torque [N.m]"]
    return table(head, rows)


def _again(name: str, duration: float | None, held: list[list[object]]) -> str:
    """Return the table of what another goal takes, once all is built, and add to `held` what a re-solve's is held to."""
    say(f"{name}, again")
    there, missing = installed()
    problem = load_problem(name, ["solver.compile=always"])
    works = {peer: _in_turn(solve(duration).again()) for peer, solve in there.items()}
    for label, alone in ((_PLAN, False), (_ALONE, True)):
        planner = Replanner()
        planner.plan(problem)
        works[label] = _in_turn(lambda goal, planner=planner, alone=alone: _plan(planner, problem, goal, alone))
    times = medians_s(works, _RE_SOLVES)
    quickest = min(times[peer] for peer in there)
    rows = [[label, 1e3 * spent, spent / quickest] for label, spent in times.items()]
    rows += [[f"{peer}: {words}", None, None] for peer, words in missing.items()]
    held.append(target(f"{name}, whole plan again, of the quickest peer's solve", times[_PLAN] / quickest, _AGAIN))
    held.append(target(f"{name}, its program alone again, of that", times[_ALONE] / quickest, _AGAIN_ALONE))
    return table([f"{name}, goal changed", "median [ms]", "of the quickest peer's"], rows)


def _in_turn(solve: Callable[[float], object]) -> Callable[[], object]:
    """Return what solves for two goals in turn, each time a hundredth of a degree nearer: none is ever asked for twice."""
    goals = (goal - np.radians(0.01) * k for k in itertools.count() for goal in (np.radians(55.0), GOAL))
    return lambda: solve(next(goals))


def _to(problem: Problem, goal: float) -> Problem:
    return problem.varied(motion=replace(problem.motion, goal=np.array([goal])))


def _plan(planner: Replanner, problem: Problem, goal: float, alone: bool) -> None:
    asked = _to(problem, goal)
    again = planner.solve_again(asked) is not None if alone else planner.plan(asked).solved_again
    assert again, "not solved again, but planned from the beginning"


def command_s(*commands: Sequence[str], repeats: int = 5) -> list[float]:
    """Return the least processor time [s] of each command to this Python, run in turn: a child's user and system time.

    Its bytecode is written and read, as it is for a user.
    """
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    if "PYTHONPATH" in environment:
        paths = environment["PYTHONPATH"].split(os.pathsep)
        environment["PYTHONPATH"] = os.pathsep.join(os.path.abspath(path) for path in paths)
    least = [np.inf] * len(commands)
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(repeats + 1):
            for k, command in enumerate(commands):
                before = resource.getrusage(resource.RUSAGE_CHILDREN)
                subprocess.run([sys.executable, *command], cwd=folder, env=environment, check=True, capture_output=True)
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                least[k] = min(least[k], after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return least
