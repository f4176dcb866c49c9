"""Welds and couplings by joint and tendon equalities: residuals and Jacobians of MuJoCo's, and what they tie together."""

import mujoco
import numpy as np
import pytest

from linkplan.models.closure.equations import read_closures
from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.reach import reach
from linkplan.models.tree.dynamics import build_tree
from tests.support.linkages import GRIPPER, PSSR, UNCUT, WELDED, loaded
from tests.support.mechanisms import replaced, simulated
from tests.support.tolerances import BRANCHING, CLOSURE, COUPLED, GAP_M, POSE, REDUCED, WELD, WELD_NM, relative_error
from tests.support.tolerances_planner import ROUNDING

N_POSES = 3


# Welds


def test_a_welded_four_bar_moves_as_the_one_in_one_piece():
    cut, whole = loaded("welded"), load_mechanism(UNCUT)
    for angle in (-0.4, 0.0, 0.7):
        q, p = (close_at(mechanism, np.array([angle])) for mechanism in (cut, whole))
        assert np.abs(q[[0, 1, 2]] - p).max() < POSE
        first, second = (float(m.dynamics.gravity_effort(x)) for m, x in ((cut, q), (whole, p)))
        assert abs(first - second) < WELD * abs(second) + WELD_NM
        first, second = (float(m.dynamics.reduced_inertia(x)) for m, x in ((cut, q), (whole, p)))
        assert abs(first - second) < WELD * second


def test_a_weld_without_torque_scale_is_a_connect():
    text = replaced(WELDED, 'body2="half"/>', 'body2="half" torquescale="0"/>')
    mechanism = load_mechanism(text)
    assert (mechanism.n_closure_rows, mechanism.dof) == (3, 2)


def test_an_angle_open_in_a_weld_counts_by_what_it_moves():
    mechanism = loaded("welded")
    q = np.array(mechanism.home)
    q[3] += 0.01
    orientation = next(closure for closure in mechanism.closures if closure.kind == "orientation")
    phi = np.array(mechanism.dynamics.closure(q)).ravel()
    assert orientation.unit == "rad"
    assert abs(orientation.gap(phi) - 2 * np.sin(0.005)) < ROUNDING
    assert mechanism.gap_m(q) >= orientation.gap(phi) * mechanism.model.stat.extent * (1 - 1e-12)


def test_gaps_stand_by_the_unit_of_what_is_tied():
    """Of three gaps open by their own amounts: pins in metres, the cranks' coupling in radians."""
    mechanism = load_mechanism(GRIPPER)
    q = np.array(mechanism.home)
    q[mechanism.joint_index("crank_l")] += 0.03
    gaps = mechanism.gaps_by_unit(np.array([mechanism.home, q]))
    assert list(gaps) == ["m", "rad"]
    assert gaps["rad"] == pytest.approx([0.0, 0.03], abs=ROUNDING)
    assert gaps["m"][1] == pytest.approx(np.hypot(0.045, 0.038) * 2 * np.sin(0.015), rel=1e-9)  # the pin, from the crank's


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
        assert abs(q[1] - (-0.1 - 4 * x + 0.5 * x**2)) < COUPLED
        expected = 0.3 + 0.02 * (-4 + x) ** 2
        assert abs(float(mechanism.dynamics.reduced_inertia(q)) - expected) < COUPLED


def test_a_joint_equality_of_one_joint_locks_it_where_it_says():
    text = replaced(WELDED, "</equality>", '<joint joint1="C" polycoef="0.1 0 0 0 0"/></equality>')
    with pytest.raises(Exception, match="locked"):
        load_mechanism(text)
    open_tree = WELDED.replace('<weld name="glue" body1="coupler" body2="half"/>', "")
    text = replaced(open_tree, "</equality>", '<joint joint1="C" polycoef="0.1 0 0 0 0"/></equality>')
    mechanism = load_mechanism(text)
    assert mechanism.dof == 3
    assert abs(mechanism.home[mechanism.joint_index("C")] - 0.1) < GAP_M


def test_a_tendon_equality_of_one_joint_each_is_the_joint_equality():
    tendons = "<tendon>" + "".join(f'<fixed name="{side}"><joint joint="crank_{side}" coef="1"/></fixed>' for side in "rl")
    text = replaced(GRIPPER, "<tendon>", tendons)
    joint = '<joint name="mirror" joint1="crank_r" joint2="crank_l" polycoef="0 -1 0 0 0"/>'
    tied = load_mechanism(replaced(text, joint, '<tendon name="mirror" tendon1="r" tendon2="l" polycoef="0 -1 0 0 0"/>'))
    plain = loaded("gripper")
    s = plain.home[plain.independent] + 0.1
    q, p = close_at(plain, s), close_at(tied, s)
    assert np.abs(q - p).max() < COUPLED
    assert relative_error(np.array(tied.dynamics.reduced_inertia(p)), np.array(plain.dynamics.reduced_inertia(q))) < REDUCED


