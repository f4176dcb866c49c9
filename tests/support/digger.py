"""A digger's arm: boom and stick, each pushed by a cylinder that a closure pins to it."""

# Limits on power [W] that bind on both, and less than half of what the cylinders would give without them.
POWERS = {"boom": 60e3, "stick": 40e3}

DIGGER = """<mujoco model="digger"><compiler angle="degree" autolimits="true"/><option timestep="1e-4"/>
<default><geom contype="0" conaffinity="0" size=".06" density="0"/><joint axis="0 -1 0"/></default>
<worldbody>
 <body name="boom"><joint name="boom" range="-45 65"/><inertial pos="2.7 0 .35" mass="1900" diaginertia="5300 5500 300"/>
  <geom type="capsule" fromto="0 0 0 5.7 0 0"/><site name="boom_lug" pos="2.2 0 .5"/>
  <body name="stick" pos="5.7 0 0"><joint name="stick" range="-155 -35"/>
   <inertial pos="1.4 0 .1" mass="1500" diaginertia="1800 1900 120"/>
   <geom type="capsule" fromto="0 0 0 2.9 0 0"/><site name="stick_lug" pos="-.75 0 .25"/></body>
  <body name="stick_barrel" pos="2.7 0 .9"><joint name="stick_barrel"/>
   <inertial pos=".8 0 0" mass="140" diaginertia="25 25 2"/>
   <body name="stick_rod"><joint name="stick_cylinder" type="slide" axis="1 0 0" range="2.2 4"/>
    <inertial pos="-.7 0 0" mass="90" diaginertia="15 15 1"/><site name="stick_rod"/></body></body>
 </body>
 <body name="boom_barrel" pos=".55 0 -.45"><joint name="boom_barrel"/>
  <inertial pos=".7 0 0" mass="250" diaginertia="40 40 4"/>
  <body name="boom_rod"><joint name="boom_cylinder" type="slide" axis="1 0 0" range="1.4 2.9"/>
   <inertial pos="-.6 0 0" mass="160" diaginertia="25 25 2"/><site name="boom_rod"/></body></body>
</worldbody>
<equality>
 <connect name="boom_eye" site1="boom_rod" site2="boom_lug"/>
 <connect name="stick_eye" site1="stick_rod" site2="stick_lug"/>
</equality>
<actuator>
 <motor name="boom" joint="boom_cylinder" ctrlrange="-350000 700000"/>
 <motor name="stick" joint="stick_cylinder" ctrlrange="-350000 350000"/>
</actuator>
<keyframe><key name="home" qpos="0.349065850 -1.396263402 -0.037845668 3.118198628 0.892970585 2.146885302"/></keyframe>
</mujoco>"""
