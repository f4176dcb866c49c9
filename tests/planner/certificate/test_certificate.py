"""Certificates: what a motion that is broken on purpose is told, and figures against other routes."""

from dataclasses import replace

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.certificate import certificate as module
from linkplan.planner.certificate.certificate import Certificate, certify, integration_rtol
from linkplan.planner.closed_chain.case import slow_share
from linkplan.planner.limits.samples import sample_points, samples_of
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import bernstein_matrix
from tests.support.bodies import HINGE, LIFT, body_problem
from tests.support.fourbar import KNEE_PROBLEMS, SHANK, knee
from tests.support.margins import margin_of
from tests.support.motions import motion_along
from tests.support.plans import planned, problem_of
from tests.support.random_motions import motion_of
from tests.support.tolerances_planner import CLOSURE_M, EXCESS, EXTREME, PEAK_ON_A_GRID, SAME_FIGURE, SINGULARITY


def motion() -> Trajectory:
    return planned("knee-reach").trajectory


def found(trajectory: Trajectory, *overrides: str) -> Certificate:
    return certify(problem_of("knee-reach", *overrides), trajectory)


def moved(name: str, by: float, where: slice) -> Trajectory:
    """Return the motion with the coefficients of some intervals shifted."""
    coefficients = np.array(getattr(motion(), name))
    coefficients[:, where] += by
    return replace(motion(), **{name: coefficients})


def sentence(certificate: Certificate, *words: str) -> bool:
    return any(all(word in failure for word in words) for failure in certificate.failures)


@pytest.mark.slow
def test_an_effort_above_its_limit_in_one_interval_is_found():
    effort = np.array(motion().effort)
    effort[:, 17] = 100.001
    certificate = found(replace(motion(), effort=effort))
    assert certificate.effort_excess == pytest.approx(0.001, rel=EXCESS)
    assert motion().breaks_s[17] <= certificate.worst_time_s["limit on the effort of act_O"] < motion().breaks_s[18]


def test_an_effort_above_its_limit_between_two_samples_is_found():
    """The effort is a parabola that exceeds its limit by 1e-3 N.m at the vertex, and not at the samples on both sides."""
    points = samples_of(problem_of("knee-reach"), motion()).points
    near = len(points) // 2
    vertex, half = 0.5 * (points[near] + points[near + 1]), 0.5 * (points[near + 1] - points[near])
    degree, effort = motion().effort.shape[0] - 1, np.array(motion().effort)
    shares = np.linspace(0.0, 1.0, degree + 1)
    values = 100.0 + 1e-3 * (1.0 - 1.5 * ((shares - vertex) / half) ** 2)
    effort[:, 17, 0] = np.linalg.solve(bernstein_matrix(degree, shares), values)
    changed = replace(motion(), effort=effort)
    samples = samples_of(problem_of("knee-reach"), changed)
    assert samples.u.max() < 100.0
    certificate = found(changed)
    assert certificate.effort_excess == pytest.approx(1e-3, rel=1e-3)
    assert sentence(certificate, "the effort of act_O comes to", "beyond its limit of")


@pytest.mark.parametrize(("share", "is_named"), [(0.5, False), (-0.9, False), (1.1, True), (-2.0, True)])
def test_a_slide_may_end_a_hundredth_of_a_millimetre_from_its_plan_when_it_is_integrated(share, is_named):
    """A constant force d on a mass m for the time T moves it by d T^2 / (2 m)."""
    problem, motion = motion_of(load_mechanism(LIFT), np.random.default_rng(0))
    force = share * 1e-5 * 2 * 2.0 / motion.duration_s**2
    certificate = certify(problem, replace(motion, effort=motion.effort + force))
    assert certificate.integration_error_m == pytest.approx(abs(share) * 1e-5, rel=1e-4)
    assert sentence(certificate, "state integrated under the planned effort", "(allowed: 1e-05 m)") == is_named


@pytest.mark.parametrize(("tolerance_deg", "rtol"), [(None, 1e-12), (1e-6, 1e-12), (5e-3, 8.7266e-11)])
def test_the_integration_is_a_million_times_as_exact_as_the_tolerance_that_is_asked(tolerance_deg, rtol):
    asked = () if tolerance_deg is None else (f"mesh.tolerance_deg={tolerance_deg}",)
    problem = problem_of("knee-reach", *asked)
    assert integration_rtol(problem) == pytest.approx(rtol, rel=1e-4)
    exact, error = certify(problem_of("knee-reach"), motion()), certify(problem, motion()).integration_error_deg
    assert error == pytest.approx(exact.integration_error_deg, abs=1e-6 * (tolerance_deg or 1e-6))


