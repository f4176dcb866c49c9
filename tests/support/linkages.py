"""Mechanisms closed otherwise than by one connect: welds, couplings, ball joints, loops that ride on a body."""

from functools import cache

from linkplan.models.mechanism import Mechanism, load_mechanism
from tests.support.mechanisms import replaced

_HEAD = """<mujoco model="{name}"><compiler angle="radian" autolimits="true"/>
  <default><joint axis="0 1 0" damping="0.01"/><geom contype="0" conaffinity="0" size="0.01"/></default>"""

# A four-bar O-A-(weld)-B-C whose coupler is cut in two and welded together again: 4 joints, 6 rows, rank 3.
WELDED = f"""
{_HEAD.format(name="welded")}
  <worldbody>
    <body name="crank"><joint name="O"/><geom type="capsule" fromto="0 0 0 0.02 0 0.08"/>
      <body name="coupler" pos="0.02 0 0.08"><joint name="A"/><geom type="capsule" fromto="0 0 0 0.09 0 0.04"/>
        <site name="cut" pos="0.09 0 0.04"/></body></body>
    <body name="rocker" pos="0.2 0 0"><joint name="C"/><geom type="capsule" fromto="0 0 0 0.01 0 0.17"/>
      <body name="half" pos="0.01 0 0.17"><joint name="B"/><geom type="capsule" fromto="0 0 0 -0.1 0 -0.05"/></body></body>
  </worldbody>
  <equality><weld name="glue" body1="coupler" body2="half"/></equality>
  <actuator><motor joint="O" ctrlrange="-2 2"/></actuator>
</mujoco>"""

# The same four-bar with the coupler in one piece, pinned to the rocker.
UNCUT = replaced(
    replaced(
        WELDED,
        '<body name="half" pos="0.01 0 0.17"><joint name="B"/><geom type="capsule" fromto="0 0 0 -0.1 0 -0.05"/></body>',
        '<site name="B2" pos="0.01 0 0.17"/>',
    ).replace(
        '<site name="cut" pos="0.09 0 0.04"/>',
        '<body pos="0.19 0 0.09"><geom type="capsule" fromto="0 0 0 -0.1 0 -0.05"/><site name="B1"/></body>',
    ),
    '<weld name="glue" body1="coupler" body2="half"/>',
    '<connect site1="B1" site2="B2"/>',
)

# Crank, a rod on a ball joint at the crank's tip, a ball (the connect) at the rocker: the rod may spin about its line.
RSSR = f"""
{_HEAD.format(name="rssr")}
  <worldbody>
    <body name="crank"><joint name="crank"/><geom type="capsule" fromto="0 0 0 0.02 0.01 0.1"/>
      <body name="rod" pos="0.02 0.01 0.1"><joint name="rod" type="ball" damping="0.001"/>
        <geom type="capsule" fromto="0 0 0 0.25 0.08 0.06"/><site name="ball" pos="0.25 0.08 0.06"/></body></body>
    <body name="rocker" pos="0.3 0.05 0"><joint name="rocker" axis="0.3 0.9 0.2"/>
      <geom type="capsule" fromto="0 0 0 -0.03 0.04 0.16"/><site name="socket" pos="-0.03 0.04 0.16"/></body>
  </worldbody>
  <equality><connect name="ball" site1="ball" site2="socket"/></equality>
  <actuator><motor joint="crank" ctrlrange="-2 2"/></actuator>
</mujoco>"""

# The same with a slide in place of the crank: the rod does not go round with it, and its spin ends with the ball's chart.
PSSR = replaced(RSSR, '<joint name="crank"/>', '<joint name="crank" type="slide"/>')

# Crank, ball-jointed rod, and a cylinder on the far side: it turns about and slides along its axis.
RSCR = replaced(
    RSSR,
    '<joint name="rocker" axis="0.3 0.9 0.2"/>',
    '<joint name="rocker" axis="0.3 0.9 0.2"/><joint name="shift" type="slide" axis="0.3 0.9 0.2"/>',
)

# A parallel gripper: two four-bars with light links (1e-4 kg), their cranks coupled by a joint equality, pulled by a tendon.
GRIPPER = f"""
{_HEAD.format(name="gripper")}
  <worldbody><body name="palm" pos="0 0 0.3"><joint name="lift" type="slide" axis="0 0 1" damping="1"/>
    <geom size="0.02" mass="0.5"/>
    <body name="crank_r" pos="0.02 0 0"><joint name="crank_r" stiffness="0.05" springref="0.4"/>
      <geom type="capsule" fromto="0 0 0 0.03 0 0.04" mass="1e-4"/>
      <body name="finger_r" pos="0.03 0 0.04"><joint name="finger_r" damping="1e-5"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.05" mass="0.01"/><site name="pin_r" pos="0.015 0 -0.002"/></body></body>
    <body name="guide_r" pos="0.035 0 -0.002"><joint name="guide_r" damping="1e-5"/>
      <geom type="capsule" fromto="0 0 0 0.03 0 0.04" mass="1e-4"/><site name="eye_r" pos="0.03 0 0.04"/></body>
    <body name="crank_l" pos="-0.02 0 0"><joint name="crank_l" stiffness="0.05" springref="-0.4"/>
      <geom type="capsule" fromto="0 0 0 -0.03 0 0.04" mass="1e-4"/>
      <body name="finger_l" pos="-0.03 0 0.04"><joint name="finger_l" damping="1e-5"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.05" mass="0.01"/><site name="pin_l" pos="-0.015 0 -0.002"/></body></body>
    <body name="guide_l" pos="-0.035 0 -0.002"><joint name="guide_l" damping="1e-5"/>
      <geom type="capsule" fromto="0 0 0 -0.03 0 0.04" mass="1e-4"/><site name="eye_l" pos="-0.03 0 0.04"/></body>
  </body></worldbody>
  <tendon><fixed name="split"><joint joint="crank_r" coef="0.5"/><joint joint="crank_l" coef="-0.5"/></fixed></tendon>
  <equality>
    <connect name="right" site1="pin_r" site2="eye_r"/><connect name="left" site1="pin_l" site2="eye_l"/>
    <joint name="mirror" joint1="crank_r" joint2="crank_l" polycoef="0 -1 0 0 0"/>
  </equality>
  <actuator>
    <motor name="lift" joint="lift" ctrlrange="-20 20"/>
    <position name="grip" tendon="split" kp="5" kv="0.05" forcerange="-1 1" ctrlrange="-0.6 0.6"/>
  </actuator>
</mujoco>"""

