"""Plans against closed forms, a boundary-value solver and an independent integration; and the promises of every plan."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp, solve_ivp
from scipy.interpolate import BPoly

from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.planner.plan.plan import Plan
from tests.support.data import KNEE_TABLE
from tests.support.fourbar import KNEE_PROBLEMS, SHANK, FourBar, knee, rate_of
from tests.support.plans import GOAL, LIMIT, START, optimal
from tests.support.tolerances_planner import (
    BINDS_DEG,
    BOUNDARY,
    CLOSURE_M,
    CONTINUITY,
    EFFORT_JUMP,
    ENERGY,
    FOLLOWED_DEG,
    LEAST_EFFORT,
    MINIMUM_TIME,
    RANGE_SLACK,
    REFERENCE,
    SECOND_ROUTE_DEG,
    SINUSOID,
    SPEED_DEG_S,
    TOUCHED,
)

REACHES = ("knee-reach", "knee-sprint", "knee-sprint-bare")
every_plan = pytest.mark.parametrize("name", KNEE_PROBLEMS)
every_reach = pytest.mark.parametrize("name", REACHES)


def carried_by(name: str) -> FourBar:
    """Return the oracle of a built-in problem's mechanism."""
    return knee() if name in ("knee-sine", "knee-sprint-bare") else knee().carrying("crank", SHANK)


def dense(plan: Plan, per_interval: int = 200) -> np.ndarray:
    return plan.trajectory.dense_times(per_interval)


# Least time.


@pytest.mark.parametrize(("name", "key"), [("knee-sprint", "shank_s"), ("knee-sprint-bare", "unloaded_s")])
def test_a_sprint_takes_the_reference_table_s_least_time(name, key):
    expected = KNEE_TABLE["min_time_rest_to_rest"][key]
    assert carried_by(name).minimum_time(START, GOAL, -LIMIT, LIMIT) == pytest.approx(expected, rel=REFERENCE)
    assert optimal(name).trajectory.duration_s == pytest.approx(expected, rel=MINIMUM_TIME)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "known"),
    [
        (("motion.start_deg.O=56.27", "motion.goal_deg.O=-49.07"), (GOAL, START, -LIMIT, LIMIT)),
        (("limits.effort.act_O=[-40.0, 100.0]",), (START, GOAL, -40.0, LIMIT)),
    ],
    ids=["the way back", "a lower limit on one side"],
)
def test_other_ends_and_limits_take_as_long_as_the_energies_say(overrides, known):
    expected = carried_by("knee-sprint").minimum_time(*known)
    assert optimal("knee-sprint", *overrides).trajectory.duration_s == pytest.approx(expected, rel=MINIMUM_TIME)


# Least effort of the knee.


