"""The section [imperfections]: quantities of simulated machines that can be wrong, each with its range and owner."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta
from msgspec.structs import fields

from linkplan.planner.problem.keys.section import Section, key

# The bound of quantities without a natural one, in their own units.
_MAX_QUANTITY = 1e9
# The legal forms of a value.
FORMS = "a number, a range [low, high], { uniform = [low, high] } or { normal = [mean, std] }"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that can be wrong: its unit, its range, and what has it.

    `of` is "" for the whole machine, "hinge" or "slide" (independent joints of that kind), "joint" (any), "actuator" or
    "body".
    """

    unit: str
    low: float
    high: float
    of: str

    @property
    def kind(self) -> Any:
        """The type of its value: `FORMS`, or a table of these by name."""
        value = {"type": "number", "minimum": self.low, "maximum": self.high}
        deviation = {"type": "number", "minimum": 0, "maximum": 1e15}
        uniform = {"type": "array", "items": value, "minItems": 2, "maxItems": 2}
        normal = {"type": "array", "prefixItems": [value, deviation], "minItems": 2, "maxItems": 2}
        laws = {"uniform": uniform, "normal": normal}
        law = {"type": "object", "properties": laws, "additionalProperties": False, "minProperties": 1, "maxProperties": 1}
        forms = [value, uniform, law]
        if self.of:
            names = {"not": {"enum": list(laws)}}
            forms.append({"type": "object", "additionalProperties": {"anyOf": [*forms]}, "propertyNames": names})
        said = f"{FORMS}, or a table of these by name" if self.of else FORMS
        return Annotated[Any, Meta(extra={"said": said, "quantity": self}, extra_json_schema={"anyOf": forms})]


def _quantity(
    meaning: str,
    unit: str,
    low: float = -_MAX_QUANTITY,
    high: float = _MAX_QUANTITY,
    of: str = "",
    otherwise: str = "nominal",
    twin: bool = False,
) -> Any:
    """Return the description of a quantity's key; with `twin` that of hinges, which declares the key of slides too."""
    kind = Quantity(unit or "1", low, high, of).kind
    if not twin:
        return key(meaning, unit, otherwise, kind=kind)
    of_slides = Quantity(unit.replace("deg", "m"), -_MAX_QUANTITY if low < 0 else 0.0, _MAX_QUANTITY, "slide").kind
    return key(meaning, unit, otherwise, twin=(), kind=kind, twin_kind=of_slides)


def _word(meaning: str) -> Any:
    return key(meaning, "", "none", kind=Annotated[str, Meta(min_length=1, extra={"said": "a name"})])


class ImperfectionsSection(Section, frozen=True):
    """Imperfections of simulated machines, as a value or a distribution for each quantity."""

    period_factor: Any = _quantity("ratio of the controller's actual to its nominal period", "", 0.5, 2.0)
    phase_periods: Any = _quantity("delay of the first control instant after the motion begins", "control periods", 0.0, 1.0)
    delay_periods: Any = _quantity("added to tracking.delay_periods; may be fractional", "control periods", 0.0, 1000.0)
    encoder_resolution_deg: Any = _quantity(
        "step to which hinges' positions are rounded", "deg", 0.0, 360.0, "hinge", twin=True
    )
    encoder_offset_deg: Any = _quantity("error of hinges' measured positions", "deg", -360.0, 360.0, "hinge", twin=True)
    position_noise_deg: Any = _quantity(
        "standard deviation of white noise on hinges' positions", "deg", 0.0, 360.0, "hinge", twin=True
    )
    velocity_noise_deg_s: Any = _quantity(
        "standard deviation of white noise on hinges' velocities, if these are measured directly",
        "deg/s",
        0.0,
        of="hinge",
        twin=True,
    )
    velocity_filter_hz: Any = _quantity(
        "velocity is the difference of measured positions, filtered by a first-order low-pass of this cutoff",
        "Hz",
        1e-6,
    )
    torque_resolution: Any = _quantity("step to which commands are rounded", "N.m or N", 0.0, of="actuator")
    torque_bandwidth_hz: Any = _quantity("bandwidth of the drive's first-order lag", "Hz", 1e-6, of="actuator")
    torque_rate: Any = _quantity("largest rate of the drive's effort", "N.m/s or N/s", 1e-9, 1e15, of="actuator")
    torque_constant_factor: Any = _quantity("ratio of actual to commanded effort", "", 0.01, 100.0, of="actuator")
    viscous_friction: Any = _quantity("damping of any joint, added to the model's", "N.m.s/rad or N.s/m", 0.0, of="joint")
    coulomb_friction: Any = _quantity("dry friction of any joint", "N.m or N", 0.0, of="joint")
    payload_mass_factor: Any = _quantity(
        "factor on the mass and inertia of the payload, or of all moving bodies if there is none",
        "",
        0.001,
        1000.0,
    )
    payload_com_x_m: Any = _quantity("shift of the payload's centre of mass along x of its body", "m")
    payload_com_y_m: Any = _quantity("shift along y", "m")
    payload_com_z_m: Any = _quantity("shift along z", "m")
    link_length_factor: Any = _quantity(
        "scales all points fixed to a link about its joint; the loop is assembled again",
        "",
        0.1,
        10.0,
        of="body",
    )
    push_start_s: Any = _quantity("time at which a push begins", "s", 0.0, otherwise="0")
    push_duration_s: Any = _quantity("duration of the push", "s", 0.0, otherwise="none")
    push_force_x_n: Any = _quantity("force along x of the world on push_body's centre of mass", "N", otherwise="none")
    push_force_y_n: Any = _quantity("force along y", "N", otherwise="none")
    push_force_z_n: Any = _quantity("force along z", "N", otherwise="none")
    push_effort: Any = _quantity("effort on push_joint", "N.m or N", otherwise="none")
    start_error_deg: Any = _quantity("hinges' initial distance from the path", "deg", -360.0, 360.0, "hinge", twin=True)
    start_velocity_error_deg_s: Any = _quantity("hinges' initial velocity error", "deg/s", of="hinge", twin=True)
    loop_time_constant_s: Any = _quantity(
        "time constant of the loop constraint in MuJoCo's solref; at least two simulator steps", "s", 1e-9
    )
    loop_damping_ratio: Any = _quantity("damping ratio of the loop constraint", "", 0.001, 1000.0)
    push_body: Any = _word("the body that a push's force acts on")
    push_joint: Any = _word("the joint that a push's effort acts on")


_FIELDS = {field.name: field.type.__metadata__[0].extra.get("quantity") for field in fields(ImperfectionsSection)}
QUANTITIES: Mapping[str, Quantity] = {name: quantity for name, quantity in _FIELDS.items() if quantity is not None}
# Keys whose values are names and not distributions.
WORDS = tuple(name for name, quantity in _FIELDS.items() if quantity is None)
