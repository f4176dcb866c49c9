"""Degrees of freedom: idle spins of rods, locked mechanisms, coordinates that coast."""

import numpy as np
import pytest
import scipy

from linkplan.models.errors import AssemblyError, LockedError, UnassembledError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.reach import reach
from tests.support.boom import boom
from tests.support.linkages import GRIPPER, PRESS, PSSR, RSSR, WELDED, loaded
from tests.support.mechanisms import FLAT_PARALLELOGRAM, TRUSS, replaced
from tests.support.refusals import TWO_BODIES, assert_refused
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
    assert_refused(lambda: follow(mechanism, path), "'rod'", kind=AssemblyError)


# A four-bar of pins O, A, C closed at B.
FOUR_BAR = """<mujoco model="bar"><worldbody>
<body name="crank"><joint name="O" axis="0 1 0"/><geom size=".01" pos="0 0 .05"/>
<body name="coupler" pos="0 0 .1"><joint name="A" axis="0 1 0"/><geom size=".01" pos=".15 0 .05"/></body></body>
<body name="rocker" pos=".3 0 0"><joint name="C" axis="0 1 0"/><geom size=".01" pos="0 0 .1"/></body></worldbody>
<equality>%s</equality><actuator><motor joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""
PIN = '<connect name="B" body1="coupler" body2="rocker" anchor=".3 0 .1"/>'


def freed(text: str) -> dict[str, int]:
    with pytest.raises(LockedError) as refused:
        load_mechanism(text)
    for part, more in refused.value.freed.items():
        assert f"{part} ({more}" in str(refused.value)
    return refused.value.freed


WELD = '<weld name="B" body1="coupler" body2="rocker" anchor=".3 0 .1"/>'
BRAKES = '<joint name="first" joint1="O"/><joint name="second" joint1="C"/>'
COUPLINGS = '<equality><joint name="left" joint1="ja"/><joint name="right" joint1="jb"/></equality>'


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (FOUR_BAR % (PIN + '<joint name="brake" joint1="O"/>'), {"B": 2, "brake": 1}),
        (FOUR_BAR % WELD, {"B": 3, "weld B's orientation": 1}),
        (FOUR_BAR % (PIN + BRAKES), {"B": 1, "first and second": 1}),  # without the pin the coupler hangs free
        (TWO_BODIES % COUPLINGS, {"left": 1, "right": 1}),
    ],
    ids=["a brake", "a weld for a pin", "two brakes, none of which locks alone", "couplings of two bodies"],
)
def test_every_closure_without_which_it_moves_is_named_with_what_it_gains(text, found):
    assert load_mechanism(FOUR_BAR % PIN).dof == 1
    assert freed(text) == found


def test_a_truss_in_a_line_is_said_to_be_held_by_its_pin():
    assert list(freed(replaced(TRUSS, "0.1 0 0.1", "0.1 0 0")).values()) == [1]


def test_a_loop_that_locks_its_nearest_closed_pose_offers_no_pose():
    shafts = "".join(
        f'<body name="{name}" pos="{place}"><joint name="{name}" axis="0 0 1"/><geom size=".1"/></body>'
        for name, place in (("in", "0 0 0"), ("out", ".5 0 .4"))
    )
    text = f"""<mujoco><worldbody>{shafts}<body name="disc" pos="0 0 .2"><freejoint name="disc"/><geom size=".1"/></body>
    </worldbody><equality><weld body1="in" body2="disc" relpose="0 0 .2 1 0 0 0"/>
    <weld body1="disc" body2="out" relpose="-.5 0 .2 1 0 0 0"/></equality></mujoco>"""
    with pytest.raises(UnassembledError, match="at the nearest closed pose found, the loops lock every joint") as refused:
        load_mechanism(text)
    assert not refused.value.home


# A crank of a centimetre below a rocker of a metre, drawn in the middle of the rocker's swing of 0.01 rad each way.
SMALL_CRANK = """<mujoco><default><geom contype="0" conaffinity="0" size=".01"/><joint axis="0 1 0"/></default><worldbody>
<body pos="0 0 1"><joint name="crank"/><geom/><body pos="0 0 .01"><joint name="pin"/>
<geom type="capsule" fromto="0 0 0 1 0 -.01"/><site name="tip" pos="1 0 -.01"/></body></body>
<body pos="1 0 0"><joint name="rocker"/><geom type="capsule" fromto="0 0 0 0 0 1"/><site name="end" pos="0 0 1"/></body>
</worldbody><equality><connect site1="tip" site2="end"/></equality>
<actuator><motor joint="rocker" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_a_joint_that_turns_by_a_hundredth_of_a_radian_each_way_is_not_locked():
    assert [joint.name for joint in load_mechanism(SMALL_CRANK).independent_joints] == ["rocker"]


@pytest.mark.parametrize(
    ("axis", "joint", "motor", "coasts"),
    [
        ("0 0 1", "", "", True),
        ("0 0 1", 'damping=".2" armature=".1"', "", True),
        ("0 .01 1", "", "", False),
        ("0 0 1", 'stiffness=".1"', "", False),
        ("0 0 1", 'frictionloss=".1"', "", False),
        ("0 0 1", "", '<motor joint="turn"/>', False),
    ],
    ids=("bare", "damped", "tilted", "sprung", "dry friction", "driven"),
)
def test_a_boom_coasts_if_nothing_but_damping_acts_on_it(axis, joint, motor, coasts):
    mechanism = load_mechanism(boom(axis, joint, motor))
    assert mechanism.coasting_dofs == ((0,) if coasts else ())


def test_momentum_and_damping_times_angle_stay_together_what_they_were():
    """The motion of a damped boom under jerky efforts on the leg, by integration."""
    mechanism = load_mechanism(boom())
    assert mechanism.coasting_dofs == (0,)

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        q, v = np.split(state, 2)
        u = [np.sin(7 * time), np.cos(5 * time) - 0.3]
        return np.concatenate([v, np.array(mechanism.dynamics.acceleration(q, v, u)).ravel()])

    begin = np.array([0.2, -0.1, 0.3, 0.5, 0.4, -0.6])
    end = scipy.integrate.solve_ivp(rate, (0.0, 1.5), begin, rtol=1e-10, atol=1e-12).y[:, -1]
    law = [float(mechanism.dynamics.reduced_inertia(x[:3])[0, :] @ x[3:]) + 0.2 * x[0] for x in (begin, end)]
    assert abs(end[0] - begin[0]) > 0.1
    assert law[1] == pytest.approx(law[0], rel=1e-8)
