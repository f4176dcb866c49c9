"""A planar four-bar in closed form, and its MJCF: an oracle that shares nothing with the package.

Links lie in the x-z plane and turn about +y, from +z towards +x: a link at angle th points along e(th) = (sin th, cos th).
The crank O-A turns by s, the coupler A-B and the rocker C-B follow from the intersection of two circles. With the links'
angular rates w_i per unit crank rate,

    M(s) = sum m_i |p_i'|^2 + I_i w_i^2,    V(s) = g sum m_i z_i,    d/ds (M v^2 / 2 + V) = tau,

so the fastest motion from rest to rest accelerates with all of the torque and brakes with all of it, and its time is the
quadrature of sqrt(M / 2 K) over the energies K that those torques leave.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.polynomial.legendre import leggauss

G = 9.81
LINKS = ("crank", "coupler", "rocker")
# The built-in problems of the knee driven at O, of which this file is the closed form.
KNEE_PROBLEMS = ("knee-sine", "knee-sine-shank", "knee-reach", "knee-sprint", "knee-sprint-bare")
# Gauss points on each arc of the time's quadrature, whose integrand is smooth: its error is at rounding.
_POINTS = 120
# Degree of the Chebyshev interpolants of M and V over a swing: their error is at rounding.
_DEGREE = 60


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Lump:
    """A rigid part of a link: mass [kg], centre (across, along) the link [m], moment about it [kg m2]."""

    mass: float
    centre: tuple[float, float]
    inertia: float


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FourBar:
    """Lengths [m], the ground pivot C (x, z) seen from O, the branch (side of AC on which B is), the links' lumps."""

    crank: float
    coupler: float
    rocker: float
    ground: tuple[float, float]
    branch: int
    lumps: dict[str, tuple[Lump, ...]] = field(default_factory=dict)

    def carrying(self, link: str, lump: Lump) -> "FourBar":
        """Return the four-bar with a further lump on a link."""
        return replace(self, lumps=self.lumps | {link: (*self.lumps[link], lump)})

    def angles(self, s: np.ndarray) -> np.ndarray:
        """Return the links' absolute angles (3, ..., n) [rad] at crank angles s (..., n), unwrapped along the last axis."""
        s = np.atleast_1d(np.asarray(s, dtype=float))
        to_C = np.array(self.ground).reshape(2, *[1] * s.ndim) - self.crank * _along(s)
        distance = np.hypot(*to_C)
        middle = (distance**2 + self.coupler**2 - self.rocker**2) / (2 * distance)
        height = np.sqrt(self.coupler**2 - middle**2)
        unit = to_C / distance
        AB = middle * unit + self.branch * height * np.array([-unit[1], unit[0]])
        CB = AB - to_C
        return np.array([s, np.unwrap(np.arctan2(AB[0], AB[1])), np.unwrap(np.arctan2(CB[0], CB[1]))])

    def rates(self, s: np.ndarray) -> np.ndarray:
        """Return the links' angular rates (3, n) per unit crank rate."""
        return self._rates_at(self.angles(s))

    def _rates_at(self, th: np.ndarray) -> np.ndarray:
        turn = np.sin(th[2] - th[1])  # the transmission angle's sine: zero at a singular pose
        w_coupler = -self.crank * np.sin(th[2] - th[0]) / (self.coupler * turn)
        w_rocker = self.crank * np.sin(th[0] - th[1]) / (self.rocker * turn)
        return np.array([np.ones_like(turn), w_coupler, w_rocker])

    def transmission(self, s: np.ndarray) -> np.ndarray:
        """Return |sin| of the angle between coupler and rocker (n,)."""
        th = self.angles(s)
        return np.abs(np.sin(th[2] - th[1]))

    def inertia(self, s: np.ndarray) -> np.ndarray:
        """Return the reduced inertia M (n,) [kg m2]: twice the kinetic energy at unit crank rate."""
        return self._inertia_at(self.angles(s))

    def _inertia_at(self, th: np.ndarray) -> np.ndarray:
        w, total = self._rates_at(th), np.zeros(th.shape[1:])
        for i, link in enumerate(LINKS):
            base = self.crank * _along_rate(th[0]) if link == "coupler" else 0.0
            for lump in self.lumps[link]:
                velocity = base + w[i] * _rotated_rate(lump.centre, th[i])
                total += lump.mass * (velocity**2).sum(axis=0) + lump.inertia * w[i] ** 2
        return total

    def potential(self, s: np.ndarray) -> np.ndarray:
        """Return the potential energy V (n,) [J], the pivot O at height zero."""
        return self._potential_at(self.angles(s))

    def energies(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the reduced inertia and the potential energy at crank angles s (..., n)."""
        th = self.angles(s)
        return self._inertia_at(th), self._potential_at(th)

    def _potential_at(self, th: np.ndarray) -> np.ndarray:
        bases = (0.0, self.crank * np.cos(th[0]), self.ground[1])
        return sum(
            G * lump.mass * (bases[i] + _rotated(lump.centre, th[i])[1])
            for i, link in enumerate(LINKS)
            for lump in self.lumps[link]
        )

    def fitted(self, start: float, goal: float) -> tuple[Chebyshev, Chebyshev]:
        """Return M and V over a swing as polynomials, to be differentiated without error to speak of."""
        domain = [min(start, goal) - 0.05, max(start, goal) + 0.05]
        return tuple(Chebyshev.interpolate(f, _DEGREE, domain=domain) for f in (self.inertia, self.potential))

    def minimum_time(self, start: float, goal: float, low: float, high: float) -> float:
        """Return the least time [s] from rest at `start` to rest at `goal` under torques in [low, high]."""
        push, brake = (high, low) if goal > start else (low, high)
        V0, V1 = self.potential(np.array([start, goal]))
        switch = (V1 - V0 + push * start - brake * goal) / (push - brake)

        def arc(end: float, torque: float, V_end: float) -> float:
            # s = end + (switch - end) x^2 takes away the root of the energy at rest.
            x, weight = leggauss(_POINTS)
            x, weight = 0.5 * (x + 1), 0.5 * weight
            s = end + (switch - end) * x**2
            energy = torque * (s - end) - (self.potential(s) - V_end)
            if np.any(energy <= 0):
                raise ValueError("the torque does not carry the swing through")
            return float(np.sum(weight * np.sqrt(self.inertia(s) / (2 * energy)) * 2 * x * abs(switch - end)))

        return arc(start, push, V0) + arc(goal, brake, V1)

    def mjcf(self, drawn_at: float, *, gear: float = 1.0, limit: float = 100.0) -> str:
        """Return the model as MJCF, drawn closed with the crank at `drawn_at` [rad]; joints O, A, C, motor act_O."""
        th = [float(angle) for angle in self.angles(np.array([drawn_at]))[:, 0]]
        x, z = self.ground
        return f"""<mujoco model="four-bar">
  <compiler angle="radian" autolimits="true"/>
  <option gravity="0 0 {-G}" timestep="0.0001"/>
  <default><joint type="hinge" axis="0 1 0"/></default>
  <worldbody>
    <body name="crank" euler="0 {th[0]!r} 0">
      <joint name="O" ref="{th[0]!r}"/>{self._inertial("crank")}
      <body name="coupler" pos="0 0 {self.crank!r}" euler="0 {th[1] - th[0]!r} 0">
        <joint name="A" ref="{th[1] - th[0]!r}"/>{self._inertial("coupler")}
        <site name="B_coupler" pos="0 0 {self.coupler!r}"/>
      </body>
    </body>
    <body name="rocker" pos="{x!r} 0 {z!r}" euler="0 {th[2]!r} 0">
      <joint name="C" ref="{th[2]!r}"/>{self._inertial("rocker")}
      <site name="B_rocker" pos="0 0 {self.rocker!r}"/>
    </body>
  </worldbody>
  <equality><connect name="B" site1="B_coupler" site2="B_rocker" solref="0.0002 1"/></equality>
  <actuator><motor name="act_O" joint="O" gear="{gear!r}" ctrlrange="{-limit!r} {limit!r}"/></actuator>
</mujoco>"""

    def _inertial(self, link: str) -> str:
        lumps = self.lumps[link]
        mass = sum(lump.mass for lump in lumps)
        centre = sum(lump.mass * np.array(lump.centre) for lump in lumps) / mass
        moment = sum(lump.inertia + lump.mass * np.sum((np.array(lump.centre) - centre) ** 2) for lump in lumps)
        return (
            f'<inertial pos="{float(centre[0])!r} 0 {float(centre[1])!r}" mass="{float(mass)!r}"'
            f' diaginertia="{float(moment)!r} {float(moment)!r} {float(moment)!r}"/>'
        )


def _along(th: np.ndarray) -> np.ndarray:
    return np.array([np.sin(th), np.cos(th)])


def _along_rate(th: np.ndarray) -> np.ndarray:
    return np.array([np.cos(th), -np.sin(th)])


def _rotated(point: tuple[float, float], th: np.ndarray) -> np.ndarray:
    """Return a link's point (across, along) turned by th, as (2, n) of x and z."""
    return point[0] * _along_rate(th) + point[1] * _along(th)


def _rotated_rate(point: tuple[float, float], th: np.ndarray) -> np.ndarray:
    return -point[0] * _along(th) + point[1] * _along_rate(th)


DENSITY = 1000.0
SHANK = Lump(mass=4.0, centre=(-0.11105599230618464, -0.16633269844768545), inertia=0.05)


def _sphere(radius: float, along: float, mass: float | None = None) -> Lump:
    mass = DENSITY * 4 / 3 * np.pi * radius**3 if mass is None else mass
    return Lump(mass=mass, centre=(0.0, along), inertia=0.4 * mass * radius**2)


def _rod(length: float, radius: float) -> Lump:
    mass = DENSITY * np.pi * radius**2 * length
    return Lump(mass=mass, centre=(0.0, length / 2), inertia=mass * (3 * radius**2 + length**2) / 12)


def knee() -> FourBar:
    """Return the Optimus knee's four-bar without payload, from the drawing: lengths, and solids of 1000 kg/m3."""
    L1, L2, L3, L4 = 0.057, 0.0741, 0.0855, 0.057
    return FourBar(
        crank=L1,
        coupler=L2,
        rocker=L3,
        ground=(L4, 0.0),
        branch=1,
        lumps={
            "crank": (_sphere(0.015, 0.0), _rod(L1, 0.01)),
            "coupler": (_sphere(0.015, 0.0), _rod(L2, 0.01)),
            "rocker": (_sphere(0.015, 0.0), _rod(L3, 0.01), _sphere(0.005, 0.0, mass=0.002), _sphere(0.015, L3)),
        },
    )


def rate_of(fourbar: FourBar, start: float, goal: float, effort: Callable[[float], float]) -> Callable:
    """Return x' = f(t, x) for x = (s, v): v' = (tau - M' v^2 / 2 - V') / M, for an integrator of choice."""
    M, V = fourbar.fitted(start, goal)
    dM, dV = M.deriv(), V.deriv()

    def rate(t: float, x: np.ndarray) -> list[float]:
        s, v = x
        return [v, (effort(t) - 0.5 * dM(s) * v**2 - dV(s)) / M(s)]

    return rate
