"""Notes on starts and goals that the motors cannot hold at rest."""

import pytest

from linkplan.planner.problem.problem import Problem

# A pendulum whose weight needs 4.905 sin(angle) N.m.
PENDULUM = """<mujoco><worldbody><body name="rod"><joint name="J" axis="0 1 0" {friction}/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody>
<actuator>{motor}<motor name="m" joint="J" ctrlrange="-3 3"/></actuator></mujoco>"""
SECOND = '<motor name="other" joint="J" ctrlrange="-2 2"/>'


def notes(start: float, goal: float, friction: str = "", motor: str = "", **arguments) -> list[str]:
    text = PENDULUM.format(friction=friction, motor=motor)
    problem = Problem.reach(text, start_deg={"J": start}, goal_deg={"J": goal}, duration_s=1.0, **arguments)
    return [note for note in problem.notes if "cannot hold" in note]


def test_a_goal_that_needs_more_than_the_limit_is_noted_with_what_is_missing():
    (note,) = notes(0.0, 90.0)
    assert note.startswith("the motors cannot hold the goal at rest: their limits lack 1.905 N.m on joint J")


@pytest.mark.parametrize(
    "motion",
    [
        {"start": 0.0, "goal": 37.0},
        {"start": 0.0, "goal": 180.0},
        {"start": 0.0, "goal": 90.0, "motor": SECOND},
        {"start": 0.0, "goal": 90.0, "friction": 'frictionloss="2"'},
        {"start": 0.0, "goal": 90.0, "goal_speed_deg_s": {"J": 20.0}},
        {"start": 0.0, "goal": 90.0, "limits": {"effort": {"m": [-5.0, 5.0]}}},
    ],
    ids=["within", "upright", "two motors", "friction", "moving", "wider limits"],
)
def test_ends_that_are_held_or_passed_have_no_note(motion):
    assert notes(**motion) == []


def test_a_start_is_noted_too():
    assert [note[:37] for note in notes(-90.0, 120.0)] == [
        "the motors cannot hold the start at r",
        "the motors cannot hold the goal at re",
    ]
