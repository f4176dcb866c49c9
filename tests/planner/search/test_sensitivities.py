"""Slopes of an optimal objective by numbers of the machine, against plans of machines with other numbers."""

from dataclasses import replace

import pytest

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.planner.search.planning import plan_motion, saved_price
from linkplan.planner.search.sensitivities import sensitivities_of, with_sensitivities
from linkplan.studies.output.plan_blocks import sensitivity_blocks
from tests.support.plans import optimal

NUMBERS = {
    "crank.mass": {},
    "coupler.length": {"tolerance": 1e-4},
    "O.armature": 1e-3,
    "A.damping": 1e-3,
    "C.friction": 0.01,
}


def slopes(problem: linkplan.Problem) -> dict[str, float]:
    plan = with_sensitivities(plan_motion(problem))
    return {one.name: one.slope for one in sensitivities_of(plan)}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["knee-reach", "knee-sprint"])
def test_slopes_are_those_of_plans_of_changed_machines(name):
    problem = linkplan.Problem.from_file(name).replace(parameters=NUMBERS)
    found = slopes(problem)
    values = {one.name: one.value for one in problem.mechanism.parameters}
    for number in ("payload.mass", "crank.mass", "coupler.length", "O.armature", "C.friction"):
        step = 1e-3 * values[number]
        ends = [
            plan_motion(problem.replace(f"parameters.{number}.value", values[number] + sign * step)).objective
            for sign in (1, -1)
        ]
        assert found[number] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5), number


def test_a_least_time_of_one_motor_has_slopes_although_it_needs_no_program():
    # T = 2 sqrt(d (m + a) / F): a slide of mass m with the armature a is moved by d with the force F.
    text = """<mujoco><option gravity="0 0 0"/><worldbody><body name="b"><joint name="x" type="slide" axis="1 0 0"/>
    <geom size="0.1" mass="2"/></body></worldbody>
    <actuator><motor name="m" joint="x" ctrlrange="-10 10"/></actuator></mujoco>"""
    problem = linkplan.Problem.reach(
        text, start_m={"x": 0.0}, goal_m={"x": 0.5}, minimize="time", parameters={"b.mass": {}, "x.armature": 0.5}
    )
    plan = linkplan.plan(problem, sensitivities=True)
    assert plan.objective == pytest.approx(2 * (0.5 * 2.5 / 10) ** 0.5)
    for one in sensitivities_of(plan):
        assert one.slope == pytest.approx(plan.objective / (2 * 2.5), rel=1e-5)
    assert "b.mass" in str(plan)
    assert plan.to_dict()["details"]["slope by b.mass"] == pytest.approx(plan.objective / 5, rel=1e-5)


def test_along_a_path_there_are_no_slopes_and_the_plan_says_so():
    text = """<mujoco><worldbody><body name="a"><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="2"/>
    <site name="tool"/></body></worldbody><actuator><motor joint="x" ctrlrange="-10 10"/></actuator></mujoco>"""
    path = {"site": "tool", "points": [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]}
    problem = linkplan.Problem.follow(text, path=path, duration_s=1.0, parameters={"a.mass": {}})
    plan = with_sensitivities(plan_motion(problem))
    assert plan.objective == pytest.approx(12 * (2 * 0.2) ** 2)  # of a single coordinate, whose equations have no loop
    assert not sensitivities_of(plan)
    assert "no sensitivities: along a path" in plan.message


def test_a_tolerance_says_its_effect():
    problem = linkplan.Problem.reach(
        "optimus-knee",
        start_deg={"O": 0},
        goal_deg={"O": 20},
        duration_s=0.3,
        parameters={"coupler.length": {"tolerance": 1e-4}},
    )
    (one,) = sensitivities_of(with_sensitivities(plan_motion(problem)))
    assert one.by_tolerance == pytest.approx(1e-4 * abs(one.slope))
    assert one.by_one_percent == pytest.approx(0.01 * one.slope * one.value)


def test_slopes_by_nothing_are_refused():
    with pytest.raises(ProblemError, match=r"name them in \[parameters\]"):
        linkplan.plan(linkplan.Problem.from_file("knee-reach", {"mechanism.payload": "none"}), sensitivities=True)


def test_slopes_and_prices_of_a_slide_s_effort_are_in_its_unit():
    plan = optimal("knee-linear-reach")
    plan = replace(plan, details={**plan.details, "slope by payload.mass": 1.0, "objective_as_modelled": 1.0})
    (table,) = sensitivity_blocks(plan)
    assert {unit for _, unit in table.columns} >= {"N2 s", "N2 s per SI"}
    assert saved_price(plan).unit == "N2 s"
