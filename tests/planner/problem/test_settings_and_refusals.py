"""What problems take from their tables, and what they refuse, on both sides of each limit."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.reach import End, reach
from linkplan.planner.problem.extra import ExtraCost, checked_extras
from linkplan.planner.problem.instant import Corner, Robust, corner_efforts_along, free_instant
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.problem.start import _way_through
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, body_problem

SECOND = QUARTER_TURN + "duration_s = 1.0\n"
TRACK = 'kind = "track"\n'
SINE = ("reference.amplitude_deg.J=20", "reference.frequency_hz=2.0")


def quarter(*overrides: str, model: str = HINGE) -> Problem:
    return body_problem(model, SECOND, *overrides)


@pytest.mark.parametrize(
    ("breaks", "legal"),
    [
        ("[0, 2e-9, 1]", True),
        ("[0, 5e-10, 1]", False),
        ("[0, 0.7, 0.6, 1]", False),
        ("[0.1, 0.6, 1]", False),
        ("[0, 0.6, 0.9]", False),
    ],
)
def test_breaks_rise_from_zero_to_one_by_more_than_rounding(breaks, legal):
    if legal:
        assert quarter(f"mesh.breaks={breaks}").mesh.intervals == 2
    else:
        with pytest.raises(ProblemError, match=r"mesh\.breaks"):
            quarter(f"mesh.breaks={breaks}")


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


@pytest.mark.parametrize(
    ("limits", "legal"), [("[-5, 7]", True), ("[0, 7]", True), ("[-5, 0]", True), ("[1, 7]", False), ("[-5, -1]", False)]
)
def test_a_limit_of_power_admits_rest(limits, legal):
    if legal:
        quarter(f"limits.power_w.motor={limits}")
    else:
        with pytest.raises(ProblemError, match="must admit rest"):
            quarter(f"limits.power_w.motor={limits}")


@pytest.mark.parametrize(("duration", "legal"), [(1000.0, True), (1001.0, False)])
def test_a_reference_is_followed_over_as_many_periods_as_the_finest_mesh_has_room_for(duration, legal):
    """Twenty thousand intervals, ten in each period of half a second."""
    asked = (*SINE, f"motion.duration_s={duration}", "mesh.intervals=10")
    if legal:
        assert body_problem(HINGE, TRACK, *asked).motion.duration_s == duration
    else:
        with pytest.raises(ProblemError, match=r"2002 periods of the reference.* at most 2000 are legal"):
            body_problem(HINGE, TRACK, *asked)


@pytest.mark.parametrize(("path", "legal"), [("[10, 50, 100]", True), ("[10]", False)])
def test_a_guessed_path_has_a_value_for_every_instant(path, legal):
    if legal:
        assert quarter(f"guess.path_deg.J={path}", "guess.duration_s=1.0").reference is None
    else:
        with pytest.raises(ProblemError, match="guess"):
            quarter(f"guess.path_deg.J={path}", "guess.duration_s=1.0")


@pytest.mark.parametrize(("length", "legal"), [(100, True), (101, False)])
def test_an_extra_cost_s_name_has_at_most_a_hundred_characters(length, legal):
    def named() -> ExtraCost:
        return ExtraCost(name="x" * length, expression=lambda at: at.time_s)

    if legal:
        assert len(named().name) == length
    else:
        with pytest.raises(ProblemError, match="at most 100 characters, got 101"):
            named()


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
    with pytest.raises(ProblemError, match="256 corners; at most 64"):
        rubbing(4)


# Turns.


@pytest.mark.parametrize(
    ("asked", "single", "branching", "words"),
    [
        (-3.0, [-2.0], {}, "no other coordinate passes it"),
        (-3.0, [2.0], {}, "another joint as mechanism.independent may pass it"),
        (3.0, [2.0], {}, "no other coordinate passes it"),
        (3.0, [-2.0], {2.0: 1}, "the mechanism may branch there"),
    ],
)
def test_the_remedy_at_the_end_of_a_reach_is_that_of_the_end_that_is_in_the_way(asked, single, branching, words):
    lower, upper = (End(position=position, reason="singular pose", joint=None) for position in (-2.0, 2.0))
    ends = replace(reach(load_mechanism(HINGE)), lower=lower, upper=upper, single=single, branching=list(branching.items()))
    assert words in _way_through(ends, "singular pose", asked)
    assert _way_through(ends, "range of J", asked) == ""


# Places of sites.


# Terms, names and times.


def test_extra_costs_have_names_that_differ():
    one, other = (ExtraCost(name=name, expression=lambda at: at.time_s) for name in ("one", "other"))
    assert checked_extras([one, other], ExtraCost, "costs") == (one, other)
    with pytest.raises(ProblemError, match="got 'one' more than once"):
        checked_extras([one, other, one], ExtraCost, "costs")


def test_the_certificate_has_a_tenth_of_the_time_and_solves_the_rest():
    begun = SolverSettings(max_time_s=1000.0).begun()
    assert begun.deadline.left_s == pytest.approx(900.0, abs=1.0)
    assert begun.certificate_deadline.left_s == pytest.approx(1000.0, abs=1.0)
