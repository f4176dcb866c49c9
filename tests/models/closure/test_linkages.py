"""Loops closed by welds, couplings, ball joints and on moving bodies: against MuJoCo, plainer models and energy."""

import copy
from functools import cache

import mujoco
import numpy as np
import pytest
import scipy.integrate

from linkplan.models.closure.equations import read_closures
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import close_at, follow, reach
from linkplan.models.tree.dynamics import build_tree
from tests.support.linkages import COUNTS, GRIPPER, LEG, LINKAGES, PRESS, RSSR, UNCUT, WELDED
from tests.support.mechanisms import FLAT_PARALLELOGRAM, Simulated, replaced, simulated
from tests.support.tolerances import (
    CLOSURE,
    INTEGRATED_GAP,
    MOMENT,
    POWER,
    RANDOM_LIMIT,
    REDUCED,
    TREE,
    relative_error,
)

N_POSES = 3
SOFTNESS = (1e-5, 1e-6)
on_every_linkage = pytest.mark.parametrize("name", LINKAGES)


@cache
def load(name: str) -> Mechanism:
    return load_mechanism(LINKAGES[name])


@cache
def samples(name: str) -> list[tuple[np.ndarray, ...]]:
    """Return closed poses with speeds, all joints' rates and efforts: (q, v, q', u)."""
    mechanism, rng = load(name), np.random.default_rng(5)
    s = mechanism.home[mechanism.independent] + rng.uniform(-0.2, 0.2, (N_POSES, mechanism.dof))
    q, v = np.array([close_at(mechanism, x) for x in s]), rng.normal(size=s.shape)
    return list(zip(q, v, joint_rates(mechanism, q, v), rng.uniform(-1, 1, (N_POSES, mechanism.n_u)), strict=True))


def in_mujoco(
    mechanism: Mechanism, q: np.ndarray, rates: np.ndarray, u: np.ndarray | None = None, softness: float = 1.0
) -> Simulated:
    """Return MuJoCo's quantities at internal coordinates and rates under efforts u, its constraints made harder."""
    model = copy.copy(mechanism.model)
    model.body_invweight0[:] *= softness
    model.dof_invweight0[:] *= softness
    for array in (model.actuator_ctrllimited, model.actuator_forcelimited):
        array[:] = False
    state = mechanism.qpos_of(q), mechanism.qvel_of(q, rates)
    if u is None:
        return simulated(model, *state)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = state
    mujoco.mj_forward(model, data)
    ctrl = np.zeros(model.nu)
    for actuator, effort in zip(mechanism.actuators, u, strict=True):
        length, velocity = data.actuator_length[actuator.output], data.actuator_velocity[actuator.output]
        gain, bias = (np.dot([1.0, length, velocity], x) for x in (actuator.gains, actuator.biases))
        ctrl[actuator.channel] = (effort - bias) / gain
    return simulated(model, *state, ctrl)


