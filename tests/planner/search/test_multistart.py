"""Fast motions of several motors: a leg whose knee is a four-bar, and the parts of its search by themselves.

The best known values are of an independent collocation, at the nodes of its mesh.
"""

from dataclasses import replace

import numpy as np
import pytest

import linkplan
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.formulate import FIRST_TIE_WEIGHT, tie_weights
from linkplan.planner.limits.limit import with_limits
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import failed
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.refinement.history import recording
from linkplan.planner.search import multistart
from linkplan.planner.search.attempts import of_several
from linkplan.planner.search.finer_meshes import FIRST_MARGIN, along_ranges, at_a_distance
from linkplan.planner.search.jumps import effort_jumps
from linkplan.planner.search.methods import FULL_BUDGET
from linkplan.planner.search.multistart import from_several_starts
from linkplan.planner.search.planning import plan_motion, search_for
from linkplan.planner.search.without_solver import slower
from tests.support.legs import LEG, leg
from tests.support.motions import motion_along

LEAST_TIME_S, LEAST_EFFORT = 0.18663512, 850.59


@pytest.fixture(scope="module")
def in_least_time():
    return leg(duration_s="free", minimize="time")


@pytest.fixture(scope="module")
def quickest(in_least_time):
    return plan_motion(in_least_time)


def test_the_least_time_is_the_best_known_one_and_a_proof_accepts_its_efforts(quickest):
    assert quickest.status == "optimal"
    assert quickest.objective == pytest.approx(LEAST_TIME_S, rel=1e-4)
    assert quickest.objective == pytest.approx(quickest.trajectory.duration_s, rel=1e-12)  # without what breaks ties
    assert quickest.certificate.effort_overrun.max() <= 1.0
    assert "which breaks ties" in quickest.message


def test_little_effort_near_a_singular_pose_is_not_a_motion_and_a_rest():
    plan = plan_motion(leg(duration_s=0.279953, minimize="effort"))
    assert plan.status == "optimal"
    assert plan.objective <= LEAST_EFFORT * (1 + 1e-3)
    assert "it keeps a distance from singular poses, 0.01 of that at home" in plan.message
    assert "ties" not in plan.message


def test_solves_keep_a_distance_from_singular_poses_that_the_certificate_does_not_ask_for(in_least_time):
    case = at_a_distance(case_of(in_least_time), in_least_time.start_pose())
    assert case.problem.limits.singular_margin == FIRST_MARGIN
    assert case.asked.limits.singular_margin == 0.0


def test_a_margin_that_is_asked_for_is_kept():
    problem = leg(duration_s=0.3, limits={"singular_margin": 0.3})
    assert at_a_distance(case_of(problem), problem.start_pose()).problem.limits.singular_margin == 0.3


def test_a_slower_motion_bounds_a_least_time_that_cannot_be_proved(in_least_time, monkeypatch):
    own = multistart.certified

    def failing(problem, found):
        return own(problem, found) if problem.motion.duration_s else Plan(problem=problem, verdict=failed(""))

    monkeypatch.setattr(multistart, "certified", failing)
    monkeypatch.setattr(multistart, "slower", lambda *_: None)
    with recording():
        plan = from_several_starts(search_for(in_least_time), FULL_BUDGET)
    assert plan.status == "feasible"
    assert plan.passed
    assert plan.objective == pytest.approx(1.05 * LEAST_TIME_S, rel=2e-3)
    assert "a motion with 0.1867" in plan.message  # its duration, without what breaks ties
    assert "was found, but does not pass its certificate" in plan.message


@pytest.mark.parametrize(("share", "factor"), [(0.999, 1.001), (0.99, 1.01), (0.9, None)])
def test_a_motion_that_overruns_its_efforts_a_little_passes_if_it_is_a_little_slower(quickest, share, factor):
    """Efforts of inertia fall with the square of the duration; a tenth too much is no error of a mesh."""
    limits = replace(quickest.problem.limits, effort=share * quickest.problem.limits.effort)
    plan = slower(quickest.problem.varied(limits=limits), [quickest.trajectory])
    if factor is None:
        assert plan is None
        return
    assert plan.status == "feasible"
    assert plan.trajectory.duration_s == pytest.approx(factor * quickest.trajectory.duration_s)
    assert plan.certificate.effort_overrun.max() <= 1.0
    motion = replace(plan.problem.motion, max_duration_s=quickest.trajectory.duration_s)
    assert slower(plan.problem.varied(motion=motion), [quickest.trajectory]) is None


def test_the_tie_weight_is_the_mean_squared_effort_in_shares_of_the_limits(in_least_time):
    weights = tie_weights(in_least_time, FIRST_TIE_WEIGHT)
    assert weights * np.array([130.0, 120.0]) ** 2 == pytest.approx(FIRST_TIE_WEIGHT / 2)
    assert not tie_weights(leg(duration_s=0.3, minimize="effort"), FIRST_TIE_WEIGHT).any()
    mixed = leg(duration_s="free", minimize={"time": 1.0, "effort": 1e-5})
    assert not tie_weights(mixed, FIRST_TIE_WEIGHT).any()


