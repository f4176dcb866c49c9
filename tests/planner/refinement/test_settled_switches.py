"""When switch times replace a solution without them, and when they have settled; the solves are not made."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.refinement import switch_search
from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.refinement.switch_search import settle_switch_times
from linkplan.planner.transcription.mesh import uniform


def settled(monkeypatch, objectives: list[float]) -> tuple[float, int]:
    """Return the objective of the answer and the number of solves, from 1 without switch times; one effort is never held."""
    solves = []

    def solution(objective: float) -> SimpleNamespace:
        motion = SimpleNamespace(breaks_s=np.linspace(0.0, 1.0, 41))
        return SimpleNamespace(
            motion=motion, mesh=uniform(40), solution=SimpleNamespace(objective=objective, transcribed=None)
        )

    def attempt(*_, **__):
        solves.append(objectives[len(solves)])
        return solution(solves[-1])

    fixed = FixedArcs(efforts=np.full((2, 1), np.nan), paths=np.zeros((2, 1), dtype=int))
    monkeypatch.setattr(switch_search, "_arcs_of", lambda *_: (np.array([0.4]), fixed))
    monkeypatch.setattr(switch_search, "attempt", attempt)
    monkeypatch.setattr(switch_search, "arcs_against_their_limits", lambda _: [])
    monkeypatch.setattr(switch_search, "at_bounds", lambda _: False)
    monkeypatch.setattr(switch_search, "_known", lambda *_: False)
    case = SimpleNamespace(start_from=lambda _: None, problem=SimpleNamespace(mesh=SimpleNamespace(intervals=40)))
    return settle_switch_times(case, solution(1.0)).solution.objective, len(solves)


@pytest.mark.parametrize(("objective", "taken"), [(1.0 + 5e-5, True), (1.0 + 5e-4, False)])
def test_a_solution_with_switch_times_may_be_a_ten_thousandth_worse_than_one_without(monkeypatch, objective, taken):
    found, solves = settled(monkeypatch, [objective, objective])
    assert found == (objective if taken else 1.0)
    assert solves == (1 if taken else 2)  # then with efforts free


@pytest.mark.parametrize(
    ("objectives", "solves"),
    [
        ([0.9, 0.8, 0.7, 0.6], 4),
        ([0.9, 0.9 - 1e-11], 2),
        ([0.9, 0.9 - 4e-9, 0.9 - 4.1e-9], 3),
        ([1.0 - 1e-10], 1),
    ],
)
def test_switch_times_have_settled_once_a_solve_gains_less_than_a_billionth(monkeypatch, objectives, solves):
    assert settled(monkeypatch, objectives) == (objectives[-1], solves)
