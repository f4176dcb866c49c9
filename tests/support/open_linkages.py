"""Random linkages of one degree of freedom as MJCF: six-bars of Watt and Stephenson, offset slider-cranks, spatial RSSRs.

Drawn at home, where all joints are at 0: frames of bodies are parallel to the world's there. The driven joint is "O"; a site
"tip" is on the coupler. Springs, dampers and gears are random too.
"""

from dataclasses import dataclass

import numpy as np

KINDS = ("watt", "stephenson", "slider-crank", "rssr")
_GRAVITY = 9.81


@dataclass(frozen=True, kw_only=True, slots=True)
class Linkage:
    """A model without limits, its kind, its size [m], its driven joint's gear, and joints that follow it, hinges alone."""

    kind: str
    mjcf: str
    size: float
    gear: float
    followers: tuple[str, ...]


def random_linkage(rng: np.random.Generator, kind: str) -> Linkage:
    """Return a linkage that closes at home; whether it moves far is for its poses to say."""
    size = float(10 ** rng.uniform(-1.3, 0.2))
    heavy = float(10 ** rng.uniform(-0.7, 0.8))
    torque = heavy * _GRAVITY * size
    gear = float(rng.choice([1.0, 1.0, -2.0, 4.0]))
    spring = float(rng.choice([0.0, 0.5])) * torque
    damping = float(rng.choice([0.0, 0.02]) * torque * np.sqrt(size / _GRAVITY))
    build = {"watt": _watt, "stephenson": _stephenson, "slider-crank": _slider_crank, "rssr": _rssr}[kind]
    bodies, pins, followers = build(_Draw(rng=rng, size=size, heavy=heavy, spring=spring, damping=damping))
    mjcf = f"""<mujoco model="{kind}"><compiler angle="radian" autolimits="true"/>
<option gravity="0 0 -9.81" timestep="0.0002"/>
<default><joint axis="0 -1 0"/><geom contype="0" conaffinity="0"/></default>
<worldbody>{bodies}</worldbody><equality>{pins}</equality>
<actuator><motor name="act" joint="O" gear="{gear!r}" ctrlrange="-1e6 1e6"/></actuator></mujoco>"""
    return Linkage(kind=kind, mjcf=mjcf, size=size, gear=gear, followers=followers)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Draw:
    """What a linkage is drawn from: random numbers, a length [m], a mass [kg], a spring [N.m] and a damper [N.m.s]."""

    rng: np.random.Generator
    size: float
    heavy: float
    spring: float
    damping: float

    def point(self, x: float, z: float, spread: float = 0.15) -> np.ndarray:
        """Return a point of the plane near a place, in units of the size."""
        return self.size * (np.array([x, 0.0, z]) + spread * self.rng.uniform(-1, 1, 3) * np.array([1, 0, 1]))

    def body(self, name: str, at: np.ndarray, within: np.ndarray, to: np.ndarray, more: str = "", joint: str = "") -> str:
        """Return a body with its pivot at a point [m] of the world, in a parent with its own there, and its far end."""
        arm = to - at
        length, mass = float(np.linalg.norm(arm)), self.heavy * float(self.rng.uniform(0.3, 1.5))
        centre = arm * self.rng.uniform(0.3, 0.7) + 0.1 * length * self.rng.uniform(-1, 1, 3) * np.array([1, 0, 1])
        moment = mass * length**2 * self.rng.uniform(0.05, 0.2)
        joint = joint or f'<joint name="{name}"/>'
        return (
            f'<body name="b{name}" pos="{_text(at - within)}">{joint}<inertial pos="{_text(centre)}" mass="{mass!r}" '
            f'diaginertia="{_text(moment * np.array([1.0, 1.1, 0.9]))}"/>{more}</body>'
        )

    def sprung(self, name: str) -> str:
        """Return a hinge with the spring, wound up at home by a random angle, and the damper."""
        wound = float(self.rng.uniform(-1, 1))
        return f'<joint name="{name}" stiffness="{self.spring!r}" springref="{wound!r}" damping="{self.damping!r}"/>'


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in np.atleast_1d(values))


def _site(name: str, at: np.ndarray, within: np.ndarray) -> str:
    return f'<site name="{name}" pos="{_text(at - within)}"/>'


_ORIGIN = np.zeros(3)


