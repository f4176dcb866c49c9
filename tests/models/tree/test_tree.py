"""The open tree against MuJoCo: mass matrix, bias, passive forces, effort limits, margins of ranges, carried weight."""

from functools import cache

import casadi as ca
import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models.audit import audit
from linkplan.models.digest import part_hashes
from linkplan.models.errors import ModelError, ProblemError
from linkplan.models.library import built_in_text
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.tree.dynamics import build_tree
from tests.support.linkages import LEG, RSSR
from tests.support.mechanisms import PENDULUM, SLIDER_CRANK, Simulated, random_tree, replaced, simulated
from tests.support.tolerances import ENERGY, TREE, TREE_ACCELERATION, relative_error, worst_relative_error
from tests.support.tolerances_planner import ROUNDING

N_STATES = 1000

KNEE_JOINTS = '<joint type="hinge" axis="0 1 0"/>'
SPRUNG_JOINTS = (
    '<joint type="hinge" axis="0 1 0" stiffness="3 -0.4 0.2" springref="12" damping="0.5 0.2 0.1" armature="0.003"/>'
)

TREES = ("tree 1", "tree 2", "tree 3")
SPRUNG = ("sprung knee", *TREES)
MODELS = ("optimus-knee", "optimus-knee-source", *SPRUNG)


def over(names: tuple[str, ...]) -> pytest.MarkDecorator:
    """Return the parametrization by model; of the random trees, which take long to build, the first alone is quick."""
    return pytest.mark.parametrize(
        "name", [pytest.param(name, marks=pytest.mark.slow) if name in TREES[1:] else name for name in names]
    )


@cache
def mechanism(name: str) -> Mechanism:
    if name == "sprung knee":
        return load_mechanism(replaced(built_in_text("optimus-knee"), KNEE_JOINTS, SPRUNG_JOINTS))
    return load_mechanism(random_tree(int(name.split()[1])) if name in TREES else name)


@cache
def states(name: str) -> tuple[np.ndarray, np.ndarray, tuple[Simulated, ...]]:
    """Return positions and speeds (n, n_q), and MuJoCo's quantities there."""
    rng = np.random.default_rng(len(name) + 7 * sum(map(ord, name)))
    n_q = mechanism(name).n_q
    q, v = rng.uniform(-np.pi, np.pi, (N_STATES, n_q)), 3 * rng.normal(size=(N_STATES, n_q))
    model = mechanism(name).model
    return q, v, tuple(simulated(model, *state) for state in zip(q, v, strict=True))


@over(MODELS)
def test_mass_matrix_bias_and_passive_force_are_mujocos(name):
    q, v, expected = states(name)
    dynamics = mechanism(name).dynamics
    masses, biases, passives = (
        np.array([getattr(s, what) for s in expected]) for what in ("mass_matrix", "bias", "passive")
    )
    assert worst_relative_error(sampled(dynamics.mass_matrix, q), masses) < TREE
    assert worst_relative_error(sampled(dynamics.bias, q, v)[:, :, 0], biases) < TREE
    if name in SPRUNG:
        assert np.abs(passives).max(axis=1).min() > 1e-3, "springs and dampers act at every state"
        assert worst_relative_error(sampled(dynamics.passive, q, v)[:, :, 0], passives) < TREE


@over(TREES)
def test_an_open_tree_accelerates_as_in_mujoco_under_its_motors(name):
    chain = mechanism(name)
    q, v, passive_only = states(name)
    ctrl = np.random.default_rng(0).normal(size=(50, chain.n_u))
    expected = np.array([simulated(chain.model, *x).acceleration for x in zip(q, v, ctrl, strict=False)])
    unpowered = np.array([s.acceleration for s in passive_only[:50]])
    assert np.abs(expected - unpowered).max(axis=1).min() > 1e-3, "the motors move every state"
    actual = sampled(chain.dynamics.acceleration, q[:50], v[:50], ctrl)[:, :, 0]
    assert worst_relative_error(actual, expected) < TREE_ACCELERATION


@over(TREES)
def test_kinetic_and_potential_energy_are_mujocos(name):
    q, v, expected = states(name)
    ours = [[float(x) for x in mechanism(name).dynamics.energy(*at)] for at in zip(q[:100], v[:100], strict=True)]
    kinetic, potential = np.array(ours).T
    assert relative_error(kinetic, np.array([s.energy[1] for s in expected[:100]])) < ENERGY
    assert relative_error(potential, np.array([s.energy[0] for s in expected[:100]])) < ENERGY


