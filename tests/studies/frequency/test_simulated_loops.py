"""Simulated loops of a frequency response, and what a measurement refuses."""

import numpy as np
import pytest

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.sampling import sampling
from linkplan.controllers.trackers.pd import pd, pd_gain
from linkplan.controllers.trackers.tracker import with_feedforward
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.frequency.excitation import whole_samples
from linkplan.studies.feedback.frequency.feedback_loops import feedback_loop, law_gain, operating_point
from linkplan.studies.feedback.frequency.simulated_loops import SimulatedLoops
from linkplan.studies.feedback.frequency.sinestream import measure
from tests.support.machines import run_alone
from tests.support.mechanisms import FIVE_BAR
from tests.support.tolerances_loops import COUPLED_DB, COUPLED_DEG, NEAREST_WHOLE

# States and commands against rollout's own, where the order of sums differs. Measured 1e-16 and 3e-15.
SAME = 1e-12
KP, KD, N = 200.0, 20.0, 400
ARRAYS = ("time_s", "pose_rad", "position_rad", "velocity_rad_s", "effort")


def kicked(point, speed):
    """Return the point held at rest, its first sample asking for a speed: what starts a run with one."""
    still = point.constant(1e-4, N)
    arrays = {name: np.array(getattr(still, name)) for name in ARRAYS}
    arrays["velocity_rad_s"][0] = speed
    return SampledReference(period_s=1e-4, cycle=None, **arrays)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_every_simulation_is_the_run_of_its_own_loop(delay):
    mechanism = load_mechanism("optimus-knee", payload="shank")
    points = [operating_point(mechanism, np.radians([angle])) for angle in (-30.0, 3.6, 40.0)]
    references = [kicked(point, speed) for point, speed in zip(points, (0.01, 0.5, -4.0), strict=True)]
    trackers = [with_feedforward(pd(mechanism, r, KP, KD)) for r in references]
    loop = ControlLoop(effort_limit=np.array([[-30.0, 30.0]]), delay_periods=delay)
    runs = [run_alone(mechanism, r, tracker, loop) for r, tracker in zip(references, trackers, strict=True)]
    batch = SimulatedLoops(
        mechanism,
        pose=np.array([r.pose_rad[0] for r in references]),
        velocity=np.array([r.velocity_rad_s[0] for r in references]),
        gain=np.array([tracker.gains[0] for tracker in trackers]),
        under_way=np.array([rollout.commanded[0] for rollout in runs]),
        timing=sampling(mechanism, 1e-4, delay),
        effort_limit=loop.effort_limit,
    )
    along = np.stack([np.concatenate([r.position_rad, r.velocity_rad_s], axis=1) for r in references], axis=1)
    states, commands = batch.run(np.arange(3), along, np.stack([r.effort for r in references], axis=1))
    for i, rollout in enumerate(runs):
        assert np.abs(states[:, i, 0] - rollout.position_rad[:, 0]).max() < SAME
        assert np.abs(states[:, i, 1] - rollout.velocity_rad_s[:, 0]).max() < SAME * 1e3
        assert np.abs(commands[:, i] - rollout.commanded).max() < SAME * 1e3
    # The limit is met on the way, so that its share in the loop is looked at too.
    assert runs[2].saturated_fraction > 0


def test_a_simulation_left_out_runs_no_more():
    mechanism = load_mechanism("optimus-knee")
    point = operating_point(mechanism, np.radians([3.6]))
    batch = SimulatedLoops(
        mechanism,
        pose=np.tile(point.pose, (2, 1)),
        velocity=np.full((2, 1), 0.1),
        gain=np.tile(pd_gain(np.eye(1), KP, 1.0), (2, 1, 1)),
        under_way=np.tile(point.hold, (2, 1)),
        timing=sampling(mechanism, 1e-4),
        effort_limit=mechanism.effort_limit,
    )
    before = batch.state()
    batch.run(np.array([1]), np.tile(point.state, (5, 1, 1)), np.tile(point.hold, (5, 1, 1)))
    after = batch.state()
    assert np.all(np.isnan(after[0]))
    assert not np.array_equal(after[1], before[1])


