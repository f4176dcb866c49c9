"""What problems take from their tables, and what they refuse, on both sides of each limit."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.reach import End, reach
from linkplan.planner.problem import motion
from linkplan.planner.problem.imperfections import spread_of
from linkplan.planner.problem.instant import Corner, Robust, Scales, corner_efforts_along, free_instant
from linkplan.planner.problem.motion import _way_through
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.problem.reference import Sine, is_whole
from linkplan.planner.problem.settings import MeshSettings, SolverSettings, Tracking
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, body_problem
from tests.support.refusals import assert_refused

SECOND = QUARTER_TURN + "duration_s = 1.0\n"
TRACK = 'kind = "track"\n'
SINE = ("reference.amplitude_deg.J=20", "reference.frequency_hz=2.0")


def quarter(*overrides: str, model: str = HINGE) -> Problem:
    return body_problem(model, SECOND, *overrides)


PERIODS = (*SINE, "mesh.intervals=10")
GUESS = ("guess.duration_s=1.0",)


@pytest.mark.parametrize(
    ("motion", "given", "said"),
    [
        (SECOND, ["mesh.breaks=[0, 2e-9, 1]"], None),
        (SECOND, ["mesh.breaks=[0, 5e-10, 1]"], "mesh.breaks"),
        (SECOND, ["mesh.breaks=[0, 0.7, 0.6, 1]"], "mesh.breaks"),
        (SECOND, ["mesh.breaks=[0.1, 0.6, 1]"], "mesh.breaks"),
        (SECOND, ["mesh.breaks=[0, 0.6, 0.9]"], "mesh.breaks"),
        # a limit on power admits rest
        (SECOND, ["limits.power_w.motor=[0, 7]"], None),
        (SECOND, ["limits.power_w.motor=[-5, 0]"], None),
        (SECOND, ["limits.power_w.motor=[1, 7]"], "must admit rest"),
        (SECOND, ["limits.power_w.motor=[-5, -1]"], "must admit rest"),
        # twenty thousand intervals, ten in each period of half a second
        (TRACK, [*PERIODS, "motion.duration_s=1000"], None),
        (TRACK, [*PERIODS, "motion.duration_s=1001"], "2002 periods of the reference"),
        # a guessed path has a value for every instant
        (SECOND, [*GUESS, "guess.path_deg.J=[10, 50, 100]"], None),
        (SECOND, [*GUESS, "guess.path_deg.J=[10]"], "guess"),
    ],
)
def test_the_last_legal_values_are_taken_and_the_next_refused(motion, given, said):
    if said is None:
        assert body_problem(HINGE, motion, *given).name
    else:
        assert_refused(lambda: body_problem(HINGE, motion, *given), said, kind=ProblemError)


@pytest.mark.parametrize(("timestep_s", "period_s"), [(2e-3, 2e-3), (1e-5, 1e-4)])
def test_a_control_period_is_a_tenth_of_a_millisecond_or_the_model_s_longer_step(timestep_s, period_s):
    model = HINGE.replace('gravity="0 0 0"', f'gravity="0 0 0" timestep="{timestep_s}"')
    assert quarter(model=model).tracking.period_s == pytest.approx(period_s, rel=1e-12)
    assert quarter("tracking.period_s=0.007", model=model).tracking.period_s == 0.007


@pytest.mark.parametrize(
    ("minimised", "effort"),
    [
        ("{ work = 1.0, time = 3.0 }", "constant"),
        ("{ work = 1.0 }", "constant"),
        ("{ effort = 1.0, time = 3.0 }", "polynomial"),
        ("{ work = 1.0, effort = 1.0, time = 1.0 }", "polynomial"),
    ],
)
def test_efforts_are_held_over_intervals_where_work_and_time_alone_are_the_cost(minimised, effort):
    problem = body_problem(HINGE, QUARTER_TURN + 'duration_s = "free"\n', f"objective.minimize={minimised}")
    assert problem.mesh.effort == effort


@pytest.mark.parametrize(("reserve", "kept"), [(0.0, 4.0), (0.25, 3.0)])
def test_a_reserve_is_kept_of_every_effort_limit(reserve, kept):
    limits = quarter(f"limits.reserve={reserve}").limits
    assert limits.effort.tolist() == [[-kept, kept]]
    assert limits.actuators_effort == pytest.approx(np.array([[-4.0, 4.0]]))


def test_an_actuator_s_power_counts_where_it_drives():
    at, (q, v, _, u, *_) = free_instant(load_mechanism(HINGE))
    power = ca.Function("power", [q, v, u], [at.positive_powers])
    assert [float(power(0.3, *given)) for given in ((5.0, 2.0), (4.0, -3.0), (-6.0, -1.0))] == [10.0, 0.0, 6.0]


# Ranges of machines.


def test_a_corner_s_friction_is_viscous_and_dry():
    mechanism = load_mechanism(HINGE)
    v, a, u = np.array([[2.0], [-1.0]]), np.array([[0.5], [3.0]]), np.zeros((2, 1))
    corner = Corner(torque_factor=0.8, friction=(("J", 0.05, 0.3),))
    found = corner_efforts_along(mechanism, (corner,), np.zeros((2, 1)), v, a, u)[:, 0]
    assert found == pytest.approx((HINGE_INERTIA * a + 0.05 * v + 0.3) / 0.8)


def test_frictions_of_three_joints_have_sixty_four_corners_and_more_are_refused():
    """Two ends of a viscous and of a dry friction for each joint."""

    def rubbing(joints: int) -> Robust:
        names = "ABCD"[:joints]
        return Robust(viscous_friction=dict.fromkeys(names, (0.1, 0.2)), coulomb_friction=dict.fromkeys(names, (0.1, 0.3)))

    assert len(rubbing(3).corners) == 64
    assert_refused(lambda: rubbing(4), "256 corners; the limit is 64", kind=ProblemError)


# Reach.


@pytest.mark.parametrize(
    ("asked", "single", "branching", "words"),
    [
        (-3.0, [-2.0], {}, "no choice of coordinate passes it"),
        (-3.0, [2.0], {}, "with another joint as mechanism.independent the motion may pass it"),
        (3.0, [2.0], {}, "no choice of coordinate passes it"),
        (3.0, [-2.0], {2.0: 1}, "the mechanism may change its branch there"),
    ],
)
def test_the_remedy_at_the_end_of_a_reach_is_that_of_the_end_that_is_in_the_way(asked, single, branching, words):
    lower, upper = (End(position=position, reason="singular pose", joint=None) for position in (-2.0, 2.0))
    ends = replace(reach(load_mechanism(HINGE)), lower=lower, upper=upper, single=single, branching=list(branching.items()))
    assert words in _way_through(ends, "singular pose", asked)
    assert _way_through(ends, "range of J", asked) == ""


# Terms, names and times.


def test_the_certificate_has_a_tenth_of_the_time_and_solves_the_rest():
    begun = SolverSettings(max_time_s=1000.0).begun()
    assert begun.deadline.left_s == pytest.approx(900.0, abs=1.0)
    assert begun.certificate_deadline.left_s == pytest.approx(1000.0, abs=1.0)


def test_the_units_of_power_and_force_are_the_largest_of_their_parts():
    scales = Scales(
        time_s=0.5, position=np.array([2.0, 0.1]), effort=np.array([7.0]), residual=np.array([3.0, 8.0]), length_m=0.25
    )
    assert scales.power == pytest.approx(2.0 * 3.0 / 0.5)
    assert scales.force == pytest.approx(8.0 / 0.25)
    assert scales.vector() == pytest.approx([0.5, 2.0, 0.1, 7.0, 3.0, 8.0, 0.25, 12.0, 32.0])


@pytest.mark.parametrize(
    ("number", "whole"),
    [(1.0, True), (3.0 + 1e-10, True), (1e6 * (1 + 1e-10), True), (2.5, False), (3.0 + 1e-7, False), (0.0, False)],
)
def test_a_ratio_is_whole_but_for_the_rounding_of_decimals(number, whole):
    assert is_whole(number) is whole


@pytest.mark.parametrize("order", [0, 1])
def test_each_derivative_of_a_sine_is_the_slope_of_the_one_before(order):
    sine = Sine(amplitude=np.array([0.3, 0.1]), bias=np.array([0.2, -1.0]), phase=np.array([0.4, 0.0]), frequency_hz=1.5)
    time, step = np.linspace(0.0, 1.0, 7), 1e-6
    slope = (sine.derivative(time + step, order) - sine.derivative(time - step, order)) / (2 * step)
    np.testing.assert_allclose(sine.derivative(time, order + 1), slope, atol=1e-6)
    np.testing.assert_allclose(sine.derivative(np.zeros(1)), [[0.2 + 0.3 * np.sin(0.4), -1.0]])
    assert sine.period_s == pytest.approx(1 / 1.5)


@pytest.mark.parametrize(
    ("value", "is_random"),
    [
        (1.1, False),
        ([0.9, 1.1], True),
        ([1.1, 1.1], False),
        ({"uniform": [0.9, 1.1]}, True),
        ({"normal": [1.0, 0.05]}, True),
        ({"normal": [1.0, 0.0]}, False),
    ],
)
def test_machines_differ_if_a_distribution_has_a_width(value, is_random):
    assert spread_of(value, "payload_mass_factor", "payload_mass_factor").random is is_random


@pytest.mark.parametrize("value", [[1.1, 0.9], {"normal": [1.0, -0.1]}, [1.0], {"uniform": 1.0}, {"mean": [1.0, 2.0]}])
def test_what_is_no_distribution_is_refused(value):
    with pytest.raises(ProblemError, match=r"imperfections\.payload_mass_factor"):
        spread_of(value, "payload_mass_factor", "payload_mass_factor")


@pytest.mark.parametrize(("beyond", "reason"), [(-0.1, "what lies below"), (0.1, "what lies above")])
def test_the_reason_is_that_of_the_end_beyond_which_a_position_lies(monkeypatch, beyond, reason):
    mechanism = load_problem("knee-reach").mechanism
    found = reach(mechanism)
    ends = {
        name: replace(getattr(found, name), reason=f"what lies {word}")
        for name, word in (("lower", "below"), ("upper", "above"))
    }
    monkeypatch.setattr(motion, "reach", lambda _mechanism: replace(found, **ends))
    at = found.upper.position if beyond > 0 else found.lower.position
    with pytest.raises(ProblemError, match=reason):
        motion._check_reach(mechanism, None, "goal", np.array([at + beyond]))


def test_a_joint_of_several_is_named_alone():
    five_bar = load_mechanism("five-bar")
    only = five_bar.independent_joints[0].name
    with pytest.raises(ProblemError, match="the independent joint") as refused:
        Problem.reach(five_bar, start_deg={only: 0.0}, goal_deg={only: 10.0})
    assert "plans in the named joints" not in str(refused.value)


# Settings that cannot be used, and words of the answer.
REFUSED = [
    ("solver.compile", "allways", ["'allways'", "did you mean 'always'", "auto"]),
    ("tracking.lqr_velocity_deg_s", 1e10, ["tracking.lqr_velocity_deg_s", "1e+09"]),
    ("mesh.tolerance_deg", 0.1, ["mesh.tolerance_deg must be from 1e-09", "got 0.1"]),
    ("mesh.breaks", [0, 0.6, 0.4, 1], ["mesh.breaks", "[0.0, 0.6, 0.4, 1.0]"]),
    ("mesh.breaks", 3, ["mesh.breaks must be three or more increasing numbers", "got 3"]),
]


@pytest.mark.parametrize(("key", "value", "words"), REFUSED, ids=lambda value: str(value)[:40])
def test_settings_that_cannot_be_used_are_refused(key, value, words):
    assert_refused(lambda: load_problem("knee-reach", [f"{key}={value}"]), *words, kind=ProblemError)
    assert_refused(lambda: load_problem("knee-reach").replace(key, value), *words, kind=ProblemError)


def test_numpys_numbers_are_numbers_and_kept_as_pythons():
    values = {"tracking.kp": np.float64(3.0), "tracking.delay_periods": np.int64(2), "solver.starts": np.int64(4)}
    found = load_problem("knee-reach").replace(values | {"solver.max_time_s": np.float32(2.0)})
    assert type(found.tracking.kp) is float
    assert found.tracking.delay_periods == 2
    assert type(found.solver.starts) is int
    assert found.solver.max_time_s == 2.0


def test_the_ends_of_intervals_say_how_many_there_are():
    breaks = [0.0, 0.25, 0.5, 1.0]
    for mesh in (MeshSettings(breaks=breaks), load_problem("knee-reach", [f"mesh.breaks={breaks}"]).mesh):
        assert mesh.breaks.tolist() == breaks
        assert mesh.intervals == 3


def test_angles_at_the_ends_of_what_is_legal_survive_their_way_through_radians():
    for end in (1e-9, 1e9):
        problem = load_problem("knee-reach", [f"tracking.lqr_position_deg={end}"])
        assert np.degrees(problem.tracking.lqr_errors(problem.mechanism.independent_joints)[0][0]) == pytest.approx(end)


def test_a_broken_delay_is_for_loops_and_not_for_motions_that_are_tracked():
    assert Tracking(delay_periods=0.5).delay_periods == 0.5
    with pytest.raises(ProblemError, match=r"tracking\.delay_periods must be a whole number from 0 to 1000, got 0\.5"):
        load_problem("knee-reach").replace("tracking.delay_periods", 0.5)


def test_a_slide_may_go_to_the_end_of_its_range_however_far_that_is():
    """The search for an end follows a slide over twenty sizes of the model; a rail may be longer."""
    model = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0" range="-1 30"/>
      <geom size="0.1" mass="1"/></body></worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
    assert reach(load_mechanism(model)).upper.reason == "no end found"
    given = {"start_m": {"x": 0.0}, "duration_s": 9.0}
    assert Problem.reach(model, goal_m={"x": 30.0}, **given).motion.goal == pytest.approx([30.0])
    assert_refused(lambda: Problem.reach(model, goal_m={"x": 30.1}, **given), "range of x", kind=ProblemError)
