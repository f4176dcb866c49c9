"""Plan random slider-cranks and judge every answer: `python -m tests.bench.random_sliders [N] [SEED]`.

The best motions are known without linkplan (`tests.support.sliders`).
"""

import sys
import time

from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.sliders import drawn

# An answer against the best, relative.
EXACT = 1e-6


def judged(seed: int, number: int) -> tuple[str, float, float, str]:
    """Return a random problem's kind, its answer's error (relative), the processor time [s], and what was said."""
    case, begin = drawn(seed, number), time.process_time()
    plan = plan_motion(Problem.from_tables(f"slider-{number}", case.tables))
    spent = time.process_time() - begin
    if plan.status != "optimal":
        return case.minimize, float("nan"), spent, plan.message
    return (
        case.minimize,
        plan.objective / case.best - 1.0,
        spent,
        "right" if abs(plan.objective / case.best - 1.0) <= EXACT else "wrong",
    )


def main(n: int = 40, seed: int = 1) -> int:
    """Print a line for each problem; return how many answers are not right."""
    wrong = 0
    for number in range(n):
        kind, error, spent, said = judged(seed, number)
        wrong += said != "right"
        print(f"{number:4d}  least {kind:6}  {error:+9.1e}  {spent:6.1f} s  {said}", flush=True)
    print(f"{n - wrong} of {n} right to {EXACT:g}")
    return wrong


if __name__ == "__main__":
    sys.exit(main(*(int(word) for word in sys.argv[1:])) > 0)
