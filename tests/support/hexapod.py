"""A platform on six rods (Gough, Stewart): its loops close together, through one block of eighteen joints."""

import numpy as np

HEIGHT_M, GROUND_M, PLATFORM_M = 0.45, 0.3, 0.18
_LEG = """<body pos="{foot}" quat="{turn}"><joint name="b{k}" type="ball" damping="0.001"/>
<geom type="cylinder" size=".015" mass=".4" fromto="0 0 0 0 0 .25"/><body pos="0 0 {drawn}">
<joint name="s{k}" type="slide" axis="0 0 1" range="-.12 .12" damping="5"/>
<geom type="cylinder" size=".008" mass=".2" fromto="0 0 0 0 0 .22"/><site name="t{k}" pos="0 0 .22"/></body></body>"""
_WHOLE = """<mujoco model="hexapod"><default><geom contype="0" conaffinity="0"/></default><worldbody>
<body pos="0 0 {height}"><freejoint name="root"/><geom type="cylinder" size=".2 .01" mass="6"/>{sites}</body>{legs}
</worldbody><equality>{connects}</equality><actuator>{motors}</actuator></mujoco>"""


def hexapod() -> str:
    """Return its MJCF: pairs of feet 120 deg apart, pairs of heads half way between them, a cylinder in every rod."""
    legs, sites = [], []
    for k in range(6):
        foot, head = np.radians([(-15, 15)[k % 2] + 120 * (k // 2), (-45, 45)[k % 2] + 120 * (k // 2)])
        below = GROUND_M * np.array([np.cos(foot), np.sin(foot), 0.0])
        above = np.array([PLATFORM_M * np.cos(head), PLATFORM_M * np.sin(head), HEIGHT_M])
        length = float(np.linalg.norm(above - below))
        x, y, z = (above - below) / length
        numbers = {"foot": below, "turn": np.array([1 + z, -y, x, 0.0])}
        words = {name: " ".join(f"{value:.12g}" for value in values) for name, values in numbers.items()}
        legs.append(_LEG.format(k=k, drawn=f"{length - 0.22:.12g}", **words))
        sites.append(f'<site name="p{k}" pos="{above[0]:.12g} {above[1]:.12g} 0"/>')
    connects = "".join(f'<connect site1="p{k}" site2="t{k}"/>' for k in range(6))
    motors = "".join(f'<motor name="m{k}" joint="s{k}" ctrlrange="-120 120"/>' for k in range(6))
    return _WHOLE.format(height=HEIGHT_M, sites="".join(sites), legs="".join(legs), connects=connects, motors=motors)
