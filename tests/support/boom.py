"""A leg of two links at the end of a boom, which turns about a post and which no actuator drives."""

BOOM = """<mujoco><option timestep="1e-3"/><worldbody>
<body><joint name="turn" axis="{axis}" {joint}/><geom size=".03" mass="1"/>
<body pos=".6 0 0"><joint name="hip" axis="1 0 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".3"/>
<body pos="0 0 -.2"><joint name="knee" axis="1 0 0"/><geom type="capsule" fromto="0 0 0 0 .1 -.2" size=".02" mass=".2"/>
</body></body></body></worldbody>
<actuator><motor joint="hip" ctrlrange="-9 9"/><motor joint="knee" ctrlrange="-9 9"/>{motor}</actuator></mujoco>"""


def boom(axis: str = "0 0 1", joint: str = 'damping=".2"', motor: str = "") -> str:
    """Return the model with the axis, further attributes and a motor of the boom's joint."""
    return BOOM.format(axis=axis, joint=joint, motor=motor)
