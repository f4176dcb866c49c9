"""Forces in the pins of the tree: they do not depend on the pin at which a loop is cut, and agree with closed forms."""

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import accelerations, joint_rates, sampled
from linkplan.studies.output.pin_forces import pin_forces
from tests.support.linkages import loaded

CRANK = '<geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01" density="3000"/>'
MODEL = """<mujoco><worldbody>
  <body name="crank"><joint name="O" axis="0 1 0"/>{crank}{on_crank}</body>
  <body name="rocker" pos="0.3 0 0"><joint name="C" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.25" size="0.02"/>{on_rocker}</body></worldbody>
  <equality><connect name="{cut}" body1="{parent}" body2="coupler" anchor="{anchor}"/></equality>
  <actuator><motor name="m" joint="O" ctrlrange="-9 9"/></actuator></mujoco>"""
COUPLER = """<body name="coupler" pos="{pos}"><joint name="{pin}" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 {end}" size="0.015" density="2000"/></body>"""


def cut_at(pin: str) -> Mechanism:
    """Return a four-bar O-A-B-C whose loop is cut at pin A or B."""
    if pin == "B":
        on_crank, on_rocker = COUPLER.format(pos="0 0 0.1", pin="A", end="0.3 0 0.15"), ""
    else:
        on_crank, on_rocker = "", COUPLER.format(pos="0 0 0.25", pin="B", end="-0.3 0 -0.15")
    parent, anchor = ("rocker", "0 0 0.25") if pin == "B" else ("crank", "0 0 0.1")
    return load_mechanism(
        MODEL.format(crank=CRANK, on_crank=on_crank, on_rocker=on_rocker, cut=pin, parent=parent, anchor=anchor)
    )


def all_forces(mechanism: Mechanism, angles_deg: list[float]) -> dict[str, np.ndarray]:
    """Return the forces in the cut pin and in the pins of the tree, while the crank accelerates through angles."""
    equations = mechanism.equations
    q = np.array([equations.closed_pose(at_deg={"O": angle}) for angle in angles_deg])
    v, a = np.full((len(q), 1), 7.0), np.full((len(q), 1), -30.0)
    u = equations.inverse_dynamics(q, v, a)
    cut = np.linalg.norm(sampled(mechanism.dynamics.closure_force, q, v, a, u)[:, :, 0], axis=1)
    return {mechanism.closure_names[0]: cut, **pin_forces(mechanism, q, v, a, u)}


def test_forces_do_not_depend_on_the_pin_at_which_the_loop_is_cut():
    angles = [0.0, 20.0, 50.0, -30.0]
    at_b, at_a = (all_forces(cut_at(pin), angles) for pin in "BA")
    assert sorted(at_b) == sorted(at_a) == ["A", "B", "C", "O"]
    for pin, force in at_b.items():
        assert force == pytest.approx(at_a[pin], rel=1e-9), pin
        assert force.min() > 0.1  # [N]


def test_a_weld_of_two_bodies_that_stand_still_has_no_force():
    """MuJoCo allocates six rows of its Jacobian for it, and makes none: reading them all was a fault."""
    held = '<body name="at" mocap="true"/><body name="base"><geom size=".1"/></body></worldbody>'
    text = MODEL.format(crank=CRANK, on_crank="", on_rocker="", cut="A", parent="", anchor="").split("<equality>")[0]
    text = text.replace('<joint name="C"', '<joint name="C" frictionloss=".1"').replace("</worldbody>", held)
    arm = load_mechanism(f'{text}<equality><weld body1="at" body2="base"/></equality></mujoco>')
    q, still = np.array([arm.home]), np.zeros((1, arm.dof))
    assert set(pin_forces(arm, q, still, still, np.zeros((1, arm.n_u)))) == {"O", "C"}