def test_an_effort_below_its_lower_limit_is_found():
    certificate = found(motion(), "limits.effort.act_O=[-50, 100]")
    assert certificate.effort_excess == pytest.approx(-motion().effort.min() - 50, rel=EXCESS)
    assert sentence(certificate, "the effort of act_O comes to", "beyond its limit of")


def test_a_speed_that_only_touches_its_limit_is_not_said_to_overrun_it():
    """v = L (1 - (1 - tau)^3) ends at L and is below it everywhere; the parabola through three samples of it is not."""
    problem = body_problem(HINGE, 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 45.0 }\nduration_s = 1.0\n')
    limit = np.radians(60.0)
    problem = problem.varied(limits=replace(problem.limits, speed=np.array([[-limit, limit]])))
    velocity = limit * np.array([0.0, 1.0, 1.0, 1.0])
    touching = motion_along([0.0, 1.0], np.concatenate([[0.0], np.cumsum(velocity) / 4]), velocity=velocity)
    assert margin_of(certify(problem, touching), "speed", 0).left == 0.0
    beyond = replace(touching, velocity=(1 + 1e-9) * touching.velocity)
    assert margin_of(certify(problem, beyond), "speed", 0).left == pytest.approx(-1e-9 * 60.0, rel=EXCESS)


def effort(share: float) -> Trajectory:
    return replace(motion(), effort=share * motion().effort)


def bulging() -> Trajectory:
    """Return the motion with a position that bulges within one interval."""
    position = np.array(motion().position)
    position[1:-1, 20] += np.radians(3)
    return replace(motion(), position=position)


INTEGRATED = "the state integrated under the planned effort ends"
BROKEN = {
    "an effort above its limit": (
        lambda: effort(1.3),
        ["the effort of act_O comes to", "at t = 0 s, 12.2 N.m beyond"],
    ),
    "another motion's effort": (lambda: effort(0.9), ["between nodes the motion needs", "more effort than planned"]),
    "an effort a hundredth short": (lambda: effort(0.99), [INTEGRATED, "deg"]),
    "no effort": (lambda: effort(0.0), []),
    "a velocity shifted throughout": (lambda: moved("velocity", np.radians(20), slice(None)), [INTEGRATED, "deg"]),
    "a velocity shifted from an instant on": (lambda: moved("velocity", np.radians(100), slice(1, None)), []),
    "a velocity shifted in one interval": (lambda: moved("velocity", np.radians(100), slice(20, 21)), []),
    "a position shifted in one interval": (
        lambda: moved("position", np.radians(0.5), slice(20, 21)),
        [f"{INTEGRATED} 0.5 deg"],
    ),
    "a position that bulges": (bulging, []),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_motion_that_is_broken_does_not_pass_and_is_told_why(name):
    broken, words = BROKEN[name]
    certificate = found(broken())
    assert not certificate.passed
    assert sentence(certificate, *words)


@pytest.mark.slow
def test_a_motion_to_another_goal_does_not_pass():
    """Flawless in itself; the problem asks for something else."""
    assert found(motion()).passed
    assert not found(motion(), "motion.goal_deg.O=30").passed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("override", "joint", "by"),
    [
        ("limits.range_deg.A=[20, 150]", "A", "11.6"),
        ("limits.range_deg.O=[-45, 90]", "O", "4.07"),
        ("limits.range_deg.C=[-120, 40]", "C", "2.13"),
    ],
)
def test_a_joint_that_leaves_its_range_is_named_with_its_excess(override, joint, by):
    certificate = found(motion(), override)
    assert sentence(certificate, f"joint {joint} comes to ", f"{by} deg beyond its limit of")


def test_a_joint_that_keeps_its_range_has_the_distance_as_its_margin():
    certificate = found(motion(), "limits.range_deg.A=[5, 150]")
    least = knee().angles(motion().position_at(motion().dense_times(50))[:, 0])
    q_A = least[1] - least[0]
    assert certificate.passed
    assert margin_of(certificate, "position", 1).left == pytest.approx(np.degrees(q_A.min()) - 5, abs=SAME_FIGURE)


