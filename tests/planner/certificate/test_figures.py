"""Certificates of a hinge's quarter turn, whose figures have closed forms, and of what is a little off in it."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.certificate.certificate import Certificate, _integration_failures, certify
from linkplan.planner.limits.efforts import end_sizes
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_problem
from tests.support.margins import margin_of
from tests.support.motions import motion_along
from tests.support.plans import planned
from tests.support.tolerances_planner import EXCESS

# The hinge's quarter turn in a second along s = a + b (3 t^2 - 2 t^3): speed 6 b t (1 - t), effort 6 I b (1 - 2 t).
PEAK_EFFORT = 6 * HINGE_INERTIA * TURN


def quarter_turn(*, position: float = 0.0, velocity: float = 1.0, effort: float = 1.0, extra: float = 0.0) -> Trajectory:
    """Return it with positions off by `position` [rad], speeds and efforts of other size, and an extra effort [N.m]."""
    begin = np.radians(10.0) + position
    efforts = np.array([PEAK_EFFORT, -PEAK_EFFORT]) * effort + extra
    return motion_along(
        [0.0, 1.0],
        [begin, begin, begin + TURN, begin + TURN],
        velocity=velocity * np.array([0.0, 3 * TURN, 0.0]),
        effort=efforts,
    )


def sentence(certificate: Certificate, *words: str) -> bool:
    return any(all(word in failure for word in words) for failure in certificate.failures)


def turned(trajectory: Trajectory, *limits: str) -> Certificate:
    return certify(body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n", *limits), trajectory)


def test_the_figures_of_a_motion_with_a_closed_form():
    certificate = turned(quarter_turn())
    assert certificate.passed, certificate.failures
    assert certificate.peak_effort == pytest.approx(PEAK_EFFORT)
    peak = 36 * HINGE_INERTIA * TURN**2 * np.sqrt(3) / 18  # of t (1 - t) (1 - 2 t)
    assert 0.95 * peak < certificate.peak_power[0] <= peak  # on a coarse grid
    assert certificate.peak_motor_power == pytest.approx(certificate.peak_power, rel=1e-9)  # it brakes as it drives
    assert certificate.peak_brake_power == pytest.approx(certificate.peak_power, rel=1e-9)
    assert certificate.dynamics_allowed == pytest.approx(0.02 * PEAK_EFFORT)
    assert certificate.effort_excess == certificate.inverse_dynamics_excess == 0.0
    assert certificate.effort_overrun.tolist() == [0.0]
    assert certificate.integration_error_deg < 1e-9


@pytest.mark.parametrize(("share", "named"), [(0.9e-8, False), (1.1e-8, True)])
def test_speeds_may_be_a_hundred_millionth_of_their_largest_off(share, named):
    faster = turned(quarter_turn(velocity=1 / (1 - share)))
    assert sentence(faster, "the planned velocity is not that of the planned position") is named
    assert faster.velocity_residual == pytest.approx(share, rel=1e-3)


@pytest.mark.parametrize(("share", "named"), [(0.019, False), (0.021, True)])
def test_efforts_may_be_a_fiftieth_of_their_largest_off(share, named):
    stronger = turned(quarter_turn(effort=1 / (1 - share)))
    assert sentence(stronger, "between nodes the motion needs", "t = 0 s") is named
    assert stronger.dynamics_residual == pytest.approx(share / (1 - share) * PEAK_EFFORT)
    assert stronger.residual_share == pytest.approx([share / 0.02], rel=1e-6)


@pytest.mark.parametrize(("share", "named"), [(0.9e-6, False), (1.1e-6, True), (-1.1e-6, True)])
def test_a_motion_meets_its_ends_to_a_millionth_of_its_way(share, named):
    certificate = turned(quarter_turn(position=share * TURN))
    assert certificate.boundary_error == pytest.approx(abs(share), rel=1e-3)
    assert sentence(certificate, "misses its boundary conditions") is named


def test_a_motion_that_ends_at_speed_misses_rest_by_its_share_of_the_largest():
    velocity = np.array([0.0, 3 * TURN, 0.3 * TURN])[:, None, None]
    assert turned(replace(quarter_turn(), velocity=velocity)).boundary_error == pytest.approx(0.3 / 1.5, rel=0.05)


@pytest.mark.parametrize(("limit", "size"), [("[-9, 2.5]", 2.5), ("[-2.5, 9]", 2.5), ("[0, 2.5]", 2.5), ("[-2.5, 0]", 2.5)])
def test_efforts_beyond_a_limit_are_told_by_the_share_of_it_that_a_proof_allows(limit, size):
    low, high = np.fromstring(limit.strip("[]"), sep=",")
    beyond = max(PEAK_EFFORT - high, PEAK_EFFORT + low)
    certificate = turned(quarter_turn(), f"limits.effort.motor={limit}")
    assert certificate.effort_excess == pytest.approx(beyond, rel=EXCESS)
    assert certificate.inverse_dynamics_excess == pytest.approx(beyond, rel=EXCESS)
    assert certificate.effort_overrun == pytest.approx([beyond / (2e-6 * size)], rel=1e-5)


def test_the_largest_effort_beyond_a_limit_is_found_between_the_samples():
    """With accelerations of 2.4 + 9.6 t - 21.6 t^2 turns per s^2, whose largest value is at t = 2 / 9."""
    begin, peak = np.radians(10.0), (2.4 + 9.6 * 2 / 9 - 21.6 * (2 / 9) ** 2) * TURN * HINGE_INERTIA
    motion = motion_along(
        [0.0, 1.0],
        begin + TURN * np.array([0.0, 0.0, 0.2, 1.0, 1.0]),
        velocity=TURN * np.array([0.0, 0.8, 3.2, 0.0]),
        effort=HINGE_INERTIA * TURN * np.array([2.4, 7.2, -9.6]),
    )
    certificate = turned(motion, f"limits.effort.motor=[-99, {0.999 * peak}]")
    assert certificate.effort_overrun == pytest.approx([(1 - 0.999) / (2e-6 * 0.999)], rel=1e-6)


@pytest.mark.parametrize(
    ("limits", "margins", "overruns"),
    [
        (("limits.range_deg.J=[5, 120]", "limits.speed_deg_s.J=200"), (5.0, 65.0), (0.0, 0.0)),
        (("limits.range_deg.J=[12, 112]", "limits.speed_deg_s.J=100"), (-2.0, -35.0), (2 / 100, 35 / 100)),
        (("limits.range_deg.J=[-20, 96]", "limits.speed_deg_s.J=[-400, 125]"), (-4.0, -10.0), (4 / 116, 10 / 125)),
    ],
)
def test_margins_are_distances_and_overruns_shares_of_ranges_and_speed_limits(limits, margins, overruns):
    certificate = turned(quarter_turn(), *limits)
    found = [margin_of(certificate, what, 0) for what in ("position", "speed")]
    assert [one.left for one in found] == pytest.approx(margins, rel=1e-9)
    assert [one.overrun[0] for one in found] == pytest.approx(overruns, rel=1e-9)
    assert sentence(certificate, "joint J comes to") is (margins[0] < 0)
    assert sentence(certificate, "the speed of joint J comes to") is (margins[1] < 0)


@pytest.mark.parametrize(("beyond", "named"), [(3e-10, False), (3e-9, True)])
def test_ranges_may_be_overrun_by_the_rounding_of_degrees(beyond, named):
    top = 100.0 - np.degrees(beyond)
    certificate = turned(quarter_turn(), f"limits.range_deg.J=[0, {top:.15g}]", f"motion.goal_deg.J={top - 1e-12:.15g}")
    assert sentence(certificate, "joint J comes to") is named


@pytest.mark.parametrize(
    ("in_deg", "in_m", "words"),
    [
        (0.0099, 0.99e-5, None),
        (0.0101, 0.0, "0.0101 deg (allowed: 0.01 deg)"),
        (0.0, 1.01e-5, "1.01e-05 m (allowed: 1e-05 m)"),
        (np.nan, 0.0, "nan deg"),
        (0.0, np.nan, "nan m"),
        (1.0, 1.0, "1 deg (allowed: 0.01 deg)"),
    ],
)
def test_a_state_that_integrates_elsewhere_is_told_in_the_joint_s_unit(in_deg, in_m, words):
    found = _integration_failures(in_deg, in_m)
    assert len(found) == (words is not None)
    assert all(f"ends {words}" in one for one in found)


def test_an_end_of_a_limit_at_zero_has_the_other_s_size_and_an_infinite_one_none():
    bounds = np.array([[-3.0, 5.0], [0.0, 4.0], [-2.0, 0.0], [-np.inf, 7.0], [-np.inf, np.inf]])
    assert end_sizes(bounds).tolist() == [[3.0, 5.0], [4.0, 4.0], [2.0, 2.0], [0.0, 7.0], [0.0, 0.0]]


def test_figures_of_several_joints_are_the_worst_joint_s():
    """The quarter turn on one of two hinges, with everything off by a tenth; the other hinge stands still."""
    second = (
        HINGE[HINGE.index('<body name="arm">') : HINGE.index("</worldbody>")].replace("arm", "other").replace('"J"', '"K"')
    )
    model = HINGE.replace("</worldbody>", f"{second}</worldbody>").replace(
        "</actuator>", '<motor name="m" joint="K" ctrlrange="-4 4"/></actuator>'
    )
    ends = 'kind = "reach"\nstart_deg = { J = 10.0, K = 0.0 }\ngoal_deg = { J = 100.0, K = 0.0 }\nduration_s = 1.0\n'
    off = quarter_turn(velocity=1 / 0.9, effort=1.1)
    both = replace(
        off,
        **{
            name: np.concatenate([getattr(off, name), 0 * getattr(off, name)], 2)
            for name in ("position", "velocity", "effort")
        },
        start_pose=np.array([off.start_pose[0], 0.0]),
    )
    certificate = certify(body_problem(model, ends, "limits.effort.motor=[-2.5, 2.5]"), both)
    alone = turned(off, "limits.effort.motor=[-2.5, 2.5]")
    for name in ("effort_excess", "inverse_dynamics_excess", "dynamics_residual", "velocity_residual", "effort_overrun"):
        assert getattr(certificate, name) == pytest.approx(getattr(alone, name)), name
        assert np.all(getattr(alone, name) > 0), name


def test_without_effort_a_motion_may_need_a_millionth_of_what_its_inertia_takes():
    assert turned(quarter_turn(effort=0.0)).dynamics_allowed == pytest.approx(1e-6 * PEAK_EFFORT)


def test_an_overrun_is_that_of_the_interval_and_the_end_in_which_it_is():
    """In two halves: the first needs positive efforts, the second negative ones."""
    whole = quarter_turn()
    start, end = whole.position[0, 0, 0], whole.position[-1, 0, 0]
    position = np.array([[start, start, 0.75 * start + 0.25 * end, 0.5 * (start + end)]])
    position = np.concatenate([position, start + end - position[:, ::-1]]).T[:, :, None]
    halves = replace(
        whole,
        breaks_s=np.array([0.0, 0.5, 1.0]),
        position=position,
        velocity=6.0 * np.diff(position, axis=0),
        effort=np.array([[PEAK_EFFORT, 0.0], [0.0, -PEAK_EFFORT]]).reshape(2, 2, 1),
    )
    for limit, overrun in (("[-2.5, 9]", [False, True]), ("[-9, 2.5]", [True, False])):
        certificate = turned(halves, f"limits.effort.motor={limit}")
        assert certificate.boundary_error == pytest.approx(0.0, abs=1e-12)
        assert (certificate.effort_overrun > 0).tolist() == overrun
        time = certificate.worst_time_s["limit on the effort of motor"]
        assert time == pytest.approx(0.0 if overrun[0] else 1.0)


SCREW = """<mujoco><option gravity="0 0 0"/>
  <worldbody><body><joint name="X" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="2"/></body></worldbody>
  <actuator><motor name="F" joint="X" ctrlrange="-100 100"/></actuator>
