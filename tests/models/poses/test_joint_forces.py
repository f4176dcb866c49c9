"""Forces and moments in all joints and on the frame: wherever a loop is cut, by virtual cuts and by closed forms."""

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import accelerations, joint_rates, sampled
from linkplan.models.poses.joint_forces import joint_forces
from linkplan.models.reduction.reduced import acceleration_at
from linkplan.models.tree.coordinates import HINGE, SLIDE
from tests.support.linkages import loaded
from tests.support.virtual_cuts import virtual_cuts

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
    return dict(joint_forces(mechanism, q, v, a, u).force)


def test_forces_do_not_depend_on_the_pin_at_which_the_loop_is_cut():
    angles = [0.0, 20.0, 50.0, -30.0]
    at_b, at_a = (all_forces(cut_at(pin), angles) for pin in "BA")
    assert sorted(at_b) == sorted(at_a) == ["A", "B", "C", "O"]
    for pin, force in at_b.items():
        assert force == pytest.approx(at_a[pin], rel=1e-9), pin
        assert force.min() > 0.1  # [N]


def test_a_weld_of_two_bodies_that_stand_still_loads_no_pin():
    held = '<body name="at" mocap="true"/><body name="base"><geom size=".1"/></body></worldbody>'
    text = MODEL.format(crank=CRANK, on_crank="", on_rocker="", cut="A", parent="", anchor="").split("<equality>")[0]
    text = text.replace('<joint name="C"', '<joint name="C" frictionloss=".1"').replace("</worldbody>", held)
    arm = load_mechanism(f'{text}<equality><weld body1="at" body2="base"/></equality></mujoco>')
    q, still = np.array([arm.home]), np.zeros((1, arm.dof))
    assert set(joint_forces(arm, q, still, still, np.zeros((1, arm.n_u))).force) == {"at-base", "O", "C"}


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
    found = joint_forces(arm, q, v, still, u).force
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
        found = joint_forces(model, zero, zero, zero, np.array([[effort]]))
        assert found.force["pin"] == pytest.approx([9.81 + 2 * effort], abs=1e-9)


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
    assert joint_forces(linkage, q, v, a, u).force["rod"] == pytest.approx(np.linalg.norm(needed - closure), rel=1e-6)


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
    forces = joint_forces(base, base.home[None], still, still, u).force
    assert {name: float(force[0]) for name, force in forces.items()} == {pin: pytest.approx(2 * 9.81) for pin in pins}


# Hinges, slides and a ball with anchors of their own; springs, dampers, armature; a rope around a cylinder, a gas spring, a
# weight held up; actuators of all transmissions, which act between bodies, on one body, or from outside.
CHAIN = """<mujoco><worldbody><site name="w" pos="0.2 0.1 1"/>
  <geom name="g" type="cylinder" size="0.03 0.5" pos="0.1 0 0.5" euler="90 0 0" contype="0" conaffinity="0"/>
  <body name="a" pos="0 0 1" euler="10 20 30"><joint name="A" axis="0 1 0.2" pos="0.02 0.03 0.01" damping="0.3"/>
    <inertial pos=".1 .05 .2" mass="2" diaginertia=".1 .2 .15"/><site name="sa" pos=".1 .1 .1" euler="5 6 7"/>
  <body name="b" pos=".3 .1 .1"><joint name="B" axis="1 0 0" stiffness="4" armature="0.1"/>
    <joint name="B2" axis="0 1 0" pos="0 0 0.05"/><inertial pos=".1 .05 -.2" mass="1.5" diaginertia=".1 .2 .15"/>
    <site name="sb" pos=".2 .1 .1" euler="25 6 7"/>
  <body name="c" pos=".3 0 .1"><joint name="C" axis="1 0.3 0" type="slide" damping="2"/><joint name="C2" axis="0 0 1"/>
    <inertial pos=".1 .05 -.2" mass="1.1" diaginertia=".1 .2 .15"/><site name="sc" pos=".2 .1 .1"/>
  <body name="d" pos=".1 0 0" gravcomp="0.5"><joint name="D" type="ball"/>
    <inertial pos=".1 .05 -.2" mass="0.7" diaginertia=".1 .2 .15"/><site name="sd" pos=".1 0 0"/></body></body></body></body>
  </worldbody><tendon>
  <spatial name="rope" stiffness="30" damping="3" springlength="0.1"><site site="w"/><geom geom="g"/>
    <site site="sb"/></spatial>
  <spatial name="strut" damping="3" armature="0.4"><site site="sa"/><site site="sc"/></spatial>
  <fixed name="belt"><joint joint="A" coef="2"/><joint joint="B2" coef="1"/></fixed></tendon>
  <actuator><motor tendon="strut" gear="2"/><motor tendon="rope"/><motor tendon="belt"/>
  <motor site="sc" gear="1 2 3 0.1 0.2 0.3"/><motor site="sc" refsite="sa" gear="1 2 3 0 0 0"/>
  <motor joint="D" gear="1 2 3"/>
  <motor site="sc" refsite="w" gear="3 2 1 0 0 0"/><motor jointinparent="D" gear="1 2 3"/><motor joint="A"/>
  <motor cranksite="sd" slidersite="sb" cranklength="0.9"/>
  <general tendon="strut" gainprm="0" biastype="affine" biasprm="3 -2 -1"/>
  <general site="sc" refsite="w" gear="1 2 3 0 0 0" gainprm="0" biastype="affine" biasprm="3 0 0"/></actuator></mujoco>"""
