"""The robots of several motors are what they are called, the peer has their dynamics, and a table tells what failed."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.planner.problem.problem import load_problem
from tests.bench import many
from tests.bench.many_peer import build_many_peer, node_function
from tests.bench.many_robots import KINDS, robots, write_robots
from tests.support.tolerances_planner import ROUNDING

# Of a motor's limit, the most that it takes to hold the weight at both ends.
_HELD_SHARE = 0.6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("many")
    write_robots(place)
    return place


@pytest.mark.parametrize("robot", robots(), ids=lambda robot: robot.name)
def test_a_robot_has_a_freedom_for_each_motor_and_holds_both_ends_of_a_way_that_closes(robot, folder):
    mechanism = load_mechanism(folder / f"{robot.name}.xml")
    assert mechanism.dof == mechanism.n_u == robot.n_motors
    assert [joint.name for joint in mechanism.independent_joints] == list(robot.limits)
    assert len(mechanism.closure_names) == robot.text.count("<connect")
    start, goal = (np.radians([*ends.values()]) for ends in (robot.start_deg, robot.goal_deg))
    poses = follow(mechanism, start + np.linspace(0.0, 1.0, 11)[:, None] * (goal - start))
    still = np.zeros((2, mechanism.dof))
    effort, missed = needed_effort(mechanism, poses[[0, -1]], still, still)
    assert np.abs(missed).max() < ROUNDING * mechanism.effort_limit.max()
    assert np.abs(effort / mechanism.effort_limit[:, 1]).max() < _HELD_SHARE


def test_the_set_has_robots_of_two_to_sixteen_motors_with_all_kinds_of_problems(folder):
    assert {robot.n_motors for robot in robots()} == {2, 3, 4, 6, 8, 10, 12, 16}
    assert len(list(folder.glob("*.toml"))) == len(KINDS) * len(robots())
    kept = load_problem(folder / "planar-2-speed.toml").limits.speed
    assert np.all(np.isfinite(kept))
    assert set(load_problem(folder / "planar-2-mixed.toml").objective.weights) == {"time", "effort"}


@pytest.mark.parametrize("name", ["spatial-4", "delta-reach"])
def test_the_peer_s_equations_hold_where_the_reduced_dynamics_do(name, folder):
    """In the lifted unknowns the rows are linear in accelerations and multipliers: some make all of them vanish."""
    mechanism, rng = load_mechanism(folder / f"{name}.xml"), np.random.default_rng(3)
    pose, v, a = mechanism.home, rng.normal(size=mechanism.dof), rng.normal(size=mechanism.dof)
    effort, node, n_z = needed_effort(mechanism, pose[None], v[None], a[None])[0][0], node_function(mechanism), 0
    n_z = len(mechanism.dependent)
    rates = np.array(mechanism.dynamics.velocity_map(pose)) @ v
    known = np.concatenate([pose[mechanism.dependent], rates[mechanism.dependent], np.zeros(2 * n_z)])

    def left(u: np.ndarray) -> float:
        of = [np.array(node(pose[mechanism.independent], v, a, u, known + step)[0]).ravel() for step in np.eye(4 * n_z)[2 * n_z :]]
        rest = np.array(node(pose[mechanism.independent], v, a, u, known)[0]).ravel()
        slopes = (np.array(of) - rest).T if n_z else np.zeros((len(rest), 0))
        return float(np.abs(rest - slopes @ np.linalg.lstsq(slopes, rest, rcond=None)[0]).max())

    assert left(effort) < 1e-9
    assert left(1.01 * effort) > 1e-3


def test_the_table_tells_a_plan_from_a_failure_and_is_written_after_each(folder, tmp_path):
    rows = many.compare_all([folder / "planar-2-effort15.toml", folder / "five-bar-reach-effort15.toml"], into=tmp_path / "a.json")
    assert [row.motors for row in rows] == [2, 2]
    assert all(row.peer_status == "solved" for row in rows)
    assert rows[1].status == "optimal"