@pytest.mark.slow
@pytest.mark.parametrize("joint", ["O", "A", "C"])
def test_a_joint_that_is_too_fast_is_named_with_its_excess(joint):
    free = found(motion(), f"limits.speed_deg_s.{joint}=1e5")
    assert free.passed
    index = "OAC".index(joint)
    fastest = 1e5 - margin_of(free, "speed", index).left
    certificate = found(motion(), f"limits.speed_deg_s.{joint}={fastest - 10}")
    assert sentence(certificate, f"the speed of joint {joint} comes to", "10 deg/s beyond its limit of")


def test_the_fastest_of_each_joint_agrees_with_the_closed_form():
    time = motion().dense_times(400)  # the certificate finds its extremes between its own, coarser samples
    fourbar, s = knee(), motion().position_at(time)[:, 0]
    rates = fourbar.rates(s) * motion().velocity_at(time)[:, 0]
    expected = np.abs([rates[0], rates[1] - rates[0], rates[2]]).max(axis=1)
    certificate = found(motion(), *(f"limits.speed_deg_s.{joint}=1e5" for joint in "OAC"))
    fastest = [1e5 - margin_of(certificate, "speed", joint).left for joint in range(3)]
    np.testing.assert_allclose(np.radians(fastest), expected, rtol=EXTREME)


def test_margins_of_joints_stand_by_name_in_the_units_of_hinges_and_of_slides():
    problem = problem_of("knee-linear-reach", "limits.speed_m_s.DB=9", "limits.speed_deg_s.C=9e3")
    certificate = certify(problem, planned("knee-linear-reach").trajectory)
    left = {(margin.what, margin.name): margin.left for margin in certificate.margins}
    assert certificate.joint_margin_m == {"DB": left["position", "DB"]}
    assert certificate.joint_margin_deg["C"] == left["position", "C"]
    assert certificate.speed_margin_m_s == {"DB": left["speed", "DB"]}
    assert certificate.speed_margin_deg_s == {"C": left["speed", "C"]}


def test_what_nothing_limits_has_no_margin():
    kinds = [margin.what for margin in found(motion()).margins]
    assert kinds == ["effort", *["position"] * 3]


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_a_start_pose_that_is_open_or_elsewhere_is_refused(joint):
    pose = np.array(motion().start_pose)
    pose[joint] += 0.1
    with pytest.raises(AssemblyError):
        found(replace(motion(), start_pose=pose))


@pytest.mark.slow
def test_a_motion_on_the_other_branch_does_not_pass():
    th = replace(knee(), branch=-1).angles(motion().position[0, 0])[:, 0]
    start = np.array([th[0], th[1] - th[0], th[2]])
    assert np.abs(np.exp(1j * start[1:]) - np.exp(1j * motion().start_pose[1:])).min() > 0.5  # it is the other branch
    assert problem_of("knee-reach").mechanism.gap_m(start) < CLOSURE_M
    assert not found(replace(motion(), start_pose=start)).passed


@pytest.mark.slow
@pytest.mark.parametrize("name", KNEE_PROBLEMS)
def test_the_peak_effort_is_the_largest_of_the_carried_ones(name):
    plan = planned(name)
    effort = np.abs(plan.trajectory.effort_at(plan.trajectory.dense_times(100)))
    assert plan.certificate.peak_effort[0] == pytest.approx(effort.max(), rel=PEAK_ON_A_GRID)


@pytest.mark.slow
def test_the_distance_to_a_singular_pose_is_the_transmission_angle_s_sine():
    """det J_z = L2 L3 sin(mu) in this four-bar, and its least singular value falls with it."""
    plan = planned("knee-reach", "motion.goal_deg.O=77", "motion.duration_s=0.25")
    sines = knee().carrying("crank", SHANK).transmission(np.array([0.0, np.radians(77)]))
    assert sines[1] < 0.5 * sines[0]
    assert plan.certificate.singularity_ratio < planned("knee-reach").certificate.singularity_ratio
    assert plan.certificate.singularity_ratio == pytest.approx(sines[1] / sines[0], rel=SINGULARITY)


@pytest.mark.parametrize("rounded", [False, True])
def test_a_loop_that_opens_at_an_instant_is_named_with_its_gap(rounded, monkeypatch):
    """A rocker that is turned by a microradian moves its pin by its length times that."""
    if rounded:  # the tolerance of the model's file is more than that of an exact one
        monkeypatch.setattr(module, "CLOSURE_M", 0.0)
    poses, turned, instant = samples_of(problem_of("knee-reach"), motion()), 1e-6, 100
    q = poses.q.copy()
    q[instant, 2] += turned
    monkeypatch.setattr(module, "samples_of", lambda *_: replace(poses, q=q))
    certificate = found(motion())
    assert certificate.closure_gaps == pytest.approx({"m": turned * knee().rocker}, rel=1e-3)
    assert sentence(certificate, "a kinematic loop opens by 8.55e-08 m", f"at t = {poses.time[instant]:.4g} s")
    assert sentence(certificate, "closure_tolerance_m = 9.4e-08 accepts") == rounded
    assert len(certificate.unrepairable) == rounded, "no mesh closes a rounded loop"


