"""Which coordinates are independent, which turn idly, and what changes neither: sizes, masses, the viewer's extent."""

import numpy as np
import pytest

from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.reach import reach
from tests.support.linkages import GRIPPER, PRESS, PSSR, RSSR, WELDED, loaded
from tests.support.mechanisms import FLAT_PARALLELOGRAM, replaced
from tests.support.tolerances import POSE, REACH_END, REDUCED, UNIT_VECTOR

# Choice of coordinates and singular poses


def test_the_named_joint_is_the_independent_one():
    mechanism = load_mechanism(WELDED, independent=["C"])
    assert [joint.name for joint in mechanism.independent_joints] == ["C"]
    plain = loaded("welded")
    q = close_at(plain, np.array([0.3]))
    there = close_at(mechanism, q[[2]])
    assert np.abs(there - q).max() < POSE
    ratio = np.array(plain.dynamics.velocity_map(q))[2, 0]
    inertia = [float(m.dynamics.reduced_inertia(q)) for m in (plain, mechanism)]
    assert abs(inertia[1] * ratio**2 / inertia[0] - 1) < REDUCED


def test_a_part_of_the_coordinates_may_be_named():
    mechanism = load_mechanism(PRESS, independent=["rocker_left"])
    assert [joint.name for joint in mechanism.independent_joints] == ["rocker_left"]
    gripper = load_mechanism(GRIPPER, independent=["guide_r"])
    assert "guide_r" in [joint.name for joint in gripper.independent_joints]
    assert "lift" in [joint.name for joint in gripper.independent_joints], "the driven slide stays so"


def test_a_singular_reference_pose_is_reported_where_home_is_another():
    mechanism = load_mechanism(FLAT_PARALLELOGRAM, home={"O": 0.5})
    (note,) = mechanism.notes
    assert "rank 1" in note
    assert "2 at home" in note


@pytest.mark.parametrize("world", ['<geom type="box" size="50 50 0.1" pos="0 0 -3"/>', ""])
def test_a_floor_or_the_viewers_extent_changes_no_assembly(world):
    text = replaced(PRESS, "<worldbody>", f"<worldbody>{world}")
    if not world:
        text = replaced(text, "<worldbody>", '<statistic extent="1e-4"/><worldbody>')
    mechanism, plain = load_mechanism(text), loaded("press")
    assert abs(np.log10(mechanism.model.stat.extent / plain.model.stat.extent)) > 1, "it says something else"
    assert 0.3 < mechanism.extent_m / plain.extent_m < 3
    first, second = reach(mechanism), reach(plain)
    assert abs(first.upper.position - second.upper.position) < REACH_END
    assert abs(first.lower.position - second.lower.position) < REACH_END


def test_light_bodies_change_no_rank():
    heavy = GRIPPER.replace('mass="1e-4"', 'mass="10"')
    assert heavy != GRIPPER
    assert load_mechanism(heavy).dof == loaded("gripper").dof
    tiny = load_mechanism(replaced(RSSR, "<worldbody>", "<worldbody>").replace('size="0.01"', 'size="0.01" density="0.01"'))
    assert tiny.dof == 2


def test_the_rod_between_two_balls_spins_idly_and_that_is_said():
    mechanism = loaded("rssr")
    (note,) = mechanism.notes
    assert "rod" in note
    assert "passive degree of freedom" in note
    assert [mechanism.joints[i].name for i in mechanism.passive_dofs] == ["rod_rx"]
    assert mechanism.joints[mechanism.independent[0]].name == "crank"


def test_the_first_coordinate_of_such_a_rod_is_its_spin():
    mechanism = loaded("rssr")
    rates = np.array(mechanism.dynamics.velocity_map(mechanism.home))[:, 1]
    assert np.abs(rates - np.eye(5)[1]).max() < UNIT_VECTOR, "it alone moves"
    line = np.array([0.25, 0.08, 0.06])
    spin = mechanism.qvel_of(mechanism.home, rates)[1:4]
    assert np.abs(spin - line / np.linalg.norm(line)).max() < UNIT_VECTOR


def test_a_rod_on_three_hinges_spins_idly_as_one_on_a_ball():
    hinges = "".join(f'<joint name="rod_{k}" axis="{axis}"/>' for k, axis in enumerate(("1 0 0", "0 1 0", "0 0 1")))
    mechanism = load_mechanism(replaced(RSSR, '<joint name="rod" type="ball" damping="0.001"/>', hinges))
    (note,) = mechanism.notes
    assert "body rod" in note
    assert [mechanism.joints[i].name for i in mechanism.passive_dofs] == ["rod_0"]


def test_a_bent_rod_that_gravity_turns_is_not_idle():
    bent = replaced(RSSR, '<geom type="capsule" fromto="0 0 0 0.25 0.08 0.06"/>', '<geom pos="0.1 0.2 0"/>')
    mechanism = load_mechanism(bent)
    assert mechanism.dof == 2
    assert mechanism.passive_dofs == ()


@pytest.mark.parametrize(("mass", "idle"), [(1e-3, True), (0.1, False)])
def test_a_bent_rod_is_idle_where_its_weight_is_nothing_beside_the_mechanism_s(mass, idle):
    rod = f'<inertial pos="0.125 0.04 0.033" mass="{mass}" diaginertia="{mass * 6e-3} {mass * 6e-3} {mass * 6e-3}"/>'
    bent = replaced(RSSR, '<geom type="capsule" fromto="0 0 0 0.25 0.08 0.06"/>', rod)
    heavy = bent.replace('fromto="0 0 0 0.02 0.01 0.1"', 'mass="1" fromto="0 0 0 0.02 0.01 0.1"')
    mechanism = load_mechanism(heavy.replace('fromto="0 0 0 -0.03 0.04 0.16"', 'mass="1" fromto="0 0 0 -0.03 0.04 0.16"'))
    assert bool(mechanism.passive_dofs) == idle


def test_a_path_that_leaves_a_chart_is_refused_by_joint():
    mechanism = load_mechanism(PSSR)
    spin = np.linspace(mechanism.home[mechanism.independent[1]], 6.5, 200)
    path = np.column_stack([np.zeros(200), spin])
    with pytest.raises(AssemblyError, match="'rod'"):
        follow(mechanism, path)
