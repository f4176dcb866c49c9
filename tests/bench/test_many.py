"""The robots of several motors are what they are called, the peer has their dynamics, and a table tells what failed."""

import json

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from tests.bench import many
from tests.bench.many_peer import node_function
from tests.bench.many_robots import robots, write_robots
from tests.support.tolerances_planner import ROUNDING, SAME_FIGURE

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


@pytest.mark.parametrize("name", ["spatial-4", "delta-reach"])
def test_the_peer_s_equations_hold_where_the_reduced_dynamics_do(name, folder):
    """The rows are linear in accelerations and multipliers of dependent joints: some make all rows vanish, or none do."""
    mechanism, rng = load_mechanism(folder / f"{name}.xml"), np.random.default_rng(3)
    pose, (v, a) = mechanism.home, rng.normal(size=(2, mechanism.dof))
    node, n_z = node_function(mechanism), len(mechanism.dependent)
    rates = np.array(mechanism.dynamics.velocity_map(pose)) @ v
    known = np.concatenate([pose[mechanism.dependent], rates[mechanism.dependent], np.zeros(2 * n_z)])

    def left(u: np.ndarray) -> float:
        steps = np.vstack([np.zeros(4 * n_z), np.eye(4 * n_z)[2 * n_z :]])
        first, *others = (np.array(node(pose[mechanism.independent], v, a, u, known + step)[0]).ravel() for step in steps)
        slopes = np.array(others).reshape(-1, len(first)).T - first[:, None]
        return float(np.abs(first - slopes @ np.linalg.lstsq(slopes, first, rcond=None)[0]).max())

    effort = needed_effort(mechanism, pose[None], v[None], a[None])[0][0]
    assert left(effort) < SAME_FIGURE
    assert left(1.01 * effort) > 1e3 * SAME_FIGURE


@pytest.mark.slow
def test_the_bench_tells_certified_plans_from_a_file_that_is_refused(folder, tmp_path, capsys):
    for name in ("five-bar-reach.xml", "five-bar-reach-effort15.toml"):
        (tmp_path / name).write_text((folder / name).read_text(encoding="utf-8"), encoding="utf-8")
    assert many.main([str(tmp_path), "-o", str(tmp_path / "found.json")]) == 0
    (row,) = (many.Compared(**row) for row in json.loads((tmp_path / "found.json").read_text(encoding="utf-8")))
    assert row.problem == "five-bar-reach-effort15"
    assert row.over_best is not None
    assert abs(row.over_best) < 1e-3
    assert min(row.processor_s, row.peer_processor_s or 0.0) > 0.1
    (tmp_path / "five-bar-reach.xml").unlink()
    assert many.main([str(tmp_path), "--no-peer"]) == 1
    assert "refused" in capsys.readouterr().out
