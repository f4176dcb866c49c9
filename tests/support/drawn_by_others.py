"""Models as somebody would write them who begins: Hoeken's linkage, a ring of bars, an arm; as MJCF."""

import numpy as np

# Hoeken's linkage with a = 40 mm: crank a, ground 2a, coupler and rocker 2.5a, as somebody would write it.
HOEKEN = """<mujoco model="hoeken">
  <worldbody>
    <body name="crank">
      <joint name="O2" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.004"/>
      <body name="coupler" pos="0.04 0 0">
        <joint name="A" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 0.08 0 0.18330303" size="0.004"/>
        <site name="B_coupler" pos="0.04 0 0.091651514"/><site name="foot" pos="0.08 0 0.18330303"/>
      </body>
    </body>
    <body name="rocker" pos="0.08 0 0">
      <joint name="O4" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.004"/>
      <site name="B_rocker" pos="0 0 0.1"/>
    </body>
  </worldbody>
  <contact><exclude body1="crank" body2="rocker"/><exclude body1="coupler" body2="rocker"/></contact>
  <equality><connect name="B" site1="B_coupler" site2="B_rocker"/></equality>
  {actuator}
</mujoco>"""
MOTOR = '<actuator><motor name="crank" joint="O2" ctrlrange="-1 1"/></actuator>'


def ring(n: int, motors: int) -> str:
    """Return a regular loop of n bars and the ground, the first joints driven, as MJCF."""
    corner = 0.15 * np.exp(2j * np.pi * np.arange(n + 1) / (n + 1))
    text, before = "", 0.0
    for k in range(n):
        at, bar = corner[k] - before, corner[k + 1] - corner[k]
        text += f'<body name="l{k}" pos="{at.real} 0 {at.imag}"><joint name="j{k}" axis="0 1 0" damping="0.01"/>'
        text += f'<geom size="0.006" type="capsule" fromto="0 0 0 {bar.real} 0 {bar.imag}" contype="0" conaffinity="0"/>'
        before = corner[k]
    last = corner[n] - corner[n - 1]
    drives = "".join(f'<motor name="m{k}" joint="j{k}" ctrlrange="-10 10"/>' for k in range(motors))
    return (
        f'<mujoco model="ring"><worldbody>{text}{"</body>" * n}</worldbody><equality>'
        f'<connect name="pin" body1="l{n - 1}" body2="world" anchor="{last.real} 0 {last.imag}"/></equality>'
        f"<actuator>{drives}</actuator></mujoco>"
    )


def arm(links: int, motors: int, *, down: bool = False) -> str:
    """Return an open arm of equal links, drawn level or hanging, its first joints driven, as MJCF."""
    end = "0 0 -0.1" if down else "0.1 0 0"
    text = ""
    for k in range(links):
        text += f'<body name="l{k}" pos="{end if k else "0 0 0"}"><joint name="j{k}" axis="0 1 0" damping="0.01"/>'
        text += f'<geom type="capsule" size="0.008" fromto="0 0 0 {end}" mass="0.1" contype="0" conaffinity="0"/>'
    drives = "".join(f'<motor name="m{k}" joint="j{k}" ctrlrange="-10 10"/>' for k in range(motors))
    return f'<mujoco model="arm"><worldbody>{text}{"</body>" * links}</worldbody><actuator>{drives}</actuator></mujoco>'
