"""Mechanisms with more actuators than degrees of freedom: antagonists, two motors on a joint, cables."""

import itertools

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import demanded

_HEAD = '<mujoco model="{name}"><default><geom contype="0" conaffinity="0"/></default><worldbody>'
_ARM = """<body name="arm" pos="0 0 1"><joint name="e" axis="0 -1 0" range="-60 60"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1.5"/></body></worldbody>"""


def antagonist(least: float = 10.0, most: float = 300.0) -> str:
    """Return an arm between two cables with a radius of 30 mm."""
    cables = "".join(f'<fixed name="{n}"><joint joint="e" coef="{c}"/></fixed>' for n, c in (("f", 0.03), ("x", -0.03)))
    motors = "".join(
        f'<motor name="{n}" tendon="{t}" ctrlrange="{least} {most}"/>' for n, t in (("flex", "f"), ("ext", "x"))
    )
    return f"{_HEAD.format(name='antagonist')}{_ARM}<tendon>{cables}</tendon><actuator>{motors}</actuator></mujoco>"


def two_motors(*limits: float) -> str:
    """Return an arm with motors of some limits [N.m] on its joint."""
    motors = "".join(f'<motor name="m{k}" joint="e" ctrlrange="{-x} {x}"/>' for k, x in enumerate(limits))
    return f"{_HEAD.format(name='two')}{_ARM}<actuator>{motors}</actuator></mujoco>"


def hung_point(least: float = 5.0, most: float = 100.0, mass: float = 4.0, corners: str = "1111") -> str:
    """Return a point mass between cables to some corners of a frame of 2 by 2 m: top left, top right, bottom both."""
    places = [(x, z) for (x, z), kept in zip(((-1, 2), (1, 2), (-1, 0), (1, 0)), corners, strict=True) if kept == "1"]
    sites = "".join(f'<site name="s{k}" pos="{x} 0 {z}"/>' for k, (x, z) in enumerate(places))
    joints = "".join(
        f'<joint name="{n}" type="slide" axis="{a}" range="-0.8 0.8"/>' for n, a in (("x", "1 0 0"), ("z", "0 0 1"))
    )
    body = f'<body name="p" pos="0 0 1">{joints}<geom type="sphere" size="0.05" mass="{mass}"/><site name="hook"/></body>'
    cables = "".join(f'<spatial name="c{k}"><site site="s{k}"/><site site="hook"/></spatial>' for k in range(len(places)))
    winches = "".join(f'<motor name="w{k}" tendon="c{k}" gear="-1" ctrlrange="{least} {most}"/>' for k in range(len(places)))
    return (
        f"{_HEAD.format(name='point')}{sites}{body}</worldbody><tendon>{cables}</tendon>"
        f"<actuator>{winches}</actuator></mujoco>"
    )


def hung_plate() -> str:
    """Return a plate that moves in the x-z plane and turns, between five cables of 4 to 150 N."""
    ends = [((-1.5, 2), (-0.2, -0.1)), ((1.5, 2), (0.2, -0.1)), ((-1.5, 0), (-0.2, 0.1)), ((1.5, 0), (0.2, 0.1))]
    ends.append(((0, 2.2), (0, 0.1)))
    fixed = "".join(f'<site name="s{k}" pos="{x} 0 {z}"/>' for k, ((x, z), _) in enumerate(ends))
    moved = "".join(f'<site name="p{k}" pos="{x} 0 {z}"/>' for k, (_, (x, z)) in enumerate(ends))
    joints = '<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide"/><joint name="t" axis="0 -1 0"/>'
    body = f'<body pos="0 0 1">{joints}<geom type="box" size="0.2 0.05 0.1" mass="6"/>{moved}</body>'
    cables = "".join(f'<spatial name="c{k}"><site site="s{k}"/><site site="p{k}"/></spatial>' for k in range(5))
    winches = "".join(f'<motor name="w{k}" tendon="c{k}" gear="-1" ctrlrange="4 150"/>' for k in range(5))
    return (
        f"{_HEAD.format(name='plate')}{fixed}{body}</worldbody><tendon>{cables}</tendon>"
        f"<actuator>{winches}</actuator></mujoco>"
    )


def least_holding_efforts(mechanism: Mechanism, pose: np.ndarray, limit: np.ndarray) -> np.ndarray | None:
    """Return the efforts (n_u,) of least norm within limits that hold a pose (n_q,), by trying every active set."""
    still = np.zeros((1, mechanism.dof))
    (tau,), (arms,) = demanded(mechanism, pose[None], still, still)
    best = None
    for at in itertools.product((0, 1, None), repeat=len(limit)):
        u = np.array([0.0 if end is None else row[end] for row, end in zip(limit, at, strict=True)])
        free = [k for k, end in enumerate(at) if end is None]
        u[free] = np.linalg.pinv(arms[:, free]) @ (tau - arms @ u)
        slack = 1e-9 * np.abs(limit).max()
        holds = np.abs(arms @ u - tau).max() < 1e-9 * (1 + np.abs(tau).max())
        if (
            holds
            and np.all((u >= limit[:, 0] - slack) & (u <= limit[:, 1] + slack))
            and (best is None or u @ u < best @ best)
        ):
            best = u
    return best
