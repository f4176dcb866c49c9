"""The limits of a problem, each declared once with its key; the sections [limits], [motors] and [robust] of a file.

    speed: Annotated[Rows, KeyOf("speed_deg_s", "joint", kinds.Speeds, "hinges' speeds", "deg/s")]

declares the field `speed` of `Limits`, rows [low, high] of all joints in SI, and the keys speed_deg_s and speed_m_s.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Self

import msgspec
from msgspec import Meta

from linkplan.planner.problem.keys import kinds
from linkplan.planner.problem.keys.section import KeyOf, Section, by_name, key, keys_of, required, section_of

if TYPE_CHECKING:
    import numpy as np

    Rows = np.ndarray
else:  # keys are loaded without NumPy
    Rows = Any
ByName = Mapping[str, float]
# The default of rows before construction; readers of a field never find it.
UNLIMITED: Any = None


class Box(Section, frozen=True):
    """Bounds on a site's coordinates."""

    x: kinds.Interval = key("[low, high] of x; ends may be infinite", "m", "any")
    y: kinds.Interval = key("[low, high] of y", "m", "any")
    z: kinds.Interval = key("[low, high] of z", "m", "any")


class Wall(Section, frozen=True):
    """A plane; a site stays on one of its sides."""

    normal: kinds.Point = required("points to the allowed side")
    at: kinds.Point = required("a point of the wall", "m")


class Tube(Section, frozen=True):
    """A polyline to which a site stays near."""

    along: kinds.Corners = required("the corners of the polyline", "m")
    radius_m: kinds.Positive = required("the largest distance of the site from the polyline", "m")


# The reader distinguishes them by their keys, in this order.
SITE_LIMITS: tuple[type[Wall] | type[Tube] | type[Box], ...] = (Wall, Tube, Box)
_SITE_LIMIT = Meta(
    extra={"said": "a box, a wall or a tube", "shapes": SITE_LIMITS},
    extra_json_schema={"minProperties": 1, "anyOf": [{"$ref": f"#/$defs/{shape.__name__}"} for shape in SITE_LIMITS]},
)
SiteLimitTable = Annotated[dict[str, Any], _SITE_LIMIT]
_SITES = Meta(extra={"of": "site = limits", "noun": "site"})


_Shapes = Annotated[dict[str, SiteLimitTable | list[SiteLimitTable]], _SITES]
_OWN, _ALL, _ENDS = "the model's own", "dependent joints too", "a number for both directions, or [low, high]"
_NO_JUMPS = "accelerations then have no jumps, not even from rest"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LimitValues:
    """The fields of `Limits`, in the order of their keys in [limits]; rows that are None become rows without limits."""

    effort: Annotated[Rows, KeyOf("effort", "actuator", kinds.Efforts, "[low, high] by actuator", "N.m, N", _OWN)]
    position: Annotated[
        Rows, KeyOf("range_deg", "joint", kinds.Ranges, f"hinges' ranges, {_ALL}, within the model's own", "deg", _OWN)
    ]
    speed: Annotated[Rows, KeyOf("speed_deg_s", "joint", kinds.Speeds, f"hinges' speeds, {_ALL}: {_ENDS}", "deg/s")] = (
        UNLIMITED
    )
    acceleration: Annotated[
        Rows, KeyOf("acceleration_deg_s2", "joint", kinds.Speeds, f"hinges' accelerations, {_ALL}: {_ENDS}", "deg/s2")
    ] = UNLIMITED
    jerk: Annotated[Rows, KeyOf("jerk_deg_s3", "joint", kinds.Speeds, f"hinges' jerk, {_ALL}; {_NO_JUMPS}", "deg/s3")] = (
        UNLIMITED
    )
    site_speed: Annotated[
        ByName, KeyOf("site_speed_m_s", "site", kinds.SiteSpeeds, "the largest speed of a site, such as a feed rate", "m/s")
    ] = UNLIMITED
    site_acceleration: Annotated[
        ByName,
        KeyOf("site_acceleration_m_s2", "site", kinds.SiteAccelerations, "the largest acceleration of a site", "m/s2"),
    ] = UNLIMITED
    site_jerk: Annotated[
        ByName, KeyOf("site_jerk_m_s3", "site", kinds.SiteJerks, f"the largest jerk of a site; {_NO_JUMPS}", "m/s3")
    ] = UNLIMITED
    effort_rate: Annotated[
        Rows,
        KeyOf(
            "effort_rate",
            "actuator",
            kinds.ActuatorLimits,
            "rate of efforts by actuator; efforts then have no jumps",
            "N.m/s, N/s",
        ),
    ] = UNLIMITED
    initial_effort: Annotated[
        Rows,
        KeyOf(
            "initial_effort",
            "actuator",
            kinds.ActuatorEfforts,
            "efforts before the start, of actuators with effort_rate; by default those that hold a start at rest",
            "N.m, N",
        ),
    ] = UNLIMITED
    power: Annotated[
        Rows,
        KeyOf("power_w", "actuator", kinds.ActuatorLimits, "mechanical power by actuator: a number, or [low, high]", "W"),
    ] = UNLIMITED
    closure_force: Annotated[
        Rows, KeyOf("closure_force", "closure", kinds.ClosureLimits, "the largest force on a closure's pin", "N")
    ] = UNLIMITED
    pin_force: Annotated[
        ByName,
        KeyOf("pin_force", "pin", kinds.PinLimits, "the largest force in the pin, slide or ball of a joint or closure", "N"),
    ] = UNLIMITED
    friction: Annotated[
        ByName,
        KeyOf(
            "friction",
            "contact",
            kinds.Frictions,
            "coefficients of friction of sites that stand on the ground: it pushes on them, within the friction cone",
        ),
    ] = UNLIMITED
    reserve: Annotated[
        float, KeyOf("reserve", "", kinds.Margin, "the share of every effort range that is reserved for feedback")
    ] = 0.0
    singular_margin: Annotated[
        float,
        KeyOf("singular_margin", "", kinds.Margin, "the least |det J_z| along the motion, relative to its value at home"),
    ] = 0.0
    site: Annotated[
        tuple[Any, ...],
        KeyOf("site", "site", _Shapes, "boxes, walls and tubes that sites stay within, one or a list of them", "m"),
    ] = ()
    body: Annotated[
        tuple[Any, ...],
        KeyOf(
            "body_deg",
            "body",
            kinds.BodyRanges,
            "bodies' angles, [low, high]; infinite ends limit nothing and show the angle",
            "deg",
        ),
    ] = ()
    contacts: Annotated[
        str,
        KeyOf(
            "contacts",
            "",
            kinds.Contacts,
            "refuse a plan in which geoms collide, or note the collision and ignore contact forces",
        ),
    ] = "refuse"
    unhonoured: Annotated[
        str,
        KeyOf(
            "unhonoured",
            "",
            kinds.Contacts,
            "refuse a model with forces that plans neglect, or note these forces and plan without them",
        ),
    ] = "refuse"


