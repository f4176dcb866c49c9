"""A generator of random planar mechanisms, as MJCF: one to three loops, of dyads put on what is there already.

A crank turns in a base; each loop adds a dyad between a point of a moving body and the base or another body: two links that
meet in a pin (RRR), a link and a slider (RRP), or a link cut in two and welded (RRR with a weld). Such a loop has no freedom
of its own, so that all follow the crank. Base, masses (down to 1e-4 kg), lengths, offsets, references, springs, dampers,
armatures, actuators and the way a pin is written are random; the base may itself turn on a hinge, out of the plane.
"""

from dataclasses import dataclass, field

import numpy as np

from tests.support.mechanisms import inertial, numbers, random_quaternion


@dataclass(eq=False, slots=True)
class Body:
    """A body under construction: its frame's place in the plane (x, z), its elements and children, its points to hang on."""

    name: str
    at: np.ndarray
    elements: str = ""
    children: list["Body"] = field(default_factory=list)
    points: list[np.ndarray] = field(default_factory=list)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Planar:
    """A generated mechanism: its MJCF and what is to be expected of it."""

    text: str
    dof: int
    n_loops: int
    closures: tuple[str, ...]  # "connect", "fork" (two connects for one pin) or "weld", one a loop
    rides: bool  # whether the base turns


def _local(body: Body, point: np.ndarray) -> str:
    x, z = point - body.at
    return numbers([x, 0.0, z])


def _inertial(rng: np.random.Generator, size: float) -> str:
    """Return the inertia of a link: now and then a hundred times lighter than usual."""
    if rng.random() < 0.1:
        return f'<inertial mass="1e-4" pos="{numbers(size * rng.uniform(-1, 1, 3))}" diaginertia="1e-8 1e-8 1e-8"/>'
    return inertial(rng, size)


def _joint(rng: np.random.Generator, name: str, size: float, slide: np.ndarray | None = None) -> str:
    """Return a hinge about +y, or a slide along a direction of the plane, with what a joint can carry."""
    kind = 'axis="0 1 0"' if slide is None else f'type="slide" axis="{numbers([slide[0], 0, slide[1]])}"'
    ref = rng.uniform(-1, 1) * (1.0 if slide is None else size)
    extra = ""
    if rng.random() < 0.5:
        scale = size if slide is None else 1.0
        extra += (
            f' stiffness="{numbers(scale * rng.uniform(0.5, 3))}" springref="{numbers(ref + rng.uniform(-0.5, 0.5) * size)}"'
        )
    if rng.random() < 0.5:
        extra += f' damping="{numbers(size * rng.uniform(0.01, 0.2))}"'
    if rng.random() < 0.3:
        extra += f' armature="{numbers(size**2 * rng.uniform(0.05, 0.5))}"'
    return f'<joint name="{name}" {kind} ref="{numbers(ref)}"{extra}/>'