def test_a_pendulum_on_a_ball_and_a_cart_on_a_slide_have_the_closed_forms_forces():
    mass, length, gravity, speed = 2.0, 0.5, 9.81, 3.0
    arm = load_mechanism(f"""<mujoco><worldbody><body name="cart"><joint name="rail" type="slide" axis="1 0 0"/>
      <geom size="0.1" mass="4"/><body name="arm"><joint name="pin" axis="0 1 0"/>
      <geom type="sphere" size="0.01" mass="{mass}" pos="0 0 {-length}"/></body></body></worldbody>
      <actuator><motor name="x" joint="rail" ctrlrange="-9 9"/><motor name="y" joint="pin" ctrlrange="-9 9"/></actuator>
      </mujoco>""")
    angle, still = np.array([0.4]), np.zeros((1, 2))
    q, v = np.array([[0.0, *angle]]), np.array([[0.0, speed]])
    u = arm.equations.inverse_dynamics(q, v, still)
    found = pin_forces(arm, q, v, still, u)
    inward = mass * length * speed**2 * np.array([np.sin(angle), np.cos(angle)])[:, 0]
    assert found["pin"] == pytest.approx(np.hypot(inward[0], inward[1] + mass * gravity), rel=1e-9)
    assert found["rail"] == pytest.approx(inward[1] + (4 + mass) * gravity, rel=1e-9)  # across the rail only


def test_a_tendon_that_passes_a_pin_loads_it():
    """A cable of gear 2 from the ground to a hanging link pulls the link up; the pin carries the rest of the weight."""
    model = load_mechanism("""<mujoco><worldbody><site name="up" pos="0 0 1"/><body name="link">
      <joint name="pin" axis="0 1 0"/><geom type="sphere" size="0.01" mass="1" pos="0 0 -0.5"/>
      <site name="end" pos="0 0 -0.5"/></body></worldbody><tendon><spatial name="cable"><site site="up"/>
      <site site="end"/></spatial></tendon>
      <actuator><motor name="winch" tendon="cable" gear="2" ctrlrange="-9 9"/></actuator></mujoco>""")
    zero = np.zeros((1, 1))
    for effort in (0.0, -3.0):
        found = pin_forces(model, zero, zero, zero, np.array([[effort]]))
        assert found["pin"] == pytest.approx([9.81 + 2 * effort], abs=1e-9)


def test_a_rod_on_a_ball_joint_balances_its_two_ends():
    """The force in the ball joint is what the rod's mass needs less the force of its closure at the other end."""
    linkage = loaded("rssr")
    q, v, a = np.array([linkage.home]), np.array([[3.0, 0.5]]), np.array([[2.0, -1.0]])
    u = linkage.equations.inverse_dynamics(q, v, a)[:, :1]
    closure = sampled(linkage.dynamics.closure_force, q, v, a, u)[0, :, 0]
    rates, second = joint_rates(linkage, q, v), accelerations(linkage, q, v, a)
    data, rod = mujoco.MjData(linkage.model), linkage.model.body("rod").id

    def centre(time: float) -> np.ndarray:
        data.qpos[:] = linkage.qpos_of(q + rates * time + second * time**2 / 2)[0]
        mujoco.mj_kinematics(linkage.model, data)
        return data.xipos[rod].copy()

    h = 1e-4  # [s]
    accelerated = (centre(h) - 2 * centre(0.0) + centre(-h)) / h**2
    needed = linkage.model.body_mass[rod] * (accelerated - linkage.model.opt.gravity)
    assert pin_forces(linkage, q, v, a, u)["rod"] == pytest.approx(np.linalg.norm(needed - closure), rel=1e-6)


SIX = """<mujoco><worldbody><body name="base"><joint name="x" type="slide" axis="1 0 0"/>
  <joint name="y" type="slide" axis="0 1 0"/><joint name="z" type="slide"/>
  <joint name="rx" axis="1 0 0"/><joint name="ry" axis="0 1 0"/><joint name="rz"/>
  <geom size="0.1" mass="4"/>{arm}</body></worldbody><actuator>{motors}</actuator></mujoco>"""
ARM = '<body name="arm"><joint name="pin" axis="0 1 0"/><geom size="0.01" mass="2" pos="0 0 -0.5"/></body>'


@pytest.mark.parametrize(("arm", "pins"), [("", []), (ARM, ["pin"])])
def test_a_base_on_six_joints_stands_on_no_pin(arm, pins):
    joints = ["x", "y", "z", "rx", "ry", "rz", *pins]
    base = load_mechanism(SIX.format(arm=arm, motors="".join(f'<motor joint="{j}" ctrlrange="-99 99"/>' for j in joints)))
    still = np.zeros((1, len(joints)))
    u = base.equations.inverse_dynamics(base.home[None], still, still)
    forces = pin_forces(base, base.home[None], still, still, u)
    assert {name: float(force[0]) for name, force in forces.items()} == {pin: pytest.approx(2 * 9.81) for pin in pins}
