"""Least singular values of loops that share no joints, computed loop by loop."""

import numpy as np
import pytest

from linkplan.models.closure.rank import blocks, shares
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.singular_poses import _least_along, _parts
from linkplan.models.reduction.closing import moved_entries
from linkplan.models.tree.joints import unit_steps

LOOP = """<body pos="0 {y} 0"><joint name="o{k}"/><geom fromto="0 0 0 .1 0 0"/><body pos=".1 0 0"><joint name="a{k}"/>
<geom fromto="0 0 0 .28 0 0"/><site name="k{k}" pos=".28 0 0"/></body></body>
<body pos=".3 {y} 0"><joint name="d{k}"/><geom fromto="0 0 0 {rocker} 0 0"/><site name="r{k}" pos="{rocker} 0 0"/></body>"""


def loops(n: int) -> str:
    """Return n four-bars beside each other, with different rockers, drawn flat."""
    bodies = "".join(LOOP.format(k=k, y=0.1 * k, rocker=0.22 + 0.01 * k) for k in range(n))
    pins = "".join(f'<connect site1="k{k}" site2="r{k}"/>' for k in range(n))
    motors = "".join(f'<motor joint="o{k}" ctrlrange="-3 3"/>' for k in range(n))
    home = " ".join(["1.05 -0.55 1.59"] * n)
    return f"""<mujoco><default><geom type="capsule" size=".005" contype="0" conaffinity="0"/>
<joint axis="0 -1 0"/></default>
<worldbody>{bodies}</worldbody><equality>{pins}</equality><actuator>{motors}</actuator>
<keyframe><key name="home" qpos="{home}"/></keyframe></mujoco>"""


@pytest.mark.parametrize("source", [loops(3), "optimus-knee", "five-bar"], ids=["three loops", "knee", "five-bar"])
@pytest.mark.parametrize("moved", [slice(0, 3), slice(None)], ids=["first loop", "all"])
def test_values_of_parts_are_those_of_the_whole_jacobian(source, moved):
    mechanism = load_mechanism(source)
    poses = np.tile(mechanism.home, (20, 1))
    poses[:, moved] += np.random.default_rng(1).uniform(-1.0, 1.0, poses[:, moved].shape)
    J = sampled(mechanism.dynamics.closure_jacobian, poses) * unit_steps(mechanism.joints, mechanism.extent_m)
    for dependent in (False, True):
        part = J[:, :, mechanism.dependent] if dependent else J
        whole = np.linalg.svd(part, compute_uv=False)[:, len(mechanism.dependent) - 1]
        np.testing.assert_allclose(_least_along(mechanism, poses, dependent=dependent), whole, atol=1e-14)


def test_strides_keep_the_rates_of_joints_in_the_same_loop_only():
    dynamics = load_mechanism(loops(3)).dynamics
    assert moved_entries(dynamics).tolist() == [0, 1, 2, 12, 13, 14, 24, 25, 26]


@pytest.mark.parametrize("shape", [(6, 9), (9, 6)])
def test_singular_values_by_blocks_are_those_of_the_whole_matrix(shape):
    matrix, rng = np.zeros(shape), np.random.default_rng(2)
    for k in range(3):  # rows and columns of the blocks are shuffled below
        m, n = np.array(shape) // 3
        matrix[k * m : (k + 1) * m, k * n : (k + 1) * n] = rng.uniform(-1.0, 1.0, (m, n))
    matrix[:, 0] = 0.0
    matrix = matrix[rng.permutation(shape[0])][:, rng.permutation(shape[1])]
    whole = np.linalg.svd(matrix, compute_uv=False)
    np.testing.assert_allclose(shares(matrix), whole / whole[0], atol=1e-14)
    assert sorted(len(columns) for _, columns in blocks(matrix != 0)) == sorted([shape[1] // 3 - 1, *[shape[1] // 3] * 2])


def test_loops_without_common_joints_are_different_parts():
    mechanism = load_mechanism(loops(3))
    parts = _parts(mechanism)
    assert sorted(part.columns.tolist() for part in parts) == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    assert [part.jacobian.size_out(0) for part in parts] == [(2, 3)] * 3  # the row along y is constant