def velocity_matrix(mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
    """Return T, qvel = T q', column by column."""
    return np.array([mechanism.qvel_of(q, rate) for rate in np.eye(mechanism.n_q)]).T


@on_every_linkage
def test_freedom_rows_and_rank_are_those_counted_by_hand(name):
    mechanism = load(name)
    assert (mechanism.dof, mechanism.n_closure_rows, len(mechanism.closure_rows)) == COUNTS[name]
    assert mechanism.gap_m(mechanism.home) < 1e-11


@on_every_linkage
def test_the_velocity_map_is_within_the_null_space_of_mujocos_rows(name):
    mechanism = load(name)
    for q, v, rates, _ in samples(name):
        rows = in_mujoco(mechanism, q, rates).rows
        assert np.abs(rows).max() > 0.01, "the loop is closed in MuJoCo"
        assert np.abs(rows @ mechanism.qvel_of(q, rates)).max() < REDUCED * np.abs(v).max()
        assert np.linalg.matrix_rank(rows, tol=1e-9) == mechanism.n_q - mechanism.dof


@on_every_linkage
def test_actuator_moments_are_mujocos(name):
    mechanism = load(name)
    for q, _, rates, _ in samples(name):
        expected = velocity_matrix(mechanism, q).T @ in_mujoco(mechanism, q, rates).moment.T
        assert relative_error(np.array(mechanism.dynamics.effort_matrix(q)), expected) < MOMENT


@on_every_linkage
def test_acceleration_is_the_limit_of_mujocos_as_the_loop_hardens(name):
    mechanism = load(name)
    for q, v, rates, u in samples(name):
        first, second = (in_mujoco(mechanism, q, rates, u, s).acceleration for s in SOFTNESS)
        hard = (SOFTNESS[0] * second - SOFTNESS[1] * first) / (SOFTNESS[0] - SOFTNESS[1])
        assert relative_error(chart_acceleration(mechanism, q, v, u), hard) < RANDOM_LIMIT


def chart_acceleration(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the derivative of MuJoCo's qvel along the reduced flow, by central differences of qvel(q, q')."""
    a = np.array(mechanism.dynamics.acceleration(q, v, u)).ravel()
    n_s, h = mechanism.dof, 1e-4

    def qvel(t: float) -> np.ndarray:
        s = q[mechanism.independent] + v * t + a * t**2 / 2
        pose = close_at(mechanism, s, start=q)
        rates = np.array(mechanism.dynamics.velocity_map(pose)) @ (v + a * t)
        return mechanism.qvel_of(pose, rates)

    assert n_s == len(a)
    return (8 * (qvel(h) - qvel(-h)) - (qvel(2 * h) - qvel(-2 * h))) / (12 * h)


@on_every_linkage
def test_closure_forces_act_on_the_joints_as_mujocos_constraints_do(name):
    mechanism = load(name)
    for q, v, rates, u in samples(name):
        first, second = (in_mujoco(mechanism, q, rates, u, s).constraint_force for s in SOFTNESS)
        hard = (SOFTNESS[0] * second - SOFTNESS[1] * first) / (SOFTNESS[0] - SOFTNESS[1])
        assert np.abs(hard).max() > 1e-4, "the loop carries load"
        a = mechanism.dynamics.acceleration(q, v, u)
        force = np.array(mechanism.dynamics.closure_force(q, v, a, u)).ravel()
        jacobian = np.array(mechanism.dynamics.closure_jacobian(q))
        expected = velocity_matrix(mechanism, q).T @ hard
        assert relative_error(jacobian.T @ force, expected) < RANDOM_LIMIT


@on_every_linkage
def test_energy_gained_is_work_less_dissipation_and_the_loop_stays_closed(name):
    mechanism = load(name)
    dynamics, n_q, n_s = mechanism.dynamics, mechanism.n_q, mechanism.dof

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        q, v = y[:n_q], y[n_q : n_q + n_s]
        u = np.full(mechanism.n_u, 0.05 * np.cos(20 * t))
        dq, dv = (np.array(x).ravel() for x in dynamics.flow(q, v, u))
        damper = np.array(dynamics.passive(q, dq) - dynamics.passive(q, np.zeros(n_q))).ravel()
        return np.concatenate([dq, dv, [v @ np.array(dynamics.effort_map(q)) @ u, -damper @ dq]])

    start = np.concatenate([mechanism.home, np.zeros(n_s), [0.0, 0.0]])
    end = scipy.integrate.solve_ivp(rates, (0, 0.05), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    first, last = (sum(float(e) for e in dynamics.energy(y[:n_q], y[n_q : n_q + n_s])) for y in (start, end))
    work, dissipated = end[-2:]
    kinetic = float(dynamics.energy(end[:n_q], end[n_q : n_q + n_s])[0])
    assert min(abs(work), dissipated, kinetic) > 0, "it moves, driven and damped"
    assert abs(last - first - work + dissipated) < POWER * max(abs(work), dissipated, kinetic)
    assert mechanism.gap_m(end[:n_q]) < INTEGRATED_GAP


# Welds


def test_a_welded_four_bar_moves_as_the_one_in_one_piece():
    cut, whole = load("welded"), load_mechanism(UNCUT)
    for angle in (-0.4, 0.0, 0.7):
        q, p = (close_at(mechanism, np.array([angle])) for mechanism in (cut, whole))
        assert np.abs(q[[0, 1, 2]] - p).max() < 1e-9
        first, second = (float(m.dynamics.gravity_effort(x)) for m, x in ((cut, q), (whole, p)))
        assert abs(first - second) < 1e-9 * abs(second) + 1e-12
        first, second = (float(m.dynamics.reduced_inertia(x)) for m, x in ((cut, q), (whole, p)))
        assert abs(first - second) < 1e-9 * second


def test_a_weld_without_torque_scale_is_a_connect():
    text = replaced(WELDED, 'body2="half"/>', 'body2="half" torquescale="0"/>')
    mechanism = load_mechanism(text)
    assert (mechanism.n_closure_rows, mechanism.dof) == (3, 2)


def test_an_angle_open_in_a_weld_counts_by_what_it_moves():
    mechanism = load("welded")
    q = np.array(mechanism.home)
    q[3] += 0.01
    orientation = next(closure for closure in mechanism.closures if closure.kind == "orientation")
    phi = np.array(mechanism.dynamics.closure(q)).ravel()
    assert orientation.unit == "rad"
    assert abs(orientation.gap(phi) - 2 * np.sin(0.005)) < 1e-12
    assert mechanism.gap_m(q) >= orientation.gap(phi) * mechanism.model.stat.extent * (1 - 1e-12)


_TWO_ARMS = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="a" pos="0.1 0.2 0.3"><joint name="j" axis="1 2 3" ref="0.3"/><geom size="0.1"/>
    <site name="s" pos="0.1 0.2 0.1" euler="1 0.2 0.3"/>
    <body name="b" pos="0.1 0 0.4" euler="0.3 0.1 2"><joint name="k" axis="0 1 1" ref="-0.2"/><geom size="0.1"/></body>
  </body>
  <body name="c" pos="0 0.3 0.1" euler="1 1 0.2"><joint name="m" type="slide" axis="1 1 0" ref="0.3"/>
    <joint name="n" axis="1 1 0"/><geom size="0.1"/><site name="t" pos="-0.1 0.2 0.1" euler="1 -0.2 0.3"/></body>
</worldbody>
<tendon><fixed name="f"><joint joint="j" coef="1.3"/><joint joint="m" coef="-0.4"/></fixed>
  <fixed name="g"><joint joint="n" coef="1.3"/><joint joint="k" coef="-0.4"/></fixed></tendon>
<equality>%s</equality></mujoco>"""

EQUALITIES = {
    "weld at a pose": '<weld body1="b" body2="c" relpose="0.1 0.2 0.3 0.7 0.3 0.2 -0.1" torquescale="0.3"/>',
    "weld at the reference": '<weld body1="b" body2="c" anchor="0.1 0.3 0.2"/>',
    "weld to the world": '<weld body1="b" anchor="0.1 0.3 0.2"/>',
    "weld of sites": '<weld site1="s" site2="t" torquescale="2"/>',
    "weld without torque": '<weld site1="s" site2="t" torquescale="0"/>',
    "connect": '<connect body1="b" body2="c" anchor="0.1 0.3 0.2"/>',
    "connect to the world": '<connect body1="b" anchor="0.1 0.3 0.2"/>',
    "connect of sites": '<connect site1="s" site2="t"/>',
    "joints, hinge to slide": '<joint joint1="j" joint2="m" polycoef="0.1 2 0.3 -0.2 0.5"/>',
    "joints, slide to hinge": '<joint joint1="m" joint2="k" polycoef="0.1 2 0.3 -0.2 0.5"/>',
    "one joint": '<joint joint1="m" polycoef="0.1 2 0.3 -0.2 0.5"/>',
    "tendons": '<tendon tendon1="f" tendon2="g" polycoef="0.1 2 0.3 -0.2 0.5"/>',
    "one tendon": '<tendon tendon1="g" polycoef="0.1 2 0.3 -0.2 0.5"/>',
}


@pytest.mark.parametrize("element", EQUALITIES.values(), ids=EQUALITIES)
def test_every_equality_has_mujocos_residual_and_jacobian_in_metres_where_it_is_open(element):
    import casadi as ca

    model = mujoco.MjModel.from_xml_string(_TWO_ARMS % element)
    tree = build_tree(model)
    closures = read_closures(model, tree)
    phi = ca.vertcat(*[closure.residual for closure in closures])
    function = ca.Function("phi", [tree.q], [ca.densify(phi), ca.densify(ca.jacobian(phi, tree.q))])
    scale = np.concatenate([np.full(c.rows.stop - c.rows.start, c.scale) for c in closures])
    for q in np.random.default_rng(1).uniform(-1, 1, (N_POSES, model.nq)):
        expected = simulated(model, q, np.zeros(model.nv))
        residual, jacobian = (np.array(x) for x in function(q))
        kept = slice(0, len(scale))  # a weld without torque keeps three empty rows in MuJoCo
        assert np.abs(expected.residual[kept]).max() > 1e-3, "it is open"
        assert not np.any(expected.rows[len(scale) :])
        assert np.abs(residual.ravel() - scale * expected.residual[kept]).max() < CLOSURE
        assert np.abs(jacobian - scale[:, None] * expected.rows[kept]).max() < CLOSURE


# Couplings


def test_two_geared_pendulums_have_the_inertia_of_the_ratio_squared():
    text = """<mujoco><compiler angle="radian"/><default><joint axis="0 1 0"/></default><worldbody>
      <body name="a"><joint name="a" ref="0.2"/><inertial mass="1" pos="0 0 0" diaginertia="0.3 0.3 0.3"/></body>
      <body name="b" pos="1 0 0"><joint name="b" ref="-0.1"/>
        <inertial mass="1" pos="0 0 0" diaginertia="0.02 0.02 0.02"/></body>
      </worldbody><equality><joint joint1="b" joint2="a" polycoef="0 -4 0.5 0 0"/></equality>
      <actuator><motor joint="a"/></actuator></mujoco>"""
    mechanism = load_mechanism(text)
    for x in (-0.3, 0.0, 0.4):
        q = close_at(mechanism, np.array([0.2 + x]))
        assert abs(q[1] - (-0.1 - 4 * x + 0.5 * x**2)) < 1e-10
        expected = 0.3 + 0.02 * (-4 + x) ** 2
        assert abs(float(mechanism.dynamics.reduced_inertia(q)) - expected) < 1e-10


def test_a_joint_equality_of_one_joint_locks_it_where_it_says():
    text = replaced(WELDED, "</equality>", '<joint joint1="C" polycoef="0.1 0 0 0 0"/></equality>')
    with pytest.raises(Exception, match="locked"):
        load_mechanism(text)
    open_tree = WELDED.replace('<weld name="glue" body1="coupler" body2="half"/>', "")
    text = replaced(open_tree, "</equality>", '<joint joint1="C" polycoef="0.1 0 0 0 0"/></equality>')
    mechanism = load_mechanism(text)
    assert mechanism.dof == 3
    assert abs(mechanism.home[mechanism.joint_index("C")] - 0.1) < 1e-11


def test_a_tendon_equality_of_one_joint_each_is_the_joint_equality():
    tendons = "<tendon>" + "".join(f'<fixed name="{side}"><joint joint="crank_{side}" coef="1"/></fixed>' for side in "rl")
    text = replaced(GRIPPER, "<tendon>", tendons)
    joint = '<joint name="mirror" joint1="crank_r" joint2="crank_l" polycoef="0 -1 0 0 0"/>'
    tied = load_mechanism(replaced(text, joint, '<tendon name="mirror" tendon1="r" tendon2="l" polycoef="0 -1 0 0 0"/>'))
    plain = load("gripper")
    s = plain.home[plain.independent] + 0.1
    q, p = close_at(plain, s), close_at(tied, s)
    assert np.abs(q - p).max() < 1e-10
    assert relative_error(np.array(tied.dynamics.reduced_inertia(p)), np.array(plain.dynamics.reduced_inertia(q))) < REDUCED


def test_a_coupling_said_twice_takes_one_freedom():
    again = '<joint joint1="crank_l" joint2="crank_r" polycoef="0 -1 0 0 0"/></equality>'
    assert load_mechanism(replaced(GRIPPER, "</equality>", again)).dof == load("gripper").dof


def test_an_inactive_coupling_takes_none():
    text = replaced(GRIPPER, '<joint name="mirror"', '<joint active="false" name="mirror"')
    assert load_mechanism(text).dof == load("gripper").dof + 1


def test_the_fingers_of_the_gripper_stay_mirrored_and_upright():
    mechanism = load("gripper")
    for s in ([0.0, 0.3], [0.1, -0.25]):
        q = dict(zip([j.name for j in mechanism.joints], close_at(mechanism, np.array(s)), strict=True))
        assert abs(q["crank_r"] + q["crank_l"]) < 1e-10
        assert abs(q["finger_r"] + q["crank_r"]) < 1e-9, "a parallelogram keeps its finger's direction"


def test_a_grippers_reach_ends_where_both_of_its_parallelograms_lie_flat():
    mechanism = load("gripper")
    column = [joint.name for joint in mechanism.independent_joints].index("crank_l")
    can = reach(mechanism, column)
    flat = np.arctan2(0.04, 0.03) - np.arctan2(-0.002, 0.015)  # crank along the line of the pivots
    assert (can.lower.reason, can.upper.reason) == ("singular pose", "singular pose")
    # A flat parallelogram is a branching point, where Newton on phi = 0, det J_z = 0 converges as on a double root.
    assert abs(can.lower.position + flat) < 1e-6
    assert abs(can.upper.position - (np.pi - flat)) < 1e-6


def test_a_chart_that_ends_is_not_called_a_range():
    assert reach(load("rssr"), 1).upper.reason == "end of rod_rx's chart"


# Loops that ride


def test_a_loop_on_a_turning_leg_is_as_regular_at_a_quarter_turn_as_at_none():
    mechanism = load("leg")
    s = np.array(mechanism.home[mechanism.independent])
    turned = s.copy()
    turned[0] = np.pi / 2
    straight, across = (abs(float(mechanism.dynamics.singularity(close_at(mechanism, x)))) for x in (s, turned))
    assert straight > 1e-4, "the loop is regular"
    assert abs(across / straight - 1) < TREE


def test_the_closure_of_a_leg_depends_on_no_joint_above_it():
    mechanism = load("leg")
    jacobian = np.array(mechanism.dynamics.closure_jacobian(np.ones(mechanism.n_q)))
    assert np.abs(jacobian).max() > 0.01
    assert not np.any(jacobian[:, :2])


def test_a_reach_of_a_leg_ends_where_its_own_loop_does():
    turned = replaced(LEG, '<body name="hip" pos="0 0 1">', '<body name="hip" pos="0 0 1" quat="0.3 0.8 -0.1 0.5">')
    first, second = (reach(load_mechanism(text), 2) for text in (LEG, turned))
    assert first.upper.reason == second.upper.reason
    assert abs(first.upper.position - second.upper.position) < 1e-8


# Choice of coordinates and singular poses


def test_the_named_joint_is_the_independent_one():
    mechanism = load_mechanism(WELDED, independent=["C"])
    assert [joint.name for joint in mechanism.independent_joints] == ["C"]
    plain = load("welded")
    q = close_at(plain, np.array([0.3]))
    there = close_at(mechanism, q[[2]])
    assert np.abs(there - q).max() < 1e-9
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
    mechanism, plain = load_mechanism(text), load("press")
    assert abs(np.log10(mechanism.model.stat.extent / plain.model.stat.extent)) > 1, "it says something else"
    assert 0.3 < mechanism.extent_m / plain.extent_m < 3
    first, second = reach(mechanism), reach(plain)
    assert abs(first.upper.position - second.upper.position) < 1e-8
    assert abs(first.lower.position - second.lower.position) < 1e-8


def test_light_bodies_change_no_rank():
    heavy = GRIPPER.replace('mass="1e-4"', 'mass="10"')
    assert heavy != GRIPPER
    assert load_mechanism(heavy).dof == load("gripper").dof
    tiny = load_mechanism(replaced(RSSR, "<worldbody>", "<worldbody>").replace('size="0.01"', 'size="0.01" density="0.01"'))
    assert tiny.dof == 2


def test_the_rod_between_two_balls_spins_idly_and_that_is_said():
    mechanism = load("rssr")
    (note,) = mechanism.notes
    assert "rod" in note
    assert "idle" in note
    assert [mechanism.joints[i].chart for i in mechanism.idle] == ["rod"] * 3
    assert mechanism.joints[mechanism.independent[0]].name == "crank"


def test_the_first_coordinate_of_such_a_rod_is_its_spin():
    mechanism = load("rssr")
    rates = np.array(mechanism.dynamics.velocity_map(mechanism.home))[:, 1]
    assert np.abs(rates - np.eye(5)[1]).max() < 1e-14, "it alone moves"
    line = np.array([0.25, 0.08, 0.06])
    spin = mechanism.qvel_of(mechanism.home, rates)[1:4]
    assert np.abs(spin - line / np.linalg.norm(line)).max() < 1e-14


def test_a_rod_on_three_hinges_spins_idly_as_one_on_a_ball():
    hinges = "".join(f'<joint name="rod_{k}" axis="{axis}"/>' for k, axis in enumerate(("1 0 0", "0 1 0", "0 0 1")))
    mechanism = load_mechanism(replaced(RSSR, '<joint name="rod" type="ball" damping="0.001"/>', hinges))
    (note,) = mechanism.notes
    assert "body rod" in note
    assert [mechanism.joints[i].name for i in mechanism.idle] == ["rod_0", "rod_1", "rod_2"]


def test_a_bent_rod_that_gravity_turns_is_not_idle():
    bent = replaced(RSSR, '<geom type="capsule" fromto="0 0 0 0.25 0.08 0.06"/>', '<geom pos="0.1 0.2 0"/>')
    mechanism = load_mechanism(bent)
    assert mechanism.dof == 2
    assert mechanism.idle == ()


def test_a_path_that_leaves_a_chart_is_refused_by_joint():
    mechanism = load("rssr")
    spin = np.linspace(mechanism.home[mechanism.independent[1]], 6.5, 200)
    path = np.column_stack([np.zeros(200), spin])
    with pytest.raises(AssemblyError, match="'rod'"):
        follow(mechanism, path)
