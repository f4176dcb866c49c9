"""What a certificate asks of a saved plan: its duration, its ends, its reference and its objective."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.errors import CertificateError
from linkplan.models.poses.along import sampled
from linkplan.planner.certificate import further_checks
from linkplan.planner.certificate.further_checks import disagreements, negligible_objective, objective_value
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_plan, body_problem
from tests.support.motions import motion_along

# The hinge's quarter turn along t^2 (3 - 2 t) in T seconds needs the effort 6 I b (1 - 2 t / T) / T^2.
PEAK_EFFORT = 6 * HINGE_INERTIA * TURN


def quarter_turn(duration_s: float = 1.0, periodic: bool = False) -> Trajectory:
    begin = np.radians(10.0)
    return motion_along(
        [0.0, duration_s],
        [begin, begin, begin + TURN, begin + TURN],
        effort=np.array([PEAK_EFFORT, -PEAK_EFFORT])[:, None, None] / duration_s**2,
        periodic=periodic,
    )


def reach(duration: str = "duration_s = 1.0", *overrides: str) -> Problem:
    return body_problem(HINGE, QUARTER_TURN + duration + "\n", *overrides)


@pytest.mark.parametrize(
    ("asked", "lasts", "words"),
    [
        ("duration_s = 2.0", 2.0 * (1 + 0.9e-8), None),
        ("duration_s = 2.0", 2.0 * (1 + 1.1e-8), "instead of 2 s"),
        ("duration_s = 2.0", 2.0 * (1 - 0.9e-8), None),
        ("duration_s = 2.0", 2.0 * (1 - 1.1e-8), "instead of 2 s"),
        ('duration_s = "free"\nmax_duration_s = 3.0\nmin_duration_s = 1.0', 1.5, None),
        ('duration_s = "free"\nmax_duration_s = 3.0\nmin_duration_s = 1.0', 3.1, "instead of 1 to 3 s"),
        ('duration_s = "free"\nmax_duration_s = 3.0\nmin_duration_s = 1.0', 0.9, "instead of 1 to 3 s"),
        ('duration_s = "free"', 1e4, None),
    ],
)
def test_a_motion_lasts_as_long_as_is_asked_to_rounding(asked, lasts, words):
    found = disagreements(reach(asked), quarter_turn(lasts), None)
    assert len(found) == (words is not None)
    assert all(words in sentence for sentence in found)


def test_a_reach_does_not_repeat():
    (said,) = disagreements(reach(), quarter_turn(periodic=True), None)
    assert "a reach does not repeat" in said


@pytest.mark.parametrize(("off", "missed"), [(0.9e-6, None), (1.1e-6, "start"), (-1.1e-6, "start")])
def test_a_periodic_motion_meets_its_start_and_in_its_middle_its_goal_to_a_millionth_of_its_span(off, missed):
    """There and back in two seconds: 4 t (1 - t) of the quarter turn, whose goal is met after one."""
    problem = body_problem(HINGE, QUARTER_TURN.replace("reach", "periodic") + "duration_s = 2.0\n")
    begin = np.radians(10.0)
    there = np.array([begin, begin, begin + TURN, begin + TURN])
    motion = motion_along([5.0, 6.0, 7.0], np.stack([there, there[::-1]], axis=1), effort=np.zeros((2, 2, 1)), periodic=True)
    for which, where in (("start", (slice(0, 1), slice(0, 1))), ("goal", (slice(0, 1), slice(1, 2)))):
        position = np.array(motion.position)
        position[where] += off * TURN
        found = disagreements(problem, replace(motion, position=position), None)
        assert [which in said for said in found] == ([True] if missed else [])
    assert any("not marked as periodic" in one for one in disagreements(problem, replace(motion, periodic=False), None))


@pytest.mark.parametrize(
    ("minimize", "agreeing", "differing"), [("effort", (0.991, 1.009), (0.988, 1.012)), ("work", (0.955, 1.9), (0.94, 2.1))]
)
def test_a_saved_objective_is_the_motion_s_but_for_quadrature_and_smoothing(minimize, agreeing, differing):
    """The squared effort's mean is a third of its peak's square; work is put in up to the middle: I v^2 / 2 there.

    Of efforts it may differ by a hundredth, of positive work by a twentieth; that may be saved twice as large, smoothed.
    """
    problem = reach("duration_s = 1.0", f"objective.minimize={minimize}")
    value, size = objective_value(problem, quarter_turn())
    exact = PEAK_EFFORT**2 / 3 if minimize == "effort" else 0.5 * HINGE_INERTIA * (1.5 * TURN) ** 2
    assert value == pytest.approx(exact, rel=1e-9 if minimize == "effort" else 0.05)
    assert size == pytest.approx(value)
    assert 0 < negligible_objective(problem, quarter_turn()) < 1e-4 * value
    assert [disagreements(problem, quarter_turn(), factor * value) for factor in agreeing] == [(), ()]
    assert all(disagreements(problem, quarter_turn(), factor * value) for factor in differing)


def test_a_saved_objective_of_none_is_the_one_that_counts_as_none():
    """With a weight of 0.5, of a millionth of 4 N.m, squared, in 2 s; without a limit of the effort of its inertia."""
    still = replace(quarter_turn(2.0), position=np.full((4, 1, 1), 0.2), velocity=np.zeros((3, 1, 1)))
    rest = replace(still, effort=np.zeros((2, 1, 1)))
    limited = reach("duration_s = 2.0", "objective.minimize={effort=0.5}", "limits.effort.motor=[-3, 4]")
    floor = negligible_objective(limited, rest)
    assert floor / (0.5 * (1e-6 * 4.0) ** 2 * 2.0) == pytest.approx(1.0)
    # A hundredth of the saved objective more, or of the motion's.
    for share, agrees in ((1.008, True), (1.02, False)):
        assert (not disagreements(limited, rest, share * floor)) is agrees
        pushed = replace(rest, effort=np.full((2, 1, 1), np.sqrt(share * floor)))
        assert (not disagreements(limited, pushed, 0.0)) is agrees
    free = reach("duration_s = 2.0", "objective.minimize={effort=0.5}", "limits.effort.motor=[-inf, inf]")
    assert negligible_objective(free, rest) / (0.5 * (1e-6 * HINGE_INERTIA / 4.0) ** 2 * 2.0) == pytest.approx(1.0)
    pushed = replace(rest, effort=np.array([0.0, 7.0]).reshape(2, 1, 1))  # more than its inertia's
    assert negligible_objective(free, pushed) / (0.5 * (1e-6 * 7.0) ** 2 * 2.0) == pytest.approx(1.0)


def test_terms_of_an_objective_add_up_with_their_weights():
    both = reach('duration_s = "free"', "objective.minimize={effort=0.5, time=3.0}")
    value, size = objective_value(both, quarter_turn(2.0))
    assert value == size == pytest.approx(0.5 * 2.0 * (PEAK_EFFORT / 4) ** 2 / 3 + 3.0 * 2.0)


def test_an_objective_is_exact_for_efforts_of_degree_nine_at_few_poses(monkeypatch):
    """The square of t^9 has the mean 1 / 19; the poses of two intervals are those of at most a dozen instants each."""
    counted = []

    def counting(function: ca.Function, poses: np.ndarray, *arrays: np.ndarray) -> np.ndarray:
        counted.append(len(poses))
        return sampled(function, poses, *arrays)

    monkeypatch.setattr(further_checks, "sampled", counting)
    effort = np.zeros((10, 2, 1))
    effort[-1] = 2.0  # Bernstein coefficients of 2 t^9
    motion = motion_along([0.0, 0.5, 1.0], np.full((4, 2, 1), 0.2), effort=effort)
    value, _ = objective_value(reach("duration_s = 1.0", "objective.minimize=effort"), motion)
    assert value == pytest.approx(4.0 / 19, rel=1e-9)
    assert sum(counted) <= 2 * 12


SINE = ("reference.amplitude_deg.J=10", "reference.frequency_hz=1")


def test_a_reference_that_is_missed_in_one_interval_is_named():
    plan = body_plan(HINGE, 'kind = "track"\n', *SINE)
    assert plan.passed, plan.message
    assert disagreements(plan.problem, plan.trajectory, plan.objective) == ()
    position = np.array(plan.trajectory.position)
    position[:, 5] += 1e-3
    off = replace(plan.trajectory, position=position)
    assert any("reference is missed" in words for words in disagreements(plan.problem, off, plan.objective))


def test_a_motion_whose_clock_begins_later_follows_its_reference_as_well():
    plan = body_plan(HINGE, 'kind = "track"\n', *SINE)
    later = replace(plan.trajectory, breaks_s=plan.trajectory.breaks_s + 0.3)
    assert disagreements(plan.problem, later, plan.objective) == ()


ARM = """<mujoco><option gravity="0 0 {gravity}"/><worldbody><body><joint name="A" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/></body></worldbody>
<actuator><motor name="m" joint="A" {range}/></actuator></mujoco>"""
LIMITED, UNLIMITED = 'ctrlrange="-5 5" ctrllimited="true"', ""
# gravity [m/s2], start and goal [deg], duration [s]
MOTIONS = {
    "without weight": (0.0, 0, 0, 0.5),
    "in balance": (-9.81, 0, 0, 20.0),
    "that its weight makes": (-9.81, -10, 10, 0.4485),
}


def planned(motion: str, range_: str, minimize):
    gravity, start, goal, duration = MOTIONS[motion]
    arm, ends = ARM.format(gravity=gravity, range=range_), {"start_deg": {"A": start}, "goal_deg": {"A": goal}}
    return plan_motion(Problem.reach(arm, **ends, duration_s=duration, minimize=minimize))


@pytest.mark.parametrize("minimize", ["work", "effort", {"work": 1e-3, "effort_rate": 1e-6}], ids=str)
@pytest.mark.parametrize("range_", [LIMITED, UNLIMITED], ids=["limited", "unlimited"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_plan_that_needs_next_to_nothing_is_read_as_it_was_saved(motion, range_, minimize, tmp_path):
    plan = planned(motion, range_, minimize)
    assert plan.passed, plan.message
    (tmp_path / "plan").mkdir()
    write_plan(plan, tmp_path / "plan")
    again = read_plan(tmp_path / "plan")
    assert (again.status, again.objective) == (plan.status, plan.objective)


def test_an_objective_beyond_what_counts_as_none_is_refused_of_a_motion_that_needs_none(tmp_path):
    plan = planned("without weight", LIMITED, "work")
    floor = negligible_objective(plan.problem, plan.trajectory)
    assert floor == pytest.approx(1e-6 * 5)  # a millionth of 5 N.m through a radian [J]
    with pytest.raises(CertificateError, match="saved objective is"):
        write_plan(replace(plan, objective=3 * floor), tmp_path)
