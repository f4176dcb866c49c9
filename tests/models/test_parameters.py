"""Numbers of a model as symbols: the equations at other values are those of the model with these values."""

import json

import casadi as ca
import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models.catalogue import MODELS
from linkplan.models.errors import LinkplanError, ModelError
from linkplan.models.library import built_in_text
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.parameters import parameters_of
from linkplan.models.poses.assembly import close_at
from linkplan.models.selected_model import whole_model_text
from tests.support.data import DATA

FINGER = """<mujoco><compiler angle="radian"/><worldbody><body name="palm"><site name="s0" pos="0 0.01 0"/>
  <body name="near" pos="0 0 0"><joint name="k" axis="0 1 0" damping="0.01" stiffness="0.2" frictionloss="0.01"/>
    <geom type="capsule" size="0.01" fromto="0 0 0 0.05 0 0"/><site name="s1" pos="0.03 0 0.012"/>
    <body name="far" pos="0.05 0 0"><joint name="l" axis="0 1 0" armature="1e-5"/>
      <geom type="capsule" size="0.01" fromto="0 0 0 0.04 0 0"/><site name="s2" pos="0.02 0 0.01"/></body></body></body>
  </worldbody>
  <tendon><spatial name="t" stiffness="5" damping="0.1" springlength="0.04">
  <site site="s0"/><site site="s1"/><site site="s2"/></spatial></tendon>
  <actuator><motor name="pull" tendon="t" gear="2" ctrlrange="0 20"/><motor name="m" joint="k" ctrlrange="-1 1"/></actuator>
</mujoco>"""
TREE_FUNCTIONS = ("mass_matrix", "closure", "effort_matrix", "site_places", "gravity_effort", "velocity_map")


def compared(of: Mechanism, other: Mechanism, at: dict[str, float], rng: np.random.Generator) -> None:
    """Compare a mechanism's symbolic dynamics at values with the dynamics of the model that has these values."""
    values = ca.DM([at.get(one.name, one.value) for one in of.parameters])
    symbolic = of.parametric_dynamics()
    q, v, a = other.home, *rng.normal(size=(2, of.dof))
    inputs = {"inverse_dynamics": (q, v, a), "passive": (q, rng.normal(size=of.n_q)), "bias": (q, rng.normal(size=of.n_q))}
    inputs["closure_force"] = (q, v, a, rng.normal(size=of.n_u))
    for name in (*TREE_FUNCTIONS, *inputs):
        given = inputs.get(name, (q,))
        found, expected = getattr(symbolic, name)(*given, values), getattr(other.dynamics, name)(*given)
        np.testing.assert_allclose(found.full(), expected.full(), rtol=1e-11, atol=1e-11, err_msg=name)


@pytest.mark.parametrize("source", ["optimus-knee", "five-bar", "slider-crank", FINGER], ids=lambda one: str(one)[:12])
def test_symbols_at_other_values_are_the_model_that_has_these_values(source):
    nominal, rng, checked = load_mechanism(source), np.random.default_rng(3), 0
    known = parameters_of(nominal.model)
    for name in rng.choice(list(known), size=16, replace=False):
        value = known[name].value * 1.01 + 1e-4
        try:
            other = load_mechanism(source, parameters={name: value})
            of = load_mechanism(source, parameters={name: None})
        except LinkplanError:  # a moved pin opens the loop, or no body has this inertia
            continue
        # A pin out of its plane has its anchors moved along its axis; an axis out of its plane takes a freedom away.
        if (other.shifted, other.dof) != (of.shifted, of.dof):
            continue
        compared(of, other, {name: value}, rng)
        checked += 1
    assert checked >= 8


def test_a_changed_model_is_what_mujoco_compiles_from_changed_mjcf():
    text = built_in_text("slider-crank")
    nominal = load_mechanism("slider-crank")
    name = next(name for name in parameters_of(nominal.model) if name.endswith(".mass"))
    body = name.removesuffix(".mass")
    spec = mujoco.MjSpec.from_string(text)
    changed = spec.body(body)
    own = nominal.model.body(body)
    changed.explicitinertial, changed.mass = True, 3.25
    changed.ipos, changed.iquat, changed.inertia = own.ipos, own.iquat, own.inertia
    other = spec.compile()
    model = load_mechanism("slider-crank", parameters={name: 3.25}).model
    data = [mujoco.MjData(one) for one in (model, other)]
    for one, of in zip((model, other), data, strict=True):
        of.qpos[:], of.qvel[:] = 0.3, 0.7
        mujoco.mj_forward(one, of)
    np.testing.assert_allclose(data[0].qfrc_bias, data[1].qfrc_bias, rtol=1e-12)
    np.testing.assert_allclose(data[0].qacc_smooth, data[1].qacc_smooth, rtol=1e-12)


