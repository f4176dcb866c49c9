"""Legs along limits on pin forces: as quick as an answer that knows nothing of linkplan, each instant at some limit."""

import numpy as np
import pytest

from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.samples import closure_forces
from linkplan.planner.phase_plane.leg_field import AT_FORCE
from linkplan.planner.phase_plane.legs_motion import legs_motion
from linkplan.planner.phase_plane.power_legs import power_legs
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.sliders import drawn_with_a_pin

# Against the exact least time, relative; of the legs' own integration.
EXACT, INTEGRATED = 1e-6, 1e-6
# A force or an effort at its limit, as a share of that.
AT_LIMIT = 1e-6
# Of the random sliders, such as were 4e-3 late and called optimal, and 2e-6 late.
LATE = (3, 7)


def rated(newton: float):
    problem = load_problem("knee-sprint", [f"limits.closure_force.B={newton}"])
    return problem, problem.start_pose()


@pytest.mark.parametrize("number", LATE)
def test_legs_take_the_least_time(number):
    case = drawn_with_a_pin(1, number)
    problem = Problem.from_tables("slider", case.tables)
    legs, boundaries = power_legs(problem, problem.start_pose())
    assert boundaries[-1] == pytest.approx(case.best, rel=INTEGRATED)
    assert any(abs(held) >= AT_FORCE for leg in legs for _, (held,) in leg.arcs())


@pytest.mark.slow
@pytest.mark.parametrize("number", LATE)
def test_a_least_time_along_a_pins_rating_is_exact(number):
    case = drawn_with_a_pin(1, number)
    plan = plan_motion(Problem.from_tables("slider", case.tables))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(case.best, rel=EXACT)


def test_a_pin_or_the_effort_is_at_its_limit_at_every_instant_of_the_legs_motion():
    problem, pose = rated(2.5)
    motion = legs_motion(problem, pose)
    certificate = certify(problem, motion)
    assert certificate.passed, certificate.failures
    time = motion.dense_times()
    s, v, a, u = (of(time) for of in (motion.position_at, motion.velocity_at, motion.acceleration_at, motion.effort_at))
    (closure,) = problem.limits.limited_closures
    force = closure_forces(problem, follow(problem.mechanism, s, pose), v, a, u)[:, closure]
    borne, full = np.abs(force / 2.5 - 1.0) < AT_LIMIT, np.abs(np.abs(u[:, 0]) / 100.0 - 1.0) < AT_LIMIT
    assert np.all(borne | full)
    assert np.mean(borne) > 0.1


def test_where_no_pin_is_at_its_rating_there_are_no_such_legs():
    assert power_legs(*rated(2.5)) is not None
    assert power_legs(*rated(1e4)) is None


def test_a_rating_below_what_rest_asks_has_no_such_legs():
    case = drawn_with_a_pin(1, 3)
    tables = case.tables | {"limits": case.tables["limits"] | {"closure_force": {"P": 1e-3}}}
    problem = Problem.from_tables("slider", tables)
    assert power_legs(problem, problem.start_pose()) is None
