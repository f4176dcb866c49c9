"""The least factor on effort limits of several starts is the least of theirs; one that is at most 1 ends the search."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.search import least_limit
from linkplan.planner.search.solving import first_mesh
from linkplan.planner.transcription.mesh import uniform
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_problem


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


@pytest.mark.parametrize(
    ("factors", "tried", "answer"),
    [
        ((1.5, 1.51, 1.5101), 2, 1.5101),
        ((1.5, 1.50014), 1, 1.50014),  # by less than 1e-4 of itself
        ((1.5, 1.49986), 1, 1.49986),
        ((1.5, 1.50016, 1.50017), 2, 1.50017),
        ((1.5, 1.6, None), 2, 1.6),
        ((1.5, 1.6, 1.7, 1.8, 1.9), 3, 1.8),
    ],
)
def test_a_factor_is_settled_where_a_finer_mesh_changes_it_by_less_than_a_ten_thousandth(
    monkeypatch, factors, tried, answer
):
    rest, meshes = iter(factors[1:]), []

    def finer(_problem, _guess, mesh, _durations):
        meshes.append(mesh.n_intervals)
        factor = next(rest)
        return None if factor is None else SimpleNamespace(factor=factor, mesh=mesh, trajectory=None, durations=None)

    monkeypatch.setattr(least_limit, "least_limit", finer)
    monkeypatch.setattr(least_limit, "motion_of", lambda _: None)
    begin = SimpleNamespace(factor=factors[0], mesh=uniform(5), trajectory=None, durations=None)
    assert least_limit.settled_limit(None, begin).factor == answer
    assert meshes == [10, 20, 40][:tried]


def test_the_least_factor_of_a_pure_inertia_is_exact_once_its_switch_is_known():
    """A quarter turn in T seconds needs 4 I b / T^2 N.m, of the 4 that it has; known from another start it is no other."""
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 0.5\n")
    guess = first_guess(problem, problem.start_pose())
    mesh, durations = first_mesh(problem, guess)
    found = least_limit.least_limit(problem, guess, mesh, durations)
    assert found.factor == pytest.approx(4 * HINGE_INERTIA * TURN / 0.5**2 / 4.0, rel=1e-7)
    assert found.first == pytest.approx(found.factor, rel=1e-2)
    assert found.durations.sum() == pytest.approx(0.5)
    for factor, same in ((1 + 0.9e-7, True), (1 - 0.9e-7, True), (1 + 1.2e-7, False), (1 - 1.2e-7, False)):
        again = least_limit.least_limit(problem, guess, mesh, durations, known=factor * found.first)
        assert (again is None) is same, factor


@pytest.mark.parametrize(("change", "kept"), [(-0.1, 1), (0.9e-4, 1), (1.1e-4, 0)])
def test_a_factor_at_switch_times_counts_unless_it_is_worse_by_more_than_the_mesh_s_error(monkeypatch, change, kept):
    factors, tried = [3.0, 3.0 * (1 + change)], []
    layout = SimpleNamespace(extra=lambda: [0], durations=lambda: [1])
    units, program = SimpleNamespace(time_s=2.0), SimpleNamespace(layout=layout)

    def transcribe(*_, **__):
        tried.append(len(tried))
        return SimpleNamespace(program=program, units=units)

    def solve(*_):
        return SimpleNamespace(converged=True, x=np.array([factors[tried[-1]], 0.5]))

    scripted = {
        "transcribe": transcribe,
        "solve": solve,
        "trajectory_of": lambda *_: SimpleNamespace(breaks_s=np.linspace(0.0, 1.0, 7), tried=tried[-1]),
        "find_switch_times": lambda *_: np.array([0.5]),
        "find_bang_efforts": lambda *_: np.full((2, 1), 12.0),
        "motion_of": lambda _: None,
        "step_of": lambda *_: None,
        "record": lambda _: None,
    }
    for name, function in scripted.items():
        monkeypatch.setattr(least_limit, name, function)
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n")
    found = least_limit.least_limit(problem, None, uniform(6), np.ones(1))
    assert tried == [0, 1]
    assert (found.factor, found.trajectory.tried, found.first) == (factors[kept], kept, 3.0)
    assert found.durations.tolist() == [1.0]
