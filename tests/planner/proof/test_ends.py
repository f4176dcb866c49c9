"""Findings at single instants, each on both sides of what is allowed: joints of pieces, starts, slopes."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.ends import _largest_of_unit, end_findings
from linkplan.planner.proof.finding import Finding
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import HINGE, QUARTER_TURN, TURN, body_problem
from tests.support.motions import motion_along
from tests.support.plans import optimal

# Over two intervals of half a second: t^2 (3 - 2 t) of the quarter turn, as Bernstein coefficients on each.
HALVES = np.array([[0.0, 0.0, 0.25, 0.5], [0.5, 0.75, 1.0, 1.0]]).T
PEAK_SPEED = 1.5 * TURN


def problem(*overrides: str) -> Problem:
    return body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n", *overrides)


def motion() -> Trajectory:
    position = np.radians(10.0) + TURN * HALVES
    return motion_along([0.0, 0.5, 1.0], position, effort=[[2.0, 0.0], [0.0, -2.0]])


def shifted(name: str, interval: int, by: float, first: int = 0) -> Trajectory:
    """Return the motion with an interval's coefficients from a first one on shifted."""
    coefficients = np.array(getattr(motion(), name))
    coefficients[first:, interval] += by
    return replace(motion(), **{name: coefficients})


def finding(trajectory: Trajectory, name: str, *overrides: str) -> Finding:
    (found,) = (one for one in end_findings(problem(*overrides), trajectory) if name in one.name)
    return found


def test_a_motion_whose_pieces_join_has_nothing_refuted():
    found = end_findings(problem(), motion())
    assert {one.answer for one in found} == {"proved"}


@pytest.mark.parametrize(("share", "answer"), [(0.9e-8, "proved"), (-1.1e-8, "refuted"), (1e-3, "refuted")])
def test_pieces_join_to_a_hundred_millionth_of_the_span_or_speed(share, answer):
    for name, size in (("position", TURN), ("velocity", PEAK_SPEED)):
        found = finding(shifted(name, 1, share * size), f"the pieces of {name} join")
        assert found.answer == answer
        assert found.bound == pytest.approx(abs(share), rel=2e-2)
        assert found.margin == pytest.approx(1e-8 - found.bound)
        assert found.time_s == pytest.approx(0.5)


@pytest.mark.parametrize(("share", "answer"), [(0.9e-8, "proved"), (1.1e-8, "refuted")])
def test_the_velocity_is_the_position_s_slope_to_a_hundred_millionth_of_the_speed(share, answer):
    found = finding(shifted("velocity", 0, share * PEAK_SPEED), "is the slope of the planned position")
    assert found.answer == answer
    assert found.bound == pytest.approx(share, rel=1e-3)


@pytest.mark.parametrize(("share", "answer"), [(0.0, "sampled"), (0.019, "sampled"), (0.021, "refuted")])
def test_a_velocity_of_another_degree_is_compared_at_samples(share, answer):
    """Raised by a degree, and off by a share of the largest speed."""
    b = np.array(motion().velocity)
    raised = np.stack([b[0], (b[0] + 2 * b[1]) / 3, (2 * b[1] + b[2]) / 3, b[2]])
    raised[1:3] += share * PEAK_SPEED * 4 / 3  # up to the share in the middle, none at the ends
    found = finding(replace(motion(), velocity=raised), "is the slope of the planned position")
    assert found.answer == answer


@pytest.mark.parametrize(("share", "answer"), [(0.9e-7, "proved"), (1.1e-7, "refuted")])
def test_efforts_of_a_limited_rate_join_to_a_ten_millionth_of_the_largest(share, answer):
    stepped = shifted("effort", 1, 2.0 * share)
    assert not [one for one in end_findings(problem(), stepped) if "pieces of effort" in one.name]
    found = finding(stepped, "the pieces of effort of motor join", "limits.effort_rate.motor=100")
    assert (found.answer, found.bound) == (answer, pytest.approx(share, rel=1e-6))


def test_a_periodic_effort_joins_from_the_last_piece_to_the_first():
    turn = body_problem(HINGE, 'kind = "periodic"\nturns = { J = 1 }\nduration_s = 1.0\n', "limits.effort_rate.motor=100")
    found = end_findings(turn, replace(motion(), periodic=True))
    (joined,) = (one for one in found if "pieces of effort" in one.name)
    assert joined.bound == pytest.approx((2.0 + 2.0) / 2.0)


@pytest.mark.parametrize(("apart", "answer"), [(0.9e-6, "proved"), (-1.1e-6, "refuted")])
def test_the_start_pose_is_the_problem_s_to_a_millionth(apart, answer):
    found = finding(replace(motion(), start_pose=np.radians([10.0]) + apart), "on the problem's branch")
    assert (found.answer, found.bound) == (answer, pytest.approx(abs(apart), rel=1e-6))


