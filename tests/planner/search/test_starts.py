"""Where plans begin and how they are refined: several starts, the user's guess, meshes of one's own, and the history."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.planner.plan.folder import write_plan
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search import starts
from linkplan.planner.search.methods import FULL_BUDGET
from linkplan.planner.search.planning import SEARCH_METHODS, plan_motion, search_for
from linkplan.planner.search.starts import with_switch_times
from tests.support.bodies import HINGE, HINGE_INERTIA, LIFT, PENDULUM, QUARTER_TURN, TURN, body_plan, body_problem
from tests.support.plans import optimal, planned
from tests.support.refusals import assert_refused
from tests.support.tolerances_planner import (
    BEST_START,
    COARSE_MESH,
    EXACT_EFFORT,
    LEAST_EFFORT,
    MINIMUM_TIME,
    REFINED_EFFORT,
)

# Several starts.

STARTS = ("knee-reach", "solver.starts=4", "mesh.intervals=20")


@pytest.mark.slow
def test_every_start_is_reported_and_the_best_is_kept():
    plan = optimal(*STARTS)
    tried = [step for step in plan.history if step.what.startswith("start ")]
    assert [step.what.split(",")[0] for step in tried] == [f"start {k} of 4" for k in (1, 2, 3, 4)]
    solved = [step.objective for step in tried if step.converged]
    assert plan.details["starts"] == 4
    assert plan.details["starts_solved"] == len(solved) >= 2
    assert tried[int(plan.details["best_start"]) - 1].objective == min(solved)
    assert plan.objective == pytest.approx(min(solved), rel=BEST_START)


@pytest.mark.slow
def test_several_starts_are_the_same_in_every_run():
    again = plan_motion(load_problem(STARTS[0], STARTS[1:]))
    assert [step.objective for step in again.history] == [step.objective for step in optimal(*STARTS).history]


# A weak pendulum has two ways up: straight, where the torque is short, or by a swing.

LIGHT_ROD = PENDULUM.format(limit=3)
UP = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 180.0 }\nduration_s = "free"\n'


def time_of_one_swing(switch: float) -> float:
    """Return the time [s] that the pendulum takes up with one swing back, pushed back until -`switch` [rad] by all torque.

    From there on it is pushed forward: to a stop at -b, back through zero, and on to where braking brings it to rest
    upright. With W = m g l, energies give b, u (2 a - b) = W (1 - cos b), and where to brake, u (2 s + b - pi) =
    W (1 + cos b). On each arc angle = rest -+ x^2 takes away the root of the energy at rest.
    """
    u, W, inertia = 3.0, 9.81 * 0.5, 0.01 + 0.5**2
    stop = brentq(lambda b: u * (2 * switch - b) - W * (1 - np.cos(b)), switch, 2 * switch)
    brake = (W * (1 + np.cos(stop)) / u + np.pi - stop) / 2

    def arc(rest: float, end: float, torque: float) -> float:
        way = np.sign(end - rest)

        def slowness(x: float) -> float:
            angle = rest + way * x**2
            return 2 * x * np.sqrt(inertia / 2 / (torque * (angle - rest) + W * (np.cos(angle) - np.cos(rest))))

        return quad(slowness, 0, np.sqrt(abs(end - rest)))[0]

    return arc(0, -switch, -u) + arc(-stop, -switch, u) + arc(-stop, brake, u) + arc(np.pi, brake, -u)


@pytest.mark.parametrize(
    ("model", "goal", "asked", "is_begun"),
    [
        (LIGHT_ROD, 180.0, {"duration_s": 3.0}, True),
        (LIGHT_ROD, 180.0, {"minimize": "time"}, False),  # it is looked for itself
        (HINGE, 90.0, {"duration_s": 1.5}, False),  # it does not swing
    ],
)
def test_least_effort_is_begun_from_a_motion_of_least_time_that_swings(model, goal, asked, is_begun):
    problem = linkplan.Problem.reach(model, start_deg={"J": 0.0}, goal_deg={"J": goal}, **asked)
    search = search_for(problem)
    names = [name for name, _ in starts.of_the_phase_plane(search, FULL_BUDGET)]
    assert names[-1] == "the phase plane"
    assert ("the least-time motion" in names) is is_begun


@pytest.mark.slow
def test_a_motor_short_of_gravity_swings_back_once_and_takes_the_least_time_of_that():
    plan = body_plan(LIGHT_ROD, UP, "objective.minimize=time")
    assert 1 * 9.81 * 0.5 > 3  # the motor cannot hold the arm level
    assert plan.status == "optimal", plan.message
    motion = plan.trajectory
    assert motion.position_at(motion.dense_times()).min() < -0.1  # it swings back first
    least = minimize_scalar(time_of_one_swing, bounds=(0.2, 0.8), method="bounded", options={"xatol": 1e-8}).fun
    assert plan.objective == pytest.approx(least, rel=MINIMUM_TIME)


def test_the_history_ends_with_what_was_planned_and_no_step_of_it_is_faster():
    plan = body_plan(LIGHT_ROD, UP, "objective.minimize=time")
    assert plan.history[-1].objective == plan.objective
    assert plan.history[-1].integration_error_deg == plan.certificate.integration_error_deg
    first = next(step for step in plan.history if step.converged)
    assert first.objective > plan.objective  # its switches were smeared


# The user's guess.


@pytest.mark.slow
def test_an_earlier_plan_is_a_guess_for_another_problem(tmp_path):
    (tmp_path / "saved").mkdir()
    write_plan(optimal("knee-reach"), tmp_path / "saved")
    plan = planned("knee-reach", f"guess.plan='{tmp_path / 'saved'}'", "motion.duration_s=0.18")
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(optimal("knee-reach", "motion.duration_s=0.18").objective, rel=LEAST_EFFORT)


@pytest.mark.slow
def test_the_guess_given_is_tried_first_and_named(tmp_path):
    (tmp_path / "saved").mkdir()
    write_plan(optimal("knee-reach"), tmp_path / "saved")
    plan = optimal("knee-reach", "solver.starts=2", f"guess.plan='{tmp_path / 'saved'}'")
    assert plan.history[0].what == "start 1 of 2, the guess given"
    assert plan.history[1].what == "start 2 of 2, a smooth path"


@pytest.mark.slow
def test_a_guessed_path_is_begun_from():
    plan = optimal("knee-reach", "solver.starts=2", "guess.path_deg.O=[-49.07,-80,20,50,56.27]")
    assert plan.history[0].what.endswith("the guess given")
    assert plan.objective == pytest.approx(optimal("knee-reach").objective, rel=LEAST_EFFORT)


@pytest.mark.slow
def test_a_guess_decides_which_of_two_local_optima_is_found():
    """In 4 s the weak pendulum goes up by swings that begin to one side or to the other; the first is the better."""
    fixed = UP.replace('"free"', "4.0")
    plans = [
        body_plan(LIGHT_ROD, fixed, f"guess.path_deg.J={path}") for path in ([0, -60, -20, 90, 180], [0, -30, 60, -90, 180])
    ]
    for plan in plans:
        assert plan.status == "optimal", plan.message
    early = [plan.trajectory.position_at([0.5])[0, 0] for plan in plans]
    assert early[0] < 0 < early[1]
    assert plans[0].objective < plans[1].objective * (1 - LEAST_EFFORT)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("guess.plan=nowhere",), "is not a folder"),
        (("guess.path_deg.O=[1]",), "two or more positions"),
        (("guess.path_deg.O=5",), "two or more positions"),
        (("guess.path_deg.K=[1,2]",), "K"),
        (("guess.path=[1,2]",), "unknown key"),
        (("guess.path_deg.O=[0,10]", "guess.plan=nowhere"), "two guesses"),
        (("solver.starts=2.5",), "solver.starts"),
        (("mesh.breaks=[0,0.5,0.5000000000000001,1]",), "at least 1e-09 apart"),
        (("mesh.breaks=[0,0.5,1]", "mesh.intervals=2"), "keep one"),
        (("mesh.refine=degrees",), "did you mean 'degree'"),
    ],
)
def test_a_start_or_mesh_that_cannot_be_is_refused_in_one_line(given, said):
    assert_refused(lambda: planned("knee-reach", *given), said, kind=ProblemError)


# Meshes of one's own, and refinement.


def test_the_breaks_given_are_those_of_the_first_mesh():
    breaks = [0, 0.1, 0.3, 0.6, 0.8, 1]
    plan = body_plan(HINGE, QUARTER_TURN + "duration_s = 1.5\n", f"mesh.breaks={breaks}")
    assert plan.history[0].intervals == 5
    np.testing.assert_allclose(plan.trajectory.breaks_s / 1.5, breaks, atol=EXACT_EFFORT)
    assert plan.objective == pytest.approx(12 * HINGE_INERTIA**2 * TURN**2 / 1.5**3, rel=EXACT_EFFORT)


COARSE = ("knee-reach", "mesh.intervals=6")
ASKED_DEG = 1e-7


@cache
def refined(mode: str) -> Plan:
    return optimal(*COARSE, f"mesh.refine={mode}", f"mesh.tolerance_deg={ASKED_DEG}")


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["intervals", "degree", "both"])
def test_each_way_of_refining_reaches_the_tolerance(mode):
    plan = refined(mode)
    assert plan.history[0].integration_error_deg > ASKED_DEG
    assert plan.certificate.integration_error_deg <= ASKED_DEG
    assert plan.objective == pytest.approx(optimal("knee-reach").objective, rel=REFINED_EFFORT)


@pytest.mark.slow
def test_refining_by_intervals_keeps_the_degree():
    assert {step.scheme for step in refined("intervals").history} == {"radau-3"}
    assert refined("intervals").intervals > 6


@pytest.mark.slow
def test_refining_by_degree_raises_it_before_it_cuts():
    history = refined("degree").history
    assert history[1].what.startswith("higher degree")
    assert history[1].intervals == history[0].intervals == 6
    assert history[1].scheme == "radau-5"


@pytest.mark.slow
def test_a_transcription_that_is_named_is_kept():
    plan = optimal(*COARSE, "mesh.scheme=radau-2", "mesh.tolerance_deg=1e-4")
    assert {step.scheme for step in plan.history} == {"radau-2"}
    raised = optimal(*COARSE, "mesh.scheme=radau-2", "mesh.tolerance_deg=1e-4", "mesh.refine=both")
    assert {step.scheme for step in raised.history} != {"radau-2"}


def test_the_history_holds_each_step_s_mesh_error_objective_and_time():
    history = refined("both").history
    assert len(history) >= 2
    for step in history:
        assert step.intervals >= 6
        assert step.segments >= 1
        assert step.converged
        assert step.build_s > 0
        assert step.solve_s > 0
        assert step.objective == pytest.approx(optimal("knee-reach").objective, rel=COARSE_MESH)
    errors = [step.integration_error_deg for step in history]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == refined("both").certificate.integration_error_deg
    assert history[-1].objective == refined("both").objective


@pytest.mark.slow
def test_least_time_finds_its_switch_from_a_mesh_that_has_none_there():
    lift = 'kind = "reach"\nstart_m = { J = 0.1 }\ngoal_m = { J = 0.9 }\nduration_s = "free"\n'
    plan = body_plan(LIFT, lift, "objective.minimize=time", "mesh.intervals=10")
    rise, brake = 50 / 2 - 9.81, 30 / 2 + 9.81
    exact = np.sqrt(2 * 0.8 * (rise + brake) / (rise * brake))
    switch = exact * brake / (rise + brake)
    assert any("switch times as unknowns" in step.what for step in plan.history)
    assert np.abs(plan.trajectory.breaks_s - switch).min() < MINIMUM_TIME * exact
    assert plan.history[0].objective > plan.objective  # without the cut the switch is smeared


def test_a_least_time_plan_is_a_guess_that_knows_its_switch():
    plan = body_plan(HINGE, QUARTER_TURN + 'duration_s = "free"\n', "objective.minimize=time")
    guess = with_switch_times(plan)
    assert guess.switch_times_s == pytest.approx([plan.trajectory.duration_s / 2], rel=1e-6)
    assert not starts.other_limits(body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n"))


@pytest.mark.parametrize(
    ("setting", "others"),
    [("limits.speed_deg_s.O=900", False), ("limits.range_deg.A=[0, 100]", False), ("limits.power_w.act_O=500", True)],
)
def test_the_phase_plane_leaves_out_all_limits_but_those_on_effort_range_and_speed(setting, others):
    assert starts.other_limits(load_problem("knee-reach", [setting])) == others


# A two-link arm that swings its hand through a post.
ARM = """<mujoco><option gravity="0 0 0"/><default><geom type="capsule" size="0.02"/></default><worldbody>
<geom name="post" type="cylinder" size="0.15 0.2" pos="0 {reach} 0"/>
<body name="upper"><joint name="a" axis="0 0 1" range="-170 170"/>
<geom fromto="0 0 0 0.4 0 0" mass="1" contype="0" conaffinity="0"/>
<body name="lower" pos="0.4 0 0"><joint name="b" axis="0 0 1" range="-20 40"/>
<geom name="hand" fromto="0.1 0 0 0.3 0 0" mass="1"/></body></body>
</worldbody><actuator><motor joint="a" ctrlrange="-50 50"/><motor joint="b" ctrlrange="-50 50"/></actuator></mujoco>"""


def planned_past_a_post(reach):
    problem = linkplan.Problem.reach(
        linkplan.load_mechanism(ARM.format(reach=reach)),
        start_deg={"a": 30.0, "b": 0.0},
        goal_deg={"a": 150.0, "b": 30.0},
        duration_s=1.0,
        mesh={"intervals": 20},
    )
    return plan_motion(problem, methods=SEARCH_METHODS[1:2])


def test_a_motion_through_a_post_is_not_refined():
    apart = planned_past_a_post(reach=5.0)
    assert apart.passed
    assert any(step.scheme != "radau-3" for step in apart.history)  # its mesh is refined
    through = planned_past_a_post(reach=0.6)
    assert not through.passed
    assert "collide" in through.message
    assert all(step.what.startswith("start from") for step in through.history)


@pytest.mark.slow
def test_an_objective_that_a_finer_mesh_changes_by_a_fifth_is_solved_on_another_mesh():
    """Up in 6 s by swings: from 51 to 69 intervals it falls from 2.65 to 2.21, and the next mesh would be one of 138."""
    reach = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 180.0 }\nduration_s = 6.0\n'
    plan = plan_motion(body_problem(PENDULUM.format(limit=2.5), reach))
    changes = np.diff([step.objective for step in plan.history])
    assert plan.status == "optimal", plan.message
    assert abs(changes[-1]) < 1e-4 * plan.objective < 0.1 * abs(changes).max()
