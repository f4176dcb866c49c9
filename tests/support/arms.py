"""Serial arms in the plane y = 0 with a site "foot" at their end, and their kinematics by hand."""

import numpy as np

UPPER, LOWER = 0.3, 0.25  # of the links [m]

_LINK = """<joint name="{name}" axis="0 -1 0" damping="0.01"/>
<inertial mass="1" pos="{half} 0 0" diaginertia="1e-3 8e-3 8e-3"/>"""


def arm(*lengths: float, limit: float = 20.0) -> str:
    """Return the MJCF of an arm of links [m]: joints J1, J2, ... from +x towards +z, motors of +-limit N.m, no weight."""
    body = f'<site name="foot" pos="{lengths[-1]} 0 0"/>'
    for k in reversed(range(len(lengths))):
        inner = _LINK.format(name=f"J{k + 1}", half=lengths[k] / 2) + body
        at = lengths[k - 1] if k else 0.0
        body = f'<body name="link{k + 1}" pos="{at} 0 0">{inner}</body>'
    motors = "".join(
        f'<motor name="act_J{k + 1}" joint="J{k + 1}" ctrlrange="-{limit} {limit}" ctrllimited="true"/>'
        for k in range(len(lengths))
    )
    return (
        f'<mujoco model="arm-{len(lengths)}"><compiler angle="degree"/><option gravity="0 0 0" timestep="1e-4"/>'
        f'<worldbody><site name="base"/>{body}</worldbody><actuator>{motors}</actuator></mujoco>'
    )


def foot_of(angles: np.ndarray, lengths: tuple[float, ...] = (UPPER, LOWER)) -> np.ndarray:
    """Return where the foot (n, 3) [m] is at joint angles (n, n_links) [rad]."""
    along = np.cumsum(np.atleast_2d(angles), axis=1)
    x, z = (np.sum(np.array(lengths) * f(along), axis=1) for f in (np.cos, np.sin))
    return np.stack([x, np.zeros_like(x), z], axis=1)


def angles_at(x: float, z: float, bend: float = 1.0) -> np.ndarray:
    """Return the two-link arm's angles (2,) [rad] with its foot at x, z, the second of the sign of `bend`: cosine rule."""
    second = bend * np.arccos((x**2 + z**2 - UPPER**2 - LOWER**2) / (2 * UPPER * LOWER))
    first = np.arctan2(z, x) - np.arctan2(LOWER * np.sin(second), UPPER + LOWER * np.cos(second))
    return np.array([first, second])
