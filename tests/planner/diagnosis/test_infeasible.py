"""Problems without an answer: which limit, which joint, when, by how much; and none that has an answer among them."""

import re

import numpy as np
import pytest
from scipy.optimize import brentq

from linkplan.models import deadline
from linkplan.models.errors import LinkplanError, PlanError, ProblemError
from linkplan.planner.closed_chain.guess import Guess
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.reasons import share_sentence
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
from tests.support.data import KNEE_TABLE
from tests.support.fourbar import SHANK, knee
from tests.support.plans import GOAL, LIMIT, START, planned
from tests.support.refusals import assert_refused
from tests.support.tolerances_planner import HIGHEST_FREQUENCY, MINIMUM_TIME, NEEDED_EFFORT, PEAK

SHORTEST = KNEE_TABLE["min_time_rest_to_rest"]["shank_s"]
LOADED = knee().carrying("crank", SHANK)
SHORT_BUDGET = ("knee-reach", "motion.duration_s=0.10")

# What is asked, and what the sentence says of it.
INFEASIBLE = {
    "too short a time": (SHORT_BUDGET, ["act_O", "joint O", "N.m", "limit of 100", "0.12185 s"]),
    "a hair too short a time": (("knee-reach", "motion.duration_s=0.1218"), ["act_O", "0.12185 s"]),
    "too weak a motor": (("knee-reach", "limits.effort.act_O=[-20, 20]"), ["act_O", "limit of 20", "shortest feasible"]),
    "an exact reference": (("knee-sine-shank", "motion.kind=track"), ["act_O", "120 N.m", "0.1875 s", "limit of 100"]),
    "an exact reference's range": (
        ("knee-sine", "limits.range_deg.A=[10, 150]"),
        ["joint A", "8.352 deg", "0.0625 s", "limit of 10"],
    ),
    "an exact reference's speed": (
        ("knee-sine", "limits.speed_deg_s.O=1000"),
        ["joint O", "1324 deg/s", "limit of 1000"],
    ),
    "an average speed": (
        ("knee-reach", "limits.speed_deg_s.O=500"),
        ["joint O", "658.4 deg/s", "on average", "0.16 s", "limit of 500", "0.2107 s"],
    ),
    "an average speed one way": (
        ("knee-reach", "limits.speed_deg_s.O=[-2000, 600]"),
        ["joint O", "658.4 deg/s", "limit of 600", "0.1756 s"],
    ),
    "a speed at the start": (
        ("knee-reach", "limits.speed_deg_s.O=800", "motion.start_speed_deg_s.O=900"),
        ["start_speed", "joint O", "900 deg/s", "limit of 800"],
    ),
    "a speed at the goal": (
        ("knee-reach", "limits.speed_deg_s.O=800", "motion.goal_speed_deg_s.O=-900"),
        ["goal_speed", "joint O", "-900 deg/s", "limit of -800"],
    ),
    "a dependent joint's range at the goal": (
        ("knee-reach", "limits.range_deg.A=[20, 150]"),
        ["joint A", "8.35194 deg", "limit of 20"],
    ),
    "a dependent joint's range at the start": (
        ("knee-reach", "limits.range_deg.C=[-20, 120]"),
        ["joint C", "-25.9383", "-20"],
    ),
    "a longest duration": (("knee-sprint", "motion.max_duration_s=0.1"), ["act_O", "N.m", "limit of 100", "0.12185 s"]),
}
# What needs no solving is found at once: the quick set's case.
every_case = pytest.mark.parametrize(
    "case", [case if case == "an exact reference" else pytest.param(case, marks=pytest.mark.slow) for case in INFEASIBLE]
)


def refused(case: str) -> Plan:
    return planned(*INFEASIBLE[case][0])


@every_case
def test_a_problem_without_an_answer_is_infeasible_by_a_limit_a_joint_and_an_amount(case):
    plan = refused(case)
    assert plan.status == "infeasible", plan.message
    assert (plan.trajectory, plan.certificate, plan.objective) == (None, None, None)
    assert "\n" not in plan.message
    for words in INFEASIBLE[case][1]:
        assert words in plan.message


