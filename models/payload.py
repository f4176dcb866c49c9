"""A rigid payload welded to a body of a model: mass, centre of mass, inertia."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from linkplan.models.catalogue import PAYLOADS
from linkplan.models.errors import ModelError, choose

BODY_NAME = "linkplan_payload"

# Largest number in SI units of a model or payload: products of larger numbers overflow.
MAX_SI_VALUE = 1e12


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Payload:
    """A rigid body welded to `body`.

    `com_m` (3,) [m] is the centre of mass in the body's frame; `inertia_kgm2` (3,) [kg m2] holds the moments about axes
    parallel to the body's frame through the centre of mass.
    """

    body: str
    mass_kg: float
    com_m: np.ndarray
    inertia_kgm2: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("com_m", "inertia_kgm2"):
            value = np.array(getattr(self, name), dtype=float)
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        if not 0 < self.mass_kg < MAX_SI_VALUE:
            raise ModelError(f"payload.mass_kg must be a positive number, got {self.mass_kg!r}")
        moments = np.sort(self.inertia_kgm2)
        if moments[2] > moments[:2].sum() * (1 + 1e-9):  # 1e-9 is rounding of typed numbers
            raise ModelError(
                "payload.inertia_kgm2 is not that of a rigid body: the largest moment exceeds the sum of the other two,"
                f" got {self.inertia_kgm2.tolist()}"
            )

    def as_in(self, model: mujoco.MjModel) -> "Payload":
        """Return the payload with the numbers that it has in a compiled model."""
        body = model.body(BODY_NAME)
        return replace(self, mass_kg=float(body.mass[0]), com_m=body.ipos, inertia_kgm2=body.inertia)

    def table(self) -> dict:
        """Return the payload as a table of a problem file."""
        return {
            "body": self.body,
            "mass_kg": float(self.mass_kg),
            "com_m": self.com_m.tolist(),
            "inertia_kgm2": self.inertia_kgm2.tolist(),
        }

    def scaled(self, factor: float) -> "Payload":
        """Return the payload with mass and inertia multiplied by `factor`, its centre of mass kept."""
        return replace(self, mass_kg=self.mass_kg * factor, inertia_kgm2=self.inertia_kgm2 * factor)


# The shank of the source's knee. It points along the world's -x if the knee is straight (q_O = 56.27 deg). Only the moment
# about y affects the motion of a planar linkage.
SHANK = Payload(
    body="crank",
    mass_kg=4.0,
    com_m=np.array([-0.11105599230618464, 0.0, -0.16633269844768545]),
    inertia_kgm2=np.array([0.05, 0.05, 0.05]),
)

BUILT_IN: Mapping[str, Payload] = dict(zip(PAYLOADS, (SHANK,), strict=True))


def payload_from(value: Payload | str | Mapping | None) -> Payload | None:
    """Return the payload of a problem file's `mechanism.payload`: a built-in name, a table, or "none".

    The file's reader has checked the table's keys and their types (`planner.problem.keys`).
    """
    if value is None or value == "none":
        return None
    if isinstance(value, str):
        return BUILT_IN[choose("payload", value, [*BUILT_IN, "none"])]
    return Payload(**value) if isinstance(value, Mapping) else value


def attach(spec: mujoco.MjSpec, payload: Payload) -> None:
    """Weld the payload to its body in `spec`."""
    names = [body.name for body in spec.bodies if body.name and body.name != "world"]
    body = spec.body(choose("payload.body", payload.body, names)).add_body(name=BODY_NAME)
    body.explicitinertial = True
    body.mass = payload.mass_kg
    body.ipos = payload.com_m
    body.inertia = payload.inertia_kgm2
