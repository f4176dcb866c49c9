"""A rigid payload welded to a body of a model: mass, centre of mass, inertia."""

import numbers
from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from linkplan.models.catalogue import PAYLOADS
from linkplan.models.errors import ModelError
from linkplan.models.names import choose, nearest

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
    inertia_kgm2: np.ndarray

    def __post_init__(self) -> None:
        for name in ("com_m", "inertia_kgm2"):
            try:
                value = np.array(getattr(self, name), dtype=float)
            except (TypeError, ValueError, OverflowError):
                value = np.zeros(0)
            if value.shape != (3,) or not np.all(np.isfinite(value)):
                raise ModelError(f"payload.{name} is three finite numbers, got {getattr(self, name)!r}")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        number = isinstance(self.mass_kg, numbers.Real) and not isinstance(self.mass_kg, bool)
        if not number or not 0 < self.mass_kg < MAX_SI_VALUE:
            raise ModelError(f"payload.mass_kg is a positive number, got {self.mass_kg!r}")
        if np.abs([*self.com_m, *self.inertia_kgm2]).max() > MAX_SI_VALUE:
            raise ModelError("payload.com_m and payload.inertia_kgm2 are too large for a mechanism")
        moments = np.sort(self.inertia_kgm2)
        if moments[0] < 0:
            raise ModelError(f"payload.inertia_kgm2 has no negative moments, got {self.inertia_kgm2.tolist()}")
        if moments[2] > moments[:2].sum() * (1 + 1e-9):  # 1e-9 is rounding of typed numbers
            raise ModelError(
                "payload.inertia_kgm2 belongs to no rigid body: the largest moment exceeds the sum of the other two,"
                f" got {self.inertia_kgm2.tolist()}"
            )

    def numbers(self) -> np.ndarray:
        """Return mass, centre of mass and moments of inertia (7,), the parameters of `symbolic`."""
        return np.concatenate([[self.mass_kg], self.com_m, self.inertia_kgm2])

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

_KEYS = ("body", "mass_kg", "com_m", "inertia_kgm2")


def payload_from(value: object) -> Payload | None:
    """Return the payload of a problem file's `mechanism.payload`: a built-in name, a table, or "none"."""
    if value is None or value == "none":
        return None
    if isinstance(value, Payload):
        return value
    if isinstance(value, str):
        return BUILT_IN[choose("payload", value, [*BUILT_IN, "none"])]
    if not isinstance(value, Mapping):
        raise ModelError(f"payload is a built-in name ({', '.join(BUILT_IN)}) or a table, got {value!r}")
    for key in value:
        if key not in _KEYS:
            raise ModelError(f"unknown key 'payload.{key}'{nearest(str(key), _KEYS)}; keys are {', '.join(_KEYS)}")
    missing = [key for key in _KEYS[:3] if key not in value]
    if missing:
        raise ModelError(f"payload needs {', '.join(_KEYS[:3])}; missing {', '.join(missing)}")
    if not isinstance(value["body"], str):
        raise ModelError(f"payload.body is a body's name, got {value['body']!r}")
    return Payload(
        body=value["body"],
        mass_kg=value["mass_kg"],
        com_m=value["com_m"],
        inertia_kgm2=value.get("inertia_kgm2", [0.0, 0.0, 0.0]),
    )


def attach(spec: mujoco.MjSpec, payload: Payload) -> None:
    """Weld the payload to its body in `spec`."""
    names = [body.name for body in spec.bodies if body.name and body.name != "world"]
    if payload.body not in names:
        raise ModelError(
            f"payload.body '{payload.body}' is not a body of the model{nearest(payload.body, names)};"
            f" bodies are {', '.join(names) or 'all unnamed'}"
        )
    body = spec.body(payload.body).add_body(name=BODY_NAME)
    body.explicitinertial = True
    body.mass = payload.mass_kg
    body.ipos = payload.com_m
    body.inertia = payload.inertia_kgm2
