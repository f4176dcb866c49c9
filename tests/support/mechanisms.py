"""Small mechanisms for the tests: generators and inline MJCF, with closed forms where there are some.

Planar linkages lie in their root frame's x-z plane and turn about its +y, angles counted from +z towards +x, as in the
knee. The root frame itself may stand anywhere in space.
"""

import copy
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np


def numbers(values: object) -> str:
    """Return numbers as MJCF writes them, none of their digits lost."""
    return " ".join(repr(float(value)) for value in np.ravel(values))


def replaced(text: str, old: str, new: str) -> str:
    """Return `text` with `old` replaced; a test that replaces nothing would test nothing."""
    assert old in text, f"{old!r} is not in the text"
    return text.replace(old, new)


def wrapped(angle: object) -> np.ndarray:
    """Return angles [rad] folded into (-pi, pi]."""
    return np.angle(np.exp(1j * np.asarray(angle, dtype=float)))


def stated_gap_mm(refusal: Exception) -> float:
    """Return the gap that a refusal's message gives."""
    (gap,) = re.findall(r"open by (\S+) mm", str(refusal))
    return float(gap)


def random_quaternion(rng: np.random.Generator) -> np.ndarray:
    """Return a unit quaternion, uniform over rotations."""
    quaternion = rng.normal(size=4)
    return quaternion / np.linalg.norm(quaternion)


def inertial(rng: np.random.Generator, size: float) -> str:
    """Return an <inertial>: six point masses about a random centre of mass, so that some rigid body has it."""
    masses, points = rng.uniform(0.1, 1.0, 6), rng.uniform(-size, size, (6, 3))
    com = masses @ points / masses.sum()
    arms = points - com
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, arms, strict=True))
    entries = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    return f'<inertial mass="{numbers(masses.sum())}" pos="{numbers(com)}" fullinertia="{numbers(entries)}"/>'


