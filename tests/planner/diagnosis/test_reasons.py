"""Reasons without a motion: what is proved infeasible, and what a known motion or enough effort contradicts."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.models import deadline
from linkplan.planner.diagnosis import reasons
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.problem import load_problem
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem


def search(*known_s: float, named: float | None = None, quickest=None):
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 2.0\n", "limits.speed_deg_s.J=500")
    return SimpleNamespace(
        problem=problem,
        start_pose=problem.start_pose(),
        known=SimpleNamespace(motions=[SimpleNamespace(duration_s=x) for x in known_s]),
        named_limit=None if named is None else SimpleNamespace(factor=named),
        smooth=None,
        quickest=quickest,
        within=lambda _: problem,
    )


@pytest.mark.parametrize(
    ("known_s", "status"),
    [
        ((), "infeasible"),
        ((2.0 * (1 + 0.9e-9),), "failed"),
        ((2.0 * (1 + 1.1e-9),), "infeasible"),
        ((3.0, 1.5), "failed"),
        ((3.0, 4.0), "infeasible"),
    ],
)
def test_a_known_motion_of_the_duration_asked_contradicts_that_there_is_none(monkeypatch, known_s, status):
    """Of the shortest of them, in the duration asked to rounding."""
    monkeypatch.setattr(reasons, "shortest_sentence", lambda *_: "")
    plan = reasons._infeasible(search(*known_s), "infeasible: for a reason", {})
    assert plan.status == status
    assert ("for a reason" in plan.message) is (status == "infeasible")


@pytest.mark.parametrize(("factor", "named"), [(None, False), (1.0, False), (1.01, True)])
def test_efforts_are_a_reason_where_more_than_the_limits_are_needed(monkeypatch, factor, named):
    monkeypatch.setattr(reasons, "effort_sentence", lambda *_: ("too weak", {}))
    monkeypatch.setattr(reasons, "shortest_sentence", lambda *_: "")
    assert (reasons.efforts(search(named=factor)) is not None) is named
    least = None if factor is None else SimpleNamespace(factor=factor)
    monkeypatch.setattr(reasons, "least_limit_of_starts", lambda *_: least)
    plan = reasons.efforts_without_other_limits(search())
    assert (plan is not None) is named
    assert plan is None or "even without its other limits, too weak" in plan.message


@pytest.mark.parametrize(("factor", "named"), [(1.009, False), (1.011, True)])
def test_the_phase_plane_s_factor_is_a_reason_beyond_its_error_along_speed_limits(monkeypatch, factor, named):
    monkeypatch.setattr(reasons, "least_share", lambda *_: (factor, None))
    monkeypatch.setattr(reasons, "share_sentence", lambda *_, **__: "too weak")
    plan = reasons.efforts_by_the_phase_plane(search())
    assert (plan is not None) is named
    assert plan is None or plan.details["needed_limit_factor"] == factor


@pytest.mark.parametrize(("factor", "said"), [(1.0, False), (1.01, True)])
def test_where_nothing_is_found_the_smooth_path_s_effort_is_said_if_it_is_too_large(monkeypatch, factor, said):
    monkeypatch.setattr(reasons, "solver_stopped", lambda _: None)
    monkeypatch.setattr(reasons, "path_effort", lambda *_: SimpleNamespace(factor=factor, sentence="the path is steep"))
    plan = reasons.nothing_found(search())
    assert plan.status == "failed"
    assert ("the path is steep" in plan.message) is said


def test_a_search_that_runs_out_of_time_names_the_effort_that_the_smooth_path_lacks():
    """A reach of a five-bar with two actuators, too short but not by far."""

    def late(_search):
        deadline._CHILD_TIME.seconds += 1000.0
        raise deadline.OutOfTimeError("late")

    problem = load_problem("five-bar-reach", ["motion.duration_s=0.1", "solver.max_time_s=20"])
    plan = plan_motion(problem, rungs=(), diagnoses=(late,))
    assert plan.status == "failed"
    assert "ran out of its 20 s" in plan.message
    assert "along the smooth path from start to goal act_O" in plan.message
    assert "times its limit of" in plan.message


def test_the_least_relaxation_of_a_limit_is_found_by_bisection(monkeypatch):
    """Of a factor of three on the limit at the most; from 1.7 on there is a motion."""
    tried = []
    kind = SimpleNamespace(key="speed", factor=lambda *_: 3.0, scaled=lambda _, factor: factor)

    def solved(_solver, factor: float):
        tried.append(factor)
        return SimpleNamespace(converged=factor >= 1.7, transcribed=SimpleNamespace(factor=factor), x=None)

    first = SimpleNamespace(converged=True, transcribed=SimpleNamespace(factor=3.0), x=None)
    fakes = {
        "transcribe": lambda *_: SimpleNamespace(program=None),
        "motion_of": lambda _: None,
        "solve": lambda *_: first,
        "record": lambda _: None,
        "step_of": lambda *_: None,
        "build_solver": lambda *_, **__: None,
        "renumbered": lambda _, factor, __: factor,
        "run_solver": solved,
        "trajectory_of": lambda transcribed, *_: transcribed.factor,
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(reasons, name, fake)
    solver = SimpleNamespace(deadline=SimpleNamespace(passed=False))
    problem = SimpleNamespace(solver=solver, limits=SimpleNamespace(effort=np.zeros((1, 2))))
    found = reasons.least_of(problem, kind, None, None, None)
    assert 1.7 <= found < 1.7 + 2.0 / 2**12
    assert tried[0] == 2.0
