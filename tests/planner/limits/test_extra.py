"""Users' own limits and costs: the plans of built-in ones that say the same, certified, diagnosed and solved again."""

import casadi as ca
import numpy as np
import pytest

import linkplan
from linkplan import ExtraCost, ExtraLimit, Problem
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.extra import ExtraPathLimit
from tests.support.bodies import HINGE, HINGE_INERTIA, PENDULUM, TURN
from tests.support.margins import other_margins
from tests.support.tolerances_planner import EXTRA_LIMIT, PEAK_ON_A_GRID, TIGHTENED_ANEW, TIGHTENED_TWICE

REACH = {"start_deg": {"O": -20.0}, "goal_deg": {"O": 20.0}, "duration_s": 0.2}
SINE = {"amplitude_deg": {"O": 20.0}, "bias_deg": {"O": 3.6}, "frequency_hz": 2.0}
# Below the largest speed of the motion of least effort, 4.9 rad/s; 2 rad/s is too slow for 40 deg in 0.2 s.
SPEED = 4.4


@pytest.fixture(scope="module")
def knee():
    return linkplan.load_mechanism("optimus-knee")


@pytest.fixture(scope="module")
def free(knee):
    return linkplan.plan(Problem.reach(knee, **REACH)).require()


def hip_speed(at):
    return at.velocity_rad_s["O"]


def own_effort(at):
    return at.effort["act_O"] ** 2


def speed_limit(upper, lower=-np.inf):
    return ExtraLimit(name="hip speed", expression=hip_speed, lower=lower, upper=upper, unit="rad/s")


@pytest.mark.slow
def test_an_extra_limit_on_a_speed_gives_the_plan_of_the_speed_limit(knee, free):
    extra = linkplan.plan(Problem.reach(knee, **REACH, extra_limits=[speed_limit(SPEED)])).require()
    limits = {"speed_deg_s": {"O": float(np.degrees(SPEED))}}
    built_in = linkplan.plan(Problem.reach(knee, **REACH, limits=limits)).require()
    assert free.objective < (1 - 1e-3) * built_in.objective  # the limit binds
    assert extra.objective == pytest.approx(built_in.objective, rel=EXTRA_LIMIT)


@pytest.mark.slow
def test_an_extra_limit_on_power_gives_the_least_time_of_the_limit_on_power():
    leg = linkplan.load_mechanism("optimus-knee", payload="shank")
    given = {"start_deg": {"O": -49.0}, "goal_deg": {"O": 56.0}, "minimize": "time"}
    power = ExtraLimit(
        name="power", expression=lambda at: at.effort["act_O"] * at.velocity_rad_s["O"], lower=-400, upper=400
    )
    effort = {"effort": {"act_O": [-80.0, 80.0]}}
    extra = linkplan.plan(Problem.reach(leg, **given, limits=effort, extra_limits=[power])).require()
    built_in = linkplan.plan(Problem.reach(leg, **given, limits=effort | {"power_w": {"act_O": 400.0}})).require()
    assert built_in.duration_s > 0.15  # 0.135 s without the limit
    assert extra.duration_s == pytest.approx(built_in.duration_s, rel=EXTRA_LIMIT)


@pytest.mark.slow
def test_an_extra_limit_on_a_dependent_joint_gives_the_plan_of_its_speed_limit(knee, free):
    assert "C" not in [joint.name for joint in knee.independent_joints]
    most_deg_s = 0.9 * float(np.abs(free.sample().speed_deg_s["C"]).max())
    most = np.radians(most_deg_s)
    limit = ExtraLimit(name="slow", expression=lambda at: at.velocity_rad_s["C"], lower=-most, upper=most)
    extra = linkplan.plan(Problem.reach(knee, **REACH, extra_limits=[limit])).require()
    built_in = linkplan.plan(Problem.reach(knee, **REACH, limits={"speed_deg_s": {"C": most_deg_s}})).require()
    assert free.objective < (1 - 1e-3) * built_in.objective  # the limit binds
    assert extra.objective == pytest.approx(built_in.objective, rel=TIGHTENED_TWICE)


