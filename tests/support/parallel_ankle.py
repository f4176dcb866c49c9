"""A parallel ankle: two motors on the shin, each with crank and rod to the foot, which pitches about y, then rolls about x.

Closed form (the ankle of Lutz et al., arXiv 2503.22459): the foot's rod end is at D = R_y(pitch) R_x(roll) f - m from the
motor, the crank's tip at c(a) = r (-cos a, 0, sin a), and |D - c|^2 = l^2 is solved for the motor's angle a. The rate
follows from (D - c) . (dD - dc) = 0.
"""

import re

import numpy as np

import linkplan

CRANK_M = 0.05
# Each side: motor's place and foot's rod end [m] in the frames of shin and foot, both with the ankle as origin.
MOTORS = np.array([[0.01, 0.04, 0.22], [0.0, -0.04, 0.15]])
FEET = np.array([[-0.045, 0.035, 0.015], [-0.05, -0.035, 0.01]])
TIPS = MOTORS + np.array([-CRANK_M, 0.0, 0.0])
RODS = np.linalg.norm(TIPS - FEET, axis=1)
ARMATURE, DAMPING, FRICTION = 0.012, 0.03, 0.2
NAMES = ("left", "right")
HINGES = r'<joint name="rod_pitch_(\w+)" axis="0 1 0"/>\s*<joint name="rod_roll_\w+" axis="1 0 0"/>'


def _side(name: str, motor: np.ndarray, tip: np.ndarray, foot: np.ndarray) -> str:
    rod = foot - tip
    place, end, middle = (" ".join(repr(float(x)) for x in v) for v in (motor, rod, rod / 2))
    return f"""
      <body name="crank_{name}" pos="{place}">
        <joint name="motor_{name}" axis="0 1 0" range="-1.4 1.4" armature="{ARMATURE}" damping="{DAMPING}"
          frictionloss="{FRICTION}"/>
        <inertial mass="0.05" pos="-0.025 0 0" diaginertia="2e-5 2e-5 2e-5"/>
        <body name="rod_{name}" pos="{-CRANK_M} 0 0">
          <joint name="rod_pitch_{name}" axis="0 1 0"/>
          <joint name="rod_roll_{name}" axis="1 0 0"/>
          <inertial mass="0.08" pos="{middle}" diaginertia="2e-4 2e-4 1e-5"/>
          <geom type="capsule" fromto="0 0 0 {end}" size="0.004" mass="0"/>
          <site name="rod_end_{name}" pos="{end}"/>
        </body>
      </body>"""


def ankle_text() -> str:
    """Return the ankle's MJCF: outputs `ankle_pitch` and `ankle_roll`, motors `left` and `right`."""
    sides = "".join(_side(*side) for side in zip(NAMES, MOTORS, TIPS, FEET, strict=True))
    ends = "\n".join(
        f'          <site name="foot_{name}" pos="{" ".join(repr(float(x)) for x in foot)}"/>'
        for name, foot in zip(NAMES, FEET, strict=True)
    )
    soft = 'solref="0.0002 1" solimp="0.999 0.999 0.001"'
    pins = "\n".join(f'    <connect name="pin_{name}" site1="rod_end_{name}" site2="foot_{name}" {soft}/>' for name in NAMES)
    motors = "\n".join(f'    <motor name="{name}" joint="motor_{name}" ctrlrange="-40 40"/>' for name in NAMES)
    return f"""<mujoco model="parallel-ankle">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.0001" solver="Newton" iterations="200" tolerance="1e-12"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="shin" pos="0 0 0.5">
      <geom type="capsule" fromto="0 0 0.02 0 0 0.3" size="0.02" mass="1"/>{sides}
      <body name="cross">
        <joint name="ankle_pitch" axis="0 1 0" range="-0.7 0.5"/>
        <inertial mass="0.05" pos="0 0 0" diaginertia="1e-5 1e-5 1e-5"/>
        <body name="foot">
          <joint name="ankle_roll" axis="1 0 0" range="-0.35 0.35"/>
          <inertial mass="0.7" pos="0.04 0 -0.04" diaginertia="6e-4 3e-3 3e-3"/>
          <geom type="box" pos="0.04 0 -0.05" size="0.11 0.04 0.01" mass="0"/>
{ends}
        </body>
      </body>
    </body>
  </worldbody>
  <equality>
{pins}
  </equality>
  <actuator>
{motors}
  </actuator>
</mujoco>
"""


def soft_ankle(mass: float) -> str:
    """Return the ankle with its left rod of some mass [kg], on the model's default softness."""
    soft = ankle_text().replace(' solref="0.0002 1" solimp="0.999 0.999 0.001"', "").replace('timestep="0.0001"', "")
    light = f'<inertial mass="{mass}" pos="\\1" diaginertia="{mass:g} {mass:g} {mass:g}"/>'
    return re.sub(r'<inertial mass="0.08" pos="([^"]*)"[^>]*/>', light, soft)


def motor_angle(side: int, pitch: float, roll: float) -> float:
    """Return the motor's angle [rad] by the closed form, on the branch of the drawn pose."""
    D = _offset(side, pitch, roll)
    k = 0.5 * (RODS[side] ** 2 - CRANK_M**2 - D @ D)
    reach, phase = CRANK_M * np.hypot(D[0], D[2]), np.arctan2(D[2], D[0])
    found = [sign * np.arccos(k / reach) - phase for sign in (1, -1)]
    found = [(angle + np.pi) % (2 * np.pi) - np.pi for angle in found]
    return min(found, key=abs)


def ratio(pitch: float, roll: float) -> np.ndarray:
    """Return G (2, 2), the motors' rates over the rates of pitch and roll, by the closed form."""
    rows = []
    for side in range(2):
        a = motor_angle(side, pitch, roll)
        crank = CRANK_M * np.array([-np.cos(a), 0.0, np.sin(a)])
        slope = CRANK_M * np.array([np.sin(a), 0.0, np.cos(a)])
        rod = _offset(side, pitch, roll) - crank
        foot = _turned(pitch, roll) @ FEET[side]
        axes = np.array([0.0, 1.0, 0.0]), np.array([np.cos(pitch), 0.0, -np.sin(pitch)])  # of pitch and roll, in the shin
        rows.append([rod @ np.cross(axis, foot) / (rod @ slope) for axis in axes])
    return np.array(rows)


def _turned(pitch: float, roll: float) -> np.ndarray:
    (c, s), (d, t) = (np.cos(pitch), np.sin(pitch)), (np.cos(roll), np.sin(roll))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[1, 0, 0], [0, d, -t], [0, t, d]])


def _offset(side: int, pitch: float, roll: float) -> np.ndarray:
    return _turned(pitch, roll) @ FEET[side] - MOTORS[side]


def ankle(*, balls: bool) -> linkplan.Mechanism:
    """Return an ankle without dry friction, with two motors and two rods, on universal or on ball joints."""
    text = re.sub(r'\s*frictionloss="[\d.]+"', "", ankle_text())
    return linkplan.load_mechanism(re.sub(HINGES, r'<joint name="\1" type="ball" damping="5e-4"/>', text) if balls else text)