def test_the_knee_s_least_effort_satisfies_pontryagin_s_conditions():
    """Solved apart by scipy: with H = p^2 / 2M + V, s' = H_p, p' = u - H_s, minimise the integral of u^2."""
    M, V = carried_by("knee-reach").fitted(START, GOAL)
    duration = 0.16

    def rate(_: np.ndarray, x: np.ndarray) -> np.ndarray:
        s, p, by_s, by_p = x
        m, m1, m2 = M(s), M.deriv()(s), M.deriv(2)(s)
        H_s, H_sp = V.deriv()(s) - p**2 * m1 / (2 * m**2), -p * m1 / m**2
        H_ss = V.deriv(2)(s) - p**2 / 2 * (m2 / m**2 - 2 * m1**2 / m**3)
        return np.array([p / m, -0.5 * by_p - H_s, by_p * H_ss - by_s * H_sp, by_p * H_sp - by_s / m])

    def ends(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        return np.array([left[0] - START, left[1], right[0] - GOAL, right[1]])

    time = np.linspace(0, duration, 100)
    share = time / duration
    path = START + (GOAL - START) * (3 * share**2 - 2 * share**3)
    solved = solve_bvp(rate, ends, time, np.array([path, 0 * path, 0 * path, 0 * path]), tol=1e-6, max_nodes=5000)
    assert solved.success
    effort = quad(lambda t: (0.5 * solved.sol(t)[3]) ** 2, 0, duration, epsabs=1e-8, limit=200)[0]
    assert optimal("knee-reach").objective == pytest.approx(effort, rel=LEAST_EFFORT)


# What every plan promises.


@every_plan
def test_the_effort_is_within_the_limit_however_densely_it_is_looked_at(name):
    plan = optimal(name)
    effort = plan.trajectory.effort_at(dense(plan, 1000))
    low, high = plan.problem.limits.effort.T
    assert np.all((effort >= low) & (effort <= high))
    if name == "knee-sine-shank":  # nearest to a reference, with next to no price on effort: the barrier leaves it that much
        assert np.abs(effort).max() == pytest.approx(LIMIT, rel=TOUCHED)
    elif name not in ("knee-sine", "knee-reach"):
        assert np.abs(effort).max() == pytest.approx(LIMIT)  # the limit binds, and is not passed


@every_plan
def test_the_oracle_s_loop_stays_closed_along_a_plan(name):
    plan = optimal(name)
    poses = follow(plan.problem.mechanism, plan.trajectory.position_at(dense(plan, 5)), plan.trajectory.start_pose)
    th = knee().angles(poses[:, 0])
    np.testing.assert_allclose(poses[:, 1], th[1] - th[0], atol=CLOSURE_M)
    np.testing.assert_allclose(poses[:, 2], th[2], atol=CLOSURE_M)


@every_plan
def test_velocity_is_the_derivative_of_position_at_every_instant(name):
    trajectory = optimal(name).trajectory
    time = trajectory.dense_times(20)
    derivative = BPoly(trajectory.position, trajectory.breaks_s).derivative()(time)
    np.testing.assert_allclose(trajectory.velocity_at(time), derivative, atol=CONTINUITY * np.abs(derivative).max())


@pytest.mark.slow
def test_boundary_speeds_are_kept():
    trajectory = optimal("knee-reach", "motion.start_speed_deg_s.O=100", "motion.goal_speed_deg_s.O=-50").trajectory
    assert np.degrees(trajectory.velocity[0, 0, 0]) == pytest.approx(100, abs=SPEED_DEG_S)
    assert np.degrees(trajectory.velocity[-1, -1, 0]) == pytest.approx(-50, abs=SPEED_DEG_S)


def test_a_periodic_motion_returns_to_its_own_state():
    trajectory = optimal("knee-sine-shank").trajectory
    first, last = np.zeros(1), np.array([np.nextafter(trajectory.duration_s, 0)])
    assert trajectory.position_at(last)[0, 0] == pytest.approx(trajectory.position_at(first)[0, 0], abs=BOUNDARY)
    speed = np.abs(trajectory.velocity).max()
    assert trajectory.velocity_at(last)[0, 0] == pytest.approx(trajectory.velocity_at(first)[0, 0], abs=BOUNDARY * speed)
    assert trajectory.effort[-1, -1, 0] == pytest.approx(trajectory.effort[0, 0, 0], abs=EFFORT_JUMP)


@every_plan
def test_scipy_and_the_oracle_s_dynamics_arrive_where_the_plan_says(name):
    plan = optimal(name)
    trajectory = plan.trajectory
    path = trajectory.position_at(dense(plan, 4))
    breaks = trajectory.breaks_s
    fourbar = carried_by(name)
    state = np.array([trajectory.position[0, 0, 0], trajectory.velocity[0, 0, 0]])
    worst = 0.0
    for k in range(len(breaks) - 1):  # the effort may jump at a break, and the oracle restarts there
        one = BPoly(trajectory.effort[:, [k], 0], breaks[k : k + 2])
        rate = rate_of(fourbar, float(path.min()), float(path.max()), lambda t, one=one: float(one(t)))
        solved = solve_ivp(rate, breaks[k : k + 2], state, rtol=1e-9, atol=1e-11)
        state = solved.y[:, -1]
        worst = max(worst, abs(state[0] - trajectory.position[-1, k, 0]))
    assert np.degrees(worst) < SECOND_ROUTE_DEG


@every_reach
def test_the_work_of_the_effort_is_the_rise_in_energy(name):
    plan = optimal(name)
    trajectory, fourbar = plan.trajectory, carried_by(name)
    time = np.linspace(0.0, 0.6 * trajectory.duration_s, 20001)  # at speed: the kinetic energy is there
    power = (trajectory.effort_at(time) * trajectory.velocity_at(time))[:, 0]
    s, v = trajectory.position_at(time)[[0, -1], 0], trajectory.velocity_at(time)[[0, -1], 0]
    energy = 0.5 * fourbar.inertia(s) * v**2 + fourbar.potential(s)
    work = float(np.sum(0.5 * (power[1:] + power[:-1])) * (time[1] - time[0]))
    assert work > 0.01
    assert work == pytest.approx(energy[1] - energy[0], rel=ENERGY)


# Limits that bind between the nodes.


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "override", "joint", "limit"),
    [
        ("knee-sprint", "limits.speed_deg_s.O=1200", 0, 1200.0),
        ("knee-sine-shank", "limits.speed_deg_s.O=1200", 0, 1200.0),
        ("knee-reach", "limits.speed_deg_s.C=[-100, 560]", 2, 560.0),
    ],
)
def test_a_speed_limit_that_binds_holds_between_the_nodes(name, override, joint, limit):
    def fastest(plan: Plan) -> float:
        time = dense(plan, 50)
        poses = follow(plan.problem.mechanism, plan.trajectory.position_at(time), plan.trajectory.start_pose)
        rates = joint_rates(plan.problem.mechanism, poses, plan.trajectory.velocity_at(time))
        return float(np.degrees(np.abs(rates[:, joint]).max()))

    assert fastest(optimal(name)) > 1.05 * limit
    speed = fastest(optimal(name, override))
    assert speed <= limit + np.degrees(RANGE_SLACK)
    assert speed > 0.98 * limit


