"""Random offset slider-cranks with springs and dampers, their exact dynamics, and the best motions by quadrature and BVP.

Nothing here is linkplan's: kinematics in closed form, least times from both legs of the phase plane, least efforts from
Pontryagin's conditions. Geometry and loads are other than those of the random four-bars.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from tests.support.least_effort import least_effort_of
from tests.support.least_time import Curves, least_time_of, least_time_within

_POSES = 6001
_NO_POWER = (-np.inf, np.inf)


@dataclass(frozen=True, kw_only=True, slots=True)
class Slider:
    """A crank of length r [m], a rod of length l, a slider on a guide at `tilt` [rad], off the axis by `offset` [m].

    `mass` [kg] of the crank, whose centre is at its middle, of the rod, whose centre is at the share `centre`, and of the
    slider; `inertia` [kg m2] of crank and rod; `spring` [N/m] on the slider, relaxed at `relaxed` [m]; `damping` of crank
    [N.m.s] and slider [N.s/m].
    """

    r: float
    l: float  # noqa: E741
    offset: float
    tilt: float
    mass: tuple[float, float, float]
    inertia: tuple[float, float]
    centre: float
    spring: float
    relaxed: float
    damping: tuple[float, float]

    def pose(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rod's angle [rad] and the slider's place on the guide [m] at crank angles."""
        along, across = self.r * np.cos(angle - self.tilt), self.r * np.sin(angle - self.tilt)
        lean = np.arcsin((self.offset - across) / self.l)
        return lean + self.tilt, along + self.l * np.cos(lean)

    def slopes(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of the rod's angle and the slider's place by the crank's angle."""
        lean = self.pose(angle)[0] - self.tilt
        rod = -self.r * np.cos(angle - self.tilt) / (self.l * np.cos(lean))
        return rod, -self.r * np.sin(angle - self.tilt) - self.l * np.sin(lean) * rod

    def inertia_at(self, angle: np.ndarray) -> np.ndarray:
        """Return the reduced inertia [kg m2]."""
        rod, slide = self.slopes(angle)
        a, b = self.r, self.centre * self.l
        apart = angle - self.pose(angle)[0]
        centre = a**2 + (b * rod) ** 2 + 2 * a * b * rod * np.cos(apart)
        first, second, third = self.mass
        return self.inertia[0] + first * (a / 2) ** 2 + self.inertia[1] * rod**2 + second * centre + third * slide**2

    def potential(self, angle: np.ndarray) -> np.ndarray:
        """Return the energy of weight and spring [J]."""
        rod, place = self.pose(angle)
        tip = self.r * np.sin(angle)
        height = self.mass[0] * tip / 2 + self.mass[1] * (tip + self.centre * self.l * np.sin(rod))
        height = height + self.mass[2] * (place * np.sin(self.tilt) + self.offset * np.cos(self.tilt))
        return 9.81 * height + 0.5 * self.spring * (place - self.relaxed) ** 2

    def drag(self, angle: np.ndarray) -> np.ndarray:
        """Return the reduced damping [N.m.s]."""
        return self.damping[0] + self.damping[1] * self.slopes(angle)[1] ** 2

    def pin_force(self, angle: np.ndarray, v: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the pin's force (n, 2) [N] at crank angles that turn at v [rad/s] without acceleration, and its slope by a.

        Along the guide it moves the slider, about the crank's pin it turns the rod: two equations, Newton's and Euler's.
        """
        (rod, place), (rod_by, place_by) = self.pose(angle), self.slopes(angle)
        rod_bend, place_bend = (CubicSpline(angle, x).derivative()(angle) for x in (rod_by, place_by))
        along, reach = np.array([np.cos(self.tilt), np.sin(self.tilt)]), self.centre * self.l
        drag, stretched = self.damping[1] * place_by, place - self.relaxed

        def forces(a: float, gravity: float, springs: float) -> np.ndarray:
            slide = place_by * a + place_bend * v**2
            pulled = self.mass[2] * (slide + gravity * along[1]) + springs * (self.spring * stretched + drag * v)
            turn = rod_by * a + rod_bend * v**2
            x, z = (
                -self.r * (a * np.sin(angle) + v**2 * np.cos(angle)),
                self.r * (a * np.cos(angle) - v**2 * np.sin(angle)),
            )
            x = x - reach * (turn * np.sin(rod) + (rod_by * v) ** 2 * np.cos(rod))
            z = z + reach * (turn * np.cos(rod) - (rod_by * v) ** 2 * np.sin(rod)) + gravity
            moment = self.inertia[1] * turn + self.mass[1] * reach * (np.cos(rod) * z - np.sin(rod) * x)
            rows = np.stack([np.tile(along, (len(angle), 1)), self.l * np.column_stack([np.sin(rod), -np.cos(rod)])], axis=1)
            return np.linalg.solve(rows, np.stack([pulled, moment], axis=1)[:, :, None])[:, :, 0]

        at_rest = forces(0.0, 9.81, 1.0)
        return at_rest, forces(1.0, 9.81, 1.0) - at_rest

    def mjcf(self, home: float, limit: float) -> str:
        """Return the model drawn at a crank angle, with a motor on the crank."""
        rod, place = (float(x) for x in self.pose(np.array(home)))
        d = float(np.cos(self.tilt)), float(np.sin(self.tilt))
        x, z = place * d[0] - self.offset * d[1], place * d[1] + self.offset * d[0]
        small = 'diaginertia="{0} {0} {0}"'
        return f"""<mujoco model="slider"><compiler angle="radian"/><option gravity="0 0 -9.81" timestep="0.0002"/>
<default><joint axis="0 -1 0"/></default><worldbody>
<body name="crank" euler="0 {-home!r} 0"><joint name="O" ref="{home!r}" damping="{self.damping[0]!r}"/>
<inertial pos="{self.r / 2!r} 0 0" mass="{self.mass[0]!r}" {small.format(self.inertia[0])}/>
<body name="rod" pos="{self.r!r} 0 0" euler="0 {home - rod!r} 0"><joint name="A" ref="{rod - home!r}"/>
<inertial pos="{self.centre * self.l!r} 0 0" mass="{self.mass[1]!r}" {small.format(self.inertia[1])}/>
<site name="end" pos="{self.l!r} 0 0"/></body></body>
<body name="slider" pos="{x!r} 0 {z!r}"><joint name="B" type="slide" axis="{d[0]!r} 0 {d[1]!r}" ref="{place!r}"
 stiffness="{self.spring!r}" springref="{self.relaxed!r}" damping="{self.damping[1]!r}"/>
<inertial pos="0 0 0" mass="{self.mass[2]!r}" {small.format(0.001)}/><site name="pin"/></body></worldbody>
<equality><connect name="P" site1="end" site2="pin"/></equality>
<actuator><motor name="act" joint="O" ctrlrange="{-limit!r} {limit!r}"/></actuator></mujoco>"""


@dataclass(frozen=True, kw_only=True, slots=True)
class Drawn:
    """A random problem: a file's tables, what is minimised, and the best value."""

    tables: dict
    minimize: str
    best: float


def drawn(seed: int, number: int) -> Drawn:
    """Return a random problem by its number: least time, one in three of them within a power, or least effort."""
    rng = np.random.default_rng([seed, number])
    while True:
        slider = random_slider(rng)
        start = float(rng.uniform(-np.pi, np.pi))
        goal = start + float(rng.choice([-1, 1]) * rng.uniform(0.5, 5.0))
        curves = _curves(slider, start, goal)
        weight = float(np.abs(curves.still(np.linspace(start, goal, _POSES))).max())
        limit = weight * float(rng.uniform(1.3, 4.0)) + 0.05
        effort = number % 2 == 1
        quickest = least_time_of(curves, start, goal, (-limit, limit), _NO_POWER)
        tables = {
            "mechanism": {"model": slider.mjcf(start, float(1000.0 * limit))},
            "motion": {"kind": "reach", "start_deg": {"O": np.degrees(start)}, "goal_deg": {"O": np.degrees(goal)}},
            "objective": {"minimize": "effort" if effort else "time"},
            "limits": {"effort": {"act": [-limit, limit]}},
        }
        if not effort:
            tables["motion"]["duration_s"] = "free"
            power = _NO_POWER
            if number % 3 == 0:
                most = float(rng.uniform(0.2, 0.8)) * limit * abs(goal - start) / quickest
                tables["limits"]["power_w"], power = {"act": [-most, most]}, (-most, most)
            return Drawn(tables=tables, minimize="time", best=least_time_of(curves, start, goal, (-limit, limit), power))
        tables["limits"]["effort"] = {"act": [-100.0 * limit, 100.0 * limit]}
        tables["motion"]["duration_s"] = duration = quickest * float(rng.uniform(0.8, 2.0))
        best = least_effort_of(curves, start, goal, duration)
        if best is not None:
            return Drawn(tables=tables, minimize="effort", best=best)


def drawn_with_a_pin(seed: int, number: int) -> Drawn:
    """Return a random least time within a pin's rating that is between what it bears at rest and what it would without."""
    rng = np.random.default_rng([seed, number, 12])
    while True:
        slider = random_slider(rng)
        start = float(rng.uniform(-np.pi, np.pi))
        goal = start + float(rng.choice([-1, 1]) * rng.uniform(0.5, 2.0))
        curves = _curves(slider, start, goal)
        angle = np.linspace(min(start, goal), max(start, goal), _POSES)
        weight = float(np.abs(curves.still(angle)).max())
        limit = weight * float(rng.uniform(1.3, 4.0)) + 0.05
        still, fast, back = (slider.pin_force(angle, v)[0] for v in (0.0, 1.0, -1.0))
        by_a = slider.pin_force(angle, 0.0)[1]
        parts = [still, 0.5 * (fast + back) - still, 0.5 * (fast - back), by_a]
        force = CubicSpline(angle, np.stack(parts, axis=1))
        highest = limit / curves.inertia(angle)
        rest, pushed = (np.linalg.norm(x, axis=1).max() for x in (still, still + by_a * highest[:, None]))
        rating = rest + float(rng.uniform(0.3, 0.7)) * (pushed - rest)
        within = _within_a_pin(curves, force, limit, rating)
        try:
            best = least_time_within(curves, start, goal, within)
        except ValueError:  # legs that end before they meet
            continue
        tables = {
            "mechanism": {"model": slider.mjcf(start, float(1000.0 * limit))},
            "motion": {"kind": "reach", "start_deg": {"O": np.degrees(start)}, "goal_deg": {"O": np.degrees(goal)}},
            "objective": {"minimize": "time"},
            "limits": {"effort": {"act": [-limit, limit]}, "closure_force": {"P": rating}},
        }
        tables["motion"]["duration_s"] = "free"
        return Drawn(tables=tables, minimize="time", best=best)


def _within_a_pin(curves: Curves, force: CubicSpline, limit: float, rating: float):
    """Return the function (place, speed) -> efforts at which a pin carries no more than its rating."""

    def within(s: float, v: float) -> tuple[float, float]:
        f = force(s)
        free = float(curves.still(s) + curves.square(s) * v**2 + curves.linear(s) * v)
        by_effort = f[3] / float(curves.inertia(s))
        given = f[0] + f[1] * v**2 + f[2] * v + by_effort * free
        a, b, c = by_effort @ by_effort, by_effort @ given, given @ given - rating**2
        if b * b < a * c:
            return 0.0, 0.0
        root = np.sqrt(b * b - a * c)
        return max(-limit, (-b - root) / a), min(limit, (-b + root) / a)

    return within


def random_slider(rng: np.random.Generator) -> Slider:
    """Return a random slider-crank, one in two of them with a spring."""
    size, heavy = float(10 ** rng.uniform(-1.5, 0.0)), float(10 ** rng.uniform(-0.5, 1.0))
    r = size * float(rng.uniform(0.3, 1.0))
    l = r * float(rng.uniform(1.6, 4.0))  # noqa: E741
    mass = tuple(heavy * float(m) for m in rng.uniform(0.2, 1.5, 3))
    weight = 9.81 * sum(mass)
    return Slider(
        r=r,
        l=l,
        offset=float(rng.uniform(-0.4, 0.4)) * (l - r),
        tilt=float(rng.uniform(-np.pi, np.pi)),
        mass=mass,
        inertia=tuple(mass[k] * x**2 * float(rng.uniform(0.05, 0.2)) for k, x in enumerate((r, l))),
        centre=float(rng.uniform(0.2, 0.8)),
        spring=float(rng.choice([0.0, 1.0])) * weight / r * float(rng.uniform(0.1, 1.0)),
        relaxed=l + r * float(rng.uniform(-1.0, 1.0)),
        damping=tuple(float(rng.choice([0.0, 0.05]) * weight * np.sqrt(r / 9.81)) * x for x in (r, 1.0 / 3.0)),
    )


def _curves(slider: Slider, start: float, goal: float) -> Curves:
    """Return M, and what M a comes to at rest, by v^2 and by v, as curves over the crank's angle."""
    room = 0.6 * abs(goal - start)
    angle = np.linspace(min(start, goal) - room, max(start, goal) + room, _POSES)
    inertia, energy = (CubicSpline(angle, of(angle)) for of in (slider.inertia_at, slider.potential))
    drag = CubicSpline(angle, -slider.drag(angle))
    slope, weight = inertia.derivative(), energy.derivative()
    return Curves(
        inertia=inertia,
        effort=lambda s: np.ones_like(s),
        still=CubicSpline(angle, -weight(angle)),
        square=CubicSpline(angle, -0.5 * slope(angle)),
        linear=drag,
    )