def passive_elements(rng: np.random.Generator, size: float) -> str:
    """Return joint attributes: spring and damper, each a polynomial, and an armature, in proportion to gravity's torque."""
    return (
        f'stiffness="{numbers(size * rng.uniform([1, -1, 0], [5, 1, 2]))}" springref="{numbers(rng.uniform(-1, 1))}"'
        f' damping="{numbers(size * rng.uniform(0.02, 0.2, 3))}" armature="{numbers(size**2 * rng.uniform(0.05, 0.5))}"'
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FourBar:
    """A planar four-bar O-A-B-C, ground OC along +x of its root frame, with its closed form.

    `branch` is +1 where B lies to the left of the way from A to C seen with +z up and +x to the right, -1 to the right.
    The model is drawn at `q_O` = `drawn`.
    """

    crank: float
    coupler: float
    rocker: float
    ground: float
    branch: int
    drawn: float

    def diagonal(self, q_O: np.ndarray) -> np.ndarray:
        """Return the length |AC| [m]."""
        return np.hypot(self.crank * np.sin(q_O) - self.ground, self.crank * np.cos(q_O))

    def transmission(self, q_O: np.ndarray) -> np.ndarray:
        """Return the sine of the angle at B between coupler and rocker, 0 at a singular pose; NaN where open."""
        square = self.coupler**2 + self.rocker**2 - self.diagonal(q_O) ** 2
        cosine = square / (2 * self.coupler * self.rocker)
        return np.sqrt(np.where(np.abs(cosine) <= 1, 1 - cosine**2, np.nan))

    def pose(self, q_O: np.ndarray) -> np.ndarray:
        """Return the angles (n, 3) of O, A and C [rad]: B is where the circles about A and C meet."""
        q_O = np.atleast_1d(np.asarray(q_O, dtype=float))
        A = np.stack([self.crank * np.sin(q_O), self.crank * np.cos(q_O)], axis=1)
        to_C = np.array([self.ground, 0.0]) - A
        d = np.linalg.norm(to_C, axis=1, keepdims=True)
        along = (d**2 + self.coupler**2 - self.rocker**2) / (2 * d)
        across = self.branch * np.sqrt(self.coupler**2 - along**2)
        left = np.stack([-to_C[:, 1], to_C[:, 0]], axis=1)
        B = A + (along * to_C + across * left) / d
        coupler, rocker = B - A, B - np.array([self.ground, 0.0])
        q_A = np.arctan2(coupler[:, 0], coupler[:, 1]) - q_O
        return np.stack([q_O, wrapped(q_A), np.arctan2(rocker[:, 0], rocker[:, 1])], axis=1)

    def singular(self) -> np.ndarray:
        """Return the angles q_O in [-pi, pi] at which coupler and rocker lie on one line (law of cosines), sorted."""
        found = []
        for diagonal in (self.coupler + self.rocker, self.coupler - self.rocker):
            sine = (self.crank**2 + self.ground**2 - diagonal**2) / (2 * self.crank * self.ground)
            if abs(sine) <= 1:
                found += [np.arcsin(sine), np.pi - np.arcsin(sine)]
        return np.sort(wrapped(found))

    def mirrored(self) -> "FourBar":
        """Return the four-bar assembled the other way round."""
        return replace(self, branch=-self.branch)

    def samples(self, rng: np.random.Generator, n: int, least: float = 0.3) -> np.ndarray:
        """Return poses (n, 3) on the branch at random q_O, the transmission's sine at least `least`."""
        q_O = rng.uniform(-np.pi, np.pi, 2000 * n)
        q_O = q_O[np.nan_to_num(self.transmission(q_O)) >= least][:n]
        assert len(q_O) == n
        return self.pose(q_O)

    def mjcf(
        self,
        rng: np.random.Generator,
        *,
        quaternion: np.ndarray | None = None,
        anchor_form: bool = False,
        motors: tuple[str, ...] = ("O",),
        bare: bool = False,
    ) -> str:
        """Return the model: random masses, inertias, springs, dampers (none if `bare`), gravity and gears."""
        drawn = self.pose(self.drawn)[0]
        length = self.ground
        extras = ["" if bare else passive_elements(rng, length) for _ in range(3)]
        joint = [
            f'<joint name="{name}" axis="0 1 0" ref="{numbers(angle)}" {extra}/>'
            for name, angle, extra in zip("OAC", drawn, extras, strict=True)
        ]
        turn = [f'quat="{numbers([np.cos(t / 2), 0, np.sin(t / 2), 0])}"' for t in drawn]
        connect = (
            f'<connect name="B" body1="coupler" body2="rocker" anchor="0 0 {numbers(self.coupler)}"/>'
            if anchor_form
            else '<connect name="B" site1="B_coupler" site2="B_rocker"/>'
        )
        motor = [f'<motor joint="{name}" gear="{numbers(rng.uniform(-3, 3))}"/>' for name in motors]
        root = np.array([1.0, 0, 0, 0]) if quaternion is None else quaternion
        return f"""
<mujoco model="four-bar"><compiler angle="radian"/>
  <option gravity="{numbers(rng.uniform(-10, 10, 3))}"/>
  <worldbody><body name="ground" pos="{numbers(rng.uniform(-1, 1, 3))}" quat="{numbers(root)}">
    <body name="crank" {turn[0]}>{joint[0]}{inertial(rng, length)}
      <body name="coupler" pos="0 0 {numbers(self.crank)}" {turn[1]}>{joint[1]}{inertial(rng, length)}
        <site name="B_coupler" pos="0 0 {numbers(self.coupler)}"/></body></body>
    <body name="rocker" pos="{numbers(self.ground)} 0 0" {turn[2]}>{joint[2]}{inertial(rng, length)}
      <site name="B_rocker" pos="0 0 {numbers(self.rocker)}"/></body>
  </body></worldbody>
  <equality>{connect}</equality>
  <actuator>{"".join(motor)}</actuator>
</mujoco>"""


def random_four_bar(rng: np.random.Generator, least_transmission: float = 0.35) -> FourBar:
    """Return a four-bar of random lengths, drawn at a random angle at which it assembles well."""
    while True:
        lengths = (rng.uniform(0.3, 1.0, 4) * rng.choice([0.05, 0.3, 1.0])).tolist()
        bar = FourBar(
            crank=lengths[0],
            coupler=lengths[1],
            rocker=lengths[2],
            ground=lengths[3],
            branch=int(rng.choice([-1, 1])),
            drawn=float(rng.uniform(-2.5, 2.5)),
        )
        if np.nan_to_num(bar.transmission(bar.drawn)) >= least_transmission:
            return bar


def off_axis(bar: FourBar, offset_m: float, quaternion: np.ndarray | None = None) -> str:
    """Return the four-bar with the rocker's pin moved along the joints' axes, so that it cannot meet the coupler's."""
    site = f'<site name="B_rocker" pos="0 0 {bar.rocker!r}"/>'
    return replaced(bar.mjcf(np.random.default_rng(0), quaternion=quaternion), site, site.replace('"0 0', f'"0 {offset_m}'))


def doubled_pin(bar: FourBar, quaternion: np.ndarray) -> str:
    """Return the four-bar with its pin held at two points of its axis, as exporters write a fork."""
    text = bar.mjcf(np.random.default_rng(0), quaternion=quaternion)
    for body, at in (("coupler", bar.coupler), ("rocker", bar.rocker)):
        site = f'<site name="B_{body}" pos="0 0 {at!r}"/>'
        text = replaced(text, site, site + f'<site name="B2_{body}" pos="0 0.03 {at!r}"/>')
    return replaced(text, "</equality>", '<connect site1="B2_coupler" site2="B2_rocker"/></equality>')


# A Grashof crank-rocker: shortest + longest = 0.21 < 0.28, the shortest link is the crank.
CRANK_ROCKER = FourBar(crank=0.05, coupler=0.15, rocker=0.13, ground=0.16, branch=1, drawn=0.2)
# No link turns fully: shortest + longest = 0.19 > 0.15; both ends of the crank's reach are singular poses.
TRIPLE_ROCKER = FourBar(crank=0.08, coupler=0.07, rocker=0.05, ground=0.14, branch=1, drawn=0.9)


def random_tree(seed: int, n_bodies: int = 5) -> str:
    """Return a spatial tree: up to three joints a body, hinges and slides, all that a joint and a motor can carry."""
    rng = np.random.default_rng(seed)
    children: dict[int, list[int]] = {k: [] for k in range(n_bodies + 1)}
    for body in range(1, n_bodies + 1):
        children[int(rng.integers(max(0, body - 2), body))].append(body)
    motors: list[str] = []

    def joint(name: str, kind: str) -> str:
        if rng.random() < 0.6:
            motors.append(
                f'<motor joint="{name}" gear="{numbers(rng.uniform(-3, 3))}" armature="{numbers(rng.uniform(0, 0.3))}"'
                f' damping="{numbers(rng.uniform(0, 0.3, 3))}"/>'
            )
        return (
            f'<joint name="{name}" type="{kind}" axis="{numbers(rng.normal(size=3))}"'
            f' pos="{numbers(rng.uniform(-0.2, 0.2, 3))}" ref="{numbers(rng.uniform(-0.5, 0.5))}"'
            f" {passive_elements(rng, 1.0)}/>"
        )

    def body(k: int) -> str:
        kinds = ["hinge", "slide", "hinge"][: int(rng.integers(1, 4))] if k > 1 else ["slide", "hinge", "hinge"]
        joints = "".join(joint(f"j{k}{'abc'[i]}", kind) for i, kind in enumerate(kinds))
        return (
            f'<body pos="{numbers(rng.uniform(-0.4, 0.4, 3))}" euler="{numbers(rng.uniform(-2, 2, 3))}">'
            f"{joints}{inertial(rng, 0.3)}{''.join(body(child) for child in children[k])}</body>"
        )

    bodies = "".join(body(child) for child in children[0])
    return f"""
<mujoco model="tree"><compiler angle="radian" eulerseq="zyx"/>
  <option gravity="{numbers(rng.uniform(-10, 10, 3))}"/>
  <worldbody>{bodies}</worldbody><actuator>{"".join(motors)}</actuator>
</mujoco>"""


PENDULUM = """
<mujoco model="pendulum"><compiler angle="radian" autolimits="true"/>
  <worldbody><body name="rod"><joint name="hip" axis="0 1 0" range="-1 2"/>
    <inertial mass="2" pos="0 0 -0.3" diaginertia="0.01 0.02 0.01"/></body></worldbody>
  <actuator><motor name="hip" joint="hip" ctrlrange="-3 5"/></actuator>
</mujoco>"""


def slider_crank(size: float = 1.0) -> str:
    """Return a crank of 0.1 m and a rod of 0.3 m, times `size`, and a slide along +x whose position is its distance."""
    r, x, away = numbers(0.1 * size), numbers(0.3 * size), numbers(0.4 * size)
    return f"""
<mujoco model="slider-crank"><compiler angle="radian" autolimits="true"/>
  <default><geom contype="0" conaffinity="0" size="{numbers(0.01 * size)}"/></default>
  <worldbody>
    <body name="crank"><joint name="crank" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 {r} 0 0"/>
      <body name="rod" pos="{r} 0 0"><joint name="pin" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 {x} 0 0"/><site name="end" pos="{x} 0 0"/></body></body>
    <body name="slider" pos="{away} 0 0"><joint name="slide" type="slide" axis="1 0 0" ref="{away}"/>
      <geom type="sphere" size="{numbers(0.02 * size)}"/><site name="wrist"/></body>
  </worldbody>
  <equality><connect site1="end" site2="wrist"/></equality>
  <actuator><motor joint="crank" ctrlrange="-2 2"/></actuator>
  <keyframe><key name="home" qpos="0.7 -0.916 {numbers(0.3685 * size)}"/></keyframe>
</mujoco>"""


SLIDER_CRANK = slider_crank()

# Two motors at the base, two degrees of freedom, symmetric (after Bordalba, Ros and Porta, T-RO 2022).
FIVE_BAR = """
<mujoco model="five-bar"><compiler angle="radian"/>
  <default><joint axis="0 1 0" damping="0.0176"/><geom contype="0" conaffinity="0" size="0.01" density="3000"/></default>
  <worldbody>
    <body name="left" pos="-0.06 0 0"><joint name="left" ref="-0.6"/><geom type="capsule" fromto="0 0 0 -0.113 0 0.165"/>
      <body name="left_distal" pos="-0.113 0 0.165"><joint name="left_elbow"/>
        <geom type="capsule" fromto="0 0 0 0.173 0 0.1"/><site name="tip_left" pos="0.173 0 0.1"/></body></body>
    <body name="right" pos="0.06 0 0"><joint name="right" ref="0.6"/><geom type="capsule" fromto="0 0 0 0.113 0 0.165"/>
      <body name="right_distal" pos="0.113 0 0.165"><joint name="right_elbow"/>
        <geom type="capsule" fromto="0 0 0 -0.173 0 0.1"/><site name="tip_right" pos="-0.173 0 0.1"/></body></body>
  </worldbody>
  <equality><connect name="tip" site1="tip_left" site2="tip_right"/></equality>
  <actuator><motor joint="left" ctrlrange="-1.4 1.4"/><motor joint="right" ctrlrange="-1.4 1.4"/></actuator>
</mujoco>"""

# A spatial loop: crank about +y, coupler hung on it by a universal joint, a ball (the connect) at the rocker, which turns
# about an oblique axis. Four joints, rank 3, one degree of freedom.
SPATIAL_LOOP = """
<mujoco model="spatial-loop"><compiler angle="radian"/>
  <default><geom contype="0" conaffinity="0" size="0.01"/><joint damping="0.01" armature="0.001"/></default>
  <worldbody>
    <body name="crank"><joint name="crank" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.02 0.01 0.1"/>
      <body name="coupler" pos="0.02 0.01 0.1"><joint name="yaw" axis="0 0 1"/><joint name="pitch" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.25 0.08 0.06"/><site name="ball" pos="0.25 0.08 0.06"/></body></body>
    <body name="rocker" pos="0.3 0.05 0"><joint name="rocker" axis="0.3 0.9 0.2"/>
      <geom type="capsule" fromto="0 0 0 -0.03 0.04 0.16"/><site name="socket" pos="-0.03 0.04 0.16"/></body>
  </worldbody>
  <equality><connect name="ball" site1="ball" site2="socket"/></equality>
  <actuator><motor joint="crank"/></actuator>
</mujoco>"""

# Two loops in one plane (a Watt chain): a four-bar O-A-B-C whose rocker drives a second one, C-D-E-F. Rank 4 of 6 rows.
SIX_BAR = """
<mujoco model="six-bar"><compiler angle="radian"/>
  <default><geom contype="0" conaffinity="0" size="0.01"/><joint axis="0 1 0" damping="0.01"/></default>
  <worldbody>
    <body name="crank"><joint name="O"/><geom type="capsule" fromto="0 0 0 0.02 0 0.08"/>
      <body name="coupler" pos="0.02 0 0.08"><joint name="A"/><geom type="capsule" fromto="0 0 0 0.19 0 0.09"/>
        <site name="B1" pos="0.19 0 0.09"/></body></body>
    <body name="rocker" pos="0.2 0 0"><joint name="C"/><geom type="capsule" fromto="0 0 0 0.01 0 0.17"/>
      <site name="B2" pos="0.01 0 0.17"/>
      <body name="link" pos="0.05 0 0.12"><joint name="D"/><geom type="capsule" fromto="0 0 0 0.16 0 0.05"/>
        <site name="E1" pos="0.16 0 0.05"/></body></body>
    <body name="output" pos="0.4 0 0"><joint name="F"/><geom type="capsule" fromto="0 0 0 0.01 0 0.17"/>
      <site name="E2" pos="0.01 0 0.17"/></body>
  </worldbody>
  <equality><connect name="B" site1="B1" site2="B2"/><connect name="E" site1="E1" site2="E2"/></equality>
  <actuator><motor joint="O"/></actuator>
</mujoco>"""

# The loops that have no closed form here, by name.
CHAINS = {"slider-crank": SLIDER_CRANK, "five-bar": FIVE_BAR, "spatial-loop": SPATIAL_LOOP, "six-bar": SIX_BAR}

# A parallelogram drawn flat, where its Jacobian loses rank: 1 degree of freedom, though J has rank 1 there.
FLAT_PARALLELOGRAM = """
<mujoco model="parallelogram"><compiler angle="radian"/><default><joint axis="0 1 0"/></default>
  <worldbody>
    <body name="crank"><joint name="O"/><geom size="0.01" pos="0.05 0 0"/>
      <body name="coupler" pos="0.1 0 0"><joint name="A"/><geom size="0.01" pos="0.1 0 0"/>
        <site name="B1" pos="0.2 0 0"/></body></body>
    <body name="rocker" pos="0.2 0 0"><joint name="C"/><geom size="0.01" pos="0.05 0 0"/>
      <site name="B2" pos="0.1 0 0"/></body>
  </worldbody>
  <equality><connect site1="B1" site2="B2"/></equality><actuator><motor joint="O"/></actuator>
</mujoco>"""

# Two bars pinned to each other and to the ground: a triangle, which cannot move.
TRUSS = """
<mujoco model="truss"><compiler angle="radian"/><default><joint axis="0 1 0"/></default>
  <worldbody>
    <body name="left"><joint name="O"/><geom size="0.01" pos="0.1 0 0"/><site name="top_left" pos="0.1 0 0.1"/></body>
    <body name="right" pos="0.2 0 0"><joint name="C"/><geom size="0.01" pos="-0.1 0 0"/>
      <site name="top_right" pos="-0.1 0 0.1"/></body>
  </worldbody>
  <equality><connect site1="top_left" site2="top_right"/></equality>
</mujoco>"""


def derivative(function: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    """Return the derivative at 0 by five-point central differences, of fourth order in h."""
    return (8 * (function(h) - function(-h)) - (function(2 * h) - function(-2 * h))) / (12 * h)


def second_derivative(function: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    """Return the second derivative at 0 by five-point central differences, of fourth order in h."""
    near, far = function(h) + function(-h), function(2 * h) + function(-2 * h)
    return (16 * near - far - 30 * function(0.0)) / (12 * h**2)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Simulated:
    """MuJoCo's own quantities at one state: the second route of most tests."""

    mass_matrix: np.ndarray
    bias: np.ndarray
    passive: np.ndarray
    acceleration: np.ndarray
    constraint_force: np.ndarray  # J^T f (n_q,)
    rows: np.ndarray  # constraint Jacobian (n_rows, n_q)
    residual: np.ndarray  # how far the rows are from holding (n_rows,)
    row_force: np.ndarray  # f (n_rows,)
    moment: np.ndarray  # actuator_moment (n_u, n_q)
    energy: np.ndarray  # potential, kinetic


def simulated(
    model: mujoco.MjModel, q: np.ndarray, v: np.ndarray, ctrl=None, *, impedance: float = 0.9999, softness: float = 1.0
) -> Simulated:
    """Return what MuJoCo computes at (q, q') with loops of an impedance (below 1), and inverse weights times `softness`."""
    model = copy.copy(model)
    for weights in (model.body_invweight0, model.dof_invweight0):
        weights[:] *= softness
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    model.opt.tolerance = 0
    model.eq_solimp[:, 0:2] = impedance
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    if ctrl is not None:
        data.ctrl[:] = ctrl
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    moment = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    return Simulated(
        mass_matrix=mass,
        bias=data.qfrc_bias.copy(),
        passive=data.qfrc_passive.copy(),
        acceleration=data.qacc.copy(),
        constraint_force=data.qfrc_constraint.copy(),
        rows=np.array(data.efc_J).reshape(-1, model.nv).copy() if data.nefc else np.zeros((0, model.nv)),
        residual=data.efc_pos.copy(),
        row_force=data.efc_force.copy(),
        moment=moment,
        energy=data.energy.copy(),
    )
