"""What decides on the way to longer motions: what a step saved, and how near a motion comes to a singular pose."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.closed_chain.guess import Guess
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search import continuations
from linkplan.planner.search.continuations import Continued, _saved_little, continued, nears_singular
from linkplan.planner.search.ladder import KnownMotions
from linkplan.planner.transcription.mesh import uniform


@pytest.mark.parametrize(("before", "after", "little"), [(1.0009, 1.0, True), (1.0011, 1.0, False), (-0.9, -1.0, False)])
def test_a_step_saved_little_below_a_thousandth_of_what_is_left(before, after, little):
    assert _saved_little(SimpleNamespace(objective=before), SimpleNamespace(objective=after)) is little
    assert _saved_little(SimpleNamespace(objective=after), SimpleNamespace(objective=before))


@pytest.mark.parametrize(("furthest", "nears"), [(0.5, False), (1.36, True)])
def test_a_motion_nears_a_singular_pose_where_it_comes_within_half_the_distance_of_its_ends(furthest, nears):
    """The knee's crank from 0.4 rad to `furthest` and back; at 1.37 rad its loop is next to a singular pose."""
    problem = load_problem("knee-sprint")
    begin = 0.4

    def position(t: np.ndarray) -> np.ndarray:
        return (begin + (furthest - begin) * np.sin(np.pi * t))[:, None]

    guess = Guess(
        position=position,
        velocity=position,
        acceleration=position,
        effort=None,
        duration_s=1.0,
        start_pose=problem.start_pose(),
    )
    assert nears_singular(problem, guess) is nears


@pytest.mark.parametrize(
    ("used", "saving", "enough"),
    [(1.0, 0.9e-3, True), (1.0, 1.1e-3, False), (1 - 0.9e-3, 0.9e-3, True), (1 - 1.1e-3, 0.9e-3, False)],
)
def test_the_last_motion_is_enough_if_it_uses_its_time_and_saved_little(used, saving, enough, monkeypatch):
    """Each step uses the share `used` of its allowed duration, and lowers the objective by the share `saving`."""
    problem = load_problem("knee-sprint", ["motion.duration_s=free", "motion.max_duration_s=10.0"])
    known = KnownMotions()

    def step(_problem: object, at: Continued, allowed: float) -> Continued:
        before = 1.0 if at.motion is None else at.objective
        after = before / (1 + saving) if at.motion is not None else 1.0
        start = SimpleNamespace(duration_s=used * allowed)
        return replace(at, start=start, longest_s=allowed, objective=after, motion=SimpleNamespace())

    monkeypatch.setattr(continuations, "_step", step)
    quickest = SimpleNamespace(duration_s=1.0, switch_times_s=None)
    found = continued(problem, quickest, 20, known)
    assert found is not None
    assert found.enough is enough
    assert len(known.motions) == (2 if enough else 1 if used < 1 else 17)


@pytest.mark.parametrize(("least", "kept"), [(1.1, True), (1.2, False)])
def test_a_lost_step_is_tried_again_on_finer_meshes_and_leaves_the_last_motion_if_it_is_long_enough(
    least, kept, monkeypatch
):
    """No motion of more than 1.16 s is found. The step of 15 % is halved twice (its square root, and the root of that)."""
    problem = load_problem(
        "knee-sprint", ["motion.duration_s=free", "motion.max_duration_s=10.0", f"motion.min_duration_s={least}"]
    )
    lost = []

    def step(_problem: object, at: Continued, allowed: float) -> Continued | None:
        if allowed > 1.16:
            lost.append((at.mesh.n_intervals, allowed))
            return None
        start = SimpleNamespace(duration_s=allowed)
        return replace(at, start=start, longest_s=allowed, objective=-allowed, motion=SimpleNamespace())

    monkeypatch.setattr(continuations, "_step", step)
    monkeypatch.setattr(continuations, "nears_singular", lambda *_: False)
    monkeypatch.setattr(continuations, "graded_mesh", lambda _start, _switches, n: (uniform(n), np.ones(1)))
    quickest = SimpleNamespace(duration_s=1.0, switch_times_s=None)
    found = continued(problem, quickest, 100, KnownMotions())
    intervals, allowed = zip(*lost, strict=True)
    assert intervals == (100, 200, 320)
    assert allowed == pytest.approx([1.15 ** (1 + power) for power in (1.0, 0.5, 0.25)])
    assert (found is not None) is kept
    assert found is None or (found.lost and found.longest_s == pytest.approx(1.15))