def test_a_joint_that_stands_still_is_measured_by_a_nanometre_or_a_millionth_of_its_place():
    ends = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 0.0 }\nduration_s = 1.0\n'
    still = body_problem(HINGE, ends)
    for place, size in ((0.0, 1e-9), (1e-2, 1e-8)):
        step = np.array([[place, place + 0.5 * size]])[:, :, None]
        resting = replace(motion(), position=np.repeat(step, 4, axis=0), velocity=0 * motion().velocity)
        (joined,) = (one for one in end_findings(still, resting) if "pieces of position" in one.name)
        assert joined.bound == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "unit", "scale", "jump"), [("hinge", "deg", 1.0, 1e-3), ("slide", "m", np.radians(1.0), 1e-3 / 0.101)]
)
def test_of_two_joints_the_one_with_the_jump_counts_and_the_faster_one_is_the_measure_of_speeds(kind, unit, scale, jump):
    """The quarter turn on the first, a tenth of it on the second, which jumps and starts at speed.

    A jump is a share of the largest span with its unit, to which it adds; speeds at the ends are one of the largest of all.
    """
    body = HINGE[HINGE.index('<body name="arm">') : HINGE.index("</worldbody>")]
    other = body.replace("arm", "other").replace('"J"', '"K"').replace('"hinge"', f'"{kind}"')
    both = HINGE.replace("</worldbody>", other + "</worldbody>")
    both = both.replace("</actuator>", '<motor name="m" joint="K" ctrlrange="-4 4"/></actuator>')
    places = f"start_{unit}.K = {1.0 * float(scale)!r}\ngoal_{unit}.K = {10.0 * float(scale)!r}\n"
    ends = f'kind = "reach"\nstart_deg.J = 10.0\ngoal_deg.J = 100.0\nduration_s = 1.0\n{places}'
    one = motion()
    arrays = {
        name: np.concatenate([x, 0.1 * x], 2) for name in ("position", "velocity", "effort") for x in [getattr(one, name)]
    }
    arrays["position"][:, 1, 1] += 1e-3 * TURN
    arrays["velocity"][0, 0, 1] = 1e-2 * PEAK_SPEED
    off = replace(one, **arrays, start_pose=np.radians([10.0, 1.0]))
    found = {finding.name: finding for finding in end_findings(body_problem(both, ends), off)}
    assert found["the pieces of position join"].bound == pytest.approx(jump)
    assert found["the motion starts and ends where asked"].bound == pytest.approx(1e-2, rel=1e-3)


def test_sizes_are_the_largest_of_all_joints_with_the_unit():
    model = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body><joint name="x" type="slide"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body><joint name="b" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></body></worldbody>
    <actuator><motor joint="a"/><motor joint="x"/><motor joint="b"/></actuator></mujoco>"""
    ends = 'kind = "reach"\nstart_deg = { a = 0.0, b = 0.0 }\nstart_m = { x = 0.0 }\n'
    reach = body_problem(model, ends + ends[15:].replace("start", "goal") + "duration_s = 1.0\n")
    assert _largest_of_unit(reach, np.array([0.2, 7.0, 0.3])).tolist() == [0.3, 7.0, 0.3]
    assert _largest_of_unit(problem(), np.array([0.2])).tolist() == [0.2]


def other_assembly(mechanism, q: np.ndarray) -> np.ndarray:
    """Return a closed pose at the same independent positions on another assembly branch than q, by scipy."""
    dependent, random = list(mechanism.dependent), np.random.default_rng(0)

    def gap(z: np.ndarray) -> np.ndarray:
        return np.array(mechanism.dynamics.independent_closure(pose_with(z))).ravel()

    def pose_with(z: np.ndarray) -> np.ndarray:
        pose = np.array(q)
        pose[dependent] = z
        return pose

    for _ in range(100):
        found = scipy.optimize.root(gap, random.uniform(-np.pi, np.pi, len(dependent)))
        turned = np.abs(np.exp(1j * found.x) - np.exp(1j * q[dependent])).max()
        if found.success and np.abs(gap(found.x)).max() < 1e-10 and turned > 0.1:
            return pose_with(found.x)
    raise AssertionError("there is one assembly only")


@pytest.mark.parametrize("name", ["knee-sine", "knee-sine-shank", "knee-reach"])
def test_a_motion_on_another_branch_than_the_problem_s_is_refuted_whatever_its_kind(name):
    plan = optimal(name)
    assert (plan.problem.motion.start is None) == (name != "knee-reach")
    other = replace(plan.trajectory, start_pose=other_assembly(plan.problem.mechanism, plan.trajectory.start_pose))
    for motion, answer in ((plan.trajectory, "proved"), (other, "refuted")):
        (found,) = (one for one in end_findings(plan.problem, motion) if "on the problem's branch" in one.name)
        assert found.answer == answer