@pytest.mark.slow
@pytest.mark.parametrize(
    ("override", "joint", "limit", "sign"),
    [("limits.range_deg.A=[11, 150]", 1, 11.0, -1), ("limits.range_deg.O=[-90, 50]", 0, 50.0, 1)],
)
def test_a_range_that_binds_holds_between_the_nodes(override, joint, limit, sign):
    def furthest(plan: Plan) -> float:
        poses = follow(plan.problem.mechanism, plan.trajectory.position_at(dense(plan, 50)), plan.trajectory.start_pose)
        return float(sign * np.degrees((sign * poses[:, joint]).max()))

    coarse = "mesh.intervals=20"
    assert sign * furthest(optimal("knee-sine-shank", coarse)) > sign * limit + 0.3
    reached = furthest(optimal("knee-sine-shank", coarse, override))
    assert sign * reached <= sign * limit + np.degrees(RANGE_SLACK)
    assert reached == pytest.approx(limit, abs=BINDS_DEG)


# Tracking.


@pytest.mark.slow
def test_a_reference_within_the_limits_is_followed():
    plan = optimal("knee-sine", "motion.kind=periodic")
    assert plan.details["tracking_rms_deg"] < FOLLOWED_DEG


def test_an_exact_reference_is_the_sinusoid_itself():
    trajectory = optimal("knee-sine").trajectory
    time = np.linspace(0, 0.25, 500)
    sinusoid = np.radians(3.6 + 52.67 * np.sin(2 * np.pi * 4 * time))
    np.testing.assert_allclose(trajectory.position_at(time)[:, 0], sinusoid, atol=SINUSOID)


def test_the_nearest_motion_is_nearer_than_a_sinusoid_that_keeps_the_limit():
    plan = optimal("knee-sine-shank")
    share = LIMIT / KNEE_TABLE["seed_sine"]["shank"]["max_Nm"]  # about the amplitude that the limit allows
    shrunk = np.radians(52.67) * (1 - share) / np.sqrt(2)
    assert 0 < np.radians(plan.details["tracking_rms_deg"]) < 0.2 * shrunk