def _four_bar(draw: _Draw, coupler: str, rocker: str, points: tuple[np.ndarray, ...]) -> str:
    """Return crank O-A, coupler A-B and rocker C-B, with more inside coupler and rocker."""
    A, B, C = points
    tip = _site("tip", A + 0.6 * (B - A) + draw.point(0, 0, 0.3), A) + _site("B1", B, A)
    crank = draw.body("O", _ORIGIN, _ORIGIN, A, draw.body("A", A, _ORIGIN, B, tip + coupler))
    return crank + draw.body("C", C, _ORIGIN, B, _site("B2", B, C) + rocker, draw.sprung("C"))


_PIN = '<connect name="{0}" site1="{0}1" site2="{0}2"/>'


def _watt(draw: _Draw) -> tuple[str, str, tuple[str, ...]]:
    A, B, C = draw.point(0.1, 0.35, 0.1), draw.point(0.9, 0.75), draw.point(1.0, 0.0)
    D, F = C + 0.8 * (B - C) + draw.point(0.1, 0.1, 0.1), draw.point(2.0, 0.0)
    E = F + draw.point(0.0, 0.7)
    rocker = draw.body("D", D, C, E, _site("E1", E, D))
    bodies = _four_bar(draw, "", rocker, (A, B, C)) + draw.body("F", F, _ORIGIN, E, _site("E2", E, F))
    return bodies, _PIN.format("B") + _PIN.format("E"), ("A", "C", "D", "F")


def _stephenson(draw: _Draw) -> tuple[str, str, tuple[str, ...]]:
    A, B, C = draw.point(0.1, 0.35, 0.1), draw.point(0.9, 0.75), draw.point(1.0, 0.0)
    D = 0.5 * (A + B) + draw.point(0.0, 0.5)
    F = draw.point(1.7, 1.0)
    E = F + draw.point(-0.1, 0.7, 0.1)
    coupler = draw.body("D", D, A, E, _site("E1", E, D))
    bodies = _four_bar(draw, coupler, "", (A, B, C)) + draw.body("F", F, _ORIGIN, E, _site("E2", E, F))
    return bodies, _PIN.format("B") + _PIN.format("E"), ("A", "C", "D", "F")


def _slider_crank(draw: _Draw) -> tuple[str, str, tuple[str, ...]]:
    A, P = draw.point(0.2, 0.4, 0.2), draw.point(1.6, 0.1, 0.25)
    tilt = float(draw.rng.uniform(-0.3, 0.3))
    force = draw.spring / draw.size**2, draw.damping / draw.size**2
    slide = (
        f'<joint name="P" type="slide" axis="{float(np.cos(tilt))!r} 0 {float(np.sin(tilt))!r}" stiffness="{force[0]!r}" '
        f'springref="{float(draw.size * draw.rng.uniform(-0.5, 0.5))!r}" damping="{force[1]!r}"/>'
    )
    rod = draw.body("A", A, _ORIGIN, P, _site("tip", A + draw.point(0.7, 0.2), A) + _site("B1", P, A))
    slider = draw.body("P", P, _ORIGIN, P + draw.point(0.2, 0.0, 0.05), _site("B2", P, P), slide)
    return draw.body("O", _ORIGIN, _ORIGIN, A, rod) + slider, _PIN.format("B"), ("A",)


def _rssr(draw: _Draw) -> tuple[str, str, tuple[str, ...]]:
    """A rod between two balls: on the crank a universal joint, so that it has no spin of its own."""
    across = draw.size * draw.rng.uniform(-0.4, 0.4, 4)
    A, B, C = draw.point(0.1, 0.35, 0.1), draw.point(0.9, 0.8), draw.point(1.0, 0.0)
    A, B, C = (p + np.array([0.0, y, 0.0]) for p, y in zip((A, B, C), across, strict=False))
    along = (B - A) / np.linalg.norm(B - A)
    first = np.cross(along, [0.3, 0.2, 1.0])
    first /= np.linalg.norm(first)
    axes = f'<joint name="A" axis="{_text(first)}"/><joint name="A2" axis="{_text(np.cross(along, first))}"/>'
    lean = [float(x) for x in draw.rng.uniform(-0.5, 0.5, 2)]
    rocker = f'<joint name="C" axis="{lean[0]!r} -1 {lean[1]!r}" damping="{draw.damping!r}"/>'
    rod = draw.body("A", A, _ORIGIN, B, _site("tip", A + 0.5 * (B - A), A) + _site("B1", B, A), axes)
    crank = draw.body("O", _ORIGIN, _ORIGIN, A, rod)
    return crank + draw.body("C", C, _ORIGIN, B, _site("B2", B, C), rocker), _PIN.format("B"), ("C",)
