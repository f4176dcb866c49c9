"""The closed loop in MuJoCo: what acts and when, on which masses; loops closed, limits kept, verdicts right."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.rollout import ControlLoop, Rollout
from linkplan.controllers.trackers.pd import pd
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.compare.compare import build_tracker
from tests.support.bodies import HINGE, HINGE_INERTIA
from tests.support.fourbar import KNEE_PROBLEMS
from tests.support.machines import run_alone
from tests.support.plans import GOAL, optimal
from tests.support.references import hinge_reference
from tests.support.scripted import Scripted
from tests.support.tolerances_planner import (
    DIED_OUT,
    FEEDFORWARD_GAIN,
    OPEN_LOOP_DEG,
    ROLLOUT_GAP_M,
    ROUNDING,
    SAME_FIGURE,
    SINE_RMS_DEG,
    STILL,
)

# How long each built-in plan is tracked here [s]: the motion and a rest, or one period.
DURATION = {"knee-sine": 0.25, "knee-sine-shank": 0.25, "knee-reach": 0.24, "knee-sprint": 0.2, "knee-sprint-bare": 0.005}
TRACKERS = ("pd", "pd+ff", "lqr")
# The sinusoid needs no solving: it is the plan of the quick set.
every_plan = pytest.mark.parametrize(
    "name", [name if name == "knee-sine" else pytest.param(name, marks=pytest.mark.slow) for name in KNEE_PROBLEMS]
)
every_tracker = pytest.mark.parametrize("kind", TRACKERS)


@cache
def reference_of(name: str, period_s: float | None = None) -> SampledReference:
    plan = optimal(name)
    return sample(plan.problem.mechanism, plan.trajectory, period_s or plan.problem.tracking.period_s, DURATION[name])


def loop_of(name: str, **changes) -> ControlLoop:
    problem = optimal(name).problem
    return replace(ControlLoop(effort_limit=problem.limits.effort, delay_periods=problem.tracking.delay_periods), **changes)


@cache
def tracked(kind: str, name: str) -> Rollout:
    """Return a built-in plan tracked with its own settings."""
    reference = reference_of(name)
    return run_alone(
        optimal(name).problem.mechanism, reference, build_tracker(kind, optimal(name), reference), loop_of(name)
    )


def rms_deg(rollout: Rollout) -> float:
    return float(np.degrees(np.sqrt(np.mean(rollout.error_rad**2))))


# Every run.


@pytest.mark.slow
@every_plan
@every_tracker
def test_the_loop_stays_closed_to_ten_micrometres(kind, name):
    rollout = tracked(kind, name)
    assert rollout.finite
    assert np.abs(rollout.velocity_rad_s).max() > 1  # it moves
    assert 0 < rollout.gap_m.max() < ROLLOUT_GAP_M


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pd", "pd+ff"])
def test_a_command_beyond_the_limit_acts_as_the_limit(kind):
    rollout = tracked(kind, "knee-sprint")
    beyond = np.abs(rollout.commanded) > 100
    assert beyond.mean() > 0.01
    np.testing.assert_array_equal(np.abs(rollout.applied[beyond]), 100)
    np.testing.assert_array_equal(rollout.applied[~beyond], rollout.commanded[~beyond])
    assert rollout.saturated_fraction == pytest.approx(beyond.mean())


@every_plan
def test_a_run_begins_in_the_reference_s_state(name):
    rollout, reference = tracked("pd", name), reference_of(name)
    np.testing.assert_array_equal(rollout.pose_rad[0], reference.pose_rad[0])
    np.testing.assert_allclose(rollout.velocity_rad_s[0], reference.velocity_rad_s[0], rtol=ROUNDING)


def test_a_run_records_what_its_result_depends_on():
    conditions = tracked("pd", "knee-sine").conditions
    assert conditions["mujoco"] == mujoco.__version__
    assert conditions["timestep_s"] == conditions["control_period_s"] == 1e-4
    assert conditions["integrator"] == "EULER"
    assert conditions["solref"] == [[0.0002, 1.0]]
    assert conditions["duration_s"] == pytest.approx(0.25)


def test_a_slower_controller_leaves_the_simulation_s_step_alone():
    reference = reference_of("knee-reach", 1e-3)
    plan = optimal("knee-reach")
    rollout = run_alone(plan.problem.mechanism, reference, build_tracker("lqr", plan, reference), loop_of("knee-reach"))
    assert rollout.conditions["timestep_s"] == pytest.approx(1e-4)
    assert len(rollout.time_s) == 240


# How well each tracker does.


def test_the_knee_s_sinusoid_is_tracked_by_pd_alone():
    assert 0.001 < rms_deg(tracked("pd", "knee-sine")) < SINE_RMS_DEG


@pytest.mark.slow
@pytest.mark.parametrize("name", ["knee-sine-shank", "knee-reach", "knee-sprint"])
@pytest.mark.parametrize("kind", ["pd+ff", "lqr"])
def test_knowing_the_effort_leaves_at_most_a_tenth_of_pd_s_error(kind, name):
    assert rms_deg(tracked("pd", name)) > 1
    assert rms_deg(tracked(kind, name)) < FEEDFORWARD_GAIN * rms_deg(tracked("pd", name))


@pytest.mark.slow
def test_the_planned_effort_alone_takes_mujoco_to_the_goal():
    """No feedback: MuJoCo's own dynamics, integrated under the plan, arrive where the plan does."""
    plan = optimal("knee-reach")
    reference = sample(plan.problem.mechanism, plan.trajectory, 2.5e-5, plan.trajectory.duration_s)
    rollout = run_alone(plan.problem.mechanism, reference, Scripted(efforts=reference.effort), loop_of("knee-reach"))
    assert np.abs(np.degrees(rollout.error_rad)).max() < OPEN_LOOP_DEG
    assert np.degrees(rollout.position_rad[-1, 0]) == pytest.approx(np.degrees(GOAL), abs=OPEN_LOOP_DEG)


