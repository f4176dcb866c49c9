"""The least factor on effort limits of several starts is the least of theirs; one that is at most 1 ends the search."""

from types import SimpleNamespace

import pytest

from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.search import least_limit
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem


@pytest.mark.parametrize(
    ("factors", "tried", "best"),
    [((3.0, 2.0, 2.5), 3, 2.0), ((3.0, None, 2.5), 3, 2.5), ((3.0, 0.9, 0.5), 2, 0.9), ((1.0, 0.9, 0.8), 1, 1.0)],
)
def test_the_least_of_three_starts_is_taken(monkeypatch, factors, tried, best):
    problem, rest, knew = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n"), iter(factors), []

    def found(*_given, known: float | None) -> SimpleNamespace | None:
        knew.append(known)
        factor = next(rest)
        return None if factor is None else SimpleNamespace(factor=factor, first=10 * factor)

    monkeypatch.setattr(least_limit, "least_limit", found)
    answer = least_limit.least_limit_of_starts(problem, first_guess(problem, problem.start_pose()))
    assert answer.factor == best
    assert len(knew) == tried
    assert knew[:2] == [None, 10 * factors[0]][:tried]