def _elbow(rng: np.random.Generator, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a point that makes a good triangle with a and b: the angle there is between 40 and 140 deg."""
    while True:
        middle, apart = (a + b) / 2, np.linalg.norm(a - b)
        point = middle + rng.normal(size=2) * max(apart, 0.1)
        u, v = a - point, b - point
        lengths = np.linalg.norm(u) * np.linalg.norm(v)
        if min(np.linalg.norm(u), np.linalg.norm(v)) > 0.08 and abs(u[0] * v[1] - u[1] * v[0]) > 0.64 * lengths:
            return point


def random_planar(seed: int) -> Planar:
    """Return the mechanism of a seed."""
    rng = np.random.default_rng(seed)
    n_loops = int(rng.integers(1, 4))
    rides = bool(rng.random() < 0.2)
    base = Body("base", np.zeros(2), points=list(rng.uniform(-0.5, 0.5, (4, 2))))
    if rides:
        base.elements += f'<joint name="turret" axis="{numbers(rng.normal(size=3))}" damping="0.1"/>{inertial(rng, 0.2)}'
    crank = Body("crank", base.points[0], points=[base.points[0] + _direction(rng) * rng.uniform(0.1, 0.3)])
    crank.elements += _joint(rng, "crank", 0.2) + _inertial(rng, 0.1)
    base.children.append(crank)
    moving, equalities, kinds, sites = [crank], [], [], 0
    joints = {"crank": "hinge"}
    tendon_ends: list[str] = []
    for k in range(n_loops):
        host = moving[int(rng.integers(len(moving)))]
        start = host.points[int(rng.integers(len(host.points)))]
        others = [body for body in (base, base, *moving) if body is not host]
        far = [(body, point) for body in others for point in body.points if np.linalg.norm(point - start) > 0.15]
        other, anchor = far[int(rng.integers(len(far)))]
        elbow = _elbow(rng, start, anchor)
        link = Body(f"link{k}", start, points=[elbow, (start + elbow) / 2 + 0.05 * rng.normal(size=2)])
        link.elements += _joint(rng, f"a{k}", 0.2) + _inertial(rng, 0.1)
        host.children.append(link)
        kind = str(rng.choice(["connect", "fork", "weld"], p=[0.5, 0.2, 0.3]))
        if rng.random() < 0.3:  # a slider instead of a second link, along the first one as far as may be: across, it sticks
            along = (elbow - start) / np.linalg.norm(elbow - start)
            slide = along + 0.3 * rng.normal(size=2)
            slide /= np.linalg.norm(slide)
            second = Body(f"slider{k}", elbow, points=[elbow + 0.1 * rng.normal(size=2)])
            second.elements += _joint(rng, f"b{k}", 0.2, slide)
            joints[f"b{k}"] = "slide"
        else:
            second = Body(f"rocker{k}", anchor, points=[elbow, anchor + 0.2 * _direction(rng)])
            second.elements += _joint(rng, f"b{k}", 0.2)
            joints[f"b{k}"] = "hinge"
        second.elements += _inertial(rng, 0.1)
        other.children.append(second)
        moving += [link, second]
        if kind == "weld":
            half = Body(f"half{k}", elbow)
            half.elements += _joint(rng, f"c{k}", 0.1) + _inertial(rng, 0.05)
            second.children.append(half)
            attributes = f'anchor="{numbers(rng.uniform(-0.1, 0.1, 3))}" torquescale="{numbers(rng.uniform(0.2, 2))}"'
            equalities.append(f'<weld name="loop{k}" body1="link{k}" body2="half{k}" {attributes}/>')
        else:
            for y in (0.0, 0.04)[: 1 + (kind == "fork")]:
                equalities.append(_pin(rng, k, link, second, elbow, y, sites))
                sites += 2
        kinds.append(kind)
        tendon_ends.append(f"hook{k}")
        link.elements += f'<site name="hook{k}" pos="{_local(link, start + 0.7 * (elbow - start))}"/>'
    base.elements += f'<site name="reel" pos="{numbers(rng.uniform(-0.6, 0.6, 3))}"/>'
    place = f'pos="{numbers(rng.uniform(-1, 1, 3))}" quat="{numbers(random_quaternion(rng))}"'
    rope = "".join(f'<site site="{site}"/>' for site in ("reel", *tendon_ends))
    belt = "".join(f'<joint joint="{joint}" coef="{numbers(rng.uniform(-1, 1))}"/>' for joint in joints)
    text = f"""
<mujoco model="planar {seed}"><compiler angle="radian" autolimits="true"/>
  <option gravity="{numbers(rng.uniform(-10, 10, 3))}"/>
  <worldbody><body {place}>{_xml(base)}</body></worldbody>
  <tendon><spatial name="rope"{_spring(rng)}>{rope}</spatial><fixed name="belt"{_spring(rng)}>{belt}</fixed>
  </tendon>
  <equality>{"".join(equalities)}</equality>
  <actuator>{_actuators(rng, joints)}</actuator>
</mujoco>"""
    return Planar(text=text, dof=1 + rides, n_loops=n_loops, closures=tuple(kinds), rides=rides)


def _direction(rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(-np.pi, np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _pin(rng, k: int, first: Body, second: Body, point: np.ndarray, y: float, sites: int) -> str:
    """Return a connect of two bodies at a point, by its anchor or by two sites, which it puts on the bodies."""
    name = f"loop{k}" if y == 0 else f"loop{k}_fork"
    if rng.random() < 0.5:
        x, z = point - first.at
        return f'<connect name="{name}" body1="{first.name}" body2="{second.name}" anchor="{numbers([x, y, z])}"/>'
    for n, body in enumerate((first, second)):
        x, z = point - body.at
        body.elements += f'<site name="pin{sites + n}" pos="{numbers([x, y, z])}"/>'
    return f'<connect name="{name}" site1="pin{sites}" site2="pin{sites + 1}"/>'


def _spring(rng: np.random.Generator) -> str:
    """Return a tendon's spring and damper, or nothing."""
    if rng.random() < 0.5:
        return ""
    return f' stiffness="{numbers(rng.uniform(0.5, 3))}" springlength="0.1 0.3" damping="{numbers(rng.uniform(0, 0.3))}"'


def _actuators(rng: np.random.Generator, joints: dict[str, str]) -> str:
    """Return the crank's motor and up to three more, of any transmission and of motors and servos alike."""

    def kind() -> str:
        return str(rng.choice(["<motor", '<position kp="3" kv="0.2"', '<velocity kv="0.4"']))

    def gear() -> str:
        return f'gear="{numbers(rng.choice([-1, 1]) * rng.uniform(0.5, 3))}"'

    wrench = numbers([*rng.normal(size=2), *rng.normal(size=4)])
    choices = [
        f'{kind()} name="pull" tendon="rope" {gear()}/>',
        f'{kind()} name="turn" tendon="belt" {gear()}/>',
        f'{kind()} name="drive" joint="{list(joints)[-1]}" {gear()}/>',
        f'<motor name="jet" site="hook0" gear="{wrench}"/>',
        f'{kind()} name="reach" site="hook0" refsite="reel" gear="1 0.3 -0.5 0 0 0"/>',
        f'<motor name="piston" cranksite="hook0" slidersite="reel" cranklength="2" {gear()}/>',
    ]
    more = rng.choice(len(choices), size=int(rng.integers(0, 4)), replace=False)
    return f'{kind()} name="crank" joint="crank" {gear()}/>' + "".join(choices[k] for k in more)


def _xml(body: Body, parent: np.ndarray | None = None) -> str:
    x, z = body.at - (np.zeros(2) if parent is None else parent)
    inside = body.elements + "".join(_xml(child, body.at) for child in body.children)
    return f'<body name="{body.name}" pos="{numbers([x, 0.0, z])}">{inside}</body>'
