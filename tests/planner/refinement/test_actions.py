"""What actions write into the record of a refinement, and which of two solves they keep; the solves are not made."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.refinement import actions
from linkplan.planner.refinement.actions import Halve, ImposeRanges, Loosen, RaiseDegree, ReleaseArcs, _solved_on
from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.refinement.state import RefinementState
from linkplan.planner.refinement.switch_search import bounded_by_guess, is_bang_bang
from linkplan.planner.solvers.solve import SUCCEEDED
from linkplan.planner.transcription.mesh import Mesh, segmented, uniform
from tests.support.refinement_states import AIMS, iterate, state

NOWHERE = np.zeros(10, dtype=bool)


def begun(target=AIMS, **changes) -> RefinementState:
    """Return a state after 5 rounds, 2 tightenings, 1 release and 1 idle loosening, whose case is itself when changed."""
    before = state(iterate(**changes), target=target, rounds=5, tightenings=2, releases=1, idle=1)
    case = SimpleNamespace(problem=before.case.problem, target=target, start_from=lambda _: None)
    case.with_scheme, case.tightened = (lambda _: case), (lambda *_: case)
    before.at.found.solution.transcribed.scheme = SimpleNamespace(name="radau-3")
    return replace(before, asked=case, case=case, best=before.at if changes.get("passed", True) else None)


def solves(monkeypatch, found) -> None:
    """Let every solve give `found`, which is certified by nothing."""
    monkeypatch.setattr(actions, "_solved_on", lambda *_: found)
    monkeypatch.setattr(actions, "attempt", lambda *_, **__: found)
    monkeypatch.setattr(actions, "certify_iterate", lambda *_: None)
    monkeypatch.setattr(actions, "observed", lambda after, _, **__: after)


def test_a_finer_mesh_is_a_round_and_tightening_is_counted(monkeypatch):
    solves(monkeypatch, object())
    after = Halve(NOWHERE).apply(begun())
    assert (after.rounds, after.tightenings, after.ended) == (6, 2, False)
    after = Halve(NOWHERE, tightens=True).apply(begun())
    assert (after.rounds, after.tightenings) == (6, 3)
    solves(monkeypatch, None)
    assert Halve(NOWHERE).apply(begun()).ended


@pytest.mark.parametrize("found", [None, SimpleNamespace()])
def test_imposed_ranges_are_a_round_whether_there_is_a_motion_or_not(monkeypatch, found):
    solves(monkeypatch, found)
    after = ImposeRanges().apply(begun())
    assert (after.rounds, after.rows_lost, after.position_rows) == (6, found is None, found is not None)


@pytest.mark.parametrize("passed", [True, False])
def test_a_degree_without_a_motion_ends_what_passes_and_is_lost_for_what_does_not(monkeypatch, passed):
    solves(monkeypatch, None)
    after = RaiseDegree("radau-5").apply(begun(passed=passed))
    assert (after.ended, after.degree_lost) == (passed, not passed)
    assert after.rounds == (5 if passed else 6)


def test_a_loosening_without_a_motion_is_a_round_that_gained_nothing(monkeypatch):
    solves(monkeypatch, None)
    after = Loosen().apply(begun())
    assert (after.rounds, after.idle, after.tightenings, after.ended) == (6, 2, 0, True)


def test_a_release_is_counted_whether_anything_is_released_or_not(monkeypatch):
    solves(monkeypatch, None)
    monkeypatch.setattr(actions, "released", lambda _: None)
    after = ReleaseArcs().apply(begun())
    assert (after.releases, after.rounds, after.ended) == (2, 5, True)
    fixed = FixedArcs(efforts=np.full((2, 1), np.nan), paths=np.zeros((2, 0), dtype=int))
    monkeypatch.setattr(actions, "released", lambda _: (np.array([0.0, 0.4, 1.0]), fixed))
    monkeypatch.setattr(actions, "interval_breaks", lambda _: np.linspace(0.0, 1.0, 11))
    after = ReleaseArcs().apply(begun())
    assert (after.releases, after.rounds, after.ended) == (2, 6, True)
    solves(monkeypatch, object())
    after = ReleaseArcs().apply(begun())
    assert (after.releases, after.rounds, after.ended) == (2, 6, False)


@pytest.mark.parametrize(
    ("objectives", "kept"),
    [([1.0 + 3e-7], 0), ([1.001, 1.0], 1), ([0.999, 1.001], 0), ([1.0 - 3e-6, 1.0], 0)],
)
def test_bang_arcs_are_solved_another_way_if_the_objective_moves_by_a_millionth_and_the_better_is_kept(
    monkeypatch, objectives, kept
):
    """The first solve is from next to the coarser mesh, whose objective is 1."""
    found = [SimpleNamespace(solution=SimpleNamespace(objective=one, status=SUCCEEDED)) for one in objectives]
    rest, close = iter(found), []

    def attempt(*_, **given):
        close.append(given["close"])
        return next(rest)

    monkeypatch.setattr(actions, "attempt", attempt)
    assert _solved_on(begun(replace(AIMS, bang_bang=True)), NOWHERE, "") is found[kept]
    assert close == [True, False][: len(objectives)]


def test_of_two_solves_one_that_succeeded_is_kept_whatever_its_objective(monkeypatch):
    rest = iter(SimpleNamespace(solution=SimpleNamespace(objective=x, status=y)) for x, y in ((0.5, "no"), (1.1, SUCCEEDED)))
    monkeypatch.setattr(actions, "attempt", lambda *_, **__: next(rest))
    assert _solved_on(begun(replace(AIMS, bang_bang=True)), NOWHERE, "").solution.objective == 1.1


# Switch times.


@pytest.mark.parametrize(
    ("kinds", "n_path", "only_efforts"),
    [
        ((), 0, True),
        (("position",), 0, True),
        (("speed",), 0, False),
        (("position", "speed"), 0, False),
        (("position",), 1, False),
    ],
)
def test_all_efforts_are_bangs_where_only_their_limits_and_ranges_bind(kinds, n_path, only_efforts):
    interval = SimpleNamespace(n_path=n_path, own_kinds=("continuity", *kinds))
    transcribed = SimpleNamespace(program=SimpleNamespace(interval=interval))
    for bang_bang in (False, True):
        case = SimpleNamespace(target=replace(AIMS, bang_bang=bang_bang))
        assert is_bang_bang(case, transcribed) == (bang_bang and only_efforts)


def held_by(at: float, mesh: Mesh, shortest_s: float = 0.0, longest_s: float = np.inf) -> str | None:
    """Return how a motion would change whose segments may last from 0.02 to 100 s, in units of 2 s."""
    n = mesh.n_segments
    layout = SimpleNamespace(durations=lambda: np.arange(n))
    transcribed = SimpleNamespace(
        program=SimpleNamespace(layout=layout, mesh=mesh), lower=np.full(n, 0.02), upper=np.full(n, 100.0),
        units=SimpleNamespace(time_s=2.0),
    )  # fmt: skip
    return bounded_by_guess(SimpleNamespace(transcribed=transcribed, x=np.full(n, at)), shortest_s, longest_s)


@pytest.mark.parametrize(
    ("at", "user", "would_be"),
    [
        (99.5, (0.0, np.inf), "longer"),
        (97.0, (0.0, np.inf), None),
        (0.0201, (0.0, np.inf), "shorter"),
        (0.0210, (0.0, np.inf), None),
        (1.0, (0.0, np.inf), None),
        (99.5, (0.0, 200.0), None),  # 199 s are at the user's own bound of 200
        (99.5, (0.0, 210.0), "longer"),
        (0.0201, (0.04, np.inf), None),
        (0.0201, (0.037, np.inf), "shorter"),
        (99.5, (199.0, 199.0), None),
    ],
)
def test_a_duration_within_a_hundredth_of_a_bound_that_is_not_the_user_s_would_go_on(at, user, would_be):
    assert held_by(at, uniform(4), *user) == would_be


def test_a_motion_with_switch_times_is_not_held_by_its_guess():
    assert held_by(99.5, segmented(np.array([1.0, 1.0]), 8)) is None
