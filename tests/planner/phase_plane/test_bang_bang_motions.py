"""Motions by full effort: parts, turns of steady energy, shares of the effort and speeds at the ends, in closed form."""

import numpy as np
import pytest

from linkplan.planner.phase_plane.bang_bang_motions import (
    least_share,
    least_time_guess,
    parts_of,
    phase_plane_applies,
    phase_plane_guess,
    stretched,
)
from linkplan.planner.problem.problem import Problem
from tests.support.bodies import cart

CRANK = """<mujoco><option gravity="0 0 {gravity}"/><worldbody><body><joint name="J" axis="0 1 0" damping="0.5"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.26 0.26 0.26"/></body></worldbody>
<actuator><motor name="u" joint="J" ctrlrange="{low} {high}"/></actuator></mujoco>"""
MASS, PUSH, PULL = 2.0, 6.0, 4.0
# Relative error of a time that the grid gives.
GRID = 2e-3


def reach(start: float, goal: float, *, joint: str = "", waypoints=(), duration="free", limits=None, **motion) -> Problem:
    given = {"start_m": {"x": start}, "goal_m": {"x": goal}, "duration_s": duration, "limits": limits or {}} | motion
    given |= {"waypoints": list(waypoints)} if waypoints else {}
    return Problem.reach(cart("-4 6", joint=joint), **given, minimize="time" if duration == "free" else "effort")


def at(place: float, speed: float | None = None) -> dict:
    return {"at_m": {"x": place}} | ({} if speed is None else {"speed_m_s": {"x": speed}})


def quickest(problem: Problem):
    found = least_time_guess(problem, problem.start_pose())
    assert found is not None
    return found


def least_time(way: float, ahead: float = PUSH, back: float = PULL) -> float:
    """Return the least time from rest to rest: full effort for the share back / (ahead + back) of the way, then braking."""
    return np.sqrt(2 * MASS * way * (ahead + back) / (ahead * back))


@pytest.mark.parametrize(("start", "goal", "ahead", "back"), [(-1.0, 1.0, PUSH, PULL), (1.0, -1.0, PULL, PUSH)])
def test_a_push_and_a_brake_of_other_size_take_the_closed_form_s_time(start, goal, ahead, back):
    guess = quickest(reach(start, goal))
    assert guess.duration_s == pytest.approx(least_time(2.0, ahead, back), rel=GRID)
    (switch,) = guess.switch_times_s
    assert switch / guess.duration_s == pytest.approx(back / (ahead + back), rel=1e-2)
    assert np.abs(guess.bang_efforts).ravel().tolist() == [ahead, back]
    assert np.abs(guess.effort(np.array([0.0, guess.duration_s]))).ravel().tolist() == [ahead, back]


def test_dry_friction_adds_to_the_brake_and_takes_from_the_push():
    guess = quickest(reach(-1.0, 1.0, joint='frictionloss="1"'))
    assert guess.duration_s == pytest.approx(least_time(2.0, PUSH - 1.0, PULL + 1.0), rel=GRID)


@pytest.mark.parametrize(
    ("places", "speeds", "parts"),
    [
        ([-1.0, 1.0], [None], [([-1.0, 1.0], (0.0, 0.0))]),
        ([-1.0, 0.5, 1.0], [None], [([-1.0, 0.5, 1.0], (0.0, 0.0))]),
        ([-1.0, 0.5, 1.0], [0.3], [([-1.0, 0.5], (0.0, 0.3)), ([0.5, 1.0], (0.3, 0.0))]),
        ([-1.0, 2.0, 1.0], [None], [([-1.0, 2.0], (0.0, 0.0)), ([2.0, 1.0], (0.0, 0.0))]),
        ([-1.0, 0.0, 2.0, 1.0], [None, None], [([-1.0, 0.0, 2.0], (0.0, 0.0)), ([2.0, 1.0], (0.0, 0.0))]),
    ],
)
def test_a_reach_has_a_part_between_each_two_known_speeds(places, speeds, parts):
    """A waypoint at which it turns back is passed at rest; one on the way at any speed, unless one is asked."""
    way = [at(place, speed) for place, speed in zip(places[1:-1], speeds, strict=False)]
    found = parts_of(reach(places[0], places[-1], waypoints=way).motion)
    assert [(part.places.tolist(), part.speeds) for part in found] == parts


def test_a_reach_that_turns_back_takes_the_times_of_its_two_ways():
    guess = quickest(reach(-1.0, 1.0, waypoints=[at(3.0)]))
    times = np.array([least_time(4.0), least_time(2.0)])
    assert guess.boundaries_s == pytest.approx([0.0, times[0], times.sum()], rel=GRID)
    assert guess.position(guess.boundaries_s)[:, 0] == pytest.approx([-1.0, 3.0, 1.0])


