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


def unequal_antagonist() -> str:
    """Return an arm between two cables that run straight from the frame to places on the arm."""
    fixed = '<site name="top" pos="-0.02 0 1.2"/><site name="low" pos="-0.02 0 0.8"/>'
    moved = '<site name="a" pos="0.11 0 0.01"/><site name="b" pos="0.08 0 -0.01"/></body></worldbody>'
    cables = "".join(
        f'<spatial name="{n}"><site site="{n}"/><site site="{at}"/></spatial>' for n, at in (("top", "a"), ("low", "b"))
    )
    motors = "".join(
        f'<motor name="m{n}" tendon="{n}" gear="-1" ctrlrange="5 {most}"/>' for n, most in (("top", 300), ("low", 200))
    )
    arm = _ARM.replace('range="-60 60"', 'range="-40 40"').replace("</body></worldbody>", moved)
    return f"{_HEAD.format(name='straight')}{fixed}{arm}<tendon>{cables}</tendon><actuator>{motors}</actuator></mujoco>"


def finger() -> str:
    """Return two links and three tendons over both joints that only pull."""
    links = """<body pos="0 0 1"><joint name="j1" axis="0 -1 0" range="-60 60"/>
      <geom type="capsule" fromto="0 0 0 0.06 0 0" size="0.008" mass="0.08"/>
      <body pos="0.06 0 0"><joint name="j2" axis="0 -1 0" range="-60 60"/>
      <geom type="capsule" fromto="0 0 0 0.05 0 0" size="0.007" mass="0.05"/></body></body></worldbody>"""
    arms = ((0.012, 0.009), (0.011, -0.009), (-0.014, 0.001))
    tendons = "".join(
        f'<fixed name="t{k}"><joint joint="j1" coef="{a}"/><joint joint="j2" coef="{b}"/></fixed>'
        for k, (a, b) in enumerate(arms)
    )
    motors = "".join(f'<motor name="m{k}" tendon="t{k}" ctrlrange="{k + 1} 70"/>' for k in range(3))
    return f"{_HEAD.format(name='finger')}{links}<tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>"


def three_legs() -> str:
    """Return a plate on three legs of two links in a vertical plane, with a motor at each base and one at an elbow."""
    angles = np.radians([90, 210, 330])
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    bodies, closures = "", ""
    for k, (base, end) in enumerate(zip(0.45 * around, 0.12 * around, strict=True)):
        way = end - base
        elbow = way / 2 + 0.14 * np.array([-way[1], way[0]]) / np.linalg.norm(way)
        last = way - elbow
        plate = ""
        if k == 0:
            plate = f"""<body name="plate" pos="{last[0]} {last[1]} 0"><joint name="C" axis="0 0 1"/>
              <geom type="cylinder" size="0.1 0.01" pos="{-end[0]} {-end[1]} 0" mass="0.5"/></body>"""
        else:
            closures += f'<connect body1="l{k}" body2="plate" anchor="{last[0]} {last[1]} 0"/>'
        bodies += f"""<body pos="{base[0]} {base[1]} 0"><joint name="A{k}" axis="0 0 1"/>
          <geom type="capsule" fromto="0 0 0 {elbow[0]} {elbow[1]} 0" size="0.01" mass="0.3"/>
          <body name="l{k}" pos="{elbow[0]} {elbow[1]} 0"><joint name="B{k}" axis="0 0 1"/>
          <geom type="capsule" fromto="0 0 0 {last[0]} {last[1]} 0" size="0.008" mass="0.2"/>{plate}</body></body>"""
    motors = "".join(f'<motor name="m{k}" joint="A{k}" ctrlrange="-{most} {most}"/>' for k, most in enumerate((1, 0.8, 1.2)))
    head = _HEAD.format(name="legs").replace("<default>", '<option gravity="0 -9.81 0"/><default>')
    return (
        f"{head}{bodies}</worldbody>"
        f'<equality>{closures}</equality><actuator>{motors}<motor name="m3" joint="B0" gear="2" ctrlrange="-0.3 0.3"/>'
        "</actuator></mujoco>"
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
