"""What a plan leaves out is named in it: contacts along the motion too."""

from dataclasses import replace

from models.library import built_in_text
from models.mechanism import load_mechanism
from planner.plan_folder import record
from planner.planning import plan_motion
from planner.problem_file import load_problem


def test_contacts_along_the_motion_are_named_in_the_plan():
    colliding = built_in_text("optimus-knee").replace('contype="0" conaffinity="0"', 'contype="1" conaffinity="1"')
    problem = load_problem("knee-reach")
    touching = plan_motion(replace(problem, mechanism=load_mechanism(colliding, payload="shank")))
    assert touching.status == "optimal"
    assert any("contact of geoms L2 and B" in text for text in record(touching)["not_honoured"])
    assert record(plan_motion(problem))["not_honoured"] == []