@pytest.mark.slow
def test_springs_dampers_and_armature_of_a_tendon_are_mujocos():
    motor = '<motor tendon="rope" gear="2" armature="0.2" damping="0.3 0.1 0.2"/>'
    text = replaced(SLIDER_CRANK, '<motor joint="crank" ctrlrange="-2 2"/>', motor)
    sites = '<site name="hook" pos="-0.3 0.1 0.4"/>'
    rope = (
        '<tendon><spatial name="rope" stiffness="40 3 5" springlength="0.1 0.3" damping="1 0.5 0.2" armature="0.7">'
        '<site site="hook"/><site site="end"/></spatial></tendon><equality>'
    )
    text = replaced(replaced(text, "<worldbody>", f"<worldbody>{sites}"), "<equality>", rope)
    chain = load_mechanism(text)
    assert audit(chain.model) == ()
    tree = build_tree(chain.model)
    energy = ca.Function("energy", [tree.q, tree.qd], [tree.kinetic_energy, tree.potential_energy])
    for q, v in np.random.default_rng(0).uniform(-1, 1, (20, 2, 3)):
        expected = simulated(chain.model, q, v)
        assert np.abs(expected.passive).max() > 1e-2, "the tendon pulls"
        assert relative_error(np.array(chain.dynamics.passive(q, v)).ravel(), expected.passive) < TREE
        assert relative_error(np.array(chain.dynamics.mass_matrix(q)), expected.mass_matrix) < TREE
        assert relative_error(np.array(chain.dynamics.bias(q, v)).ravel(), expected.bias) < TREE
        kinetic, potential = (float(e) for e in energy(q, v))
        assert abs(kinetic - expected.energy[1]) < ROUNDING * max(1.0, kinetic)
        assert abs(potential - expected.energy[0]) < ROUNDING * max(1.0, abs(potential))


def test_the_random_trees_carry_every_feature_that_they_are_there_to_test():
    models = [mechanism(name).model for name in TREES]

    def some(values: str, axis: slice = np.s_[...]) -> bool:
        return any(np.any(np.asarray(getattr(model, values))[axis] != 0) for model in models)

    assert {joint.kind for name in TREES for joint in mechanism(name).joints} == {"hinge", "slide"}
    assert max(model.body_jntnum.max() for model in models) == 3, "several joints on one body"
    assert min(model.body_jntnum[1:].min() for model in models) == 1
    assert any(len(set(model.body_parentid[2:])) < model.nbody - 2 for model in models), "a branching tree"
    for values in ("jnt_pos", "qpos0", "qpos_spring", "jnt_stiffness", "dof_damping", "dof_armature", "body_ipos"):
        assert some(values), values
    for values in ("jnt_stiffnesspoly", "dof_dampingpoly", "actuator_dampingpoly"):
        assert some(values, np.s_[:, 0]), values
        assert some(values, np.s_[:, 1]), values
    assert some("actuator_armature")
    assert some("actuator_damping")
    assert any(np.any(model.actuator_gear[:, 0] < 0) for model in models)
    assert some("body_quat", np.s_[:, 1:])
    assert some("body_iquat", np.s_[:, 1:])
    assert all(np.all(model.opt.gravity != 0) for model in models), "gravity is aslant"


def test_a_small_product_of_inertia_is_kept():
    inertial = '<inertial mass="1" pos="0 0 0" fullinertia="0.1 0.2 0.15 2e-6 -1e-6 3e-6"/>'
    hinge = '<joint axis="0 1 0"/><joint axis="1 0 0"/><joint axis="0 0 1"/>'
    chain = load_mechanism(f"<mujoco><worldbody><body>{hinge}{inertial}</body></worldbody></mujoco>")
    expected = simulated(chain.model, np.zeros(3), np.zeros(3)).mass_matrix
    assert relative_error(np.diag(np.diag(expected)), expected) > 1e-5, "the products matter"
    assert relative_error(np.array(chain.dynamics.mass_matrix(np.zeros(3))), expected) < TREE


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_payloads_moments_are_about_its_bodys_axes(axis):
    text = replaced(PENDULUM, 'axis="0 1 0"', f'axis="{" ".join(map(str, np.eye(3)[axis]))}"')
    moments = [0.3, 0.4, 0.5]
    load = {"body": "rod", "mass_kg": 2.0, "com_m": [0.0, 0.0, 0.0], "inertia_kgm2": moments}
    bare, loaded = (float(load_mechanism(text, payload=p).dynamics.reduced_inertia(0.0)) for p in (None, load))
    assert relative_error(loaded - bare, moments[axis]) < TREE