def test_an_extra_cost_that_is_the_squared_effort_is_least_where_the_effort_is(knee, free):
    cost = ExtraCost(name="own effort", expression=own_effort)
    alone = linkplan.plan(Problem.reach(knee, **REACH, minimize={}, extra_costs=[cost])).require()
    assert alone.objective == pytest.approx(free.objective, rel=EXTRA_LIMIT)


def test_an_extra_cost_adds_its_weighted_integral_to_the_objective(knee, free):
    cost = ExtraCost(name="own effort", expression=own_effort, weight=3.0)
    both = linkplan.plan(Problem.reach(knee, **REACH, extra_costs=[cost])).require()
    assert both.objective == pytest.approx(4.0 * free.objective, rel=EXTRA_LIMIT)


def test_a_cost_below_zero_is_planned_in_as_many_solves_saved_and_read(knee, free, tmp_path):
    """A constant taken from the squared effort leaves the motion, and takes its integral from the objective."""
    saved = 1.5 * free.objective
    cost = ExtraCost(name="less", expression=lambda at: own_effort(at) - saved / REACH["duration_s"])
    plan = linkplan.plan(Problem.reach(knee, **REACH, minimize={}, extra_costs=[cost])).require()
    assert plan.objective == pytest.approx(free.objective - saved, rel=EXTRA_LIMIT)
    assert len(plan.history) == len(free.history)
    plan.save(tmp_path / "plan")
    assert linkplan.read_plan(tmp_path / "plan", extra_costs=[cost]).objective == plan.objective


@pytest.mark.slow
def test_an_extra_limit_on_a_sites_place_is_certified_as_what_it_comes_to():
    problem = Problem.from_file("five-bar-reach")
    wide = problem.replace(limits={"site": {"P": {"x": [-10.0, 10.0]}}})
    peak = float(linkplan.plan(wide).require().sample().site["P"][:, 0].max())
    limit = ExtraLimit(name="reach", expression=lambda at: at.site("P")[0], upper=peak + 1e-3, unit="m")
    (margin,) = other_margins(linkplan.plan(problem.replace(extra_limits=[limit])).require().certificate)
    assert margin.kept
    assert margin.value == pytest.approx(peak, rel=PEAK_ON_A_GRID)


def test_the_certificate_of_a_motion_says_how_far_it_is_beyond_an_extra_limit_between_the_nodes(knee, free):
    problem = Problem.reach(knee, **REACH, extra_limits=[speed_limit(SPEED)])
    certificate = certify(problem, free.trajectory)
    (margin,) = other_margins(certificate)
    time = np.linspace(0.0, 0.2, 20001)
    peak = float(np.radians(free.sample(time).speed_deg_s["O"]).max())
    assert not certificate.passed
    assert (margin.title, margin.unit) == ("the extra limit 'hip speed'", "rad/s")
    assert margin.value == pytest.approx(peak, rel=PEAK_ON_A_GRID)
    assert margin.left == pytest.approx(SPEED - peak, rel=PEAK_ON_A_GRID)
    assert any("the extra limit 'hip speed' comes to" in failure for failure in certificate.failures)


@pytest.mark.slow
def test_a_motion_that_an_extra_limit_forbids_is_infeasible_and_the_sentence_names_it():
    """An inertia that speeds up and slows down by a = effort / inertia takes TURN / speed + speed / a at the least."""
    asked = {"start_deg": {"J": 10.0}, "goal_deg": {"J": 100.0}, "duration_s": 1.0}
    limit = ExtraLimit(name="turning", expression=lambda at: at.velocity_rad_s["J"], upper=1.2, unit="rad/s")
    plan = linkplan.plan(Problem.reach(HINGE, **asked, extra_limits=[limit], mesh={"intervals": 10}))
    assert plan.status == "infeasible"
    assert plan.message.startswith("infeasible: the extra limit 'turning' would have to be")
    assert "beyond its limit of 1.2 rad/s; the shortest feasible duration is" in plan.message
    shortest = float(plan.message.removesuffix(" s").rpartition(" ")[2])
    assert shortest == pytest.approx(TURN / 1.2 + 1.2 * HINGE_INERTIA / 4.0, rel=1e-3)


