"""Linkages that turn though counting their constraints says that they do not: Bennett's, coupled cranks, Bricard's, Sarrus'.

Each is drawn from its closed form, cut at one hinge, which two points on the hinge's line close again.
"""

import numpy as np

from tests.support.mechanisms import numbers

HEAD = """<mujoco model="{name}"><compiler angle="radian" autolimits="true"/>
  <option timestep="0.0005"/><default><joint damping="0.001"/><geom contype="0" conaffinity="0" size="0.01"/></default>"""
# Bennett's link lengths [m] and twists [rad]: a sin(beta) = b sin(alpha).
BENNETT_A, BENNETT_ALPHA, BENNETT_B = 0.1, np.radians(40.0), 0.15
BENNETT_BETA = float(np.arcsin(BENNETT_B * np.sin(BENNETT_ALPHA) / BENNETT_A))


def denavit_hartenberg(length: float, twist: float, offset: float = 0.0) -> np.ndarray:
    """Return the frame of the next hinge at angle zero, z along the hinges: Trans_z(offset) Trans_x(length) Rot_x(twist)."""
    c, s = np.cos(twist), np.sin(twist)
    return np.array([[1.0, 0, 0, length], [0, c, -s, 0], [0, s, c, offset], [0, 0, 0, 1.0]])


def turn(angle: float) -> np.ndarray:
    """Return the frame turned about its z."""
    frame = np.eye(4)
    frame[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return frame


def bennett_follower(theta: np.ndarray) -> np.ndarray:
    """Return the next hinge's angle: tan(theta / 2) tan(phi / 2) = sin((beta + alpha) / 2) / sin((beta - alpha) / 2)."""
    ratio = np.sin((BENNETT_BETA + BENNETT_ALPHA) / 2) / np.sin((BENNETT_BETA - BENNETT_ALPHA) / 2)
    return 2 * np.arctan2(ratio * np.cos(np.asarray(theta) / 2), np.sin(np.asarray(theta) / 2))


def closed_chain(name: str, links: list[tuple[float, float, float]], angles: list[float], noise: float = 0.0) -> str:
    """Return a loop of hinges along z, cut at the last: links (length, twist, offset) and the angles that close it.

    The hinge of link 0, the ground, is the first; `noise` [rad] turns every axis a little.
    """
    rng = np.random.default_rng(3)
    frames = [np.eye(4)]  # of each hinge, its angle included
    body, tail = "", ""
    for k, (link, angle) in enumerate(zip(links[:-1], angles[:-1], strict=True)):
        step = turn(angle) @ denavit_hartenberg(*link)
        place = denavit_hartenberg(*links[k - 1]) if k else np.eye(4)
        frame = place @ turn(angle)
        quat = _quaternion(frame[:3, :3])
        axis = np.array([0.0, 0, 1]) + noise * rng.normal(size=3)
        tip = (turn(-angle) @ step)[:3, 3]
        body += (
            f'<body name="L{k}" pos="{numbers(frame[:3, 3])}" quat="{numbers(quat)}">'
            f'<joint name="H{k}" axis="{numbers(axis)}"/>'
            f'<geom type="capsule" fromto="0 0 0 {numbers(tip)}" mass="0.05"/>'
        )
        tail += "</body>"
        frames.append(frames[-1] @ step)
    # The last hinge: its line in the last link's frame, and in the ground's, where its angle and link lead back to home.
    last = denavit_hartenberg(*links[-2])
    end = frames[-1]
    closed = end @ turn(angles[-1]) @ denavit_hartenberg(*links[-1])
    assert np.abs(closed - np.eye(4)).max() < 1e-9, "the angles close the loop"
    sites = ground = ""
    for which, along in (("a", -0.05), ("b", 0.05)):
        point = np.array([0, 0, along, 1.0])
        sites += f'<site name="p{which}" pos="{numbers((last @ point)[:3])}"/>'
        ground += f'<site name="g{which}" pos="{numbers((end @ point)[:3])}"/>'
    connects = "".join(f'<connect name="{w}" site1="p{w}" site2="g{w}"/>' for w in "ab")
    return (
        f"{HEAD.format(name=name)}<worldbody>{ground}{body}{sites}{tail}</worldbody>"
        f'<equality>{connects}</equality><actuator><motor joint="H0" ctrlrange="-2 2"/></actuator></mujoco>'
    )


def _quaternion(R: np.ndarray) -> np.ndarray:
    K = np.array(
        [
            [R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [0, R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]],
            [0, 0, R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2]],
            [0, 0, 0, R[2, 2] - R[0, 0] - R[1, 1]],
        ]
    )
    K = np.triu(K) + np.triu(K, 1).T
    return np.linalg.eigh(K)[1][:, -1]


