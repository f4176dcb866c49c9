"""Periodic motions that go on by whole turns: cranks that turn for ever."""

from functools import cache

import numpy as np
import pytest
import scipy.interpolate
import scipy.optimize

import linkplan
from linkplan.models.errors import CertificateError, ProblemError
from linkplan.models.library import built_in_text
from tests.support.linkages import GRIPPER, UNCUT
from tests.support.mechanisms import replaced
from tests.support.refusals import assert_refused
from tests.support.slider_crank import inertia, potential
from tests.support.tolerances_planner import CLOSURE_M, ROLLOUT_GAP_M

PERIOD_S, DAMPING = 0.4, 0.01
# Least effort against forty harmonics' and a free turn's speed against quadrature, relative: the mesh's own error.
OBJECTIVE, FREE_SPEED = 1e-5, 1e-5


def damped() -> str:
    """Return the slider-crank with a bearing that takes 0.01 N.m.s/rad."""
    text = built_in_text("slider-crank")
    return replaced(text, '<joint name="O"/>', f'<joint name="O" damping="{DAMPING}"/>')


@cache
def turning(n: int = 1, damping: bool = True) -> linkplan.Plan:
    """Return the slider-crank's plan of least effort over n turns in as many periods."""
    model = damped() if damping else "slider-crank"
    tracking = {"period_s": 1e-3, "kp": 20.0, "kd": 0.5, "duration_s": 3 * PERIOD_S}
    return linkplan.plan(
        linkplan.Problem.periodic(model, turns={"O": n}, duration_s=PERIOD_S, tracking=tracking, name="turning")
    ).require()