def test_a_goal_beyond_an_extra_limit_is_infeasible_before_any_solve(knee):
    limit = ExtraLimit(name="angle", expression=lambda at: at.position_rad["O"], upper=0.1, unit="rad")
    plan = linkplan.plan(Problem.reach(knee, **REACH, extra_limits=[limit]))
    assert plan.status == "infeasible"
    assert "the extra limit 'angle' is 0.349066 rad at the goal, 0.2491 rad beyond its limit of 0.1" in plan.message
    assert not plan.history


def test_a_way_that_leaves_an_extra_limit_between_start_and_goal_is_infeasible(knee):
    limit = ExtraLimit(name="away from 0", expression=lambda at: at.position_rad["O"] ** 2, lower=0.01)
    plan = linkplan.plan(Problem.reach(knee, **REACH, extra_limits=[limit]))
    assert plan.status == "infeasible"
    assert "the extra limit 'away from 0' is" in plan.message


def test_a_periodic_motion_keeps_an_extra_limit():
    sine = {"amplitude_deg": {"J": 20.0}, "frequency_hz": 1.0}
    swing = Problem.periodic(PENDULUM.format(limit=20), reference=sine)
    assert np.radians(linkplan.plan(swing).require().sample().speed_deg_s["J"]).max() > 2.19
    limit = ExtraLimit(name="swing", expression=lambda at: at.velocity_rad_s["J"], lower=-2.08, upper=2.08, unit="rad/s")
    plan = linkplan.plan(swing.replace(extra_limits=[limit], mesh={"tolerance_deg": 1e-3})).require()
    assert np.abs(np.radians(plan.sample().speed_deg_s["J"])).max() <= 2.08 + EXTRA_LIMIT


def test_a_prescribed_motion_is_judged_by_an_extra_limit(knee):
    assert linkplan.plan(Problem.track(knee, reference=SINE, extra_limits=[speed_limit(40.0)])).status == "optimal"
    plan = linkplan.plan(Problem.track(knee, reference=SINE, extra_limits=[speed_limit(4.0)]))
    assert plan.status != "optimal"
    assert "the extra limit 'hip speed' comes to 4.386 rad/s" in plan.message


@pytest.mark.parametrize("name", ["weight", "bound"])
def test_a_planner_gives_each_weight_and_bound_the_plan_of_its_own(knee, name):
    planner = linkplan.Planner()
    knee_speed = lambda at: at.velocity_rad_s["C"] ** 2  # noqa: E731
    costs = [[ExtraCost(name="knee", expression=knee_speed, weight=weight)] for weight in (1e-9, 1e-7)]
    limits = [[speed_limit(upper)] for upper in (4.6, 4.5)]
    for extras in (
        [{"extra_costs": cost} for cost in costs] if name == "weight" else [{"extra_limits": one} for one in limits]
    ):
        problem = Problem.reach(knee, **REACH, **extras)
        assert planner.plan(problem).objective == pytest.approx(linkplan.plan(problem).objective, rel=TIGHTENED_ANEW)


def test_expressions_of_other_symbols_are_refused(knee):
    other = ExtraLimit(name="other", expression=lambda at: at.position_rad["O"] + ca.SX.sym("other"), upper=1.0)
    with pytest.raises(linkplan.LinkplanError, match="may use only the instant's symbols"):
        Problem.reach(knee, **REACH, extra_limits=[other])


def test_a_relaxed_limit_is_wider_by_its_size_times_what_the_factor_is_above_one(knee):
    limit = ExtraLimit(name="narrow", expression=hip_speed, lower=-3.0, upper=2.0, unit="rad/s")
    problem = Problem.reach(knee, **REACH, extra_limits=[limit])
    (wider,) = ExtraPathLimit.relaxed(problem, 1.5).extra_limits
    assert (wider.lower, wider.upper) == pytest.approx((-4.5, 3.5))
    assert ExtraPathLimit.relaxed(problem, np.inf).extra_limits == ()