def test_a_link_of_two_pins_has_a_length_and_what_hangs_on_it_moves_along():
    knee = load_mechanism("optimus-knee", parameters={"crank.length": 0.06})
    assert knee.gap_m(knee.home) < 1e-12
    model = knee.model
    assert np.linalg.norm(model.body("coupler").pos) == pytest.approx(0.06, abs=1e-15)
    assert load_mechanism("optimus-knee").model.body("coupler").pos[2] == pytest.approx(0.057)


def test_a_slider_crank_s_slopes_are_those_of_the_textbook():
    # x = r cos t + sqrt(l^2 - r^2 sin^2 t): dx/dr = cos t - r sin^2 t / s, dx/dl = l / s, s = sqrt(l^2 - r^2 sin^2 t)
    text = """<mujoco><option gravity="0 0 0"/><worldbody>
      <body name="crank"><joint name="t" axis="0 -1 0"/><geom size="0.01" mass="1"/>
        <body name="rod" pos="0.1 0 0"><joint name="p" axis="0 -1 0"/><geom size="0.01" mass="1"/>
        <site name="end" pos="0.3 0 0"/></body></body>
      <body name="piston" pos="0.4 0 0"><joint name="x" type="slide" axis="1 0 0"/><geom size="0.01" mass="1"/>
        <site name="pin"/></body></worldbody>
      <equality><connect site1="end" site2="pin"/></equality>
      <actuator><motor joint="t" ctrlrange="-1 1"/></actuator></mujoco>"""
    of = load_mechanism(text, parameters={"crank.length": None, "rod.length": None})
    dynamics, p = of.parametric_dynamics(), ca.SX.sym("p", 2)
    q = ca.SX.sym("q", 3)
    slope = ca.Function("slope", [q, p], [ca.jacobian(dynamics.closure(q, p), q), ca.jacobian(dynamics.closure(q, p), p)])
    r, rod = 0.1, 0.3
    for t in (0.3, 1.1, 2.5):
        s = np.sqrt(rod**2 - (r * np.sin(t)) ** 2)
        by_q, by_p = (
            one.full() for one in slope([t, -t - np.arcsin(r * np.sin(t) / rod), r * np.cos(t) + s - 0.4], [r, rod])
        )
        moved = -np.linalg.lstsq(by_q[:, 1:], by_p, rcond=None)[0][1]
        np.testing.assert_allclose(moved, [np.cos(t) - r * np.sin(t) ** 2 / s, rod / s], rtol=1e-12)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"crank.weight": 1.0}, "unknown parameter 'crank.weight'"),
        ({"crank.mass": 0.0}, "'crank.mass' must be a number of at least 1e-15 kg, got 0"),
        ({"O.pos_x": 0.0}, "'O.pos_x' is that of several elements: write 'joint O.pos_x' or 'site O.pos_x'"),
        ({"crank.length": 0.06, "coupler.pos_z": 0.06}, "'crank.length' and 'coupler.pos_z' set the same number"),
        ({"crank.inertia_x": 1.0}, "body 'crank' is no rigid body"),
        ({"crank.length": 5.0}, "does not close"),
    ],
)
def test_values_that_no_machine_has_are_refused(parameters, said):
    with pytest.raises(LinkplanError, match=said.replace("(", r"\(")):
        load_mechanism("optimus-knee", parameters=parameters)


