"""Fast motions of several motors: a leg whose knee is a four-bar, and the parts of its search by themselves.

The best known values are of an independent collocation, at the nodes of its mesh.
"""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

import linkplan
from linkplan.models.deadline import Deadline, OutOfTimeError
from linkplan.planner.certificate.further_checks import objective_value
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.formulate import FIRST_TIE_WEIGHT, tie_weights
from linkplan.planner.closed_chain.guess import first_guess, guess_from
from linkplan.planner.limits.joints import RangeLimit
from linkplan.planner.limits.limit import with_limits
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.instant import Robust
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.refinement.actions import nearest_on
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.history import recording
from linkplan.planner.search import finer_meshes, multistart, pieces
from linkplan.planner.search.attempts import of_several
from linkplan.planner.search.finer_meshes import FIRST_MARGIN, along_ranges, at_a_distance, gain_at_margin
from linkplan.planner.search.jumps import effort_jumps
from linkplan.planner.search.methods import FULL_BUDGET
from linkplan.planner.search.multistart import from_several_starts
from linkplan.planner.search.planning import plan_motion, search_for
from linkplan.planner.search.without_solver import slower
from linkplan.planner.transcription.mesh import uniform
from tests.bench.many_robots import write_robots
from tests.support.arms import arm
from tests.support.data import DATA
from tests.support.motions import motion_along

LEG = DATA / "leg_with_four_bar_knee.xml"
LOAD = {"body": "shank", "mass_kg": 1.5, "com_m": [0.0, 0.0, 0.0], "inertia_kgm2": [1e-3, 1e-3, 1e-3]}
LEAST_TIME_S, LEAST_EFFORT = 0.18663512, 850.59
ARM_EFFORT, KNEE_S = 18.302525, 0.12185127
ENDS = {"start_deg": {"hip_pitch": 20.0, "knee_motor": 5.0}, "goal_deg": {"hip_pitch": -50.0, "knee_motor": 38.0}}


def leg(payload=None, limits=None, **asked):
    mechanism = linkplan.load_mechanism(LEG, payload=payload)
    limits = {"contacts": "note"} | (limits or {})
    return linkplan.Problem.reach(mechanism, **ENDS, **asked, mesh={"intervals": 40}, limits=limits)


def refined(problem, start_s: float):
    """Return the refined motion of a problem, from a motion on a coarse mesh that begins at a duration."""
    first = multistart._first_case(case_of(problem).problem, problem.start_pose())
    guess = first_guess(problem, problem.start_pose())
    return finer_meshes.refine_several(case_of(problem), attempt(first, guess, uniform(24), np.array([start_s]), "first"))


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
    assert plan.objective < 0.202712  # 0.202711 s; 0.203292 s at the first distance


@pytest.mark.parametrize(("beyond_rad", "along"), [(-1e-5, {0}), (1e-2, set())])
def test_ranges_are_kept_between_the_nodes_where_a_motion_comes_to_their_ends(quickest, beyond_rad, along):
    problem, motion = quickest.problem, quickest.trajectory
    joints, position = problem.mechanism.independent, problem.limits.position.copy()
    position[joints] = [-np.inf, motion.position[:, 1:-1, 0].max() + beyond_rad], [-np.inf, np.inf]
    ranged = replace(problem, limits=replace(problem.limits, position=position))
    assert along_ranges(ranged, motion) == along


def test_rows_between_the_nodes_are_those_of_the_joints_that_need_them(in_least_time):
    joints = in_least_time.mechanism.independent
    for asked, found in ((True, [0, 1]), ({1}, [1])):
        limits = RangeLimit.of(in_least_time, position_rows=asked)
        assert [(limit.item, limit.column) for limit in limits] == [(joints[k], k) for k in found]


def test_a_margin_that_is_asked_for_is_kept():
    problem = leg(duration_s=0.3, limits={"singular_margin": 0.3})
    assert at_a_distance(case_of(problem), problem.start_pose()).problem.limits.singular_margin == 0.3


def test_a_slower_motion_bounds_a_least_time_that_does_not_pass(in_least_time, monkeypatch):
    own = multistart.certified

    def failing(problem, found):
        return own(problem, found) if problem.motion.duration_s else Plan(problem=problem, status="failed", message="")

    monkeypatch.setattr(multistart, "certified", failing)
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
    plan = slower(replace(quickest.problem, limits=limits), [quickest.trajectory])
    if factor is None:
        assert plan is None
        return
    assert plan.status == "feasible"
    assert plan.trajectory.duration_s == pytest.approx(factor * quickest.trajectory.duration_s)
    assert plan.certificate.effort_overrun.max() <= 1.0
    motion = replace(plan.problem.motion, max_duration_s=quickest.trajectory.duration_s)
    assert slower(replace(plan.problem, motion=motion), [quickest.trajectory]) is None


