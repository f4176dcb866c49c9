"""Linkages with spins in them: spatial four-bars whose crank turns fully, and a bush on a loop's own pin."""

from tests.support.mechanisms import replaced

_HEAD = """<mujoco model="{name}"><compiler angle="radian" autolimits="true"/><option timestep="0.0005"/>
  <default><joint axis="0 1 0" damping="0.002"/><geom contype="0" conaffinity="0" size="0.008"/></default>
  <worldbody>"""
_ROCKER = """<body name="rocker" pos="0.25 0.05 -0.02"><joint name="C" axis="0.3 0.9 0.2"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.12"/><site name="socket" pos="0 0 0.12"/></body>"""
_TAIL = """</equality><actuator><motor name="act_O" joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""
_ROD = '<geom type="capsule" fromto="0 0 0 0.2 0.05 0.1"/><site name="ball" pos="0.2 0.05 0.1"/>'
_CRANK = '<joint name="O"/><geom type="capsule" fromto="0 0 0 0.05 0 0"/>'

# The crank of 50 mm turns fully: the rod, on a ball joint at its tip, goes round with it and may spin about its line.
ON_A_BALL = f"""{_HEAD.format(name="rod on a ball")}
    <body name="crank">{_CRANK}
      <body name="rod" pos="0.05 0 0"><joint name="rod" type="ball" damping="1e-4"/>{_ROD}</body></body>
    {_ROCKER}</worldbody>
  <equality><connect name="ball" site1="ball" site2="socket"/>{_TAIL}"""
# The same with a rod of 2 mm in a ball that drags: its spin rests within a microsecond.
DRAGGING = replaced(ON_A_BALL, 'damping="1e-4"/>' + _ROD, 'damping="1e-3"/>' + _ROD.replace("<geom ", '<geom size="0.001" '))
# The same, both balls made by connects: the rod floats.
FLOATING = f"""{_HEAD.format(name="floating rod")}
    <body name="crank">{_CRANK}<site name="tip" pos="0.05 0 0"/></body>
    <body name="rod" pos="0.05 0 0"><freejoint name="rod"/>{_ROD}<site name="eye"/></body>
    {_ROCKER}</worldbody>
  <equality><connect name="ball" site1="ball" site2="socket"/><connect name="tip" site1="eye" site2="tip"/>{_TAIL}"""
# The same, both balls joints of the tree, and the rocker's hinge made by two connects.
TWO_BALLS = f"""{_HEAD.format(name="two balls")}
    <body name="crank">{_CRANK}
      <body name="rod" pos="0.05 0 0"><joint name="rod" type="ball" damping="1e-4"/>{_ROD}
        <body name="rocker" pos="0.2 0.05 0.1"><joint name="ball" type="ball" damping="1e-4"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.12"/><site name="p1" pos="0 0 -0.12"/>
          <site name="p2" pos="0.03 0.09 -0.1"/></body></body></body>
    <site name="g1" pos="0.25 0.05 -0.02"/><site name="g2" pos="0.28 0.14 0"/></worldbody>
  <equality><connect name="one" site1="p1" site2="g1"/><connect name="two" site1="p2" site2="g2"/>{_TAIL}"""
# The same, the ball a universal joint, on which the rod hangs by a hinge along its line.
ON_ITS_LINE = replaced(
    ON_A_BALL,
    '<body name="rod" pos="0.05 0 0"><joint name="rod" type="ball" damping="1e-4"/>' + _ROD + "</body>",
    """<body name="fork" pos="0.05 0 0"><joint name="fork_y" damping="1e-4"/>
      <joint name="fork_z" axis="0 0 1" damping="1e-4"/><geom size="0.002"/>
      <body name="rod"><joint name="roll" axis="0.2 0.05 0.1" damping="1e-4"/>"""
    + _ROD
    + "</body></body>",
)
ROUND = {"ball": ON_A_BALL, "floating": FLOATING, "two balls": TWO_BALLS, "on its line": ON_ITS_LINE}
SPINS = {"ball": "rod_rx", "floating": "rod_rx", "two balls": "rod_rx", "on its line": "roll"}

# A four-bar whose coupler carries a bush on the pin of the loop: it turns as it likes, but for its bearing's drag.
BUSH = f"""{_HEAD.format(name="bush")}
    <body name="crank"><joint name="O"/><geom type="capsule" fromto="0 0 0 0.02 0 0.08"/>
      <body name="coupler" pos="0.02 0 0.08"><joint name="A"/><geom type="capsule" fromto="0 0 0 0.19 0 0.09"/>
        <body name="bush" pos="0.19 0 0.09"><joint name="bush" damping="1e-5"/>
          <geom type="cylinder" size="0.02 0.01" euler="1.5707963 0 0"/><site name="B1"/></body></body></body>
    <body name="rocker" pos="0.2 0 0"><joint name="C"/><geom type="capsule" fromto="0 0 0 0.01 0 0.17"/>
      <site name="B2" pos="0.01 0 0.17"/></body></worldbody>
  <equality><connect name="B" site1="B1" site2="B2"/>{_TAIL}"""
# The same without its joint: the bush is fixed to the coupler.
FIXED_BUSH = replaced(BUSH, '<joint name="bush" damping="1e-5"/>', "")

# A car's double wishbone with its rack: the tie rod lies along the rack, hung on it by a ball joint, and spins
# about its line.
WISHBONE = """<mujoco model="double wishbone"><compiler angle="degree" autolimits="true"/>
  <default><geom contype="0" conaffinity="0" type="capsule" size="0.012" density="7800"/></default>
  <worldbody>
    <site name="tower" pos="0 0.35 0.75"/>
    <body name="lower" pos="0 0.2 0.25">
      <joint name="lower" axis="1 0 0" damping="2"/>
      <geom fromto="-0.15 0 0 0 0.35 0"/><geom fromto="0.15 0 0 0 0.35 0"/><site name="strut" pos="0 0.25 0"/>
      <body name="upright" pos="0 0.35 0"><joint name="upright" type="ball" damping="2"/>
        <geom fromto="0 0 0 -0.02 -0.05 0.3"/>
        <geom type="cylinder" size="0.3 0.1" euler="90 0 0" pos="0 0.1 0.1" mass="18"/></body></body>
    <body name="upper" pos="-0.02 0.25 0.52"><joint name="upper" axis="1 0 0" damping="2"/>
      <geom fromto="0 0 0 0 0.25 0.03"/></body>
    <body name="rack" pos="-0.12 0.2 0.3"><joint name="rack" type="slide" axis="0 1 0" damping="2" range="-0.08 0.08"/>
      <geom fromto="0 -0.3 0 0 0 0"/>
      <body name="tie"><joint name="tie" type="ball"/><geom fromto="0 0 0 0 0.35 0.02"/></body></body></worldbody>
  <tendon><spatial name="coil" stiffness="20000" damping="1500" springlength="0.62"><site site="strut"/><site site="tower"/>
    </spatial></tendon>
  <equality><connect name="top" body1="upright" body2="upper" anchor="-0.02 -0.05 0.3"/>
    <connect name="steered" body1="tie" body2="upright" anchor="0 0.35 0.02"/></equality>
  <actuator><motor name="steer" joint="rack" ctrlrange="-1500 1500"/>
    <motor name="bump" tendon="coil" ctrlrange="-6000 6000"/></actuator></mujoco>"""
# The same, the tie rod on a universal joint.
WISHBONE_WITHOUT = replaced(
    WISHBONE, '<joint name="tie" type="ball"/>', '<joint name="tie_x" axis="1 0 0"/><joint name="tie_z" axis="0 0 1"/>'
)