def test_a_coupling_said_twice_takes_one_freedom():
    again = '<joint joint1="crank_l" joint2="crank_r" polycoef="0 -1 0 0 0"/></equality>'
    assert load_mechanism(replaced(GRIPPER, "</equality>", again)).dof == loaded("gripper").dof


def test_the_fingers_of_the_gripper_stay_mirrored_and_upright():
    mechanism = loaded("gripper")
    for s in ([0.0, 0.3], [0.1, -0.25]):
        q = dict(zip([j.name for j in mechanism.joints], close_at(mechanism, np.array(s)), strict=True))
        assert abs(q["crank_r"] + q["crank_l"]) < COUPLED
        assert abs(q["finger_r"] + q["crank_r"]) < POSE, "a parallelogram keeps its finger's direction"


def test_a_grippers_reach_ends_where_both_of_its_parallelograms_lie_flat():
    mechanism = loaded("gripper")
    column = [joint.name for joint in mechanism.independent_joints].index("crank_l")
    can = reach(mechanism, column)
    flat = np.arctan2(0.04, 0.03) - np.arctan2(-0.002, 0.015)  # crank along the line of the pivots
    assert (can.lower.reason, can.upper.reason) == ("singular pose", "singular pose")
    # A flat parallelogram is a branching point, where Newton on phi = 0, det J_z = 0 converges as on a double root.
    assert abs(can.lower.position + flat) < BRANCHING
    assert abs(can.upper.position - (np.pi - flat)) < BRANCHING


def test_a_chart_that_ends_is_not_called_a_range():
    assert reach(load_mechanism(PSSR), 1).upper.reason == "end of rod_rx's chart"


@pytest.mark.parametrize(("kind", "unit"), [("hinge", "rad"), ("slide", "m")])
@pytest.mark.parametrize("arm", [1.0, 0.01])
def test_the_gap_of_a_tendon_is_that_of_the_joint_that_moves_it_most(kind, unit, arm):
    bodies = "".join(f'<body><joint name="{n}" type="{kind}"/><geom size="0.1"/></body>' for n in "ab")
    tendon = f'<fixed name="t"><joint joint="a" coef="{arm}"/><joint joint="b" coef="{-0.5 * arm}"/></fixed>'
    mechanism = load_mechanism(
        f"<mujoco><worldbody>{bodies}</worldbody><tendon>{tendon}</tendon>"
        '<equality><tendon tendon1="t"/></equality><actuator><motor joint="b"/></actuator></mujoco>'
    )
    q = np.array(mechanism.home)
    q[0] += 0.02
    (closure,) = mechanism.closures
    assert closure.unit == unit
    assert closure.gap(np.array(mechanism.dynamics.closure(q)).ravel()) == pytest.approx(0.02)


# A mass that slides along x and z on a rope of constant length over a site: a pendulum.
ON_A_ROPE = """<mujoco><worldbody><site name="eye" pos="0 0 1"/>
<body pos="0.3 0 0.6"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="2" diaginertia=".01 .01 .01"/><site name="hook"/></body></worldbody>
<tendon><spatial name="rope"><site site="eye"/><site site="hook"/></spatial></tendon>
<equality><tendon name="taut" tendon1="rope"/></equality>
<actuator><motor joint="x" ctrlrange="-50 50"/></actuator></mujoco>"""


def test_a_rope_of_constant_length_is_a_pendulum():
    mechanism = load_mechanism(ON_A_ROPE)
    assert (mechanism.dof, [joint.name for joint in mechanism.independent_joints]) == (1, ["x"])
    pose = mechanism.home.copy()
    pose[0] = 0.1
    pose = close_at(mechanism, pose[:1])
    away, down = 0.3 + pose[0], 0.4 - pose[1]
    assert np.hypot(away, down) == pytest.approx(0.5, abs=1e-11)
    slope = away / down  # dz/dx along the circle
    inertia = float(mechanism.dynamics.reduced_inertia(pose))
    assert inertia == pytest.approx(2 * (1 + slope**2), rel=1e-12)
    hold = float(mechanism.dynamics.inverse_dynamics(pose, np.zeros(1), np.zeros(1)))
    assert hold == pytest.approx(2 * 9.81 * slope, rel=1e-12)


def test_a_tendon_whose_length_has_no_expression_is_refused_with_the_remedy():
    eyelet = '<site name="in" pos="0.1 0 0.9"/><geom name="eyelet" type="sphere" size="0.1" pos="0.1 0 0.9"/>'
    inside = ON_A_ROPE.replace('<site name="eye"', f'{eyelet}<site name="eye"').replace(
        '<site site="eye"/>', '<site site="eye"/><geom geom="eyelet" sidesite="in"/>'
    )
    with pytest.raises(ModelError, match="equality constraint 'taut' ties tendon 'rope', which passes through the inside"):
        load_mechanism(inside)
