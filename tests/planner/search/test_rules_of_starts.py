"""Which starts are worth trying: the phase plane's least time beside the time that is given, on both sides of its error."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from linkplan.planner.closed_chain.guess import guess_along
from linkplan.planner.search import starts
from linkplan.planner.search.starts import (
    _better_plan,
    _of_the_phase_plane,
    _swings_may_be_better,
    along_limits,
    enough_time,
    judged_by_the_phase_plane,
    no_time,
    with_switch_times,
)
from tests.support.bodies import HINGE, QUARTER_TURN, body_plan, body_problem

LEAST_S = 2.0


def search(given_s: float | None, *, switches: bool = True, swings: int = 1, known_s: float | None = None):
    """Return a search whose phase plane has a motion of 2 s, and a time that is given."""
    quickest = SimpleNamespace(
        duration_s=LEAST_S, boundaries_s=None, switch_times_s=np.ones(1) if switches else None, swings=swings
    )
    motion = SimpleNamespace(duration_s=given_s, max_duration_s=None, min_duration_s=None)
    plan = None if known_s is None else SimpleNamespace(passed=True, trajectory=SimpleNamespace(duration_s=known_s))
    known = SimpleNamespace(once=lambda *_: plan)
    return SimpleNamespace(problem=SimpleNamespace(motion=motion), quickest=quickest, known=known)


@pytest.mark.parametrize(
    ("share", "switches", "none"),
    [(1.0011, True, False), (0.9991, True, False), (0.9989, True, True), (0.991, False, False), (0.9899, False, True)],
)
def test_there_is_no_time_for_less_than_the_least_by_more_than_the_grid_s_error(share, switches, none):
    """A thousandth, and a hundredth along speed limits, where switch times are not known."""
    assert no_time(search(share * LEAST_S, switches=switches)) is none


@pytest.mark.parametrize(("known_s", "none"), [(1.9, True), (1.7, False), (None, True)])
def test_of_swings_the_least_time_plan_decides(known_s, none):
    assert no_time(search(1.8, swings=2, known_s=known_s)) is none


@pytest.mark.parametrize(("share", "enough"), [(1.0009, False), (1.0011, True)])
def test_there_is_enough_time_beyond_the_grid_s_error(share, enough):
    assert enough_time(search(share * LEAST_S)) is enough


@pytest.mark.parametrize(("share", "proved"), [(1.0019, True), (1.0021, False)])
def test_a_plan_as_quick_as_the_phase_plane_to_its_error_is_the_quickest(monkeypatch, share, proved):
    monkeypatch.setattr(starts, "other_limits", lambda _: False)
    asked = search(None)
    asked.problem.mechanism = SimpleNamespace(dof=1)
    asked.only_time_counts, asked.best = True, SimpleNamespace(trajectory=SimpleNamespace(duration_s=share * LEAST_S))
    assert judged_by_the_phase_plane(asked) == (proved, None if proved else asked.quickest)
    asked.problem.mechanism = SimpleNamespace(dof=2)
    assert judged_by_the_phase_plane(asked) == (False, None)


@pytest.mark.parametrize(
    ("peak", "swings", "n_starts", "better"),
    [(4.996, 2, 1, True), (4.994, 2, 1, False), (4.996, 1, 1, False), (4.996, 2, 2, False)],
)
def test_swings_may_be_better_where_an_effort_is_at_its_limit_to_a_thousandth(monkeypatch, peak, swings, n_starts, better):
    monkeypatch.setattr(starts, "phase_plane_applies", lambda _: True)
    asked = search(9.0, swings=swings)
    asked.problem.solver, asked.problem.guess = SimpleNamespace(starts=n_starts), None
    asked.problem.limits = SimpleNamespace(effort=np.array([[-3.0, 5.0], [-7.0, 7.0]]))
    asked.best = SimpleNamespace(certificate=SimpleNamespace(peak_effort=np.array([peak, 0.1])))
    assert _swings_may_be_better(asked) is better


@pytest.mark.parametrize(
    ("swings", "passed_s", "only_time", "given_s", "tried_s"),
    [
        (2, None, False, 9.0, [9.0]),
        (2, None, False, None, [LEAST_S]),  # a duration that is free
        (1, None, False, 9.0, []),
        (2, np.array([0.0, LEAST_S]), False, 9.0, []),  # a motion by way of waypoints
        (2, None, True, 9.0, []),
    ],
)
def test_swings_of_least_time_are_a_start_where_the_objective_is_another(
    monkeypatch, swings, passed_s, only_time, given_s, tried_s
):
    asked = search(given_s, swings=swings)
    asked.quickest.boundaries_s, asked.only_time_counts, asked.start_pose = passed_s, only_time, None
    path = CubicHermiteSpline([0.0, LEAST_S], [[0.0], [1.0]], [[0.0], [0.0]])
    monkeypatch.setattr(starts, "least_time_motion", lambda *_: guess_along(path, LEAST_S, np.zeros(1)))
    monkeypatch.setattr(starts, "_cheapest", lambda _: None)
    monkeypatch.setattr(starts, "phase_plane_guess", lambda *_: None)
    *swung, last = _of_the_phase_plane(asked, None)
    assert [(guess.duration_s, guess.swings) for _, guess in swung] == [(duration, swings) for duration in tried_s]
    assert last == ("the phase plane", None)


@pytest.mark.parametrize(
    ("least", "most", "found"), [(None, None, True), (1.1, None, False), (None, 0.9, False), (0.9, 1.1, True)]
)
def test_legs_of_a_second_are_a_plan_where_that_is_within_the_durations_asked(monkeypatch, least, most, found):
    duration = {"duration_s": None, "min_duration_s": least, "max_duration_s": most}
    problem = SimpleNamespace(motion=SimpleNamespace(**duration), objective=SimpleNamespace(weight=lambda _: 3.0))
    monkeypatch.setattr(starts, "legs_motion", lambda *_: SimpleNamespace(duration_s=1.0))
    objectives = []

    def plan_of(_problem, _motion, objective, *_words, **_given):
        objectives.append(objective)
        return "plan"

    monkeypatch.setattr(starts, "without_solving", plan_of)
    monkeypatch.setattr(starts, "replace", lambda plan, **_: SimpleNamespace(passed=True, plan=plan))
    monkeypatch.setattr(starts, "other_limits", lambda _: False)
    for quickest, as_quick in ((None, True), (0.999, True), (0.99, False)):  # a motion that turns back may be quicker
        known = None if quickest is None else SimpleNamespace(duration_s=quickest)
        answer = along_limits(SimpleNamespace(problem=problem, start_pose=None, quickest=known), None)
        assert (answer is not None) is (found and as_quick)
    assert objectives == ([3.0, 3.0] if found else [])


def test_a_least_time_plan_is_a_guess_that_knows_its_switch():
    plan = body_plan(HINGE, QUARTER_TURN + 'duration_s = "free"\n', "objective.minimize=time")
    guess = with_switch_times(plan)
    assert guess.switch_times_s == pytest.approx([plan.trajectory.duration_s / 2], rel=1e-6)
    assert not starts.other_limits(body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n"))


@pytest.mark.parametrize(
    ("passed", "objective", "kept"), [(True, 2.9, True), (True, 3.0, False), (True, 3.1, False), (False, 2.9, False)]
)
def test_of_two_plans_that_pass_the_one_with_the_lower_objective_is_kept(monkeypatch, passed, objective, kept):
    asked = search(None)
    asked.only_time_counts, asked.best = True, SimpleNamespace(objective=3.0)
    found, worth = SimpleNamespace(passed=passed, objective=objective), []

    def plan_from(*_, **given):
        worth.append(given["worth"])
        return found

    monkeypatch.setattr(starts, "judged_by_the_phase_plane", lambda _: (False, asked.quickest))
    monkeypatch.setattr(starts, "plan_from", plan_from)
    assert _better_plan(asked, None) is (found if kept else None)
    assert worth == [pytest.approx(0.999 * 3.0)]
