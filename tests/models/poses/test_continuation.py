"""Poses led in stretches: the same as by Newton to convergence in short steps, and regular only where that would be."""

import numpy as np
import pytest

from linkplan.models.compiled.functions import evaluated
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import advance, advance_all, close_at, closing_of, continue_to, follow, stride_along
from linkplan.models.poses.reach import reach
from linkplan.models.poses.singular_poses import all_regular
from linkplan.models.reduction.closing import are_regular, states_at, stretch
from linkplan.planner.problem.motion import is_open

# Rounding of poses [rad or m].
ASSEMBLY = 1e-12


def walked(mechanism, path):
    """Return the poses by short steps, each with Newton to convergence on all rows of the closure."""
    q, poses, (free, bound) = np.array(mechanism.home), [], (mechanism.independent, mechanism.dependent)
    for s in path:
        begin, n = q[free].copy(), int(np.ceil(np.abs(s - q[free]).max() / 0.01))
        for share in np.arange(1, n + 1) / n:
            q[free] = begin + share * (s - begin)
            for _ in range(6 if len(bound) else 0):
                phi, J = (np.array(f(q)) for f in (mechanism.dynamics.closure, mechanism.dynamics.closure_jacobian))
                q[bound] -= np.linalg.lstsq(J[:, bound], phi, rcond=1e-10)[0].ravel()
        assert mechanism.gap_m(q) < ASSEMBLY
        poses.append(q.copy())
    return np.array(poses)


@pytest.mark.parametrize("name", ["optimus-knee", "five-bar", "andrews-squeezer", "cart-pole"])
def test_led_poses_are_those_of_the_walk(name):
    mechanism = load_mechanism(name)
    s = mechanism.home[mechanism.independent]
    path = s + 0.3 * np.linspace(0.0, 1.0, 37)[:, None] * np.linspace(1.0, -0.5, mechanism.dof)
    poses, n = continue_to(mechanism, mechanism.home, path)
    assert n == len(path)
    np.testing.assert_allclose(poses, walked(mechanism, path), rtol=0, atol=ASSEMBLY)


@pytest.mark.parametrize("name", ["optimus-knee", "five-bar", "andrews-squeezer", "parallel-gripper"])
def test_poses_continued_side_by_side_are_those_continued_one_by_one(name):
    mechanism = load_mechanism(name)
    s = mechanism.home[mechanism.independent]
    targets = s + np.random.default_rng(0).uniform(-1.5, 1.5, (40, mechanism.dof))
    found = advance_all(mechanism, np.tile(mechanism.home, (40, 1)), targets)
    one_by_one = [advance(mechanism, mechanism.home, target) for target in targets]
    arrived = np.array([there for _, there in one_by_one])
    assert 0 < arrived.sum() < 40 or name in ("andrews-squeezer", "parallel-gripper")
    np.testing.assert_array_equal(np.isfinite(found).all(axis=1), arrived)
    wanted = np.array([pose for pose, _ in one_by_one])[arrived]
    np.testing.assert_allclose(found[arrived], wanted, rtol=0, atol=10 * ASSEMBLY)
    by_newton = [walked(mechanism, target[None])[0] for target in targets[arrived][:5]]
    np.testing.assert_allclose(wanted[:5], by_newton, rtol=0, atol=10 * ASSEMBLY)


@pytest.mark.parametrize("name", ["optimus-knee", "five-bar", "slider-crank"])
def test_a_closed_pose_of_the_equations_is_that_of_the_mechanism(name):
    mechanism = load_mechanism(name)
    names, home = [joint.name for joint in mechanism.independent_joints], mechanism.home[mechanism.independent]
    closed = []
    for goal in home + np.random.default_rng(3).uniform(-1.5, 1.5, (20, mechanism.dof)):
        asked = dict(zip(names, goal, strict=True))
        try:
            expected = close_at(mechanism, goal)
        except AssemblyError:
            with pytest.raises(AssemblyError, match="loop opens"):
                mechanism.equations.closed_pose(at_rad=asked)
            continue
        np.testing.assert_allclose(mechanism.equations.closed_pose(at_rad=asked), expected, rtol=0, atol=ASSEMBLY)
        closed.append(goal)
    assert closed


def test_a_tree_is_continued_side_by_side_without_strides():
    text = '<mujoco><worldbody><body><joint name="J" axis="0 1 0"/><geom size=".1"/></body></worldbody></mujoco>'
    mechanism = load_mechanism(text)
    targets = np.array([[0.3], [-2.0]])
    np.testing.assert_array_equal(advance_all(mechanism, np.zeros((2, 1)), targets), targets)


def test_positions_far_apart_are_led_to_in_steps():
    mechanism = load_mechanism("optimus-knee")
    there = np.radians([[55.0], [-60.0]])
    np.testing.assert_allclose(follow(mechanism, there), walked(mechanism, there), rtol=0, atol=ASSEMBLY)


def test_leading_stops_at_the_singular_pose_where_the_walk_does():
    mechanism = load_mechanism("optimus-knee")
    end = reach(mechanism).upper
    assert end.reason == "singular pose"
    path = np.linspace(mechanism.home[mechanism.independent], [end.position + 0.1], 50)
    poses, n = continue_to(mechanism, mechanism.home, path)
    assert n < len(path)
    assert len(poses) == n + 1
    assert poses[-1, mechanism.independent[0]] == pytest.approx(end.position, abs=1e-3)
    with pytest.raises(AssemblyError, match="loop opens"):
        follow(mechanism, path)


def test_a_stride_that_would_leave_the_branch_is_not_regular():
    mechanism = load_mechanism("optimus-knee")
    beyond = np.array([[reach(mechanism).upper.position + 0.05]])  # in one stride, ten times a step
    assert len(stride_along(mechanism, mechanism.home, beyond)) == 0


def test_a_stride_is_regular_only_where_newton_converges():
    mechanism = load_mechanism("optimus-knee")
    function, before = stretch(mechanism.dynamics), states_at(mechanism.dynamics, mechanism.home[None])
    s = mechanism.home[mechanism.independent][:, None] + 0.02
    after, phi, corrections = (x.T for x in evaluated(function, before.T, s))
    assert are_regular(closing_of(mechanism), before, after, phi, corrections)
    corrections[:, len(mechanism.dependent) :] += 0.01 * 0.02  # the last step
    assert not are_regular(closing_of(mechanism), before, after, phi, corrections)


def test_a_way_is_open_as_far_as_the_reach_goes():
    mechanism = load_mechanism("optimus-knee")
    can = reach(mechanism)
    for end, inwards in ((can.lower.position, 1), (can.upper.position, -1)):
        assert is_open(mechanism, np.array([end + inwards * 0.02]))
        assert not is_open(mechanism, np.array([end - inwards * 0.02]))


def test_poses_past_a_nearly_singular_one_are_not_all_regular():
    mechanism = load_mechanism("optimus-knee")
    end = reach(mechanism).upper.position
    assert all_regular(mechanism, follow(mechanism, np.linspace([0.0], [0.2], 20)))
    assert not all_regular(mechanism, follow(mechanism, np.linspace([0.0], [end - 1e-4], 20)))
