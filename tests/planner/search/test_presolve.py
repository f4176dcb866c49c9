"""Contradictions that are found without solving, on both sides of each limit, with the numbers of their sentences."""

import numpy as np
import pytest

from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.presolve import no_way_to_stop, only_way, plain_contradiction
from tests.support.bodies import UNIT_ARM

# A mass of 2 kg on a rail, pushed by -4 to 6 N; from 0.5 m/s it stops within m v^2 / (2 F).
CART = """<mujoco><option gravity="0 0 0"/><worldbody>
<body><joint name="x" type="slide" axis="1 0 0" range="-9 9" frictionloss="{friction}"/>
<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody>
<actuator>{drive}</actuator></mujoco>"""
MOTOR = '<motor name="push" joint="x" ctrlrange="-4 6"/>'
SPEED = 0.5


def stop(force: float) -> float:
    return 2.0 * SPEED**2 / (2 * force)


def reach(start: float, goal: float, *, friction=0.0, drive=MOTOR, duration=None, limits=None, **motion) -> Problem:
    given = {"kind": "reach", "start_m": {"x": start}, "goal_m": {"x": goal}, "duration_s": duration or "free"}
    model = {"model": CART.format(friction=friction, drive=drive)}
    tables = {"mechanism": model, "motion": given | motion}
    tables |= {"objective": {"minimize": "effort" if duration else "time"}, "limits": limits or {}}
    return Problem.from_tables("cart", tables)


@pytest.mark.parametrize("way", [+1, -1])
@pytest.mark.parametrize("which", ["start", "goal"])
@pytest.mark.parametrize("friction", [0.0, 1.0])
@pytest.mark.parametrize(("share", "refused"), [(0.99, True), (1.01, False)])
def test_a_speed_towards_an_end_of_the_range_needs_the_way_that_full_effort_takes(way, which, friction, share, refused):
    """Away from the other end of the motion: at the start it is stopped, with friction's help; at the goal gathered."""
    at_start = which == "start"
    force = (4.0 if way > 0 else 6.0) + friction if at_start else (6.0 if way > 0 else 4.0) - friction
    side = way if at_start else -way
    for place in (side * 1.0, -side * 1.0):
        bound = place + side * share * stop(force)
        other = place - side * 1.0
        ends = (place, other) if at_start else (other, place)
        speed = {f"{which}_speed_m_s": {"x": way * SPEED}}
        limits = {"range_m": {"x": [-9.0, bound] if side > 0 else [bound, 9.0]}}
        said = no_way_to_stop(reach(*ends, friction=friction, limits=limits, **speed))
        assert (said is not None) is refused
        if refused:
            assert f"{'stops' if at_start else 'gathers'} the 0.5 m/s of joint x at the {which}" in said.words
            assert f"within the {abs(bound - place):.4g} m to the end of its range at {bound:.5g} m" in said.words


@pytest.mark.parametrize(("speed", "refused"), [(0.0, True), (0.2, True), (0.48, False)])
@pytest.mark.parametrize("start", [-1.0, 1.0])
def test_a_goal_on_the_way_may_be_passed_as_fast_as_braking_leaves_it(start, speed, refused):
    """0.99 of the stop lies before the end; after 0.1 of it v^2 has fallen by a tenth: to 0.474 m/s."""
    room = stop(4.0)
    passing = {"goal_speed_m_s": {"x": speed}} if speed else {}
    limits = {"range_m": {"x": [-9.0, start + 0.99 * room]}}
    problem = reach(start, start + 0.1 * room, limits=limits, start_speed_m_s={"x": SPEED}, **passing)
    assert (no_way_to_stop(problem) is not None) is refused


@pytest.mark.parametrize(("speed", "refused"), [(0.39, False), (0.41, True), (-0.19, False), (-0.21, True)])
@pytest.mark.parametrize("which", ["start_speed", "goal_speed"])
def test_a_speed_at_an_end_beyond_its_limit_is_refused_with_the_limit_on_its_side(which, speed, refused):
    problem = reach(0.0, 1.0, limits={"speed_m_s": {"x": [-0.2, 0.4]}}, **{f"{which}_m_s": {"x": speed}})
    said = plain_contradiction(problem)
    assert (said is not None) is refused
    if refused:
        assert (
            f"motion.{which} of joint x is {speed:g} m/s, beyond its speed limit of {0.4 if speed > 0 else -0.2:g} m/s"
            in said.words
        )


