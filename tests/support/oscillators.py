"""Single-freedom models with closed-form responses: a mass on a spring and damper, and a pendulum, as MJCF."""

from dataclasses import dataclass

import numpy as np

GRAVITY = 9.81


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Oscillator:
    """m s'' + d s' + k s = u about an operating point: a slide, or a pendulum's small swings about an angle."""

    mass: float
    damping: float
    stiffness: float
    mjcf: str
    position: float

    def plant(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Return the continuous response 1 / (k - m w^2 + j w d)."""
        w = 2 * np.pi * frequency_hz
        return 1.0 / (self.stiffness - self.mass * w**2 + 1j * w * self.damping)

    def stepped(self, frequency_hz: np.ndarray, step_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the position and velocity responses of semi-implicit Euler with implicit damping, one step a period."""
        z, h = np.exp(2j * np.pi * frequency_hz * step_s), step_s
        F = h / (self.mass + h * self.damping)
        per_position = (z - 1) / (h * z)  # V = (z - 1) / (h z) S
        position = F / ((z - 1) * per_position + F * (self.stiffness + self.damping * per_position))
        return position, per_position * position


def mass_on_a_spring(
    integrator: str = "Euler",
    gear: float = 2.0,
    timestep: float = 1e-3,
    mass: float = 1.3,
    damping: float = 2.5,
    stiffness: float = 90.0,
) -> Oscillator:
    """Return 1.3 kg on 90 N/m with 2.5 N.s/m if not otherwise, driven through a gear."""
    m, d, k = mass, damping, stiffness
    mjcf = f"""<mujoco><option gravity="0 0 0" timestep="{timestep}" integrator="{integrator}"/><worldbody><body>
      <joint name="s" type="slide" axis="1 0 0" stiffness="{k}" damping="{d}"/><geom size="0.1" mass="{m}"/>
      </body></worldbody>
      <actuator><motor name="push" joint="s" gear="{gear}" ctrlrange="-200 200"/></actuator></mujoco>"""
    return Oscillator(mass=m, damping=d, stiffness=k, mjcf=mjcf, position=0.05)


def pendulum(integrator: str = "Euler", angle: float = 0.4, timestep: float = 1e-3) -> Oscillator:
    """Return a point mass of 1.3 kg on 0.3 m, with a rotor of 0.02 kg m2 and 0.3 N.m.s/rad, held at an angle."""
    m, length, rotor, d = 1.3, 0.3, 0.02, 0.3
    mjcf = f"""<mujoco><option gravity="0 0 -{GRAVITY}" timestep="{timestep}" integrator="{integrator}"/><worldbody><body>
      <joint name="h" type="hinge" axis="0 1 0" damping="{d}" armature="{rotor}"/>
      <inertial mass="{m}" pos="0 0 -{length}" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody>
      <actuator><motor name="turn" joint="h" ctrlrange="-60 60"/></actuator></mujoco>"""
    inertia = rotor + m * length**2 + 1e-9
    return Oscillator(mass=inertia, damping=d, stiffness=m * GRAVITY * length * np.cos(angle), mjcf=mjcf, position=angle)


def inertia_alone(inertia: float = 0.05, limit: float = 3.0) -> str:
    """Return a rotor without weight, spring or damper."""
    return f"""<mujoco><option gravity="0 0 0" timestep="1e-3"/><worldbody><body><joint name="h" axis="0 1 0"/>
      <inertial mass="1" pos="0 0 0" diaginertia="{inertia} {inertia} {inertia}"/></body></worldbody>
      <actuator><motor name="turn" joint="h" ctrlrange="-{limit} {limit}"/></actuator></mujoco>"""