# Verdicts.


@pytest.mark.parametrize(("share", "stable"), [(0.9, True), (1.1, False)])
def test_sampled_damping_of_a_pure_inertia_is_stable_up_to_twice_the_inertia_over_the_period(share, stable):
    """Held for one period T, a damper turns v into (1 - kd T / I) v: stable while kd < 2 I / T."""
    hinge = load_mechanism(HINGE.replace("<option ", '<option timestep="0.01" '))
    reference = hinge_reference(hinge, 400)
    started = replace(reference, velocity_rad_s=np.concatenate([[[0.01]], reference.velocity_rad_s[1:]]))
    tracker = pd(hinge, reference, 0.0, share * 2 * HINGE_INERTIA / 0.01)
    rollout = run_alone(hinge, started, tracker, ControlLoop(effort_limit=hinge.effort_limit))
    assert rollout.velocity_rad_s[0, 0] == 0.01
    assert rollout.stable == stable
    assert (np.abs(rollout.velocity_rad_s[-50:]).max() < DIED_OUT) == stable


def log_with(applied: np.ndarray, failure: str | None = None) -> Rollout:
    n = len(applied)
    zeros = np.zeros((n, 1))
    return Rollout(
        tracker="drawn",
        time_s=np.arange(n) * 1e-4,
        position_rad=zeros,
        velocity_rad_s=zeros,
        reference_rad=zeros,
        pose_rad=zeros,
        commanded=applied[:, None],
        applied=applied[:, None],
        gap_m=np.zeros(n),
        contacts=0,
        failure=failure,
        effort_limit=np.array([[-1.0, 1.0]]),
        conditions={},
    )


@pytest.mark.parametrize(
    ("what", "applied", "stable"),
    [
        ("rest", np.zeros(1000), True),
        ("one switch of a bang-bang plan", np.repeat([1.0, -1.0], 500), True),
        ("three switches", np.repeat([1.0, -1.0, 1.0, -1.0], 250), True),
        ("a limit held", np.ones(1000), True),
        ("a chatter", np.tile([1.0, -1.0], 500), False),
        ("a slower chatter", np.tile(np.repeat([1.0, -1.0], 5), 100), False),
        ("a chatter below the limits", np.tile([0.9, -0.9], 500), True),
        ("five swings of a short run", np.repeat([1.0, -1.0, 1.0, -1.0, 1.0, -1.0], 5), True),
        ("seven swings of a short run", np.repeat([1.0, -1.0] * 4, 5), False),
        ("seven swings in a thousand instants", np.concatenate([np.repeat([1.0, -1.0] * 4, 5), np.zeros(960)]), True),
        ("swings with 9 periods between the limits", np.tile([1.0, *9 * [0.0], -1.0, *9 * [0.0]], 50), False),
        ("swings with 10 periods between the limits", np.tile([1.0, *10 * [0.0], -1.0, *10 * [0.0]], 50), True),
    ],
)
def test_only_swinging_between_the_limits_again_and_again_is_unstable(what, applied, stable):
    del what
    assert log_with(applied).stable == stable


def test_the_largest_gaps_of_a_run_are_those_of_its_worst_instants():
    gaps = replace(log_with(np.zeros(3)), gap_m=np.array([1e-6, 3e-6, 2e-6]), gap_rad=np.array([0.01, 0.03, 0.02]))
    assert gaps.largest_gaps == (3e-6, 0.03)
    assert log_with(np.zeros(3)).largest_gaps == (0.0, 0.0)