# Planar loops with an actuator on a weld, and a spring's tendon; a leg, hinge and slide of one body, a weld in space.
BUILT_IN, IN_SPACE = ("optimus-knee-linear", "andrews-squeezer"), ("leg", "rscr", "welded")


@pytest.mark.parametrize("name", [*BUILT_IN, *IN_SPACE, CHAIN], ids=lambda name: "chain" if name == CHAIN else name)
def test_forces_and_moments_are_those_of_virtual_cuts_in_mujoco(name):
    mechanism = loaded(name) if name in IN_SPACE else load_mechanism(name)
    rng, q = np.random.default_rng(3), np.tile(mechanism.home, (3, 1))
    q += 0.2 * rng.normal(size=q.shape) * (len(mechanism.dependent) == 0)
    v, u = rng.normal(size=(3, mechanism.dof)), rng.normal(size=(3, mechanism.n_u))
    a = np.array([acceleration_at(mechanism.dynamics, *one) for one in zip(q, v, u, strict=True)])
    found = joint_forces(mechanism, q, v, a, u)
    for kind, loads in ((SLIDE, found.force), (HINGE, found.moment)):
        for pin, size in virtual_cuts(mechanism, q, v, a, u, kind=kind).items():
            own = loads.get(f"joint {pin}" if pin in mechanism.closure_names else pin, np.zeros(3))
            assert own == pytest.approx(size, rel=1e-8, abs=1e-8), pin