# The keys in [limits] by the names of the fields.
LIMIT_KEYS: Mapping[str, KeyOf] = keys_of(LimitValues)
if TYPE_CHECKING:
    LimitsSection = Section
else:
    LimitsSection = section_of(LimitValues, "LimitsSection", "Limits at every instant.")


class Motor(Section, frozen=True):
    """The motor behind an actuator, in the actuator's own effort and speed."""

    torque_constant: kinds.Positive = key(
        "effort per current; with resistance_ohm it gives the copper loss", "N.m/A, N/A", "unknown"
    )
    resistance_ohm: kinds.Positive = key("of the winding", "ohm", "unknown")
    stall_effort: kinds.Positive = key("at rest; with the no-load speed it gives the torque-speed line", "N.m, N", "unknown")
    no_load_speed_deg_s: kinds.Positive = key(
        "of an actuator that turns", "deg/s", "unknown", twin=(("that turns", "whose effort is a force"),)
    )

    @property
    def no_load_speed(self) -> float | None:
        """The no-load speed [rad/s or m/s]."""
        turning = self.no_load_speed_deg_s
        return self.no_load_speed_m_s if turning is None else math.radians(turning)

    @property
    def line(self) -> tuple[float, float] | None:
        """The stall effort and no-load speed of the line |u / stall + w / no_load| <= 1, w the actuator's speed."""
        return None if self.stall_effort is None or self.no_load_speed is None else (self.stall_effort, self.no_load_speed)

    @property
    def loss(self) -> float:
        """Copper loss per squared effort, R / k^2; 0 where unknown."""
        k, R = self.torque_constant, self.resistance_ohm
        return 0.0 if k is None or R is None else R / k**2

    def with_line(self, factor: float) -> Self:
        """Return the motor with its line multiplied by a factor; without one if that is infinite."""
        given = {name: getattr(self, name) for name in ("stall_effort", "no_load_speed_deg_s", "no_load_speed_m_s")}
        return self.replace(**{name: end and end * factor if math.isfinite(factor) else None for name, end in given.items()})


_TOGETHER = {"torque_constant": ["resistance_ohm"], "resistance_ohm": ["torque_constant"]}
MotorTable = Annotated[Motor, Meta(extra_json_schema={"dependentRequired": _TOGETHER})]


_ONE = msgspec.field(default_factory=functools.partial(list, (1.0, 1.0)))


class RobustSection(Section, frozen=True):
    """Ranges of machines; one motion satisfies all effort limits at each of their corners."""

    payload_factor: kinds.Interval = key(
        "[low, high] of the factor on the payload's mass and inertia", "", "[1, 1]", default=_ONE
    )
    torque_constant_factor: kinds.Interval = key(
        "[low, high] of the ratio of an actuator's actual to commanded effort", "", "[1, 1]", default=_ONE
    )
    viscous_friction: kinds.Ranges = by_name(
        "[low, high] of a joint's damping, added to the model's",
        "N.m.s/rad, N.s/m",
        "none",
    )
    coulomb_friction: kinds.Ranges = by_name("[low, high] of a joint's dry friction, of either sign", "N.m, N", "none")
    parameters: kinds.ParameterNames = key(
        "numbers of the model, named and with a range in [parameters], whose every combination of ends is a machine",
        otherwise="none",
        default=[],
    )