SERVO = """<mujoco><option timestep="1e-3" integrator="{integrator}"><flag contact="disable"/></option><worldbody>
<body><joint name="O" axis="0 1 0" damping="0.02" armature="0.01"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
</body></worldbody><actuator>
<position name="servo" joint="O" gear="2" kp="30" kv="1.5" ctrlrange="-1 1" forcerange="-9 9"/></actuator></mujoco>"""


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast", "RK4", "discrete"])
def test_a_servo_s_simulations_are_the_runs_of_its_loop_whatever_the_integrator(integrator):
    mechanism = load_mechanism(SERVO.format(integrator=integrator))
    point, period = operating_point(mechanism, np.array([0.2])), 2e-3
    still = point.constant(period, N)
    arrays = {name: np.array(getattr(still, name)) for name in ARRAYS}
    arrays["velocity_rad_s"][0] = 3.0
    reference = SampledReference(period_s=period, cycle=None, **arrays)
    tracker = with_feedforward(pd(mechanism, reference, 20.0, 0.5))
    loop = ControlLoop(effort_limit=np.array([[-9.0, 9.0]]))
    rollout = run_alone(mechanism, reference, tracker, loop)
    batch = SimulatedLoops(
        mechanism,
        pose=reference.pose_rad[:1],
        velocity=reference.velocity_rad_s[:1],
        gain=tracker.gains[:1],
        under_way=rollout.commanded[:1],
        timing=sampling(mechanism, period, 0),
        effort_limit=loop.effort_limit,
        motion=reference,
    )
    along = np.concatenate([reference.position_rad, reference.velocity_rad_s], axis=1)[:, None]
    states, _ = batch.run(np.arange(1), along, reference.effort[:, None])
    assert np.ptp(rollout.position_rad) > 1e-3
    assert np.abs(states[:, 0, 0] - rollout.position_rad[:, 0]).max() < SAME


def test_measured_frequencies_repeat_after_whole_samples_next_to_those_asked_for():
    asked = np.geomspace(0.7, 499.0, 60)
    p, N = whole_samples(asked, 1e-3)
    assert np.all(np.gcd(p, N) == 1)
    assert np.all(2 * p < N)
    found = p / (N * 1e-3)
    assert np.all(np.diff(found) > 0)
    low = asked < 450
    nearest = np.abs(found[:, None] / asked[None, low] - 1).min(axis=0)
    assert nearest.max() < NEAREST_WHOLE


def five_bar_loops():
    mechanism = load_mechanism(FIVE_BAR)
    assert mechanism.dof == mechanism.n_u == 2
    settings = Tracking(kp=20.0, kd=1.0, period_s=1e-3)
    point = operating_point(mechanism, mechanism.home[mechanism.independent])
    gain = law_gain(point, "pd", settings, mechanism.effort_limit)
    return mechanism, feedback_loop(point, gain, sampling(mechanism, 1e-3)), settings


@pytest.mark.slow
def test_each_joints_loop_is_predicted_and_measured_with_the_others_closed():
    mechanism, loop, _ = five_bar_loops()
    for channel in range(2):
        taken = measure([loop], np.array([2.0, 8.0, 30.0]), mechanism.effort_limit, channel=channel)
        for name, response in taken.responses[0].items():
            db, deg = response.against(loop.response(name, response.frequency_hz, channel))
            assert np.abs(db).max() < COUPLED_DB, name
            assert np.abs(deg).max() < COUPLED_DEG, name
    # The other loop matters: without it the first one's plant is another.
    alone = loop.plant(np.array([2.0]))[0, 0, 0]
    assert abs(loop.gains("plant", np.array([2.0]), 0)[0] / alone - 1) > 0.01


def test_the_study_has_a_loop_for_every_joint():
    from linkplan.studies.output.text import text_of

    mechanism, _, settings = five_bar_loops()
    home = mechanism.home[mechanism.independent][None]
    study = bode_study(mechanism, home, settings, mechanism.effort_limit, scanned=0)
    loops = study.loops[0].loops
    assert list(loops) == [f"pd {joint.name}" for joint in mechanism.independent_joints]
    text = text_of(study.summary())
    assert "stable" in text
    for joint in mechanism.independent_joints:
        assert f"{joint.name} at " in text


@pytest.fixture(scope="module")
def knee():
    return load_mechanism("optimus-knee")


def test_a_pose_that_the_limits_cannot_hold_is_refused():
    heavy = load_mechanism("optimus-knee", payload="shank")
    with pytest.raises(LinkplanError, match=r"cannot be held at O = 56 deg: act_O would need 7\.8\d* N\.m"):
        operating_point(heavy, np.radians([56.0]), np.array([[-2.0, 2.0]]))


def test_a_delay_between_simulator_steps_takes_finer_steps_or_is_refused(knee):
    assert sampling(knee, 1e-4, 0.25).substeps == 4
    with pytest.raises(LinkplanError, match="is not a whole number of simulator steps"):
        sampling(knee, 1e-4, 0.2512)