def test_a_jump_is_where_the_impulse_of_its_interval_puts_it(in_least_time):
    breaks, level = np.linspace(0.0, 1.0, 11), np.full((10, 2), 100.0)
    level[4, 0], level[5:, 0] = 100.0 - 0.3 * 200.0, -100.0  # the first effort jumps at seven tenths of the fifth interval
    still = np.zeros((2, 10, 2))
    motion = motion_along(breaks, still, effort=np.stack([level, level]), start_pose=in_least_time.mechanism.home)
    assert effort_jumps(case_of(in_least_time), motion) == pytest.approx([0.47])
    assert len(effort_jumps(case_of(leg(duration_s=0.3, minimize="effort")), motion)) == 0


def test_an_effort_jumps_from_one_end_to_the_other_of_what_its_power_permits(in_least_time):
    """At a constant speed, with 5 % of the power's range, the effort changes by 5 % of its own range."""
    speed, most = 20.0, 100.0
    power = with_limits(in_least_time, power=np.tile([-most, most], (2, 1)))
    breaks, level = np.linspace(0.0, 0.01, 11), np.full((10, 2), most / speed)
    level[5:, 0] *= -1.0
    moving = np.stack([breaks[:-1], breaks[1:]])[:, :, None] * np.array([speed, 0.0])
    motion = motion_along(breaks, moving, effort=np.stack([level, level]), start_pose=in_least_time.mechanism.home)
    assert effort_jumps(case_of(power), motion) == pytest.approx([0.005])
    assert len(effort_jumps(case_of(in_least_time), motion)) == 0


def test_a_reference_that_asks_for_a_little_too_much_is_tracked_by_two_motors_and_proved():
    """With the refinement of one motor it was "feasible": most of its objective was the smoothing of efforts."""
    reference = {
        "frequency_hz": 3.3488,
        "amplitude_deg": {"hip_pitch": 14.0, "knee_motor": 6.6},
        "bias_deg": {"hip_pitch": -15.0, "knee_motor": 21.5},
        "phase_deg": {"hip_pitch": 180.0},
    }
    mechanism, asked = linkplan.load_mechanism(LEG), {"limits": {"contacts": "note"}}
    plan = linkplan.plan(linkplan.Problem.periodic(mechanism, reference=reference, **asked))
    assert plan.status == "optimal"
    assert plan.proof.passed
    assert plan.details["reference_needs"] < -130.0
    assert plan.details["tracking_rms_deg"] < 1e-3
    assert plan.history[-1].intervals < 100  # changes of a negligible objective need no finer mesh


def test_one_motor_and_given_breaks_have_another_search(in_least_time):
    assert of_several(in_least_time)
    assert not of_several(load_problem("knee-reach"))
    breaks = np.linspace(0.0, 1.0, 21)
    assert not of_several(in_least_time.varied(mesh=in_least_time.mesh.replace(breaks=breaks)))


def test_starts_along_which_the_loops_open_are_not_said_to_lack_time(monkeypatch):
    closing = iter([True, False, True])
    monkeypatch.setattr(multistart, "closes", lambda *_: next(closing, False))
    plan = plan_motion(leg(duration_s=0.28, minimize="effort").replace(solver={"starts": 4}))
    assert plan.passed, plan.message
    assert "2 of the 4 starts were tried and the loops open along all others" in plan.message


@pytest.mark.slow
def test_as_many_starts_as_asked_are_solved_on_the_coarse_mesh_of_several_motors():
    plan = plan_motion(load_problem("five-bar-reach", ["solver.starts=5"]))
    firsts = [step for step in plan.history if step.what.startswith("start ")]
    assert [step.what.split(",")[0] for step in firsts] == [f"start {k} of 5" for k in range(1, 6)]
    assert {step.intervals for step in firsts} == {round(0.6 * plan.problem.mesh.intervals)}
    assert plan.status == "optimal"
    assert plan.details["starts"] == 5
    assert plan.details["starts_solved"] == sum(step.converged for step in firsts)


@pytest.mark.parametrize(("beyond_rad", "along"), [(-1e-5, {0}), (1e-2, set())])
def test_ranges_are_kept_between_the_nodes_where_a_motion_comes_to_their_ends(quickest, beyond_rad, along):
    problem, motion = quickest.problem, quickest.trajectory
    joints, position = problem.mechanism.independent, problem.limits.position.copy()
    position[joints] = [-np.inf, motion.position[:, 1:-1, 0].max() + beyond_rad], [-np.inf, np.inf]
    ranged = problem.varied(limits=replace(problem.limits, position=position))
    assert along_ranges(ranged, motion) == along
