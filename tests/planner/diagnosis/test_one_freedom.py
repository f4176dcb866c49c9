"""Why a single freedom has no motion: the pose on its only way, and the factor on its efforts by the phase plane."""

import re

import numpy as np
import pytest
from scipy.optimize import brentq

from linkplan.planner.phase_plane.bang_bang_motions import least_share
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search import reasons
from linkplan.planner.search.ladder import Search
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import HINGE, LIFT, body_problem
from tests.support.fourbar import G
from tests.support.fourbar_problems import random_case
from tests.support.slider_crank import CRANK, ROD

# The cage of 2 kg and its motor, too weak to lift it, which it does not know from below.
MASS, WEAK, WAY = 2.0, 12.0, 0.4
TOO_WEAK = LIFT.replace("-30 50", f"-{WEAK} {WEAK}")
LIFTED = f'kind = "reach"\nstart_deg = {{ J = 0.0 }}\ngoal_deg = {{ J = {WAY} }}\n'.replace("_deg", "_m")
# A servo of 1 N.m/rad on 1 kg m2, whose ctrl, the angle and the effort, leaves no full effort of 1 N.m above 0.05 rad.
MOTOR, POSITION = (
    '<motor name="motor" joint="J" ctrlrange="-4 4"/>',
    '<position name="s" joint="J" kp="1" ctrlrange="-4 1.05"/>',
)
SERVO = HINGE.replace("0.3 0.3 0.3", "1 1 1").replace(MOTOR, POSITION)
# The least factor is found to 2^(1 / 256) of itself.
FACTOR = 5e-3
# Over the outer dead centre, where the slider is furthest out.
ACROSS = ("motion.start_deg.O=-60", "motion.goal_deg.O=70")


def searching(problem) -> Search:
    return Search(problem=problem, start_pose=problem.start_pose())


@pytest.mark.parametrize(("short", "status"), [(1e-3, "infeasible"), (-1e-6, "optimal")])
def test_a_range_that_is_left_on_the_only_way_is_named_without_solving(short, status):
    most = CRANK + ROD - short
    plan = plan_motion(load_problem("slider-crank-turn", [*ACROSS, f"limits.range_m.B=[0.0, {most!r}]"]))
    assert plan.status == status, plan.message
    if status == "infeasible":
        assert not plan.history
        said = re.search(r"joint B stands at ([\d.]+) m where O = (-?[\d.]+) deg.*, ([\d.e-]+) m beyond", plan.message)
        assert float(said[1]) == pytest.approx(CRANK + ROD, rel=1e-4)
        assert abs(float(said[2])) < 0.5
        assert float(said[3]) == pytest.approx(short, rel=1e-2)


def test_the_least_factor_in_any_time_is_the_weight_over_the_limit():
    problem = body_problem(TOO_WEAK, LIFTED + 'duration_s = "free"\n', "objective.minimize=time")
    plan = reasons.efforts_by_the_phase_plane(searching(problem))
    assert plan.status == "infeasible"
    assert plan.details["needed_limit_factor"] == pytest.approx(MASS * G / WEAK, rel=FACTOR)
    assert "in any time: motor on joint J would have to give 19.6" in plan.message


@pytest.mark.parametrize("duration", [0.3, 0.6])
def test_the_least_factor_in_a_duration_is_that_of_the_bang_bang_motion(duration):
    problem = body_problem(TOO_WEAK, LIFTED + f"duration_s = {duration}\n")

    def over(force: float) -> float:
        up, down = force / MASS - G, force / MASS + G
        return np.sqrt(2 * WAY * (1 / up + 1 / down)) - duration

    exact = brentq(over, MASS * G * (1 + 1e-9), 1e4) / WEAK
    factor, motion = least_share(problem, problem.start_pose(), duration)
    assert factor == pytest.approx(exact, rel=FACTOR)
    assert motion.duration_s <= duration


def test_a_thousandth_too_little_time_is_infeasible_though_a_motion_with_errors_was_found():
    """The least time by quadrature of a crank that turns around; a solve converges on a coarse mesh in less."""
    case = random_case(4244, 99)
    plan = plan_motion(Problem.from_tables("too short", case.tables))
    assert plan.status == "infeasible", plan.message
    assert plan.details["shortest_duration_s"] == pytest.approx(case.shortest, rel=1e-7)
    assert case.tables["motion"]["duration_s"] == pytest.approx(0.999 * case.shortest)


def test_efforts_that_suffice_are_not_blamed():
    problem = body_problem(LIFT, LIFTED + 'duration_s = "free"\n', "objective.minimize=time")
    assert reasons.efforts_by_the_phase_plane(searching(problem)) is None


def test_a_phase_plane_that_leaves_out_a_servo_s_ctrl_does_not_contradict_the_efforts_that_are_missing():
    """Over a radian in 2.015 s: full effort alone takes 2 s, and within the range of the ctrl 2.033 s."""
    turn = f'kind = "reach"\nstart_deg = {{ J = 0.0 }}\ngoal_deg = {{ J = {np.degrees(1.0)} }}\nduration_s = 2.015\n'
    problem = body_problem(SERVO, turn, "limits.effort.s=[-1, 1]")
    assert searching(problem).quickest.duration_s == pytest.approx(2.0, rel=1e-3)
    diagnoses = (reasons.efforts_contradicted, reasons.efforts, reasons.nothing_found)
    plan = plan_motion(problem, methods=(), diagnoses=diagnoses)
    assert plan.status == "infeasible", plan.message
    assert plan.details["shortest_duration_s"] == pytest.approx(2.0328, abs=1e-4)