</mujoco>"""


def test_the_demands_of_the_knee_are_those_of_dense_samples():
    plan = planned("knee-reach")
    (found,) = plan.demands()
    table = plan.sample(np.linspace(0.0, plan.trajectory.duration_s, 40001))
    effort, speed = table.effort["act_O"], table.speed_deg_s["O"]
    power = effort * np.radians(speed)
    step = table.time_s[1]
    assert (found.actuator, found.effort_unit, found.speed_unit) == ("act_O", "N.m", "deg/s")
    assert found.peak_effort == pytest.approx(np.abs(effort).max(), rel=1e-4)
    assert found.peak_effort == pytest.approx(plan.certificate.peak_effort[0], rel=1e-4)
    assert found.rms_effort == pytest.approx(np.sqrt(np.mean(effort**2)), rel=1e-4)
    assert found.rms_effort**2 * plan.trajectory.duration_s == pytest.approx(plan.objective, rel=1e-6)
    assert found.peak_speed == pytest.approx(np.abs(speed).max(), rel=1e-4)
    assert found.peak_motor_power_w == pytest.approx(power.max(), rel=1e-3)
    assert found.peak_brake_power_w == pytest.approx(-power.min(), rel=1e-3)
    assert plan.certificate.peak_power[0] == pytest.approx(np.abs(power).max(), rel=1e-3)
    assert found.energy_given_j == pytest.approx(np.maximum(power, 0).sum() * step, rel=1e-3)
    assert found.energy_taken_j == pytest.approx(np.maximum(-power, 0).sum() * step, rel=1e-3)


def test_a_mass_takes_its_kinetic_energy_and_gives_it_back():
    """2 kg over 1 m in 1 s with least squared effort: the speed is 6 t (1 - t) m/s, the force 24 (1/2 - t) N."""
    problem = Problem.reach(load_mechanism(SCREW), start_m={"X": 0.0}, goal_m={"X": 1.0}, duration_s=1.0)
    (found,) = plan_motion(problem).demands()
    assert (found.effort_unit, found.speed_unit) == ("N", "m/s")
    assert found.peak_effort == pytest.approx(12.0, rel=1e-6)
    assert found.rms_effort == pytest.approx(np.sqrt(48.0), rel=1e-6)
    assert found.peak_speed == pytest.approx(1.5, rel=1e-3)
    assert found.energy_given_j == pytest.approx(0.5 * 2 * 1.5**2, rel=1e-5)
    assert found.energy_taken_j == pytest.approx(0.5 * 2 * 1.5**2, rel=1e-5)
    assert found.peak_motor_power_w == pytest.approx(72 * np.sqrt(3) / 36 * 2, rel=1e-3)
