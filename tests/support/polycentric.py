"""A polycentric knee: a shank on two links, whose angle no joint shows, and that angle in closed form."""

import numpy as np

# Pins in the plane (x, z) [m] with every hinge at 0: front and rear on the thigh, front and rear on the shank.
FRONT, REAR = np.array([0.03, 0.0]), np.array([-0.02, 0.01])
FRONT_END, REAR_END = np.array([0.035, -0.06]), np.array([0.005, -0.055])

KNEE = """<mujoco model="polycentric-knee">
  <compiler angle="degree" autolimits="true"/>
  <default><geom contype="0" conaffinity="0" type="capsule" size="0.008"/></default>
  <worldbody>
    <body name="front" pos="0.03 0 0">
      <joint name="A" axis="0 1 0"/><geom fromto="0 0 0 0.005 0 -0.06"/>
      <body name="shank" pos="0.005 0 -0.06">
        <joint name="B" axis="0 1 0"/><geom fromto="0 0 0 -0.03 0 0.005"/><geom fromto="-0.015 0 0 -0.015 0 -0.35"/>
      </body>
    </body>
    <body name="rear" pos="-0.02 0 0.01"><joint name="C" axis="0 1 0"/><geom fromto="0 0 0 0.025 0 -0.065"/></body>
  </worldbody>
  <equality><connect body1="shank" body2="rear" anchor="-0.03 0 0.005"/></equality>
  <actuator><motor name="act" joint="C" ctrlrange="-40 40"/></actuator>
</mujoco>"""


def shank_deg(rear_deg: np.ndarray) -> np.ndarray:
    """Return the shank's angle (n,) [deg] at angles of the rear link (n,) [deg], by the intersection of two circles.

    With points as z + i x, a turn about +y by theta is a factor exp(i theta).
    """
    front, rear, front_end, rear_end = (x[1] + 1j * x[0] for x in (FRONT, REAR, FRONT_END, REAR_END))
    pin = rear + (rear_end - rear) * np.exp(1j * np.radians(rear_deg))
    link, plate, apart = abs(front_end - front), abs(rear_end - front_end), np.abs(pin - front)
    along = (link**2 - plate**2 + apart**2) / (2 * apart)
    across = np.sqrt(link**2 - along**2)
    home = (front_end - front) / (rear_end - front)  # tells the branch: which side of the line between the pins
    end = front + (pin - front) / apart * (along + 1j * np.sign(home.imag) * across)
    return np.degrees(np.angle((pin - end) / (rear_end - front_end)))