def bennett(noise: float = 0.0) -> str:
    """Return Bennett's linkage, drawn at a first angle of 60 deg."""
    theta = np.radians(60.0)
    phi = float(bennett_follower(theta))
    a, b = (BENNETT_A, BENNETT_ALPHA, 0.0), (BENNETT_B, BENNETT_BETA, 0.0)
    return closed_chain("bennett", [a, b, a, b], [theta, phi, -theta, -phi], noise)


def bricard(noise: float = 0.0) -> str:
    """Return Bricard's trihedral linkage of equal links and right twists, drawn with its odd hinges at 120 deg."""
    theta = np.radians(70.0)
    phi = bricard_follower(theta)
    links = [(0.1, np.pi / 2 if k % 2 == 0 else -np.pi / 2, 0.0) for k in range(6)]
    return closed_chain("bricard", links, [theta, phi] * 3, noise)


def bricard_follower(theta: float) -> float:
    """Return the even hinges' angle of the trihedral linkage: cos(t) + cos(p) + cos(t) cos(p) = 0."""
    c = np.cos(theta)
    return float(np.arccos(-c / (1 + c)))


def coupled_cranks(noise: float = 0.0, pivots: tuple = ((0, 0), (0.2, 0), (0.1, 0.12)), drawn: float = 1.0) -> str:
    """Return cranks on pivots (x, z) [m] coupled by one plate: three turn for ever, though two suffice."""
    rng = np.random.default_rng(4)
    tip = 0.05 * np.array([np.cos(drawn), np.sin(drawn)])

    def axis() -> str:
        return numbers(np.array([0.0, 1, 0]) + noise * rng.normal(size=3))

    others = "".join(
        f'<body name="crank{k}" pos="{x} 0 {z}"><joint name="O{k}" axis="{axis()}"/>'
        f'<geom type="capsule" fromto="0 0 0 {tip[0]} 0 {tip[1]}" mass="0.1"/>'
        f'<site name="tip{k}" pos="{tip[0]} 0 {tip[1]}"/></body>'
        for k, (x, z) in enumerate(pivots)
        if k
    )
    eyes = "".join(f'<site name="eye{k}" pos="{x} 0 {z}"/>' for k, (x, z) in enumerate(pivots) if k)
    ties = "".join(f'<connect name="pin{k}" site1="eye{k}" site2="tip{k}"/>' for k in range(1, len(pivots)))
    return (
        f'{HEAD.format(name="cranks")}<worldbody><body name="crank0"><joint name="O0" axis="{axis()}"/>'
        f'<geom type="capsule" fromto="0 0 0 {tip[0]} 0 {tip[1]}" mass="0.1"/>'
        f'<body name="plate" pos="{tip[0]} 0 {tip[1]}"><joint name="P" axis="{axis()}"/>'
        f'<geom type="box" size="0.1 0.01 0.01" pos="0.1 0 0" mass="0.3"/>{eyes}</body>'
        f"</body>{others}</worldbody><equality>{ties}</equality>"
        '<actuator><motor joint="O0" ctrlrange="-2 2"/></actuator></mujoco>'
    )


def sarrus(drawn: float = 0.5) -> str:
    """Return Sarrus' linkage: a plate that two pairs of links, hinged across one another, guide up and down through flat."""
    length, arm = 0.1, 0.05
    c, s = length * np.cos(drawn), length * np.sin(drawn)
    up, out = f"{c} 0 {s}", f"{-c} 0 {s}"
    across, back = f"0 {c} {s}", f"0 {-c} {s}"
    return (
        f"{HEAD.format(name='sarrus')}<worldbody>"
        f'<body name="a1" pos="{arm} 0 0"><joint name="A1" axis="0 -1 0"/>'
        f'<geom type="capsule" fromto="0 0 0 {up}" mass="0.05"/>'
        f'<body name="a2" pos="{up}"><joint name="A2" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 {out}" mass="0.05"/>'
        f'<body name="plate" pos="{out}"><joint name="A3" axis="0 -1 0"/><geom pos="{-arm} 0 0" mass="0.2"/>'
        f'<site name="pa" pos="{-arm - 0.05} {arm} 0"/><site name="pb" pos="{-arm + 0.05} {arm} 0"/></body></body></body>'
        f'<body name="b1" pos="0 {arm} 0"><joint name="B1" axis="1 0 0"/>'
        f'<geom type="capsule" fromto="0 0 0 {across}" mass="0.05"/>'
        f'<body name="b2" pos="{across}"><joint name="B2" axis="1 0 0"/>'
        f'<geom type="capsule" fromto="0 0 0 {back}" mass="0.05"/>'
        f'<site name="qa" pos="-0.05 {-c} {s}"/><site name="qb" pos="0.05 {-c} {s}"/></body></body></worldbody>'
        '<equality><connect name="a" site1="pa" site2="qa"/><connect name="b" site1="pb" site2="qb"/></equality>'
        '<actuator><motor joint="A1" ctrlrange="-2 2"/></actuator></mujoco>'
    )