def test_a_least_time_with_limits_on_the_rates_of_efforts_is_changed_until_a_proof_accepts_its_efforts(in_least_time):
    """On the finer mesh no motion has all the efforts and rates at their limits that the coarse motion has there."""
    rates = np.array([[-13931.0, 13931.0], [-12859.0, 12859.0]])  # across all of its range in a tenth of the motion
    plan = plan_motion(with_limits(in_least_time, effort_rate=rates))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(0.186965, rel=1e-4)
    assert plan.certificate.effort_overrun.max() <= 1.0


def test_a_least_time_at_the_corners_of_robust_is_changed_until_every_machine_carries_it(in_least_time):
    """Where efforts of a corner jump inside an interval, the error of the mesh overruns them: tightening does not help."""
    plan = plan_motion(replace(in_least_time, robust=Robust(torque_constant_factor=(0.9, 1.1))))
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
    found = refined(replace(in_least_time, solver=solver), 0.2)
    assert [name for name, _ in calls] == called
    assert finer_meshes.is_sound(found.certificate)


def test_a_corrected_motion_that_needs_slightly_too_much_effort_takes_slightly_longer(in_least_time, monkeypatch):
    """On a coarser mesh at no distance from the limits on efforts, the correction overruns them between the nodes."""
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
    """Record the name and the duration of each call of a function of `finer_meshes`."""
    function = getattr(finer_meshes, name)

    def timed(*given, **named):
        found = function(*given, **named)
        calls.append((name, seconds))
        return found

    monkeypatch.setattr(finer_meshes, name, timed)


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
        certificate = structs.replace(kept.at.certificate, effort_overrun=np.array([overrun]))
        seen.append(overrun)
        return replace(kept.at, certificate=certificate)

    monkeypatch.setattr(finer_meshes, "_repaired", unsound)
    monkeypatch.setattr(finer_meshes, "_SETTLED_CHANGE", 0.0)  # so several meshes have a motion that passes
    found = refined(straight_arm("radau-3", duration_s=0.5, minimize="effort"), 0.5)
    assert len(seen) > 1
    assert found.certificate.effort_overrun.max() == min(seen)


@pytest.mark.parametrize("scheme", ["trapezoid", "hermite-simpson", "radau-2"])
def test_a_first_order_scheme_is_refined_until_a_proof_accepts_positions_and_velocities(scheme):
    plan = plan_motion(straight_arm(scheme, duration_s=0.5, minimize="effort"))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(ARM_EFFORT, rel=1e-4)
    assert plan.prove(existence=False).passed


@pytest.mark.parametrize("scheme", ["trapezoid", "hermite-simpson"])
def test_the_knee_s_least_time_by_a_first_order_scheme_is_the_exact_one(scheme):
    plan = plan_motion(load_problem("knee-sprint", [f"mesh.scheme={scheme}"]))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(KNEE_S, rel=1e-6)


def test_what_a_correction_costs_is_reported_as_a_change_on_a_finer_mesh(monkeypatch):
    repaired = finer_meshes._repaired

    def dearer(kept):
        at = repaired(kept)
        solution = replace(at.found.solution, objective=1.002 * at.found.solution.objective)
        return replace(at, found=replace(at.found, solution=solution))

    monkeypatch.setattr(finer_meshes, "_repaired", dearer)
    plan = plan_motion(straight_arm("radau-3", duration_s=0.5, minimize="effort"))
    assert "on a finer mesh its objective still changed by 0.2 %" in plan.message


def test_a_mesh_that_never_suffices_ends_at_the_largest_legal_number_of_intervals(monkeypatch):
    monkeypatch.setattr(finer_meshes, "MAX_INTERVALS", 600)
    monkeypatch.setattr(finer_meshes, "_MAX_RESTORATIONS", 2)
    found = refined(straight_arm("trapezoid", duration_s="free", minimize="time"), 0.2)
    assert not finer_meshes.is_sound(found.certificate)
    assert len(found.motion.breaks_s) <= 601


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


@pytest.mark.slow
def test_a_motion_within_a_limit_on_the_jerk_of_a_site_has_segments_that_end_where_the_jerk_turns_about():
    """Its size stays at the limit. On meshes without these ends, the same motion costs 0.3 % more."""
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
    assert not of_several(replace(in_least_time, mesh=in_least_time.mesh.replace(breaks=breaks)))


def test_least_work_is_refined_like_other_motions_and_its_objective_is_that_of_the_motion():
    """The refinement of one motor, on twice the intervals, has 11.9912, and 12.0035 on these."""
    plan = plan_motion(leg(duration_s=0.3, minimize="work"))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(objective_value(plan.problem, plan.trajectory)[0], rel=1e-5)
    assert plan.objective == pytest.approx(11.9912, rel=2e-4)


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
