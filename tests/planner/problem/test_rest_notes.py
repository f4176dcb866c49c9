"""Notes on starts and goals that the motors cannot hold at rest."""

import pytest

from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.presolve import plain_contradiction

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


@pytest.mark.parametrize("key", ["jerk_deg_s3", "effort_rate"])
def test_limits_that_forbid_an_acceleration_at_rest_are_infeasible_there(key):
    name = {"jerk_deg_s3": "J", "effort_rate": "m"}[key]
    text = PENDULUM.format(friction="", motor="")
    limits = {"speed_deg_s": {"J": 1e4}, key: {name: 1e7}}
    asked = {"duration_s": "free", "minimize": "time", "limits": limits}
    verdict = plain_contradiction(Problem.reach(text, start_deg={"J": 0.0}, goal_deg={"J": 90.0}, **asked))
    assert (verdict.kind, verdict.known_by) == ("infeasible", "every motion")
    assert "lack 1.905 N.m on joint J" in verdict.words


def test_a_coordinate_whose_acceleration_is_free_need_not_be_held():
    problem = load_problem("five-bar-reach").replace({"motion.duration_s": "free", "objective.minimize": "time"})
    by_joint = {joint: plain_contradiction(problem.replace("limits.jerk_deg_s3", {joint: 1e6})) for joint in ("O1", "O2")}
    assert by_joint["O2"] is None
    assert "hold the goal at rest" in by_joint["O1"].words