def test_requiring_an_infeasible_plan_raises_the_sentence_and_carries_the_plan():
    plan = refused("an exact reference")
    with pytest.raises(PlanError, match=re.escape(plan.message)) as raised:
        plan.require()
    assert raised.value.plan is plan
    assert isinstance(raised.value, LinkplanError)


@pytest.mark.slow
def test_the_verdict_has_the_shortest_feasible_duration():
    assert planned(*SHORT_BUDGET).verdict.remedy["motion.duration_s"] == pytest.approx(SHORTEST, rel=MINIMUM_TIME)


@pytest.mark.slow
def test_the_verdict_has_the_effort_with_which_the_time_would_do():
    """The least peak effort is bang-bang: the limit whose own least time is the one asked for."""
    enough = brentq(lambda limit: LOADED.minimum_time(START, GOAL, -limit, limit) - 0.10, 100.0, 300.0, xtol=1e-12)
    verdict = planned(*SHORT_BUDGET).verdict
    assert abs(verdict.overruns[0].value) == pytest.approx(enough, rel=NEEDED_EFFORT)
    assert verdict.needed_factor == pytest.approx(enough / LIMIT, rel=NEEDED_EFFORT)


@pytest.mark.slow
def test_the_effort_that_the_sentence_names_is_enough():
    needed = 1.0001 * abs(planned(*SHORT_BUDGET).verdict.overruns[0].value)
    plan = planned(*SHORT_BUDGET, f"limits.effort.act_O=[{-needed}, {needed}]")
    assert plan.status == "optimal", plan.message


@pytest.mark.slow
@pytest.mark.parametrize(("share", "status"), [(1.0001, "optimal"), (0.9999, "infeasible")])
def test_the_shortest_duration_is_the_border_between_feasible_and_not(share, status):
    plan = planned("knee-reach", f"motion.duration_s={share * SHORTEST}")
    assert plan.status == status, plan.message
    assert status == "optimal" or plan.verdict.needed_factor > 1


def test_an_exact_reference_s_worst_instant_is_the_reference_table_s():
    details = refused("an exact reference").details
    assert details["needed"] == pytest.approx(KNEE_TABLE["seed_sine"]["shank"]["max_Nm"], rel=PEAK)
    assert details["time_s"] == pytest.approx(0.1875, abs=PEAK)
    assert details["limit"] == LIMIT


def test_an_exact_reference_points_to_the_motion_that_keeps_the_limits():
    assert 'motion.kind = "periodic"' in refused("an exact reference").message


@pytest.mark.slow
def test_a_limit_on_one_side_is_named_by_its_own_end():
    plan = planned("knee-sine-shank", "motion.kind=track", "limits.effort.act_O=[-100, 130]")
    assert plan.status == "infeasible"
    needed = KNEE_TABLE["seed_sine"]["shank"]["min_Nm"]
    assert plan.details["needed"] == pytest.approx(needed, rel=PEAK)
    assert plan.details["limit"] == -LIMIT


@pytest.mark.slow
def test_a_reference_just_within_the_limits_is_followed():
    peak = KNEE_TABLE["seed_sine"]["shank"]["max_Nm"]
    plan = planned("knee-sine-shank", "motion.kind=track", f"limits.effort.act_O=[{-peak - 1e-6}, {peak + 1e-6}]")
    assert plan.status == "optimal", plan.message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("motion.goal_deg.O=80",), ["motion.goal_deg", "O = 80 deg", "-90 to 78.52", "singular pose"]),
        (("motion.start_deg.O=79",), ["motion.start_deg", "O = 79 deg", "-90 to 78.52", "singular pose"]),
        (("motion.goal_deg.O=-91",), ["O = -91 deg", "-90", "range of O"]),
        (("motion.goal_deg.O=120",), ["O = 120 deg", "range of O"]),
        (("motion.goal_deg.O=1e14",), ["1e+14", "within 100 turns"]),
        (("motion.goal_deg.O=1e4",), ["10000", "range of O"]),
        (("limits.range_deg.O=[-60, 40]",), ["O = 56.27 deg", "-60 to 40 deg", "range of O"]),
        (("limits.range_deg.O=[-40, 60]",), ["motion.start_deg", "O = -49.07 deg", "-40 to 60 deg"]),
    ],
)
def test_a_state_beyond_reach_is_refused_with_the_interval(overrides, words):
    assert_refused(lambda: planned("knee-reach", *overrides), *words, kind=ProblemError)