@pytest.mark.slow
@pytest.mark.parametrize("flag", ["gravity", "spring", "damper"])
def test_a_disabled_force_is_disabled_here_too(flag):
    text = random_tree(1)
    disabled = load_mechanism(replaced(text, "/>\n  <worldbody>", f'><flag {flag}="disable"/></option>\n  <worldbody>'))
    q, v, _ = states("tree 1")
    with_flag, without = simulated(disabled.model, q[0], v[0]), simulated(mechanism("tree 1").model, q[0], v[0])
    assert relative_error(with_flag.passive - with_flag.bias, without.passive - without.bias) > 1e-3, "the flag matters"
    actual = np.array(disabled.dynamics.passive(q[0], v[0]) - disabled.dynamics.bias(q[0], v[0])).ravel()
    assert relative_error(actual, with_flag.passive - with_flag.bias) < TREE


@pytest.mark.parametrize("flag", ["spring", "gravity"])
def test_a_disabled_force_leaves_the_potential_energy(flag):
    text = replaced(random_tree(1), "/>\n  <worldbody>", f'><flag {flag}="disable"/></option>\n  <worldbody>')
    q, v, expected = states("tree 1")
    disabled = load_mechanism(text)
    potential = simulated(disabled.model, q[0], v[0]).energy[0]
    assert abs(potential - expected[0].energy[0]) > 1e-3, "the flag matters"
    assert relative_error(float(disabled.dynamics.energy(q[0], v[0])[1]), potential) < ENERGY


MOTORS = {
    "ctrlrange": '<motor joint="crank" ctrlrange="-2 3"/>',
    "ctrlrange and gear": '<motor joint="crank" gear="-4" ctrlrange="-2 3"/>',
    "gain": '<general joint="crank" gainprm="-5" ctrllimited="true" ctrlrange="-2 3"/>',
    "forcerange": '<motor joint="crank" gear="3" ctrlrange="-20 30" forcerange="-1 7"/>',
    "forcerange inside one end": '<general joint="crank" gainprm="2" ctrlrange="-2 3" forcerange="-9 5"/>',
    "slide": '<motor joint="slide" ctrlrange="-8 9"/>',
    "joint in parent": '<motor jointinparent="crank" gear="2" ctrlrange="-2 3"/>',
}


def saturated(model: mujoco.MjModel, joint: int) -> np.ndarray:
    """Return the least and greatest generalised effort on a joint that any control gets out of MuJoCo."""
    efforts = []
    for ctrl in (-1e6, 1e6):
        data = mujoco.MjData(model)
        data.ctrl[:] = ctrl
        mujoco.mj_forward(model, data)
        efforts.append(data.qfrc_actuator[joint])
    return np.sort(efforts)


@pytest.mark.parametrize("motor", MOTORS.values(), ids=MOTORS)
def test_effort_limits_are_where_mujoco_saturates(motor):
    chain = load_mechanism(replaced(SLIDER_CRANK, '<motor joint="crank" ctrlrange="-2 2"/>', motor))
    (actuator,) = chain.actuators
    expected = saturated(chain.model, actuator.joint)
    assert relative_error(np.sort(actuator.gear * chain.effort_limit[0]), expected) < TREE


@pytest.mark.parametrize("gear", [2.0, -0.5])
def test_the_joints_own_force_range_limits_its_motor(gear):
    text = replaced(SLIDER_CRANK, '<joint name="crank"', '<joint name="crank" actuatorfrcrange="-1 0.6"')
    chain = load_mechanism(replaced(text, '<motor joint="crank"', f'<motor joint="crank" gear="{gear}"'))
    expected = saturated(chain.model, 0)
    assert expected.tolist() == [-1.0, 0.6], "the joint's range binds on both sides"
    assert relative_error(np.sort(gear * chain.effort_limit[0]), expected) < TREE


def test_unclamped_controls_leave_a_motor_unlimited():
    text = replaced(SLIDER_CRANK, "<worldbody>", '<option><flag clampctrl="disable"/></option><worldbody>')
    chain = load_mechanism(text)
    assert saturated(chain.model, 0).tolist() == [-1e6, 1e6], "the flag matters"
    assert chain.effort_limit.tolist() == [[-np.inf, np.inf]]


