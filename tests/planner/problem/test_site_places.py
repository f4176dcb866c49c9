"""Ends and waypoints by places of sites: the plan is there, by MuJoCo; what a place leaves open is the best one."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.plan.plan import Plan
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.replan import Replanner, structure
from tests.support.arms import LOWER, UPPER, angles_at, arm, foot_of
from tests.support.refusals import assert_names, refusal
from tests.support.sites import ABOVE, BELOW, arm_of, places_along, plan_of, site_problem
from tests.support.tolerances_planner import IK_RAD, MINIMUM_TIME, SAME_FIGURE

PAST = {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}, "duration_s": 0.6}
VIA = [0.4, 0.0, 0.1]
THREE = (0.25, 0.2, 0.15)
BENT = {"J1": 60.0, "J2": 40.0, "J3": 20.0}
OPEN = {"start_deg": BENT, "goal_at": {"foot": [0.2, 0.0, -0.3]}, "duration_s": 0.5}


def test_a_place_stands_for_the_pose_of_the_cosine_rule():
    motion = site_problem(arm_of(UPPER, LOWER), PAST).motion
    assert not motion.goal_is_free
    bend = np.sign(motion.start[1])
    assert motion.start == pytest.approx(angles_at(0.3, 0.35, bend), abs=IK_RAD)
    assert foot_of(motion.goal)[0] == pytest.approx(BELOW, abs=1e-9)


def test_the_plan_ends_where_mujoco_has_the_place():
    plan = plan_of(arm_of(UPPER, LOWER), PAST)
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


def by_way_of(**waypoint) -> dict:
    """Return the motion past a waypoint."""
    return PAST | {"waypoints": [waypoint]}


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
    (by_way_of(at={"foot": VIA}, at_deg={"J1": 3.0}), ["waypoints[0].at and", "waypoints[0].at_deg", "keep one"]),
    (by_way_of(at={"base": [0.0, 0.0, 0.0]}), ["waypoints[0].at", "cannot move"]),
    (by_way_of(at=[0.4, 0.0, 0.1]), ["motion.waypoints[0].at must be a table of site"]),
    (by_way_of(at_foot=VIA), ["unknown key 'motion.waypoints[0].at_foot'", "at_deg, at_m, at,"]),
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


def arm_by_way_of(*waypoints: dict, mechanism: Mechanism | None = None, **tables: dict) -> Plan:
    return plan_of(mechanism or arm_of(UPPER, LOWER), PAST | {"waypoints": list(waypoints)}, **tables)


def place_at(plan: Plan, time_s: float, site: str = "foot") -> np.ndarray:
    """Return where MuJoCo has a site (3,) [m] at an instant of a plan."""
    mechanism, motion = plan.problem.mechanism, plan.trajectory
    q = follow(mechanism, motion.position_at(np.linspace(0.0, time_s, 50)), motion.start_pose)[-1]
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(q[None])[0]
    mujoco.mj_kinematics(mechanism.model, data)
    return np.array(data.site_xpos[mechanism.model.site(site).id])


def test_a_place_is_passed_at_its_instant():
    plan = arm_by_way_of({"at": {"foot": VIA}, "time_s": 0.3})
    assert plan.problem.motion.waypoints[0].at_rows == ()  # it gives the whole pose
    assert place_at(plan, 0.3) == pytest.approx(VIA, abs=1e-8)
    assert np.abs(place_at(arm_by_way_of(), 0.3) - VIA).max() > 0.05  # it is no accident
    assert plan.certificate.site_error_m < 1e-8


# The correction of the trapezoidal rule's motion on a finer mesh costs 1.2e-4, which its message says.
@pytest.mark.parametrize(
    ("settings", "apart"),
    [({}, 1e-5), ({"mesh": {"scheme": "hermite-simpson"}}, 1e-5), ({"mesh": {"scheme": "trapezoid"}}, 2e-4)],
    ids=str,
)
def test_what_a_place_leaves_open_stands_where_that_costs_least(settings, apart):
    plan = arm_by_way_of({"at": {"foot": {"x": VIA[0]}}, "time_s": 0.3}, **settings)
    found = place_at(plan, 0.3)
    assert found[0] == pytest.approx(VIA[0], abs=1e-8)
    again = arm_by_way_of({"at": {"foot": found.tolist()}, "time_s": 0.3}, **settings)
    assert plan.objective == pytest.approx(again.objective, rel=apart)
    higher = arm_by_way_of({"at": {"foot": [found[0], 0.0, found[2] + 0.05]}, "time_s": 0.3}, **settings)
    assert plan.objective < 0.999 * higher.objective


def test_a_place_at_a_free_instant_costs_less_than_at_a_given_one():
    free, given = (arm_by_way_of({"at": {"foot": {"x": VIA[0]}}} | time) for time in ({}, {"time_s": 0.3}))
    at_breaks = foot_of(free.trajectory.position_at(free.trajectory.breaks_s))
    assert np.abs(at_breaks[:, 0] - VIA[0]).min() < 1e-8
    assert free.objective < 0.95 * given.objective


def test_a_leg_of_three_links_passes_a_point_in_the_best_pose():
    plan = plan_of(arm_of(*THREE), OPEN | {"duration_s": 0.6, "waypoints": [{"at": {"foot": VIA}, "time_s": 0.3}]})
    assert plan.problem.motion.waypoints[0].at_rows == (0, 2)
    assert place_at(plan, 0.3) == pytest.approx(VIA, abs=1e-8)


@pytest.mark.slow
def test_a_closed_loop_passes_a_coordinate():
    motion = {"start_deg": {"O1": -90.0, "O2": -90.0}, "goal_at": {"P": {"z": -0.25}}, "duration_s": 1.0}
    plan = plan_of(load_mechanism("five-bar"), motion | {"waypoints": [{"at": {"P": {"x": 0.07}}, "time_s": 0.5}]})
    assert place_at(plan, 0.5, "P")[0] == pytest.approx(0.07, abs=1e-8)
    assert plan.certificate.closure_gap_m < 1e-9


def test_a_periodic_motion_may_have_its_only_places_on_the_way():
    motion = {"kind": "periodic", "duration_s": 1.0}
    via = [{"at": {"foot": {"z": 0.3}}, "time_s": 0.25}, {"at": {"foot": {"z": -0.3}}, "time_s": 0.75}]
    plan = plan_of(arm_of(UPPER, LOWER), motion | {"waypoints": via})
    assert [place_at(plan, time)[2] for time in (0.25, 0.75)] == pytest.approx([0.3, -0.3], abs=1e-8)


def test_a_certificate_sees_a_waypoint_that_is_missed():
    plan = arm_by_way_of({"at": {"foot": {"x": VIA[0]}}, "time_s": 0.3})
    motion = plan.problem.motion
    moved = replace(motion.waypoints[0].at[0], point=motion.waypoints[0].at[0].point + 1e-4)
    waypoint = replace(motion.waypoints[0], at=(moved,))
    found = certify(plan.problem.varied(motion=replace(motion, waypoints=(waypoint,))), plan.trajectory)
    assert not found.passed
    assert found.site_error_m == pytest.approx(1e-4, rel=1e-6)
    assert any(
        "site foot is 0.0001 m away from the place that motion.waypoints[0].at gives" in said for said in found.failures
    )
    assert any("misses its boundary conditions" in said for said in found.failures)


def test_places_on_the_way_are_numbers_of_a_built_program():
    def asked(at: object) -> dict:
        return PAST | {"waypoints": [{"at": {"foot": at}, "time_s": 0.3}]}

    planner, mechanism = Replanner(), arm_of(UPPER, LOWER)
    planner.plan(site_problem(mechanism, asked({"x": 0.4})))
    again = planner.plan(site_problem(mechanism, asked({"x": 0.38})))
    assert again.solved_again
    assert place_at(again, 0.3)[0] == pytest.approx(0.38, abs=1e-8)
    assert again.objective == pytest.approx(plan_motion(again.problem).objective, rel=SAME_FIGURE)
    kinds = [structure(site_problem(mechanism, asked(at))) for at in ({"x": 0.4}, {"x": 0.3}, {"z": 0.1}, VIA)]
    assert kinds[0] == kinds[1]
    assert len({repr(kind) for kind in kinds}) == 3


def test_an_open_place_needs_a_node_where_it_is_passed():
    motion, mesh = by_way_of(at={"foot": {"x": 0.4}}), {"scheme": "gauss-3"}
    said = refusal(lambda: site_problem(arm_of(UPPER, LOWER), motion, mesh=mesh), ProblemError)
    assert_names(said, "motion.waypoints[0].at", "gauss-3", "radau")


def test_a_motion_tells_where_the_sites_are_that_its_problem_names(tmp_path):
    problem = linkplan.Problem.reach(arm(UPPER, LOWER), **PAST, waypoints=[{"at": {"foot": VIA}, "time_s": 0.3}])
    plan = linkplan.plan(problem)
    assert plan.sample(0.3).site["foot"] == pytest.approx(VIA, abs=1e-8)
    rows = plan.sample(np.array([0.0, 0.6]))
    assert rows.site["foot"] == pytest.approx(np.array([ABOVE, BELOW]), abs=1e-8)
    assert [head for head in rows.columns() if head.startswith("foot_")][:3] == ["foot_x_m", "foot_y_m", "foot_z_m"]
    plan.save(tmp_path / "saved")
    table = np.genfromtxt(tmp_path / "saved" / "trajectory.csv", delimiter=",", names=True)
    assert table["foot_z_m"][[0, -1]] == pytest.approx([0.35, -0.35], abs=1e-8)
    with np.load(tmp_path / "saved" / "trajectory.npz") as arrays:
        assert arrays["site_foot_m"][:, 2] == pytest.approx(table["foot_z_m"], abs=1e-9)
        assert arrays["time_s"] == pytest.approx(table["time_s"], abs=1e-9)
    again = linkplan.read_plan(tmp_path / "saved")
    assert again.sample(0.3).site["foot"] == pytest.approx(VIA, abs=1e-8)
    joints = {"start_deg": {"J1": 0, "J2": 0}, "goal_deg": {"J1": 9, "J2": 9}}
    by_joints = linkplan.Problem.reach(arm(UPPER, LOWER), **joints, duration_s=0.5)
    assert linkplan.plan(by_joints).sample(0.0).site == {}


def test_a_slide_that_has_the_name_of_a_sites_column_keeps_it():
    slide = arm(UPPER, LOWER).replace('name="J2"', 'name="foot_x" type="slide"').replace('joint="J2"', 'joint="foot_x"')
    motion = {"start_deg": {"J1": 10.0}, "start_m": {"foot_x": 0.0}, "goal_deg": {"J1": 40.0}, "goal_m": {"foot_x": 0.02}}
    problem = linkplan.Problem.reach(slide, **motion, duration_s=0.5, limits={"site": {"foot": {"z": [-1.0, 1.0]}}})
    columns = linkplan.plan(problem).require().sample(np.array([0.0])).columns()
    assert columns["foot_x_m"] == pytest.approx(0.0, abs=1e-12)
    assert columns["site_foot_x_m"][0] > 0.1