def harmonics() -> float:
    """Return the least integral of squared effort over a turn, by sixty harmonics and Lagrange's equation."""
    n, orders, w = 400, np.arange(1, 61), 2 * np.pi / PERIOD_S
    at = np.linspace(0.0, 2 * np.pi, 1001)
    M = scipy.interpolate.CubicSpline(at, [inertia(np.array([x]))[0, 0] for x in [*at[:-1], 0.0]], bc_type="periodic")
    V = scipy.interpolate.CubicSpline(at, [potential(np.array([x])) for x in [*at[:-1], 0.0]], bc_type="periodic")
    t = PERIOD_S * np.arange(n) / n
    phase = np.outer(w * t, orders)
    sin, cos = np.sin(phase), np.cos(phase)

    def efforts(x: np.ndarray) -> np.ndarray:
        a, b = x.reshape(2, -1)
        s = w * t + sin @ a + (cos - 1) @ b
        v = w + cos @ (a * w * orders) - sin @ (b * w * orders)
        dv = -sin @ (a * (w * orders) ** 2) - cos @ (b * (w * orders) ** 2)
        return M(s) * dv + 0.5 * M(s, 1) * v**2 + V(s, 1) + DAMPING * v

    # High harmonics weigh by their squares: unknowns in units of their accelerations.
    unit = np.tile(orders, 2) ** -2.0
    found = scipy.optimize.least_squares(lambda y: efforts(unit * y), np.zeros(120), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    return float(PERIOD_S * np.mean(found.fun**2))


def test_a_turn_of_least_effort_is_that_of_harmonics():
    plan = turning()
    assert plan.certificate.passed
    assert plan.certificate.closure_gap_m < CLOSURE_M
    assert plan.objective == pytest.approx(harmonics(), rel=OBJECTIVE)
    steady = PERIOD_S * (DAMPING * 2 * np.pi / PERIOD_S) ** 2
    assert plan.objective != pytest.approx(steady, rel=0.01), "inertia and weight matter"


def test_a_crank_without_friction_turns_freely_at_the_energy_of_its_period():
    """T = integral of sqrt(M / (2 (E - V))) over a turn."""
    plan = turning(damping=False)
    at = np.linspace(0.0, 2 * np.pi, 400, endpoint=False)
    M = np.array([inertia(np.array([x]))[0, 0] for x in at])
    V = np.array([potential(np.array([x])) for x in at])

    def late(E: float) -> float:
        return 2 * np.pi * float(np.mean(np.sqrt(M / (2 * (E - V))))) - PERIOD_S

    E = scipy.optimize.brentq(late, V.max() * 1.0001, 100.0, xtol=1e-14)
    time = np.linspace(0.0, PERIOD_S, 50)
    trajectory = plan.trajectory
    s, v = trajectory.position_at(time)[:, 0], trajectory.velocity_at(time)[:, 0]
    expected = np.array([np.sqrt(2 * (E - potential(np.array([x]))) / inertia(np.array([x]))[0, 0]) for x in s])
    assert np.abs(v / expected - 1).max() < FREE_SPEED
    assert plan.objective < 1e-12 * PERIOD_S


def test_a_motion_turns_the_other_way_where_the_turns_are_negative():
    trajectory = turning(-1).trajectory
    assert trajectory.position[-1, -1, 0] - trajectory.position[0, 0, 0] == pytest.approx(-2 * np.pi)
    assert trajectory.velocity_at(np.linspace(0, 1, 50)).max() < 0


def test_dependent_joints_go_on_with_the_crank_and_the_loops_stay_closed_between_turns():
    plan = turning()
    mechanism = plan.problem.mechanism
    table = plan.sample(np.array([0.1, 0.1 + PERIOD_S, 0.1 - PERIOD_S]))
    for name, turns in (("O", 1), ("A", -1), ("B", 0)):
        values = table.position_deg[name]
        assert values[1:] - values[0] == pytest.approx([360.0 * turns, -360.0 * turns], abs=1e-6), name
    poses = np.array([np.radians(table.position_deg["O"]), np.radians(table.position_deg["A"]), table.position_deg["B"]]).T
    assert mechanism.gaps_m(poses).max() < CLOSURE_M


@pytest.mark.parametrize("tracker", ["pd+ff", "lqr"])
@pytest.mark.parametrize("period_s", [1e-3, 0.9e-3])  # a whole number of them in a turn, and not
def test_trackers_follow_three_turns_in_mujoco(tracker, period_s):
    rollout = linkplan.track(turning(), tracker, tracking={"period_s": period_s}).comparison.nominal[tracker]
    assert rollout.stable
    assert np.degrees(rollout.position_rad[-1, 0] - rollout.position_rad[0, 0]) == pytest.approx(3 * 360.0, abs=4.0)
    assert np.degrees(np.abs(rollout.error_rad[:, 0])).max() < 1.0
    assert rollout.gap_m.max() < ROLLOUT_GAP_M


def test_a_saved_plan_of_turns_is_read_back_and_certified_again(tmp_path):
    plan = turning()
    again = linkplan.read_plan(plan.save(tmp_path / "plan"))
    assert again.certificate.passed
    assert again.problem.motion.turns.tolist() == [1.0]
    assert again.sample(1.7).position_deg["O"] == pytest.approx(plan.sample(1.7).position_deg["O"])
    text = (tmp_path / "plan" / "plan.json").read_text(encoding="utf-8")
    (tmp_path / "plan" / "plan.json").write_text(replaced(text, '"O": 1\n', '"O": 2\n'), encoding="utf-8")
    assert_refused(lambda: linkplan.read_plan(tmp_path / "plan"), "boundary", kind=CertificateError)


GEARED = """<mujoco model="geared"><compiler angle="radian"/><worldbody>
  <body><joint name="O" axis="0 1 0"/><geom size="0.01" pos="0.1 0 0"/></body>
  <body pos="1 0 0"><joint name="half" axis="0 1 0"{spring}/><geom size="0.01" pos="0.1 0 0"/></body></worldbody>
  <equality><joint joint1="half" joint2="O" polycoef="0 {ratio} 0 0 0"/></equality>
  <actuator>{drive}</actuator></mujoco>"""
MOTOR = '<motor joint="O" ctrlrange="-2 2"/>'
SERVO = '<position name="servo" joint="O" kp="5" ctrlrange="-3 3" ctrllimited="true"/>'


def geared(ratio: float, spring: str = "", drive: str = MOTOR) -> str:
    return GEARED.format(ratio=ratio, spring=spring, drive=drive)


def loaded(text: str) -> str:
    """Return a slider-crank with a weak spring on its crank and a strong one on its slider, whose load comes back."""
    sprung = replaced(text, '<joint name="O"/>', '<joint name="O" stiffness="0.5"/>')
    return replaced(sprung, 'ref="0.2"', 'ref="0.2" stiffness="3000" springref="0.1"')


@pytest.mark.parametrize(
    ("model", "turns", "words"),
    [
        ("slider-crank", {"O": 0.5}, "turns.O must be a whole number"),
        ("slider-crank", {"O": 1000}, "from -100 to 100, got 1000"),
        ("slider-crank", {"O": 0}, "whole turns, at least one"),
        ("slider-crank", {"Q": 1}, "joint 'Q' is not in"),
        ("slider-crank", {"B": 1}, "joint B: it is a slide"),
        ("slider-crank", {"A": 1}, "joint A: its turns follow from O"),
        (
            replaced(UNCUT, 'motor joint="O"', 'motor joint="C"'),
            {"C": 1},
            "joint C: it cannot turn continuously; it reaches from",
        ),
        (GRIPPER, {"crank_r": 1}, "turns"),
        (replaced(UNCUT, '<joint name="O"/>', '<joint name="O" range="-1 1"/>'), {"O": 1}, "must have no range"),
        (geared(0.5), {"O": 1}, "joint half does not return but moves by 180 deg"),
        (geared(1.0, ' stiffness="2"'), {"O": 1}, "a spring on joint half winds up"),
        (loaded(built_in_text("slider-crank")), {"O": 1}, "a spring on joint O winds up"),
        (geared(1.0, "", SERVO), {"O": 1}, "ctrl of servo servo by 6.283"),
    ],
)
def test_turns_that_cannot_be_are_refused_in_a_line(model, turns, words):
    assert_refused(lambda: linkplan.Problem.periodic(model, turns=turns, duration_s=1.0), words, kind=ProblemError)


def test_a_spring_whose_joint_is_back_after_a_turn_winds_nothing_up():
    springy = replaced(built_in_text("slider-crank"), 'ref="0.2"', 'ref="0.2" stiffness="30" springref="0.1"')
    problem = linkplan.Problem.periodic(springy, turns={"O": 1}, duration_s=1.0)
    pull = np.array(problem.mechanism.dynamics.passive(problem.start_pose(), np.zeros(3)))
    assert np.abs(pull).max() > 0.1
    assert problem.motion.turns.tolist() == [1.0]


def test_a_joint_that_is_back_after_two_turns_turns_twice():
    assert linkplan.Problem.periodic(geared(0.5), turns={"O": 2}, duration_s=1.0).motion.turns.tolist() == [2.0]


def test_turns_belong_to_periodic_motions_without_a_reference():
    sine = {"amplitude_deg": {"O": 10.0}, "frequency_hz": 2.0}
    with pytest.raises(ProblemError, match="keep one of them"):
        linkplan.Problem.periodic("slider-crank", turns={"O": 1}, reference=sine)
    with pytest.raises(ProblemError, match=r"belongs to motion\.kind 'periodic'"):
        linkplan.Problem.reach("slider-crank", start_deg={"O": 0.0}, goal_deg={"O": 90.0}, duration_s=1.0).replace(
            {"motion.turns": {"O": 1}}
        )


def test_a_turn_passes_its_waypoints_and_ends_a_turn_after_its_start():
    plan = linkplan.plan(
        linkplan.Problem.periodic(
            damped(),
            turns={"O": 1},
            start_deg={"O": 180.0},
            waypoints=[{"at_deg": {"O": 300.0}, "time_s": 0.1}],
            duration_s=PERIOD_S,
        )
    ).require()
    assert plan.sample(np.array([0.0, 0.1, PERIOD_S])).position_deg["O"] == pytest.approx([180.0, 300.0, 540.0], abs=1e-6)
    assert plan.objective > turning().objective


TWO_HINGES = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="A" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body><body pos="0 0 1"><joint name="B" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody>
<tendon><fixed name="t"><joint joint="A" coef="{coef!r}"/><joint joint="B" coef="-1"/></fixed></tendon>
<actuator><motor joint="A" ctrlrange="-6 6"/><position name="s" tendon="t" kp="9" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize("n", [3, 11])
def test_a_servo_with_a_range_or_a_spring_may_act_on_a_difference_that_returns_after_the_turns(n):
    """The difference of a joint's n-th part and another joint is zero again but for rounding, 9e-16 for eleven turns."""
    model = TWO_HINGES.format(coef=1.0 / n)
    sprung = replaced(model, '<fixed name="t">', '<fixed name="t" stiffness="2" springlength="0">')
    for text in (model, sprung):
        problem = linkplan.Problem.periodic(text, turns={"A": n, "B": 1}, duration_s=1.0)
        assert problem.motion.turns.tolist() == [n, 1]
    with pytest.raises(ProblemError, match="ctrl of servo s by"):
        linkplan.Problem.periodic(model, turns={"A": n, "B": 2}, duration_s=1.0)


def test_of_two_hinges_one_may_turn_alone():
    both = replaced(TWO_HINGES.format(coef=0.5), ' ctrlrange="-1 1"', "")
    assert linkplan.Problem.periodic(both, turns={"B": -1}, duration_s=1.0).motion.turns.tolist() == [0, -1]
