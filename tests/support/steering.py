"""A steering linkage with a tyre's force: its model, the tyre's place by the rod's length, and the rack's force by hand."""

import numpy as np
import scipy

# A rack along y, a tie rod and a knuckle at K: the rod's ends are P = (-0.15, 0.3 + s) and A = K + R(theta) ARM.
K, ARM, TYRE, P = np.array([0.0, 0.65]), np.array([-0.12, -0.03]), np.array([-0.03, 0.06]), np.array([-0.15, 0.3])
STEERING = """<mujoco><option timestep="2e-4"/><default><geom contype="0" conaffinity="0"/></default><worldbody>
  <body name="rack" pos="-0.15 0 0"><joint name="rack" type="slide" axis="0 1 0" range="-0.05 0.05" {clamp}/>
    <geom type="capsule" fromto="0 -0.3 0 0 0.3 0" size="0.012" mass="2"/>
    <body name="rod" pos="0 0.3 0"><joint name="rod" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0 0.03 0.32 0" size="0.008" mass="0.5"/></body></body>
  <body name="knuckle" pos="0 0.65 0"><joint name="knuckle" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 -0.12 -0.03 0" size="0.01" mass="9"/><site name="tyre" pos="-0.03 0.06 -0.3"/></body>
  </worldbody><equality><connect body1="rod" body2="knuckle" anchor="0.03 0.32 0"/></equality>
  <actuator><motor name="rack" joint="rack" ctrlrange="-4000 4000"/></actuator></mujoco>"""
FORCE = (-150.0, -2500.0, 40.0)


def tyre_of(s: float) -> np.ndarray:
    """Return the tyre's place (2,) [m] at a rack position [m], by the rod's length."""

    def turned(theta: float, point: np.ndarray) -> np.ndarray:
        c, s = np.cos(theta), np.sin(theta)
        return K + np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])

    length = np.linalg.norm(turned(0.0, ARM) - P)
    end = P + np.array([0.0, s])
    theta = scipy.optimize.brentq(lambda x: np.linalg.norm(turned(x, ARM) - end) - length, -0.9, 0.9, xtol=1e-15)
    return turned(theta, TYRE)


def rack_force(s: float, force=FORCE) -> float:
    """Return the rack's force [N] by virtual work, f ds + F . dp = 0."""
    h = 1e-5
    four = (tyre_of(s - 2 * h) - 8 * tyre_of(s - h) + 8 * tyre_of(s + h) - tyre_of(s + 2 * h)) / (12 * h)
    return float(-np.array(force[:2]) @ four)