def links_of_a_four_bar(angle: float, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends (3 links, 2 ends, 2) [m] and accelerations (3 links, 3) [m/s2, rad/s2] of links with uniform mass.

    Crank 0.1 m from the origin, coupler 0.3 m, rocker 0.25 m from (0.3, 0) m, by differences of closed poses (z up).
    """

    def pose(time: float) -> np.ndarray:
        turned = angle + speed * time
        A, C = 0.1 * np.array([np.cos(turned), np.sin(turned)]), np.array([0.3, 0.0])
        way = C - A
        far = np.linalg.norm(way)
        along = (0.3**2 - 0.25**2 + far**2) / (2 * far)
        B = A + along * way / far + np.sqrt(0.3**2 - along**2) * np.array([-way[1], way[0]]) / far
        return np.array([[np.zeros(2), A], [A, B], [C, B]])

    h = 1e-3 / speed
    weights, places = (-1 / 12, 4 / 3, -5 / 2, 4 / 3, -1 / 12), [pose(k * h) for k in (-2, -1, 0, 1, 2)]
    centres = sum(w * p.mean(axis=1) for w, p in zip(weights, places, strict=True)) / h**2
    turns = np.unwrap([np.arctan2(*(p[:, 1] - p[:, 0]).T[::-1]) for p in places], axis=0)
    return places[2], np.column_stack([centres, np.tensordot(weights, turns, 1) / h**2])


def test_a_four_bar_s_bearings_at_constant_crank_speed_are_the_textbook_s():
    """Nine equations of the three links in the forces of O, A, B, C and the crank's torque (Norton, Design of Machinery)."""
    link = """<site name="{name}" pos="{length} 0 0"/>
      <inertial pos="{centre} 0 0" mass="{mass}" diaginertia="{turn} {turn} {turn}"/><joint name="{pin}" axis="0 -1 0"/>"""
    links = [
        link.format(name=f"end of {pin}", pin=pin, length=long, centre=long / 2, mass=mass, turn=mass * long**2 / 12)
        for pin, long, mass in (("O", 0.1, 0.5), ("A", 0.3, 1.2), ("C", 0.25, 0.9))
    ]
    bar = load_mechanism(f"""<mujoco><worldbody><body>{links[0]}<body pos="0.1 0 0">{links[1]}</body></body>
      <body pos="0.3 0 0" euler="0 -60 0">{links[2]}</body></worldbody>
      <equality><connect name="B" site1="end of A" site2="end of C"/></equality>
      <actuator><motor name="m" joint="O" ctrlrange="-99 99"/></actuator></mujoco>""")
    speed, still, masses, lengths = 30.0, np.zeros((1, 1)), (0.5, 1.2, 0.9), (0.1, 0.3, 0.25)
    for angle in (0.3, 1.7, 4.0):
        ends, acceleration = links_of_a_four_bar(angle, speed)
        q = bar.equations.closed_pose(at_deg={"O": np.degrees(angle)})[None]
        u = bar.equations.inverse_dynamics(q, np.full((1, 1), speed), still)
        found = joint_forces(bar, q, np.full((1, 1), speed), still, u)
        # Unknowns: forces O on crank, A on coupler, B on rocker, C on rocker, torque on the crank.
        rows, right = np.zeros((9, 9)), np.zeros(9)
        acting = (((0, 1, 0), (2, -1, 1)), ((2, 1, 0), (4, -1, 1)), ((6, 1, 0), (4, 1, 1)))
        for k, (m, own) in enumerate(zip(masses, acting, strict=True)):
            for first, sign, end in own:
                arm = ends[k, end] - ends[k].mean(axis=0)
                rows[3 * k : 3 * k + 2, first : first + 2] += sign * np.eye(2)
                rows[3 * k + 2, first : first + 2] += sign * np.array([-arm[1], arm[0]])
            right[3 * k : 3 * k + 3] = (
                *(m * (acceleration[k, :2] + [0, 9.81])),
                m * lengths[k] ** 2 / 12 * acceleration[k, 2],
            )
        rows[2, 8] = 1.0
        loads = np.linalg.solve(rows, right)
        sizes = {name: np.hypot(*loads[2 * k : 2 * k + 2]) for k, name in enumerate("OABC")}
        assert {name: float(force[0]) for name, force in found.force.items()} == pytest.approx(sizes, rel=1e-6)
        assert not found.moment
        assert u[0, 0] == pytest.approx(loads[8], rel=1e-6)
        shaking = -(loads[0:2] + loads[6:8])
        assert found.on_frame[0, [0, 2]] == pytest.approx(shaking, rel=1e-6)
        # About the origin: C's force and the motor's torque; a turn from x to z is one about -y.
        assert found.on_frame[0, 4] == pytest.approx(0.3 * loads[7] + loads[8], rel=1e-6)


def test_a_slider_crank_shakes_its_frame_by_its_masses_accelerations():
    """F = -sum m (a - g); the rod's centre and the slider by the closed form of the linkage, at constant crank speed."""
    mechanism, speed = load_mechanism("slider-crank"), 40.0

    def momentum_place(turned: float) -> np.ndarray:
        """Return sum m p (2,) [kg m] of crank, rod and slider."""
        A, sine = 0.05 * np.array([np.cos(turned), np.sin(turned)]), -np.sin(turned) / 3
        along = np.array([np.sqrt(1 - sine**2), sine])
        return 0.3 * 0.4 * A + 0.2 * (A + 0.06 * along) + 0.6 * (A + 0.15 * along)

    for angle in (0.4, 2.0, 5.0):
        q, v = mechanism.equations.closed_pose(at_deg={"O": np.degrees(angle)})[None], np.full((1, 1), speed)
        u = mechanism.equations.inverse_dynamics(q, v, 0 * v)
        step = 1e-3
        bent = momentum_place(angle + step) - 2 * momentum_place(angle) + momentum_place(angle - step)
        expected = -(speed**2) * bent / step**2 - [0.0, 1.1 * 9.81]
        found = joint_forces(mechanism, q, v, 0 * v, u).on_frame[0]
        assert found[[0, 2]] == pytest.approx(expected, rel=1e-6)
        assert found[[1, 3, 5]] == pytest.approx(np.zeros(3), abs=1e-9)
