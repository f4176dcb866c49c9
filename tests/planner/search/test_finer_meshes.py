"""The refinement of fast motions of several motors: meshes, margins, corrections and their time."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

import linkplan
from linkplan.models.deadline import Deadline, OutOfTimeError
from linkplan.planner.certificate.further_checks import objective_value
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess, guess_from
from linkplan.planner.limits.joints import RangeLimit
from linkplan.planner.limits.limit import with_limits
from linkplan.planner.problem.instant import Robust
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.refinement.actions import nearest_on
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.history import recorded, recording
from linkplan.planner.search import finer_meshes, pieces
from linkplan.planner.search.finer_meshes import FIRST_MARGIN, at_a_distance, gain_at_margin
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.solvers.newton import FEASIBLE
from linkplan.planner.solvers.solve import SUCCEEDED
from linkplan.planner.transcription.mesh import uniform
from tests.bench.many_robots import write_robots
from tests.support.arms import arm
from tests.support.legs import LOAD, leg, refined

ARM_EFFORT, KNEE_S, LEG_S = 18.302525, 0.12185127, 0.18663512


@pytest.fixture(scope="module")
def in_least_time():
    return leg(duration_s="free", minimize="time")


@pytest.fixture(scope="module")
def laden():
    return leg(payload=LOAD, duration_s="free", minimize="time")


def test_the_multipliers_promise_what_a_smaller_distance_from_singular_poses_gains(laden):
    case = at_a_distance(case_of(laden), laden.start_pose())
    first = attempt(case, first_guess(laden, laden.start_pose()), uniform(24), np.array([0.3]), "margin as it is")
    nearer = replace(case, problem=with_limits(case.problem, singular_margin=0.9 * FIRST_MARGIN))
    second = attempt(nearer, guess_from(first.motion), uniform(24), np.array([first.motion.duration_s]), "a smaller one")
    gained = 1.0 - second.solution.objective / first.solution.objective
    assert gained > 1e-5
    assert gain_at_margin(case, first, 0.9 * FIRST_MARGIN) == pytest.approx(gained, rel=0.2)
    assert gain_at_margin(case, first, FIRST_MARGIN) == 0.0


def test_motions_come_nearer_to_singular_poses_before_they_are_exact(laden):
    plan = plan_motion(laden)
    steps = [step.what for step in plan.history]
    assert steps.index("nearer to singular poses") == steps.index("jumps of efforts as unknowns") + 1
    assert plan.passed
    assert plan.objective < 0.20272  # 0.20271 s; 0.203292 s at the first distance


def test_rows_between_the_nodes_are_those_of_the_joints_that_need_them(in_least_time):
    joints = in_least_time.mechanism.independent
    for asked, found in ((True, [0, 1]), ({1}, [1])):
        limits = RangeLimit.of(in_least_time, position_rows=asked)
        assert [(limit.item, limit.column) for limit in limits] == [(joints[k], k) for k in found]


def test_a_least_time_with_limits_on_the_rates_of_efforts_is_changed_until_a_proof_accepts_its_efforts(in_least_time):
    """On the finer mesh no motion has all the efforts and rates at their limits that the coarse motion has there."""
    rates = np.array([[-13931.0, 13931.0], [-12859.0, 12859.0]])  # across all of its range in a tenth of the motion
    plan = plan_motion(with_limits(in_least_time, effort_rate=rates))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(0.197298, rel=1e-4)  # 0.18664 and the ramps from rest and to rest
    assert plan.certificate.effort_overrun.max() <= 1.0


def test_a_least_time_at_the_corners_of_robust_is_changed_until_every_machine_carries_it(in_least_time):
    """Where efforts at a corner jump inside an interval, the mesh error exceeds their limits; tightening does not help."""
    plan = plan_motion(in_least_time.varied(robust=Robust(torque_constant_factor=(0.9, 1.1))))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(0.196071, rel=1e-4)  # sqrt(1 / 0.9) times 0.18664 but for gravity
    assert all(margin.kept for margin in plan.certificate.margins)
    # A corner's efforts are judged to the accuracy of inverse dynamics, as in the proof.
    margin = next(one for one in plan.certificate.margins if one.what == "robust")
    assert structs.replace(margin, left=-1.9e-6 * abs(margin.limit)).kept
    assert not structs.replace(margin, left=-2.1e-6 * abs(margin.limit)).kept


@pytest.mark.slow
def test_a_least_time_with_joints_along_their_speed_limits_is_proved(tmp_path):
    """Efforts jump where a joint reaches or leaves its speed limit; planned as jumps inside intervals they were refuted."""
    write_robots(tmp_path, ["speed"])
    plan = linkplan.plan(tmp_path / "spatial-4-speed.toml")
    assert plan.status == "optimal"
    assert plan.proof.verdict == "proved"
    assert plan.objective == pytest.approx(0.391782, rel=1e-4)


@pytest.mark.parametrize(
    ("solve_s", "repair_s", "called"),
    [(15.0, 1.0, ["attempt", "nearest_on"]), (8.0, 14.0, ["attempt"] * 2 + ["nearest_on"])],
    ids=["a second solve would not end", "a repair ends after the solves' deadline"],
)
def test_solves_that_the_time_does_not_allow_are_left_and_repairs_are_certified(
    in_least_time, monkeypatch, solve_s, repair_s, called
):
    """There are 25 s for solves, of which two thirds are for those after the first motion."""
    calls = []
    deadline = Deadline(clock=lambda: sum(seconds for _, seconds in calls)).within(25.0)
    solver = in_least_time.solver.replace(max_time_s=60.0, deadline=deadline)
    taking(monkeypatch, "attempt", calls, solve_s)
    taking(monkeypatch, "nearest_on", calls, repair_s)
    found = refined(in_least_time.varied(solver=solver), 0.2)
    assert [name for name, _ in calls] == called
    assert finer_meshes.is_sound(found.certificate)


def test_of_a_solve_that_runs_out_of_iterations_the_nearest_motion_is_used(in_least_time, monkeypatch):
    """Further meshes follow until a solve ends by itself; if the first small gain counted, the motion took 2e-5 longer."""
    monkeypatch.setattr(finer_meshes, "_MOST_ITERATIONS", 16)
    with recording():
        found = refined(in_least_time, 0.2)
        _, *finer = [step.solver_status for step in recorded() if step.what != "the same motion on a finer mesh"]
    assert finer[0] == FEASIBLE
    assert finer[-1] == SUCCEEDED
    assert finer_meshes.is_sound(found.certificate)
    assert found.motion.duration_s == pytest.approx(LEG_S, rel=1e-5)


def test_a_corrected_motion_that_needs_slightly_too_much_effort_takes_slightly_longer(in_least_time, monkeypatch):
    """With fewer intervals and no distance from the limits on efforts, the corrected motion exceeds them between nodes."""
    monkeypatch.setattr(finer_meshes, "_DISTANCE_OF_EFFORTS", 0.0)
    monkeypatch.setattr(pieces, "_MAX_PIECES_OF_CORRECTIONS", 2)
    corrected, slowed = [], finer_meshes._slowed
    monkeypatch.setattr(finer_meshes, "_slowed", lambda case, at: corrected.append(at) or slowed(case, at))
    found, last = refined(in_least_time, 0.2), corrected[-1]
    overrun = last.certificate.effort_overrun.max()
    assert overrun > 1.0
    assert finer_meshes.is_sound(found.certificate)
    longer = found.motion.duration_s / last.found.motion.duration_s
    assert longer == pytest.approx(1.0 + 2e-6 * (1.0 + overrun), abs=1e-12)
    assert not found.certificate.effort_overrun.any()
    assert found.solution.objective == pytest.approx(longer * last.found.solution.objective, rel=1e-6)
    monkeypatch.setattr(finer_meshes, "in_more_time", lambda *_: _out_of_time())
    found = refined(in_least_time, 0.2)  # a further correction takes its place
    assert finer_meshes.is_sound(found.certificate)
    assert found.motion.breaks_s.size > last.found.motion.breaks_s.size


def _out_of_time():
    raise OutOfTimeError("the deadline passed")


def taking(monkeypatch, name: str, calls: list, seconds: float) -> None:
    """Append the name and an assumed duration [s] of each call of a function of `finer_meshes` to `calls`."""
    function = getattr(finer_meshes, name)

    def timed(*given, **named):
        found = function(*given, **named)
        calls.append((name, seconds))
        return found

    monkeypatch.setattr(finer_meshes, name, timed)


def straight_arm(scheme: str, **asked):
    ends = {"start_deg": {"J1": -60.0, "J2": 20.0}, "goal_deg": {"J1": 40.0, "J2": -50.0}}
    return linkplan.Problem.reach(arm(0.5, 0.4, limit=40.0), **ends, **asked, mesh={"scheme": scheme})


def test_a_correction_that_costs_more_than_a_thousandth_is_no_correction(in_least_time, monkeypatch):
    """A correction that costs 0.2 % more is refused, so that the uncorrected motion remains; 0.05 % more is accepted."""
    for cost, accepted in ((1.002, False), (1.0005, True)):

        def dearer(*given, cost=cost, **named):
            found = nearest_on(*given, **named)
            return replace(found, solution=replace(found.solution, objective=cost * found.solution.objective))

        monkeypatch.setattr(finer_meshes, "nearest_on", dearer)
        assert finer_meshes.is_sound(refined(in_least_time, 0.2).certificate) == accepted


def test_the_soundest_of_the_corrected_motions_is_the_answer(monkeypatch):
    """If no corrected motion is sound, the one that exceeds the allowance of effort least is returned."""
    overruns, seen = iter([16.0, 2.0, 300.0, 5.0, 9.0, 9.0, 9.0, 9.0]), []

    def unsound(kept):
        overrun = next(overruns)
        certificate = structs.replace(kept.at.certificate, effort_overrun=np.array([overrun]), failures=("errs",))
        seen.append(overrun)
        return replace(kept.at, certificate=certificate)

    monkeypatch.setattr(finer_meshes, "repaired", unsound)
    monkeypatch.setattr(finer_meshes, "SETTLED_CHANGE", 0.0)  # so several meshes have a motion that passes
    found = refined(straight_arm("radau-3", duration_s=0.5, minimize="effort"), 0.5)
    assert len(seen) > 1
    assert found.certificate.effort_overrun.max() == min(seen)


@pytest.mark.parametrize("scheme", ["trapezoid", "hermite-simpson", "radau-2"])
def test_a_first_order_scheme_is_refined_until_a_proof_accepts_positions_and_velocities(scheme):
    plan = plan_motion(straight_arm(scheme, duration_s=0.5, minimize="effort"))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(ARM_EFFORT, rel=1e-4)
    assert plan.prove(existence=False).passed


def test_the_knee_s_least_time_by_a_first_order_scheme_is_the_exact_one():
    plan = plan_motion(load_problem("knee-sprint", ["mesh.scheme=hermite-simpson"]))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(KNEE_S, rel=1e-6)


@pytest.mark.hardest
def test_a_least_time_whose_mesh_needs_a_little_more_effort_is_answered_by_a_slightly_slower_motion():
    """On 4,647 intervals of the trapezoid rule the motion needs 2e-6 of its limit more than a proof allows."""
    plan = plan_motion(load_problem("knee-sprint", ["mesh.scheme=trapezoid"]))
    assert plan.passed
    assert plan.objective == pytest.approx(KNEE_S, rel=2e-4)


def test_what_a_correction_costs_is_reported_as_a_change_on_a_finer_mesh(monkeypatch):
    repaired = finer_meshes.repaired

    def dearer(kept):
        at = repaired(kept)
        solution = replace(at.found.solution, objective=1.002 * at.found.solution.objective)
        return replace(at, found=replace(at.found, solution=solution))

    monkeypatch.setattr(finer_meshes, "repaired", dearer)
    plan = plan_motion(straight_arm("radau-3", duration_s=0.5, minimize="effort"))
    assert "on a finer mesh its objective still changed by 0.2 %" in plan.message


def test_a_mesh_that_never_suffices_ends_at_the_largest_legal_number_of_intervals(monkeypatch):
    monkeypatch.setattr(finer_meshes, "MAX_INTERVALS", 600)
    monkeypatch.setattr(finer_meshes, "_MAX_RESTORATIONS", 2)
    found = refined(straight_arm("trapezoid", duration_s="free", minimize="time"), 0.2)
    assert not finer_meshes.is_sound(found.certificate)
    assert len(found.motion.breaks_s) <= 601


@pytest.mark.slow
def test_a_motion_within_a_limit_on_the_jerk_of_a_site_has_segments_that_end_where_the_jerk_turns_about():
    """The size of the jerk stays at its limit. If no segment ends where it turns about, the motion costs 0.3 % more."""
    plan = plan_motion(leg(duration_s=0.28, minimize="effort", limits={"site_jerk_m_s3": {"toe": 2e4}}))
    assert plan.status == "optimal"
    assert plan.history[-1].segments > 1
    assert plan.objective == pytest.approx(859.65, rel=1e-3)


@pytest.mark.slow
def test_a_segment_whose_switch_times_meet_on_finer_meshes_is_removed_and_the_motion_is_proved():
    """Within 0.8 times the largest force on the rod's pin; a segment of 6e-11 s had accelerations of rounding only."""
    plan = linkplan.plan(leg(minimize="time", limits={"closure_force": {"rod_end-knee_tab": 2347.431}}))
    assert plan.status == "optimal"
    assert plan.proof.passed
    assert plan.objective == pytest.approx(0.187648, rel=1e-4)


def test_least_work_is_refined_like_other_motions_and_its_objective_is_that_of_the_motion():
    """The refinement of one motor, on twice the intervals, has 11.9912, and 12.0035 on these."""
    plan = plan_motion(leg(duration_s=0.3, minimize="work"))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(objective_value(plan.problem, plan.trajectory)[0], rel=1e-5)
    assert plan.objective == pytest.approx(11.9912, rel=2e-4)