# A slide and two loops on it: a press, whose slide is driven and moves two rockers that meet at a floating link.
PRESS = f"""
{_HEAD.format(name="press")}
  <worldbody>
    <body name="ram"><joint name="ram" type="slide" axis="0 0 1"/><geom size="0.03" mass="1"/>
      <body name="left" pos="-0.05 0 0"><joint name="left"/><geom type="capsule" fromto="0 0 0 -0.1 0 0.15"/>
        <site name="left_tip" pos="-0.1 0 0.15"/></body>
      <body name="right" pos="0.05 0 0"><joint name="right"/><geom type="capsule" fromto="0 0 0 0.12 0 0.14"/>
        <site name="right_tip" pos="0.12 0 0.14"/></body></body>
    <body name="rocker_left" pos="-0.3 0 0.05"><joint name="rocker_left"/>
      <geom type="capsule" fromto="0 0 0 0.15 0 0.1"/><site name="left_eye" pos="0.15 0 0.1"/></body>
    <body name="rocker_right" pos="0.3 0 0.02"><joint name="rocker_right"/>
      <geom type="capsule" fromto="0 0 0 -0.13 0 0.12"/><site name="right_eye" pos="-0.13 0 0.12"/></body>
  </worldbody>
  <equality><connect name="left" site1="left_tip" site2="left_eye"/>
    <connect name="right" site1="right_tip" site2="right_eye"/></equality>
  <actuator><motor joint="ram" ctrlrange="-50 50"/></actuator>
</mujoco>"""

# A leg: a hip that turns about the vertical, and a four-bar knee on it. At a quarter turn the loop lies across the world.
LEG = f"""
{_HEAD.format(name="leg")}
  <worldbody><body name="hip" pos="0 0 1"><joint name="yaw" axis="0 0 1"/><geom size="0.05" pos="0.05 0 0"/>
    <body name="thigh"><joint name="pitch"/><geom type="capsule" fromto="0 0 0 0 0 -0.4"/>
      <body name="crank" pos="0 0 -0.35"><joint name="knee"/><geom type="capsule" fromto="0 0 0 0.05 0 -0.03"/>
        <body name="rod" pos="0.05 0 -0.03"><joint name="rod"/><geom type="capsule" fromto="0 0 0 0.02 0 -0.12"/>
          <site name="end" pos="0.02 0 -0.12"/></body></body>
      <body name="shank" pos="0 0 -0.45"><joint name="shank"/><geom type="capsule" fromto="0 0 0 0.07 0 -0.05"/>
        <site name="lug" pos="0.07 0 -0.05"/></body></body>
  </body></worldbody>
  <equality><connect name="loop" site1="end" site2="lug"/></equality>
  <actuator><motor joint="yaw"/><motor joint="pitch"/><motor joint="knee"/></actuator>
</mujoco>"""

LINKAGES = {"welded": WELDED, "rssr": RSSR, "rscr": RSCR, "gripper": GRIPPER, "press": PRESS, "leg": LEG}
# Degrees of freedom, closure rows and rank of each.
COUNTS = {
    "welded": (1, 6, 3),
    "rssr": (2, 3, 3),
    "rscr": (3, 3, 3),
    "gripper": (2, 7, 5),
    "press": (1, 6, 4),
    "leg": (3, 3, 2),
}


@cache
def loaded(name: str) -> Mechanism:
    """Return one of the linkages, loaded once."""
    return load_mechanism(LINKAGES[name])


# A motor's arm carries a rod between two ball joints; the rocker at its other end is a second arm.
ROD = """<mujoco><compiler angle="degree"/><worldbody>
<body name="arm"><joint name="drive" axis="0 1 0"/><geom type="capsule" size=".01" fromto="0 0 0 .1 0 0"/>
<body name="rod" pos=".1 0 0"><joint name="ball" type="ball" damping=".01" armature="1e-4" frictionloss=".002"/>
<geom type="capsule" size=".005" fromto="0 0 0 0 .05 .2"/><site name="end" pos="0 .05 .2"/></body></body>
<body name="rocker" pos="0 .05 .2"><joint name="swing" axis="0 1 0"/><geom type="capsule" size=".01" fromto="0 0 0 .1 0 0"/>
<site name="pin" pos=".1 0 0"/></body></worldbody>
<equality><connect name="close" site1="end" site2="pin"/></equality>
<actuator><motor name="motor" joint="drive" ctrlrange="-5 5"/></actuator></mujoco>"""