def test_a_run_that_blew_up_is_unstable():
    assert not log_with(np.zeros(100), failure="the simulation diverged").stable


def test_a_simulation_that_blows_up_ends_its_log_and_says_so():
    hinge = load_mechanism(HINGE)
    n = 100
    efforts = np.full((n, 1), 9e9)  # the speed passes MuJoCo's largest number within forty steps
    rollout = run_alone(
        hinge, hinge_reference(hinge, n), Scripted(efforts=efforts), ControlLoop(effort_limit=np.array([[-np.inf, np.inf]]))
    )
    assert not rollout.finite
    assert not rollout.stable
    assert len(rollout.time_s) == len(rollout.pose_rad) == len(rollout.applied) < n


@pytest.mark.parametrize("effort", [np.nan, np.inf])
def test_a_command_that_is_no_number_does_not_pass_for_a_good_run(effort):
    """MuJoCo takes such a control for zero and goes on."""
    efforts = np.zeros((20, 1))
    efforts[10] = effort
    rollout = hinge_run(efforts, effort_limit=np.array([[-np.inf, np.inf]]))
    assert rollout.failure == "the tracker gave an effort that is not a number"
    assert not rollout.stable


# Drives.


def test_a_motor_at_full_command_approaches_its_no_load_speed_as_its_line_says():
    """I w' = stall (1 - w / no_load): w = no_load (1 - exp(-stall t / (I no_load)))."""
    n, stall, no_load = 400, 3.0, 10.0
    rollout = hinge_run(np.full((n, 1), 1e3), motor_line=np.array([[stall, no_load]]))
    time, inertia = rollout.time_s, HINGE_INERTIA
    exact = no_load * (1.0 - np.exp(-stall * time / (inertia * no_load)))
    assert exact[-1] > 0.9 * no_load
    assert np.abs(rollout.velocity_rad_s[:, 0] - exact).max() < 0.01 * no_load
    share = rollout.applied[:, 0] / stall + rollout.velocity_rad_s[:, 0] / no_load
    assert share.max() < 1.0 + 1e-9


def test_a_motor_beyond_its_no_load_speed_brakes():
    rollout = hinge_run(np.full((40, 1), 5.0), motor_line=np.array([[5.0, 1e-3]]))
    assert rollout.applied.min() < 0.0
    assert np.abs(rollout.velocity_rad_s).max() < 0.5


def test_efforts_change_no_faster_than_the_drive_s_rate():
    efforts = np.concatenate([np.zeros((1, 1)), np.full((60, 1), 3.0)])
    rollout = hinge_run(efforts, rate_limit=np.array([100.0]))
    period = rollout.time_s[1]
    # The last simulator step of a ramp applies the command from its beginning: a fiftieth more in a period's mean.
    assert np.diff(rollout.applied[:, 0]).max() <= 1.021 * 100.0 * period
    assert rollout.applied[2, 0] == pytest.approx(1.5 * 100.0 * period, rel=0.05)
    assert rollout.applied[-1, 0] == pytest.approx(3.0)


# Delay.


def hinge_run(efforts: np.ndarray, **changes) -> Rollout:
    hinge = load_mechanism(HINGE)
    loop = replace(ControlLoop(effort_limit=hinge.effort_limit), **changes)
    return run_alone(hinge, hinge_reference(hinge, len(efforts)), Scripted(efforts=efforts), loop)


@pytest.mark.parametrize("delay", [0, 2, 5])
def test_the_motion_follows_the_delayed_command(delay):
    efforts = np.zeros((40, 1))
    efforts[10] = 3.0
    rollout = hinge_run(efforts, delay_periods=delay)
    moving = np.flatnonzero(np.abs(rollout.velocity_rad_s[:, 0]) > STILL)
    assert moving[0] == 10 + delay + 1  # the state is read before the command acts
    assert rollout.velocity_rad_s[-1, 0] == pytest.approx(3.0 * 0.01 / HINGE_INERTIA, rel=SAME_FIGURE)


def test_a_wider_limit_of_the_problem_admits_what_the_file_would_clamp():
    rollout = hinge_run(np.full((20, 1), 9.0), effort_limit=np.array([[-10.0, 10.0]]))
    np.testing.assert_array_equal(rollout.applied, 9.0)
    assert rollout.velocity_rad_s[-1, 0] == pytest.approx(9.0 * 0.19 / HINGE_INERTIA, rel=SAME_FIGURE)
