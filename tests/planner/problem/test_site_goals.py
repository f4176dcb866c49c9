"""Starts and goals by places of sites: the plan ends there, by MuJoCo; open poses end in the best one."""

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.replan import Replanner
from tests.support.arms import LOWER, UPPER, angles_at, foot_of
from tests.support.refusals import assert_names, refusal
from tests.support.sites import ABOVE, BELOW, arm_of, places_along, plan_of, site_problem
from tests.support.tolerances_planner import IK_RAD, MINIMUM_TIME

THREE = (0.25, 0.2, 0.15)
BENT = {"J1": 60.0, "J2": 40.0, "J3": 20.0}
OPEN = {"start_deg": BENT, "goal_at": {"foot": [0.2, 0.0, -0.3]}, "duration_s": 0.5}


def test_a_place_stands_for_the_pose_of_the_cosine_rule():
    problem = site_problem(
        arm_of(UPPER, LOWER), {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}, "duration_s": 0.6}
    )
    motion = problem.motion
    assert not motion.goal_is_free
    bend = np.sign(motion.start[1])
    assert motion.start == pytest.approx(angles_at(0.3, 0.35, bend), abs=IK_RAD)
    assert foot_of(motion.goal)[0] == pytest.approx(BELOW, abs=1e-9)


def test_the_plan_ends_where_mujoco_has_the_place():
    plan = plan_of(arm_of(UPPER, LOWER), {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}, "duration_s": 0.6})
    places = places_along(plan)
    assert np.abs(places[[0, -1]] - [ABOVE, BELOW]).max() < 1e-8
    assert plan.certificate.site_error_m < 1e-8
    assert np.ptp(places[:, 2]) > 0.5  # it went there


def test_a_place_is_worth_as_much_as_its_pose():
    by_place = plan_of(
        arm_of(0.3), {"start_deg": {"J1": 60}, "goal_at": {"foot": [0.3, 0, 0]}}, objective={"minimize": "time"}
    )
    by_joint = plan_of(arm_of(0.3), {"start_deg": {"J1": 60}, "goal_deg": {"J1": 0}}, objective={"minimize": "time"})
    assert by_place.objective == pytest.approx(by_joint.objective, rel=MINIMUM_TIME)


@pytest.mark.parametrize("coordinates", [[0.3, 0.0, -0.35], {"x": 0.3, "z": -0.35}])
def test_coordinates_that_cannot_move_may_be_given_or_not(coordinates):
    problem = site_problem(arm_of(UPPER, LOWER), {"start_at": {"foot": ABOVE}, "goal_at": {"foot": coordinates}})
    assert foot_of(problem.motion.goal)[0] == pytest.approx(BELOW, abs=1e-9)


@pytest.mark.parametrize("settings", [{}, {"mesh": {"scheme": "hermite-simpson"}}], ids=str)
def test_an_open_pose_ends_in_a_better_one_than_guessed(settings):
    mechanism = arm_of(*THREE)
    plan = plan_of(mechanism, OPEN, **settings)
    motion = plan.problem.motion
    assert motion.goal_rows == (0, 2)
    end = plan.trajectory.position[-1, -1]
    assert foot_of(end, THREE)[0] == pytest.approx([0.2, 0, -0.3], abs=1e-8)
    guessed = {f"J{k + 1}": float(np.degrees(angle)) for k, angle in enumerate(motion.goal)}
    held = plan_of(mechanism, {"start_deg": BENT, "goal_deg": guessed, "duration_s": 0.5})
    assert plan.objective < 0.95 * held.objective
    # And no worse than the end that it chose, asked for by joints.
    chosen = {f"J{k + 1}": float(np.degrees(angle)) for k, angle in enumerate(end)}
    again = plan_of(mechanism, {"start_deg": BENT, "goal_deg": chosen, "duration_s": 0.5}, **settings)
    assert plan.objective == pytest.approx(again.objective, rel=1e-5)


@pytest.mark.slow
def test_an_open_pose_of_a_closed_loop_ends_at_its_height():
    """Its efforts leave their limits next to each other, which refinement tells apart."""
    motion = {"start_deg": {"O1": -90.0, "O2": -90.0}, "goal_at": {"P": {"z": -0.25}}, "duration_s": 0.5}
    plan = plan_of(load_mechanism("five-bar"), motion, objective={"minimize": "work"})
    assert plan.problem.motion.goal_rows == (2,)
    assert places_along(plan, "P")[-1, 2] == pytest.approx(-0.25, abs=1e-8)
    assert plan.certificate.closure_gap_m < 1e-9


def test_an_open_pose_of_a_loop_needs_a_node_at_the_end():
    motion = {"start_deg": {"O1": -90.0, "O2": -90.0}, "goal_at": {"P": {"z": -0.25}}, "duration_s": 0.5}
    said = refusal(lambda: site_problem(load_mechanism("five-bar"), motion, mesh={"scheme": "gauss-3"}), ProblemError)
    assert_names(said, "goal_at", "gauss-3", "radau", "hermite-simpson")


