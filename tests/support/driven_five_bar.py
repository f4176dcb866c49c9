"""Random planar five-bars with two motors, in closed form, and their least efforts by a spectral method.

Drawn at home, where both motors are at 0. Complex numbers are points of the plane, x + i z.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

# Shifted Legendre coefficients of each motor's path, and Gauss points of the integral; a coarser pair tells the error.
_COARSE, _FINE = (14, 40), (22, 64)
_AGREE = 1e-7
# The sine of the angle between the distal links, at the least.
_APART = 0.35


@dataclass(frozen=True, kw_only=True, slots=True)
class FiveBar:
    """Points at home [m], and of proximal 1, 2 and distal 1, 2: mass [kg], centre from the pivot [m], moment [kg m2].

    `damping` [N.m.s] is of both motors' joints.
    """

    bases: tuple[complex, complex]
    elbows: tuple[complex, complex]
    pin: complex
    mass: tuple[float, ...]
    centre: tuple[complex, ...]
    moment: tuple[float, ...]
    damping: float

    def efforts(self, s: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return torques (n, 2) by virtual work at motor angles, rates and accelerations (n, 2); and the clearance (n,)."""
        turned, angles, rates, bends, clear = self._angles(s, v, a)
        u = self.damping * v
        for k in range(4):
            centre = self.centre[k] * turned[k]
            # The centre's partial rates by both motors, and its acceleration.
            if k < 2:
                slope = [1j * centre if j == k else 0 * centre for j in range(2)]
                acceleration = (1j * bends[k] - rates[k] ** 2) * centre
            else:
                arm = (self.elbows[k - 2] - self.bases[k - 2]) * turned[k - 2]
                slope = [(1j * arm if j == k - 2 else 0) + 1j * centre * angles[j][k - 2] for j in range(2)]
                acceleration = (1j * bends[k - 2] - rates[k - 2] ** 2) * arm + (1j * bends[k] - rates[k] ** 2) * centre
            pull = self.mass[k] * (acceleration + 9.81j)
            for j in range(2):
                spun = (1.0 if j == k else 0.0) if k < 2 else angles[j][k - 2]
                u[:, j] += np.real(np.conj(pull) * slope[j]) + self.moment[k] * bends[k] * spun
        return u, clear

    def _angles(self, s: np.ndarray, v: np.ndarray, a: np.ndarray):
        """Return the links' turns, the distal ones' slopes by each motor, all rates and accelerations, and the clearance."""
        proximal = [np.exp(1j * s[:, k]) for k in range(2)]
        arms = [(self.elbows[k] - self.bases[k]) * proximal[k] for k in range(2)]
        ends = [self.bases[k] + arms[k] for k in range(2)]
        lengths = [abs(self.pin - elbow) for elbow in self.elbows]
        across = ends[1] - ends[0]
        far = np.abs(across)
        along = (lengths[0] ** 2 - lengths[1] ** 2 + far**2) / (2 * far)
        home = self.elbows[1] - self.elbows[0]
        side = np.sign(np.imag((self.pin - self.elbows[0]) / home))
        with np.errstate(invalid="ignore"):
            pin = ends[0] + (along + 1j * side * np.sqrt(lengths[0] ** 2 - along**2)) * across / far
        distal = [pin - ends[k] for k in range(2)]
        turned = proximal + [distal[k] / (self.pin - self.elbows[k]) for k in range(2)]

        def solved(right: np.ndarray) -> list[np.ndarray]:
            """Return x of x1 d1 - x2 d2 = right."""
            cross = np.imag(distal[0] * np.conj(distal[1]))
            return [np.imag(right * np.conj(distal[1])) / cross, np.imag(right * np.conj(distal[0])) / cross]

        slopes = [solved(-arms[0]), solved(arms[1])]
        spins = [slopes[0][k] * v[:, 0] + slopes[1][k] * v[:, 1] for k in range(2)]
        rates = [v[:, 0], v[:, 1], *spins]
        pulls = [(1j * a[:, k] - v[:, k] ** 2) * arms[k] for k in range(2)]
        bends = solved((pulls[1] - pulls[0] + spins[0] ** 2 * distal[0] - spins[1] ** 2 * distal[1]) / 1j)
        clear = np.abs(np.imag(distal[0] * np.conj(distal[1]))) / (lengths[0] * lengths[1])
        return turned, slopes, rates, [a[:, 0], a[:, 1], *bends], clear

    def joints(self, s: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the model's joints (4,) at one instant (1, 2), their slopes (4, 2), rates (4,) and accelerations (4,)."""
        turned, slopes, rates, bends, _ = self._angles(s, v, a)
        rows = [[1, 0], [slopes[0][0][0], slopes[1][0][0]], [0, 1], [slopes[0][1][0], slopes[1][1][0]]]
        columns = [np.array([one[k][0] for k in (0, 2, 1, 3)]) for one in ([np.angle(x) for x in turned], rates, bends)]
        # Distal links turn against their proximal ones.
        relative = np.eye(4) - np.diag([1.0, 0.0, 1.0], -1)
        q, rate, bend = (relative @ column for column in columns)
        return q, relative @ np.array(rows, dtype=float), rate, bend

    def pin_at(self, s: np.ndarray) -> np.ndarray:
        """Return where the pin is (3,) [m] at motor angles (2,)."""
        none = np.zeros((1, 2))
        turned = self._angles(np.array([s]), none, none)[0]
        pin = self.bases[0] + (self.elbows[0] - self.bases[0]) * turned[0] + (self.pin - self.elbows[0]) * turned[2]
        return np.array([pin[0].real, 0.0, pin[0].imag])

    def mjcf(self) -> str:
        """Return the model, whose motors' limits are far away."""

        def body(name: str, at: complex, k: int, joint: str, more: str) -> str:
            moment = " ".join([repr(self.moment[k])] * 3)
            return (
                f'<body name="b{name}" pos="{at.real!r} 0 {at.imag!r}"><joint name="{name}" {joint}/>'
                f'<inertial pos="{self.centre[k].real!r} 0 {self.centre[k].imag!r}" mass="{self.mass[k]!r}" '
                f'diaginertia="{moment}"/>{more}</body>'
            )

        bodies, damped = "", f'damping="{self.damping!r}"'
        for k in range(2):
            arm, rod = self.elbows[k] - self.bases[k], self.pin - self.elbows[k]
            pin = f'<site name="{("P", "P2")[k]}" pos="{rod.real!r} 0 {rod.imag!r}"/>'
            bodies += body(f"O{k + 1}", self.bases[k], k, damped, body(f"E{k + 1}", arm, k + 2, "", pin))
        return f"""<mujoco model="five-bar"><compiler angle="radian" autolimits="true"/>
<option gravity="0 0 -9.81" timestep="0.0002"/><default><joint axis="0 -1 0"/></default><worldbody>{bodies}</worldbody>
<equality><connect name="pin" site1="P" site2="P2"/></equality><actuator><motor name="act1" joint="O1" ctrlrange="-1e5 1e5"/>
<motor name="act2" joint="O2" ctrlrange="-1e5 1e5"/></actuator></mujoco>"""


def random_five_bar(rng: np.random.Generator) -> tuple[FiveBar, np.ndarray, float]:
    """Return a five-bar, a goal (2,) [rad] of its motors, and a duration [s]."""
    size, heavy = float(10 ** rng.uniform(-1.0, 0.0)), float(10 ** rng.uniform(-0.5, 0.7))

    def near(x: float, z: float) -> complex:
        return size * complex(x + rng.uniform(-0.15, 0.15), z + rng.uniform(-0.15, 0.15))

    bases, elbows, pin = (0j, near(0.7, 0.0)), (near(-0.5, 0.6), near(1.2, 0.6)), near(0.35, 1.4)
    links = [elbows[0] - bases[0], elbows[1] - bases[1], pin - elbows[0], pin - elbows[1]]
    mass = tuple(heavy * float(m) for m in rng.uniform(0.3, 1.5, 4))
    bar = FiveBar(
        bases=bases,
        elbows=elbows,
        pin=pin,
        mass=mass,
        centre=tuple(complex(link * rng.uniform(0.3, 0.7)) for link in links),
        moment=tuple(float(m * abs(link) ** 2 * rng.uniform(0.05, 0.2)) for m, link in zip(mass, links, strict=True)),
        damping=float(rng.choice([0.0, 0.02]) * heavy * 9.81 * size * np.sqrt(size / 9.81)),
    )
    goal = rng.uniform(0.2, 0.9, 2) * rng.choice([-1, 1], 2)
    return bar, goal, float(np.sqrt(size / 9.81) * rng.uniform(1.5, 4.0))


def least_effort(bar: FiveBar, goal: np.ndarray, duration: float) -> float | None:
    """Return the least integral of the torques' squares from rest at home to rest at a goal; None where it is not sure."""
    coarse = _spectral(bar, goal, duration, *_COARSE, None)
    fine = None if coarse is None else _spectral(bar, goal, duration, *_FINE, coarse[1])
    if fine is None or abs(fine[0] / coarse[0] - 1) > _AGREE or fine[2] < _APART:
        return None
    return fine[0]


def _spectral(bar: FiveBar, goal: np.ndarray, duration: float, n: int, points: int, begin: np.ndarray | None):
    """Return the least effort of polynomial paths, their coefficients (n, 2), and how far apart the distal links stay."""
    x, w = np.polynomial.legendre.leggauss(points)
    x, w = 0.5 * (x + 1), 0.5 * w * duration
    # Bends x^2 (1 - x)^2 P_k(2 x - 1): each leaves both ends at rest.
    legendre = np.polynomial.Legendre
    rest = np.polynomial.Polynomial([0, 0, 1, -2, 1]).convert(kind=legendre, domain=[0, 1])
    bumps = [rest * legendre.basis(k, domain=[0, 1]) for k in range(n)]
    straight = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    tables = [
        (np.array([b.deriv(d)(x) for b in bumps]).T / duration**d, straight.deriv(d)(x) / duration**d) for d in range(3)
    ]

    def at(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        bent = coefficients.reshape(n, 2)
        return bar.efforts(*(table @ bent + np.outer(line, goal) for table, line in tables))

    def residuals(coefficients: np.ndarray) -> np.ndarray:
        u = at(coefficients)[0]
        return np.nan_to_num((np.sqrt(w)[:, None] * u).ravel(), nan=1e6)

    start = np.zeros((n, 2))
    if begin is not None:
        start[: len(begin)] = begin
    if not np.all(np.isfinite(at(start.ravel())[0])):
        return None
    found = least_squares(residuals, start.ravel(), method="trf", jac="3-point", xtol=1e-13, ftol=1e-14, gtol=1e-13)
    if not found.success:
        return None
    return 2 * found.cost, found.x.reshape(n, 2), float(at(found.x)[1].min())
