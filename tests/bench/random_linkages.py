"""Plan random linkages and judge every answer: `python -m tests.bench.random_linkages [N] [SEED] [FIRST] [sliders]`.

Six-bars, offset slider-cranks, spatial RSSRs, five-bars with two motors: `tests.support.linkage_problems` knows the best
motions without linkplan. With `sliders`, slider-cranks alone, some of them within a power (`tests.support.sliders`).
"""

import sys
import time
from collections.abc import Callable

from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support import sliders
from tests.support.linkage_problems import LinkageProblem, drawn


def drawn_slider(seed: int, number: int) -> LinkageProblem:
    """Return a random problem of a slider-crank by its number."""
    case = sliders.drawn(seed, number)
    return LinkageProblem(tables=case.tables, family="slider-crank", asked=f"least {case.minimize}", best=case.best)


def judged(problem: LinkageProblem) -> tuple[str, float, float]:
    """Return "right", or what is wrong with an answer; its error (relative) and the processor time [s]."""
    begin = time.process_time()
    plan = plan_motion(Problem.from_tables(problem.family, problem.tables))
    spent = time.process_time() - begin
    if plan.status != "optimal":
        return f"{plan.status}: {plan.message}", float("nan"), spent
    error = plan.objective / problem.best - 1.0
    if plan.certificate is None or not plan.certificate.passed:
        return "optimal without a certificate that passes", error, spent
    return "right" if abs(error) <= problem.exact else f"wrong: {plan.message}", error, spent


def main(n: int = 40, seed: int = 1, first: int = 0, draw: Callable[[int, int], LinkageProblem] = drawn) -> int:
    """Print a line for each problem; return how many answers are not right."""
    wrong = 0
    for number in range(first, first + n):
        problem = draw(seed, number)
        said, error, spent = judged(problem)
        wrong += said != "right"
        print(f"{number:4d}  {problem.family:12}  {problem.asked:21}  {error:+9.1e}  {spent:6.1f} s  {said}", flush=True)
    print(f"{n - wrong} of {n} right")
    return wrong


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "sliders"]
    sys.exit(main(*map(int, words), draw=drawn_slider if "sliders" in sys.argv else drawn) > 0)