def test_an_open_goal_is_a_number_of_a_built_program():
    planner, mechanism = Replanner(), arm_of(*THREE)
    assert not planner.plan(site_problem(mechanism, OPEN)).solved_again
    again = planner.plan(site_problem(mechanism, OPEN | {"goal_at": {"foot": [0.22, 0.0, -0.28]}}))
    assert again.solved_again
    assert places_along(again)[-1] == pytest.approx([0.22, 0, -0.28], abs=1e-8)
    other = planner.plan(site_problem(mechanism, OPEN | {"goal_at": {"foot": {"x": 0.2}}}))
    assert other.status == "optimal"
    assert not other.solved_again  # it asks for less, which is another program


def test_a_periodic_motion_is_at_its_goal_in_its_middle():
    motion = {"kind": "periodic", "start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}, "duration_s": 1.0}
    plan = plan_of(arm_of(UPPER, LOWER), motion)
    middle = plan.trajectory.position_at(np.array([0.5 * plan.trajectory.duration_s]))
    assert foot_of(middle)[0] == pytest.approx(BELOW, abs=1e-7)
    assert plan.certificate.site_error_m < 1e-7


UP = {"start_at": {"foot": ABOVE}}
REFUSED = [
    ({**UP, "goal_at": {"foot": [0.6, 0.0, 0.3]}}, ["goal_at.foot", "out of reach", "0.491935", "0.245967", "0.1208 m"]),
    ({**UP, "goal_at": {"foot": [0.3, 0.1, -0.35]}}, ["out of reach", "[0.3, 0, -0.35]", "0.1 m away"]),
    ({**UP, "goal_at": {"fot": BELOW}}, ["'fot'", "did you mean 'foot'", "base, foot"]),
    ({**UP, "goal_at": {"base": [0, 0, 0]}}, ["goal_at", "base", "cannot move"]),
    ({**UP, "goal_at": {"foot": {"y": 0.0}}}, ["goal_at", "cannot move"]),
    ({**UP, "goal_at": {"foot": [0.3, 0.2]}}, ["goal_at.foot", "[x, y, z]", "[0.3, 0.2]"]),
    ({**UP, "goal_at": {"foot": [0.3, 0.0, np.nan]}}, ["goal_at.foot[2]", "a number", "nan"]),
    ({**UP, "goal_at": {"foot": {"x": "far"}}}, ["goal_at.foot.x", "a number", "'far'"]),
    ({**UP, "goal_at": {"J1": 30.0}}, ["goal_at.J1 must be a site's place", "joint J1's position is motion.goal_deg"]),
    ({**UP, "goal_at": [0.3, 0, 0]}, ["motion.goal_at", "table of site"]),
    ({**UP, "goal_at": {"foot": BELOW}, "goal_deg": {"J1": 3, "J2": 4}}, ["goal_at", "goal_deg", "keep one"]),
    ({"start_at": {"foot": {"x": 0.3}}, "goal_at": {"foot": BELOW}}, ["start_at", "open", "start_deg"]),
    ({**UP, "goal_at": {"foot": {"x": 0.3}}, "kind": "periodic"}, ["goal_at", "open", "'reach'"]),
    (UP, ["goal_deg", "goal_at"]),
]


@pytest.mark.parametrize(("motion", "words"), REFUSED, ids=lambda item: str(item)[:60])
def test_what_cannot_be_meant_is_refused_in_one_line(motion, words):
    said = refusal(lambda: site_problem(arm_of(UPPER, LOWER), {"duration_s": 0.5, **motion}), ProblemError)
    assert_names(said, *words)


def test_a_prescribed_motion_has_no_place_to_go_to():
    tables = {"reference": {"amplitude_deg": {"J1": 10}, "frequency_hz": 1.0}}
    motion = {"kind": "track", "goal_at": {"foot": [0.3, 0.0, 0.0]}}
    assert_names(refusal(lambda: site_problem(arm_of(0.3), motion, **tables), ProblemError), "goal_at", "'track'")


def test_a_goal_out_of_a_joints_range_is_out_of_reach():
    motion = {"start_deg": {"J1": 60}, "goal_at": {"foot": [0.3, 0.0, 0.0]}, "duration_s": 0.5}
    said = refusal(lambda: site_problem(arm_of(0.3), motion, limits={"range_deg": {"J1": [10, 90]}}), ProblemError)
    nearest = 0.3 * np.array([np.cos(np.radians(10)), np.sin(np.radians(10))])
    assert_names(said, "out of reach", *(f"{x:.6g}" for x in nearest))


def test_what_is_there_already_takes_no_time():
    motion = {"start_at": {"foot": ABOVE}, "goal_at": {"foot": ABOVE}}
    problem = site_problem(arm_of(UPPER, LOWER), {**motion, "duration_s": 0.5})
    assert problem.motion.stays
    assert plan_motion(problem).status == "optimal"
