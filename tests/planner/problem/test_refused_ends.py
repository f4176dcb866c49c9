"""Refused starts and goals: the sentence names the end of the reach in the way, or the joint that is missing."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.reach import reach
from linkplan.planner.problem import start
from linkplan.planner.problem.problem import Problem, load_problem


@pytest.mark.parametrize(("beyond", "reason"), [(-0.1, "what lies below"), (0.1, "what lies above")])
def test_the_reason_is_that_of_the_end_beyond_which_a_position_lies(monkeypatch, beyond, reason):
    mechanism = load_problem("knee-reach").mechanism
    found = reach(mechanism)
    ends = {
        name: replace(getattr(found, name), reason=f"what lies {word}")
        for name, word in (("lower", "below"), ("upper", "above"))
    }
    monkeypatch.setattr(start, "reach", lambda _mechanism: replace(found, **ends))
    at = found.upper.position if beyond > 0 else found.lower.position
    with pytest.raises(ProblemError, match=reason):
        start._check_reach(mechanism, None, "goal", np.array([at + beyond]))


def test_a_joint_of_several_is_named_alone():
    five_bar = load_mechanism("five-bar")
    only = five_bar.independent_joints[0].name
    with pytest.raises(ProblemError, match="which is independent") as refused:
        Problem.reach(five_bar, start_deg={only: 0.0}, goal_deg={only: 10.0})
    assert "plans in what is named" not in str(refused.value)