@pytest.mark.parametrize(
    ("goal", "duration", "shortest"), [(1.0, 2.51, None), (1.0, 2.49, 2.5), (-1.0, 5.1, None), (-1.0, 4.9, 5.0)]
)
def test_a_mean_speed_beyond_its_limit_is_refused_with_the_duration_that_the_limit_asks_for(goal, duration, shortest):
    said = plain_contradiction(reach(0.3, 0.3 + goal, duration=duration, limits={"speed_m_s": {"x": [-0.2, 0.4]}}))
    assert (said is not None) is (shortest is not None)
    if shortest is not None:
        assert f"at {goal / duration:.4g} m/s on average over {duration:g} s" in said.words
        assert f"speed limit of {0.4 if goal > 0 else -0.2:g} m/s; this limit alone requires {shortest:g} s" in said.words


@pytest.mark.parametrize(("most", "refused"), [(0.79, True), (0.81, False)])
@pytest.mark.parametrize("name", ["start", "goal"])
def test_a_servo_whose_range_gives_no_effort_within_its_limits_is_refused(name, most, refused):
    """A force of 10 (c - x) N within 2 N either way: at 1 m it asks for a ctrl of 0.8 at least."""
    servo = f'<position name="s" joint="x" kp="10" ctrlrange="-3 {most}"/>'
    ends = (1.0, -1.0) if name == "start" else (-1.0, 1.0)
    said = plain_contradiction(reach(*ends, drive=servo, limits={"effort": {"s": [-2.0, 2.0]}}))
    assert (said is not None) is refused
    if refused:
        assert f"s on joint x would need a ctrl of 0.8 at the {name}" in said.words
        assert f"its ctrlrange is -3 to {most:g}" in said.words


@pytest.mark.parametrize(
    ("way", "servo", "said"),
    [
        (-1.0, 'ctrlrange="-0.79 3"', "would need a ctrl of -0.8 at the start"),
        (-1.0, 'ctrlrange="-0.81 3"', None),
        (1.0, 'ctrlrange="-3 0.7" forcerange="-1.9 1.9"', None),
        (1.0, 'ctrlrange="-3 0.7" forcerange="-2.1 2.1"', ""),
    ],
)
def test_a_servo_whose_ctrl_range_asks_for_more_than_the_limits_is_refused_unless_it_is_clamped(way, servo, said):
    """Of all its range the last two would give more than 2 N, but the force is clamped: at 1.9 N it keeps the limits."""
    servo = f'<position name="s" joint="x" kp="10" {servo}/>'
    found = plain_contradiction(reach(way, -way, drive=servo, limits={"effort": {"s": [-2.0, 2.0]}}))
    assert (found is not None) is (said is not None)
    assert not said or said in found.words


@pytest.mark.parametrize(("bound", "refused"), [(1.0 - 1e-9, False), (1.0 - 5e-9, True)])
def test_start_and_goal_may_exceed_a_limit_by_rounding_only(bound, refused):
    said = plain_contradiction(reach(1.0, 0.0, limits={"range_m": {"x": [-2.0, bound]}}))
    assert (said is not None) is refused


@pytest.mark.parametrize(("share", "refused"), [(3e-7, False), (3e-6, True)])
def test_the_only_way_may_exceed_a_limit_by_a_millionth_of_the_extent(share, refused):
    """A tip on a hinge of 1 m, 1 m high in the middle of its way from 70 to 110 degrees."""
    way = Problem.reach(UNIT_ARM, start_deg={"J": 70.0}, goal_deg={"J": 110.0}, duration_s=1.0)
    site = {"tip": {"z": [-9.0, 1.0 - share * way.mechanism.extent_m]}}
    said = plain_contradiction(way.replace(limits={"site": site}))
    assert (said is not None) is refused
    assert said is None or "where J = 90 deg, between start and goal" in said.words


def test_the_only_way_is_from_start_to_goal_of_one_freedom():
    problem = reach(0.25, -1.0)
    way = only_way(problem)[:, problem.mechanism.independent[0]]
    assert (way[0], way[-1]) == (0.25, -1.0)
    assert np.all(np.diff(way) < 0)
    assert np.abs(np.diff(way)).max() < 0.01