def test_a_reference_that_the_linkage_cannot_follow_is_refused_with_the_interval():
    with pytest.raises(ProblemError, match=r"reference O = 83.6 deg is beyond reach.*-90 to 78.52.*singular pose"):
        planned("knee-sine", "reference.amplitude_deg.O=80")


@pytest.mark.slow
def test_a_goal_just_short_of_the_singular_pose_is_not_refused():
    plan = planned("knee-reach", "motion.goal_deg.O=77", "motion.duration_s=0.25")
    assert plan.status == "optimal", plan.message
    assert 0 < plan.certificate.singularity_ratio < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("limit", ["limits.effort.act_O=[-100, 100]", "limits.speed_deg_s.O=1000"])
def test_the_highest_frequency_is_the_border_between_feasible_and_not(limit):
    asked = ("knee-sine", "mechanism.payload=shank", limit)
    frequency = planned(*asked).details["highest_frequency_hz"]
    assert 1.0 < frequency < 4.0
    for share, status in ((0.9999, "optimal"), (1.0001, "infeasible")):
        assert planned(*asked, f"reference.frequency_hz={share * frequency}").status == status


@pytest.mark.slow
def test_a_speed_limit_s_highest_frequency_is_speed_over_two_pi_amplitude():
    frequency = planned("knee-sine", "limits.speed_deg_s.O=1000").details["highest_frequency_hz"]
    assert frequency == pytest.approx(1000 / (2 * np.pi * 52.67), rel=HIGHEST_FREQUENCY)


@pytest.mark.slow
def test_a_range_that_the_amplitude_itself_leaves_has_no_highest_frequency():
    plan = planned("knee-sine", "limits.range_deg.A=[20, 150]")
    assert plan.status == "infeasible"
    assert "highest_frequency_hz" not in plan.details


DURATION_S, SLOWEST_S = 2.0, 1.3


def motion(speed, position) -> Guess:
    """Return a motion of the hinge with a speed, a position and an effort that grows evenly with time."""
    return Guess(
        position=lambda t: position(t)[:, None],
        velocity=lambda t: speed(t)[:, None],
        acceleration=lambda t: np.zeros((len(t), 1)),
        effort=lambda t: 2.0 + t[:, None],
        duration_s=DURATION_S,
        start_pose=np.zeros(1),
    )


def barely(t: np.ndarray) -> np.ndarray:
    """Return a speed that vanishes at both ends, and is least between them at SLOWEST_S."""
    return np.sin(np.pi * t / DURATION_S) * (0.005 + (t - SLOWEST_S) ** 2) * 3.0


@pytest.mark.parametrize("at_all", [True, False])
def test_the_pose_that_is_barely_passed_is_named(at_all):
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n")
    said = share_sentence(problem, 1.1, motion(barely, lambda t: t), at_all=at_all)
    time = np.linspace(0.1, 1.9, 100001)
    slowest = float(time[np.argmin(barely(time))])
    assert f"motor on joint J would have to give {2.0 + slowest:.3g}"[:-1] in said
    if at_all:
        named = re.search(r"to pass J = ([\d.]+) deg at t = ([\d.]+) s", said)
        assert float(named[1]) == pytest.approx(np.degrees(slowest), rel=2e-3)
        assert float(named[2]) == pytest.approx(slowest, rel=5e-3)
    else:
        assert said.endswith("throughout")


def test_a_search_that_runs_out_of_time_names_the_effort_that_the_smooth_path_lacks():
    """A reach of a five-bar with two actuators, too short but not by far."""

    def late(_search):
        deadline._CHILD_TIME.seconds += 1000.0
        raise deadline.OutOfTimeError("late")

    problem = load_problem("five-bar-reach", ["motion.duration_s=0.1", "solver.max_time_s=20"])
    plan = plan_motion(problem, methods=(), diagnoses=(late,))
    assert plan.status == "failed"
    assert "ran out of its 20 s" in plan.message
    assert "along the smooth path from start to goal act_O" in plan.message
    assert "times its limit of" in plan.message
