"""Forces of a model that plans do not honour: refused, or left out on request and named."""

import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.problem import Problem

AIRY = """<mujoco><option density="1.2"/><worldbody><body name="arm"><joint name="J" axis="0 1 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
  <actuator><motor name="motor" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""
TABLES = {
    "mechanism": {"model": AIRY},
    "motion": {"kind": "reach", "start_deg": {"J": 0}, "goal_deg": {"J": 9}, "duration_s": 1.0},
}


def test_a_refusal_names_the_key_that_plans_without_what_is_not_honoured():
    with pytest.raises(ProblemError, match=r"limits\.unhonoured"):
        Problem.from_tables("airy", TABLES)


def test_what_is_not_honoured_is_left_out_on_request_and_said_in_the_plan():
    problem = Problem.from_tables("airy", TABLES | {"limits": {"unhonoured": "note"}})
    (said,) = problem.not_honoured
    assert "false" in said
    assert "fluid forces" in said
    assert problem.mechanism.model.opt.density == 1.2, "the simulator keeps it"
