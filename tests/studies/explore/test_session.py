"""An explored problem: its sliders, the problem at their values, and the reports that follow."""

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.poses.assembly import advance
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.explore.session import Session
from linkplan.studies.output.document import Animation, Facts, Table
from tests.support.refusals import assert_refused
from tests.support.reports import blocks


@pytest.fixture(scope="module")
def session():
    return Session(first=load_problem("knee-reach"))


def test_the_sliders_are_those_of_the_problem(session):
    found = {slider.key: slider for slider in session.sliders()}
    assert set(found) == {"start_deg.O", "goal_deg.O", "duration_s", "effort_percent", "payload_kg", "kp", "kd"}
    assert (found["goal_deg.O"].low, found["goal_deg.O"].high, found["goal_deg.O"].value) == (
        -90.0,
        pytest.approx(78.5217, abs=1e-3),
        56.27,
    )
    assert found["payload_kg"].value == 4.0
    assert session.controls()["objective"] == "effort"


@pytest.mark.parametrize("name", ["knee-reach", "knee-linear-reach", "five-bar-reach", "gripper-close"])
def test_the_sliders_of_a_motion_s_ends_lead_to_poses_that_close(name):
    """Sliders that end at the joints' ranges ask for poses beyond the reach, which are refused."""
    session = Session(first=load_problem(name))
    ends = [slider for slider in session.sliders() if slider.key.startswith(("start", "goal"))]
    assert len(ends) >= 2
    for slider in ends:
        assert slider.low < slider.value < slider.high
        for value in (slider.low, slider.high):
            problem = session.problem_at({slider.key: value}, None)
            if slider.key.startswith("goal"):
                goal = np.asarray(problem.motion.goal)
                assert advance(problem.mechanism, problem.start_pose(), goal)[1], slider.key


def test_gains_and_trackers_change_the_tracked_run_and_not_the_plan(session):
    def rms_deg(values, tracker):
        report, said = session.report(values, None, tracker)
        assert said["passed"]
        (errors,) = [table for table in blocks(report, Table) if ("rms error", "deg") in table.columns]
        assert errors.rows[0][0] == tracker
        return errors.rows[0][errors.columns.index(("rms error", "deg"))], said["message"]

    soft, first = rms_deg({"kp": 100.0}, "pd")
    stiff, second = rms_deg({"kp": 400.0}, "pd")
    fed, third = rms_deg({"kp": 100.0}, "pd+ff")
    assert soft > 1.5 * stiff
    assert fed < 0.2 * stiff
    assert first == second == third
    assert_refused(lambda: session.report({}, None, "pid"), "unknown tracker 'pid'", kind=ProblemError)


def test_every_joint_has_sliders_of_its_own_gains():
    gains = {"tracking.kp": {"O1": 20.0, "O2": 40.0}, "tracking.kd": {"O1": 2.0, "O2": 0.0}}
    session = Session(first=load_problem("five-bar-reach").replace(gains))
    found = {slider.key: slider for slider in session.sliders() if slider.key.startswith("k")}
    assert {key: (one.value, one.unit) for key, one in found.items()} == {
        "kp.O1": (20.0, "N.m/rad"), "kp.O2": (40.0, "N.m/rad"), "kd.O1": (2.0, "N.m.s/rad"),
    }  # fmt: skip
    assert session.problem_at({"kp.O2": 60.0}, None).tracking.kp == {"O1": 20.0, "O2": 60.0}


def test_a_problem_of_other_values_is_not_described_as_the_first():
    session = Session(first=load_problem("knee-reach"))
    assert session.described().to_toml() == session.first.to_toml()
    session.current = session.problem_at({"duration_s": 0.2}, "work")
    assert "0.16 s" not in session.described().to_toml()
    assert session.described().to_dict()["description"] == "a reach in 0.2 s with least work, from exploring knee-reach"
    session.current = session.problem_at({}, "time")
    assert session.described().to_dict()["description"] == "a reach in free time with least time, from exploring knee-reach"