ANCHORED = """<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint name="A" axis="0 -1 0"/>
<geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.1"/><body name="b" pos="0 0 0.1"><joint name="B" axis="0 -1 0"/>
<geom type="capsule" size="0.01" fromto="0 0 0 0.3 0 0"/></body></body>
<body name="c" pos="0.3 0 0"><joint name="C" axis="0 -1 0"/><geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.1"/></body>
</worldbody><equality><connect name="P" body1="b" body2="c" anchor="0.3 0 0"/></equality>
<actuator><motor name="m" joint="A" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_only_the_link_s_own_end_of_a_connect_between_bodies_moves():
    # MuJoCo's compiler and mj_setConst place the other end anew; its link would change its length, too.
    known = parameters_of(load_mechanism(ANCHORED).model)
    longer = load_mechanism(ANCHORED, parameters={"b.length": 0.31})
    after = parameters_of(longer.model)
    assert after["b.length"].value == pytest.approx(0.31, abs=1e-15)
    assert after["c.length"].value == known["c.length"].value
    compared(load_mechanism(ANCHORED, parameters={"b.length": None}), longer, {"b.length": 0.31}, np.random.default_rng(0))
    written = load_mechanism(whole_model_text(longer))
    of_both = [parameters_of(one.model) for one in (longer, written)]
    for name in ("a.length", "b.length", "c.length"):
        assert of_both[1][name].value == pytest.approx(of_both[0][name].value, abs=1e-15)


def test_every_built_in_model_lists_its_numbers():
    for name in MODELS:
        known = parameters_of(load_mechanism(name).model)
        assert any(one.endswith(".mass") for one in known)
        assert all(np.isfinite(one.value) for one in known.values())


def test_axes_and_unknown_names_say_what_is_legal():
    with pytest.raises(ModelError, match=r"did you mean 'crank\.mass'"):
        load_mechanism("optimus-knee", parameters={"crank.mas": 1.0})


SLIDER_CRANK = """<mujoco><option gravity="0 0 0"/><worldbody>
  <body name="crank"><inertial pos="0 0 0" mass="1" diaginertia=".5 .5 1"/><joint name="crank" axis="0 0 1"/>
    <site name="of_crank" pos=".25 0 0"/></body>
  <body name="slider" pos="1.5 0 0"><inertial pos="0 0 0" mass=".5" diaginertia="1 1 1"/>
    <joint name="slide" type="slide" axis="1 0 0"/>
    <body name="rod"><inertial pos="0 0 0" mass=".5" diaginertia="1 1 2"/><joint name="rod" axis="0 0 1"/>
      <site name="of_rod" pos="-.5 0 0"/><site name="pushed" pos="1 0 0"/></body></body></worldbody>
  <equality><connect body1="crank" body2="rod" anchor=".5 0 0"/></equality>
  <tendon><spatial name="strut" stiffness="1" damping="1" springlength="1"><site site="of_crank"/>
  <site site="of_rod"/></spatial></tendon><actuator><motor name="m" joint="crank" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_a_simulated_motion_has_the_sensitivities_to_spring_and_damper_of_a_solver_for_them():
    """The slider-crank of SUNDIALS' idasSlCrank_FSA_dns: the integral of its kinetic energy over ten seconds."""
    published = json.loads((DATA / "slider_crank_sensitivity.json").read_text(encoding="utf-8"))
    names = ("strut.stiffness", "strut.damping")
    mechanism = linkplan.load_mechanism(SLIDER_CRANK, force={"pushed": [1, 0, 0]}, independent=["crank"])
    mechanism = mechanism.with_parameters(dict.fromkeys(names))
    dynamics, start = mechanism.parametric_dynamics(), close_at(mechanism, np.array([np.pi / 2]))
    state, numbers = ca.MX.sym("state", mechanism.n_q + 1), ca.MX.sym("numbers", 2)
    q, v = state[: mechanism.n_q], state[mechanism.n_q :]
    motion = {
        "x": state,
        "p": numbers,
        "ode": ca.vertcat(*dynamics.flow(q, v, 0.0, numbers)),
        "quad": dynamics.energy(q, v, numbers)[0],
    }
    ran = ca.integrator("ran", "cvodes", motion, 0.0, published["duration_s"], {"abstol": 1e-13, "reltol": 1e-13})
    found = ran(x0=ca.vertcat(start, 0.0), p=numbers)
    outputs = ca.Function("outputs", [numbers], [found["xf"], found["qf"], ca.jacobian(found["qf"], numbers)])
    end, integral, slopes = outputs(mechanism.parameter_values)
    values = published["values"]
    assert float(integral) == pytest.approx(values["G"], abs=1e-9)
    assert slopes.full().ravel() == pytest.approx([values["dG_dk"], values["dG_dc"]], abs=1e-9)
    assert float(end[mechanism.independent[0]]) == pytest.approx(values["q_end"], abs=1e-9)