ARM = """<mujoco><option gravity="0 0 0"/><worldbody><body name="arm">
<joint name="J" axis="0 1 0" range="-90 60" limited="true" {margin}/><geom size="0.05" pos="0.3 0 0"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""


def arm(margin: str) -> str:
    return ARM.format(margin=margin)


def test_a_margin_is_no_part_of_a_joints_free_range():
    mechanism = linkplan.load_mechanism(arm('margin="0.1"'))
    (joint,) = mechanism.joints
    assert (joint.lower, joint.upper) == pytest.approx((np.radians(-90) + 0.1, np.radians(60) - 0.1))


@pytest.mark.parametrize(("inside_rad", "pushed"), [(0.001, False), (-0.001, True)])
def test_mujoco_pushes_back_where_the_free_range_ends(inside_rad, pushed):
    mechanism = linkplan.load_mechanism(arm('margin="0.1"'))
    model = mujoco.MjModel.from_xml_string(arm('margin="0.1"'))
    data = mujoco.MjData(model)
    data.qpos[0] = mechanism.joints[0].upper - inside_rad
    mujoco.mj_forward(model, data)
    assert bool(np.any(data.qacc)) == pushed


def test_a_goal_within_the_margin_is_refused():
    mechanism = linkplan.load_mechanism(arm('margin="0.1"'))
    with pytest.raises(ProblemError, match=r"J = 58 deg is beyond reach.*54.27"):
        linkplan.Problem.reach(mechanism, start_deg={"J": 0}, goal_deg={"J": 58}, duration_s=1.0)


def test_a_margin_that_leaves_nothing_is_refused_in_one_line():
    with pytest.raises(ModelError, match="leaves joint J no position"):
        linkplan.load_mechanism(arm('margin="1.5"'))


def test_a_margin_changes_the_fingerprint_and_none_does_not():
    without, zero, some = (part_hashes(mujoco.MjModel.from_xml_string(arm(m))) for m in ("", 'margin="0"', 'margin="0.1"'))
    assert without == zero
    assert {part for part in some if some[part] != zero[part]} == {"joints"}


TEXTS = {
    "leg": replaced(LEG, '<body name="thigh">', '<body name="thigh" gravcomp="0.7">'),
    "rod on a ball": replaced(RSSR, '<body name="rod" ', '<body name="rod" gravcomp="1" '),
    "carried by an actuator": replaced(
        replaced(LEG, '<body name="thigh">', '<body name="thigh" gravcomp="1">'),
        '<joint name="pitch"/>',
        '<joint name="pitch" actuatorgravcomp="true"/>',
    ),
}


@pytest.mark.parametrize("name", TEXTS)
def test_passive_forces_are_mujocos_with_gravity_compensation(name):
    mechanism = load_mechanism(TEXTS[name])
    model, data = mechanism.model, mujoco.MjData(mechanism.model)
    rng = np.random.default_rng(2)
    for _ in range(3):
        q = mechanism.home + rng.uniform(-0.5, 0.5, mechanism.n_q)
        rates = rng.normal(size=mechanism.n_q)
        data.qpos[:], data.qvel[:] = mechanism.qpos_of(q), mechanism.qvel_of(q, rates)
        mujoco.mj_forward(model, data)
        assert np.abs(data.qfrc_gravcomp).max() > 1e-3, "it acts"
        T = np.array([mechanism.qvel_of(q, e) for e in np.eye(mechanism.n_q)]).T
        forces = data.qfrc_passive + np.where(model.jnt_actgravcomp[model.dof_jntid], data.qfrc_gravcomp, 0.0)
        assert relative_error(np.array(mechanism.dynamics.passive(q, rates)).ravel(), T.T @ forces) < TREE


def test_what_compensation_carries_is_no_weight_and_the_model_is_planned_as_it_is():
    text = LEG.replace("<body ", '<body gravcomp="1" ')
    mechanism = load_mechanism(text)
    assert np.abs(np.array(mechanism.dynamics.gravity_effort(mechanism.home))).max() < 1e-12
    assert not [one for one in audit(mechanism.model) if one.falsifies]


def test_compensation_that_joints_clamp_is_named_once_with_what_to_change():
    text = LEG.replace("<body ", '<body gravcomp="1" ')
    for joint in ("yaw", "pitch"):
        clamped = f'<joint name="{joint}" actuatorgravcomp="true" actuatorfrcrange="-9 9"'
        text = text.replace(f'<joint name="{joint}"', clamped)
    (found,) = [one.text for one in audit(load_mechanism(text).model) if one.falsifies]
    assert found.startswith("gravcomp of body hip and 4 more, clamped by the actuatorfrcrange of joint yaw and 1 more")
    free = text.replace(' actuatorgravcomp="true"', "")
    assert not [one for one in audit(load_mechanism(free).model) if one.falsifies]