@pytest.mark.parametrize("name", ["breaks_s", "position", "velocity", "effort", "start_pose"])
def test_a_trajectory_with_a_value_that_is_not_finite_is_refused(name):
    value = np.array(getattr(motion(), name))
    value.flat[0] = np.nan
    with pytest.raises(ValueError, match=f"trajectory.{name}"):
        replace(motion(), **{name: value})


@pytest.mark.parametrize("name", ["position", "velocity", "effort"])
def test_a_trajectory_with_an_interval_missing_is_refused(name):
    with pytest.raises(ValueError, match="intervals"):
        replace(motion(), **{name: getattr(motion(), name)[:, :-1]})


def test_a_limit_is_checked_at_instants_closer_than_a_seventh_of_an_interval():
    points = sample_points(3)
    assert points[0] == 0.0
    assert points[-1] == pytest.approx(1.0)
    assert np.diff(points).max() < 1 / 7


RUBBING = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="J" axis="0 1 0"{friction}/>
<inertial pos="0 0 0" mass="1" diaginertia="0.3 0.3 0.3"/></body></worldbody>
<actuator><motor name="motor" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""
# Of 400 samples.
SHARE = 0.005


def speeding_up(fastest: float) -> Trajectory:
    """Return a motion in 2 s from rest to a speed [rad/s] at a constant acceleration."""
    return motion_along([0.0, 2.0], [0.0, 0.0, fastest])


@pytest.mark.parametrize("share", [0.1, 0.6])
@pytest.mark.parametrize("way", [1, -1])
def test_a_joint_is_too_slow_where_the_smooth_friction_is_below_nine_tenths(share, way):
    mechanism = linkplan.load_mechanism(RUBBING.format(friction=' frictionloss="0.1"'))
    slow = np.arctanh(0.9) * mechanism.friction_transition
    found = slow_share(mechanism, speeding_up(way * slow / share))
    assert found == (pytest.approx(share, abs=SHARE), "joint J")


def test_a_joint_that_stands_still_and_one_without_friction_are_not_too_slow():
    rubbing, smooth = (linkplan.load_mechanism(RUBBING.format(friction=one)) for one in (' frictionloss="0.1"', ""))
    assert slow_share(rubbing, speeding_up(0.0)) == (0.0, "joint J")
    assert slow_share(smooth, speeding_up(1.0)) is None


# A flywheel of 1 kg m2; its actuator gives (1 + q) N.m per unit of ctrl at the angle q, more and more on the way.
FLYWHEEL = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody><body><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
<actuator><general name="m" joint="J" gaintype="affine" gainprm="1 1 0" ctrlrange="-3 {most}"/></actuator></mujoco>"""
TORQUE = 2.0


def failures(most: float, model: str = FLYWHEEL, efforts: tuple[float, ...] = (TORQUE,), limits: str = "") -> list[str]:
    """Return what the certificate says of ctrl along q = t^2, for which the ctrl 2 / (1 + q) is needed."""
    motion = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 57.29577951308232 }\nduration_s = 1.0\n'
    problem = body_problem(model.format(most=most), motion + limits)
    trajectory = motion_along([0.0, 1.0], [0.0, 0.0, 1.0], effort=np.reshape(efforts, (1, 1, -1)))
    return [said for said in certify(problem, trajectory).failures if "ctrl" in said]


def test_a_ctrl_beyond_its_range_at_the_start_alone_is_said_with_its_excess():
    (said,) = failures(1.5)
    assert said.startswith("m would need a ctrl 0.5 beyond its range at t = 0 s")


@pytest.mark.parametrize("most", [2.0, 2.5])
def test_a_ctrl_within_its_range_is_not_named(most):
    assert failures(most) == []


def test_a_motor_beside_a_servo_gives_what_limits_effort_allows():
    beside = FLYWHEEL.replace("</actuator>", '<motor name="p" joint="J" ctrlrange="-1 1"/></actuator>')
    assert failures(2.5, beside, (0.0, TORQUE), "[limits]\neffort = { p = [-3.0, 3.0] }\n") == []
