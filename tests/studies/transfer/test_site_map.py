"""`transfer` tells what a site does for motors: columns over the table, ellipses and the polytope of forces at home."""

import csv

import numpy as np
import pytest

import linkplan
from tests.support.refusals import assert_refused

# Two links in the plane y = 0 without weight, hinges along -y: the tip is at (l1 c1 + l2 c12, l1 s1 + l2 s12) in x and z.
UPPER, LOWER, ANGLES, LIMITS = 0.3, 0.2, np.radians([20.0, 60.0]), np.array([5.0, 2.0])
ARM = f"""<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="a" axis="0 -1 0" range="-10 50"/>
<geom size="0.02" contype="0"/><body pos="{UPPER} 0 0"><joint name="b" axis="0 -1 0" range="30 90"/>
<geom size="0.02" contype="0"/><site name="tip" pos="{LOWER} 0 0"/></body></body></worldbody><actuator>
<motor name="one" joint="a" ctrlrange="-5 5"/><motor name="two" joint="b" ctrlrange="-2 2"/></actuator>
<keyframe><key name="home" qpos="{ANGLES[0]} {ANGLES[1]}"/></keyframe></mujoco>"""


def jacobian(a, b):
    """The tip's rates in x and z (2, 2) [m/rad]."""
    upper, lower = UPPER * np.array([-np.sin(a), np.cos(a)]), LOWER * np.array([-np.sin(a + b), np.cos(a + b)])
    return np.column_stack([upper + lower, lower])


@pytest.fixture(scope="module")
def found():
    return linkplan.transfer(ARM, ["a", "b"], tolerance=0.3, sites=["tip"])


def test_the_ellipses_of_a_two_link_arm_are_those_of_its_jacobian(found):
    home, sizes = found.sites["tip"], np.linalg.svd(jacobian(*ANGLES), compute_uv=False)
    assert home["speed_semi_axes_m_s"] == pytest.approx(sizes, rel=1e-9)
    assert home["force_semi_axes_n"] == pytest.approx(1 / sizes, rel=1e-9)
    for size, way in zip(sizes, home["directions"][:, [0, 2]], strict=True):
        assert np.linalg.norm(jacobian(*ANGLES).T @ way) == pytest.approx(size, rel=1e-9)
    assert home["held_n"] == pytest.approx(np.zeros(3), abs=1e-9)


def test_the_vertices_of_the_polytope_need_a_corner_of_the_limits(found):
    needed = found.sites["tip"]["force_vertices_n"][:, [0, 2]] @ jacobian(*ANGLES)  # u = J^T f
    assert np.abs(needed) == pytest.approx(np.tile(LIMITS, (4, 1)), rel=1e-9)
    assert {tuple(signs) for signs in np.sign(needed).astype(int).tolist()} == {(1, 1), (1, -1), (-1, 1), (-1, -1)}


def test_a_site_has_columns_over_the_table_and_a_picture(found, tmp_path):
    with (found.save(tmp_path / "arm") / "table.csv").open(encoding="utf-8") as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    for row in rows:
        a, b = row["joint_position_a [rad]"], row["joint_position_b [rad]"]
        assert row["tip_x_per_two [m/rad]"] == pytest.approx(jacobian(a, b)[0, 1], rel=1e-8)
        assert row["one_per_tip_z [N.m/N]"] == pytest.approx(jacobian(a, b)[1, 0], rel=1e-8, abs=1e-9)
        assert row["tip_x_largest_push [N]"] == pytest.approx(min(LIMITS / np.abs(jacobian(a, b)[0])), rel=1e-8)
    assert (tmp_path / "arm" / "sites.png").exists()
    assert_refused(lambda: linkplan.transfer(ARM, ["a", "b"], tolerance=0.3, sites=["tp"]), "unknown site 'tp'")
