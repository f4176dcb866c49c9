"""[parameters] of a problem: values, ranges, boxes, and what is refused."""

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import LinkplanError
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.search.planning import plan_motion

REACH = {"start_deg": {"O": 0.0}, "goal_deg": {"O": 20.0}, "duration_s": 0.3}


def reach(**more) -> linkplan.Problem:
    return linkplan.Problem.reach("optimus-knee", **REACH, **more)


def test_a_value_is_that_of_the_machine_and_is_saved():
    problem = reach(parameters={"crank.mass": 0.05, "coupler.length": {"value": 0.0742, "tolerance": 1e-4}})
    assert problem.mechanism.model.body("crank").mass[0] == 0.05
    assert problem.mechanism.gap_m(problem.mechanism.home) < 1e-12
    again = linkplan.Problem.from_tables("again", problem.to_dict())
    assert again.to_dict() == problem.to_dict()
    np.testing.assert_array_equal(again.mechanism.parameter_values, problem.mechanism.parameter_values)


def test_a_setting_changes_one_value_and_keeps_the_others():
    problem = reach(parameters={"crank.mass": 0.05, "O.armature": 0.01})
    heavier = problem.replace("parameters.crank.mass.value", 0.06)
    assert heavier.to_dict()["parameters"] == {"crank.mass": {"value": 0.06}, "O.armature": 0.01}
    assert heavier.mechanism.parameter_values.tolist() == [0.06, 0.01]
    assert heavier.mechanism.model.body("crank").mass[0] == 0.06


def test_a_payload_s_mass_is_the_same_number_by_either_key():
    by_name = linkplan.Problem.from_file("knee-reach", {"parameters.payload.mass": 4.2}).mechanism
    by_table = linkplan.Problem.from_file("knee-reach", {"mechanism.payload.mass_kg": 4.2}).mechanism
    np.testing.assert_array_equal(by_name.parameter_values, by_table.parameter_values)
    assert by_name.model.body("linkplan_payload").mass[0] == by_table.model.body("linkplan_payload").mass[0] == 4.2


def test_a_payload_is_the_one_that_the_machine_carries():
    problem = linkplan.Problem.from_file("knee-reach", {"parameters.payload.mass": 4.2})
    assert problem.mechanism.payload.mass_kg == 4.2
    table = {"body": "crank", "mass_kg": 4.0, "com_m": [0.1, 0.0, 0.0]}
    heavier = linkplan.load_mechanism("optimus-knee", payload=table).with_parameters({"payload.mass": 5.0})
    assert heavier.source["payload"]["mass_kg"] == heavier.payload.mass_kg == 5.0
    assert linkplan.Problem.reach(heavier, **REACH).mechanism.model.body("linkplan_payload").mass[0] == 5.0


def test_a_new_value_keeps_what_else_is_known_of_a_number():
    knee = reach(parameters={"coupler.length": {"value": 0.0741, "tolerance": 1e-4}}).mechanism
    assert knee.with_parameters({"coupler.length": 0.0742}).source["parameters"] == {
        "coupler.length": {"value": 0.0742, "tolerance": 1e-4}
    }


def test_a_planner_plans_a_machine_with_another_link_as_if_it_were_the_first():
    planner = linkplan.Planner()
    found = {}
    for length in (0.0741, 0.08):
        problem = reach(parameters={"coupler.length": length}, limits={"site": {"B_rocker": {"z": [0.0, 1.0]}}})
        found[length] = planner.plan(problem).require().objective
        assert found[length] == pytest.approx(plan_motion(problem).objective, rel=1e-6)
    assert found[0.0741] != pytest.approx(found[0.08], rel=1e-3)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"crank.mass": "heavy"}, r"parameters.crank.mass must be"),
        ({"crank.mass": True}, r"parameters.crank.mass must be"),
        ({"crank.mass": {"vale": 1.0}}, r"unknown key"),
        ({"crank.mass": {"range": [0.1, 0.2]}}, r"range must contain the value"),
        ({"payload.mass": 5.0}, r"mechanism.payload.mass_kg is 4, but parameters.'payload.mass' 5; keep one of them"),
    ],
)
def test_a_model_s_numbers_are_checked_without_a_motion_too(table, said):
    payload = {"body": "crank", "mass_kg": 4.0, "com_m": [0.1, 0.0, 0.0]}
    with pytest.raises(LinkplanError, match=said):
        mechanism_from_tables({"mechanism": {"model": "optimus-knee", "payload": payload}, "parameters": table})


def test_a_box_of_named_numbers_costs_what_its_dearest_corner_costs():
    # The effort of a slide is (m + a) x'', so the least time of the box is that of its heaviest corner.
    text = """<mujoco><option gravity="0 0 0"/><worldbody><body name="b"><joint name="x" type="slide" axis="1 0 0"/>
    <geom size="0.1" mass="2"/></body></worldbody>
    <actuator><motor name="m" joint="x" ctrlrange="-10 10"/></actuator></mujoco>"""
    numbers = {"b.mass": {"range": [1.5, 3.0]}, "x.armature": {"value": 0.5, "range": [0.0, 1.0]}}
    problem = linkplan.Problem.reach(
        text,
        start_m={"x": 0.0},
        goal_m={"x": 0.5},
        minimize="time",
        parameters=numbers,
        robust={"parameters": ["b.mass", "x.armature"]},
    )
    assert len(problem.robust.corners) == 4
    plan = plan_motion(problem)
    assert plan.objective == pytest.approx(2 * (0.5 * 4.0 / 10) ** 0.5, rel=1e-6)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"parameters": {"crank.mas": 1.0}}, r"unknown parameter 'crank.mas' \(did you mean 'crank.mass'\?\)"),
        ({"parameters": {"crank.mass": "heavy"}}, r"parameters.crank.mass must be"),
        ({"parameters": {"crank.mass": {"weight": 1.0}}}, r"unknown key"),
        (
            {"parameters": {"crank.mass": {"range": [0.1, 0.2]}}},
            r"parameters.'crank.mass'.range must contain the value 0.0320\d*, got \[0.1, 0.2\]",
        ),
        (
            {"parameters": {"crank.mass": 0.03}, "robust": {"parameters": ["crank.mass"]}},
            r"robust.parameters names 'crank.mass', which needs a range in \[parameters\]; none has one",
        ),
        (
            {
                "parameters": {"coupler.length": {"range": [0.074, 0.075]}},
                "robust": {"parameters": ["coupler.length"]},
            },
            r"in which efforts are not affine",
        ),
        (
            {"parameters": {"crank.com_z": {"range": [0.0, 0.1]}}, "robust": {"parameters": ["crank.com_z"]}},
            r"in which efforts are not affine",
        ),
        (
            {"parameters": {"act_O.gear": 2.0}, "gear": {"act_O": 3.0}},
            r"mechanism.gear and parameters.'act_O.gear' set the same number; keep one",
        ),
        (
            {"parameters": {"crank.mass": {"range": [0.03, 0.04]}}, "robust": {"parameters": ["crank.mass"] * 2}},
            r"robust.parameters names 'crank.mass' twice",
        ),
        (
            {"parameters": {"O.friction": {"range": [0.0, 0.1]}}, "robust": {"parameters": ["O.friction"]}},
            r"ranges of dry friction are robust.coulomb_friction",
        ),
    ],
)
def test_what_no_machine_has_is_refused(more, said):
    with pytest.raises(LinkplanError, match=said):
        reach(**more)