@pytest.mark.parametrize(("start", "goal"), [(-1.0, 1.0), (1.0, -1.0)])
@pytest.mark.parametrize(("which", "turns"), [("start", True), ("start", False), ("goal", True), ("goal", False)])
def test_a_speed_at_an_end_adds_the_way_on_which_it_is_lost_or_gathered(start, goal, which, turns):
    """Where it turns, it goes v^2 m / (2 F) beyond its end, in m v / F; else it comes from or goes to a rest out there."""
    way = np.sign(goal - start)
    v = 0.5
    ahead, back = (PUSH, PULL) if way > 0 else (PULL, PUSH)
    effort = ahead if which == "start" else back
    room, time = MASS * v**2 / (2 * effort), MASS * v / effort
    expected = least_time(2.0 + room, ahead, back) + (time if turns else -time)
    guess = quickest(reach(start, goal, **{f"{which}_speed_m_s": {"x": (-v if turns else v) * way}}))
    assert guess.duration_s == pytest.approx(expected, rel=2 * GRID)


@pytest.mark.parametrize("turns", [1, -1])
def test_a_damped_crank_turns_at_the_speed_at_which_dampers_take_full_effort(turns):
    """u = c w: 4 N.m over 0.5 N.m.s make 8 rad/s, and 3 N.m backwards 6 rad/s."""
    motion = {"turns": {"J": turns}, "start_deg": {"J": -200.0 * turns}, "minimize": "time"}
    guess = quickest(Problem.periodic(CRANK.format(gravity=0, low=-3, high=4), **motion))
    assert guess.duration_s == pytest.approx(2 * np.pi / (8.0 if turns > 0 else 6.0), rel=GRID)
    problem = Problem.periodic(CRANK.format(gravity=-9.81, low=-3, high=4), **motion)
    guess = quickest(problem)
    speeds = guess.velocity(np.array([0.0, guess.duration_s]))[:, 0]
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-3)
    times = np.linspace(0.0, guess.duration_s, 4001)
    s, v = guess.position(times)[:, 0], guess.velocity(times)[:, 0]
    given = turns * 2 * np.pi * (4.0 if turns > 0 else -3.0)
    assert np.trapezoid(0.5 * v**2, times) == pytest.approx(given, rel=1e-3)  # what is pushed in is damped
    assert s[-1] - s[0] == pytest.approx(2 * np.pi * turns)


def test_the_least_share_of_the_effort_falls_with_the_square_of_the_time():
    problem, slower = reach(-1.0, 1.0), 0.45
    duration = slower * least_time(2.0)
    share, guess = least_share(problem, problem.start_pose(), duration)
    assert share == pytest.approx(slower**-2, rel=5e-3)
    assert share >= slower**-2 * (1 - 2 * GRID)
    assert guess.duration_s <= duration
    assert guess.duration_s == pytest.approx(duration, rel=5e-3)


@pytest.mark.parametrize("duration", [1.3, 4.0])
def test_a_guess_of_a_fixed_duration_takes_it_and_goes_the_same_way(duration):
    problem = reach(-1.0, 1.0, duration=duration * least_time(2.0))
    fixed = phase_plane_guess(problem, quickest(problem))
    assert fixed.duration_s == pytest.approx(duration * least_time(2.0))
    ends = np.array([0.0, fixed.duration_s])
    np.testing.assert_allclose(fixed.position(ends)[:, 0], [-1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(fixed.velocity(ends)[:, 0], 0.0, atol=1e-6)


def test_a_stretched_motion_is_slower_by_its_factor_and_pushes_by_its_square():
    guess = quickest(reach(-1.0, 1.0, waypoints=[at(0.5)]))
    slow, t = stretched(guess, 3.0 * guess.duration_s), np.linspace(0.0, guess.duration_s, 13)
    np.testing.assert_allclose(slow.position(3 * t), guess.position(t))
    np.testing.assert_allclose(3 * slow.velocity(3 * t), guess.velocity(t))
    np.testing.assert_allclose(9 * slow.acceleration(3 * t), guess.acceleration(t))
    np.testing.assert_allclose(slow.boundaries_s, 3 * guess.boundaries_s)


def test_a_speed_limit_is_kept_and_takes_the_time_of_a_trapezoid():
    """Up to 1 m/s by 3 m/s2, down by 2 m/s2, and the rest of the 2 m at 1 m/s."""
    guess = quickest(reach(-1.0, 1.0, limits={"speed_m_s": {"x": 1.0}}))
    ramps = 1.0 / 3.0, 1.0 / 2.0
    assert guess.duration_s == pytest.approx(sum(ramps) + 2.0 - 0.5 * sum(ramps), rel=GRID)
    assert np.abs(guess.velocity(np.linspace(0.0, guess.duration_s, 501))).max() <= 1.0 + 1e-6
    assert guess.switch_times_s is None
    fast = quickest(reach(-1.0, 1.0, limits={"speed_m_s": {"x": 9.0}}))
    assert len(fast.switch_times_s) == 1


def test_the_phase_plane_is_for_reaches_with_limited_efforts_and_waypoints_at_places_of_any_time():
    assert phase_plane_applies(reach(-1.0, 1.0, waypoints=[at(0.5)]))
    assert not phase_plane_applies(reach(-1.0, 1.0, duration=2.0, waypoints=[at(0.5) | {"time_s": 1.0}]))