def test_values_are_those_of_the_planned_problem(session):
    values = {"goal_deg.O": 40.0, "duration_s": 0.2, "effort_percent": 80.0, "payload_kg": 3.0}
    problem = session.problem_at(values, "work")
    tables = problem.to_dict()
    assert (tables["motion"]["goal_deg"], tables["motion"]["duration_s"]) == ({"O": 40.0}, 0.2)
    assert problem.limits.effort[0].tolist() == [-80.0, 80.0]
    assert problem.mechanism.payload.mass_kg == 3.0
    assert tables["objective"]["minimize"] == "work"
    assert session.problem_at(values, "time").motion.duration_s is None


@pytest.mark.parametrize("payload", ["'shank'", "{ mass_kg = 4.0, body = 'coupler', com_m = [0.1, 0.0, 0.0] }"])
def test_every_number_that_the_problem_names_has_a_slider(payload):
    named = ("payload.mass={ range = [3.5, 4.5] }", "coupler.length={ tolerance = 1e-4 }", "A.damping=0.01")
    problem = load_problem("knee-reach", [f"mechanism.payload={payload}", *(f"parameters.{one}" for one in named)])
    varied = Session(first=problem)
    found = {one.key: one for one in varied.sliders()}
    assert "payload_kg" not in found
    assert (found["parameters.payload.mass"].low, found["parameters.payload.mass"].high) == (3.5, 4.5)
    moved = varied.problem_at({"parameters.payload.mass": 4.4, "parameters.coupler.length": 0.075}, None).mechanism
    assert moved.payload.mass_kg == 4.4
    assert {one.name: one.value for one in moved.parameters}["coupler.length"] == 0.075


def test_what_no_slider_gives_is_refused(session):
    for values, said in (
        ({"goal_deg.A": 1.0}, "unknown slider"),
        ({"duration_s": -1.0}, "motion.duration_s must be"),
        ({"effort_percent": 0.0}, "effort_percent must be"),
        ({"goal_deg.O": 500.0}, "motion.goal_deg"),
        ({"duration_s": "long"}, "duration_s"),
    ):
        with pytest.raises(ProblemError, match=said):
            session.problem_at(values, None)
    assert_refused(lambda: Session(first=load_problem("knee-sine")), "explore needs a reach", kind=ProblemError)


def test_boxes_go_beyond_the_ends_of_their_sliders_and_the_saved_changes_are_named(session):
    (slider,) = [one for one in session.sliders() if one.key == "duration_s"]
    far = 2.0 * slider.high
    problem = session.problem_at({"duration_s": far, "effort_percent": 150.0}, None)
    assert (problem.motion.duration_s, problem.limits.effort[0, 1]) == (far, 150.0)
    other = Session(first=session.first)
    assert other.changes() == "the problem as it was read"
    other.current = problem
    assert other.changes() == f"limits.effort.act_O = [-150, 150], motion.duration_s = {far:g}"


def test_a_moved_slider_gives_the_plan_of_its_problem(session):
    session.report({}, None)
    document, said = session.report({"duration_s": 0.2}, None)
    assert said["passed"]
    (moving, *_) = blocks(document, Animation)
    assert [ghost.name for ghost in moving.ghosts] == ["pd+ff"]
    expected = plan_motion(load_problem("knee-reach", ["motion.duration_s=0.2"]))
    rows = dict(blocks(document, Facts)[0].rows)
    assert float(rows["objective"].split()[1]) == pytest.approx(expected.objective, rel=1e-5)
    text = session.current.to_toml()
    assert Problem.from_tables("again", session.current.to_dict()).to_toml() == text
    assert "duration_s = 0.2" in text


def test_a_motion_that_there_is_not_is_told(session):
    document, said = session.report({"duration_s": 0.06}, None)
    assert not said["passed"]
    assert document.passed is False
    assert "infeasible" in said["message"]
