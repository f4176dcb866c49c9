"""Imperfections of a simulated machine: the keys of [imperfections] with meanings, units and ranges. Quick to import."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

# The bound of quantities without a natural one, in their own units.
_MAX_QUANTITY = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A quantity that can be wrong: its meaning, unit, range, and the kind of object that has it.

    `of` is "" for the whole machine, "hinge" or "slide" (independent joints of that kind), "joint" (any), "actuator" or
    "body".
    """

    meaning: str
    unit: str
    low: float
    high: float
    of: str = ""
    otherwise: str = "as modelled"  # the default in words


QUANTITIES: Mapping[str, Quantity] = {
    "period_factor": Quantity(meaning="ratio of the controller's actual to its nominal period", unit="1", low=0.5, high=2.0),
    "phase_periods": Quantity(
        meaning="delay of the first control instant after the motion begins", unit="control periods", low=0.0, high=1.0
    ),
    "delay_periods": Quantity(
        meaning="added to tracking.delay_periods; may be fractional", unit="control periods", low=0.0, high=1000.0
    ),
    "encoder_resolution_deg": Quantity(
        meaning="step to which hinges' positions are rounded", unit="deg", low=0.0, high=360.0, of="hinge"
    ),
    "encoder_resolution_m": Quantity(
        meaning="step to which slides' positions are rounded", unit="m", low=0.0, high=_MAX_QUANTITY, of="slide"
    ),
    "encoder_offset_deg": Quantity(
        meaning="error of hinges' measured positions", unit="deg", low=-360.0, high=360.0, of="hinge"
    ),
    "encoder_offset_m": Quantity(
        meaning="error of slides' measured positions", unit="m", low=-_MAX_QUANTITY, high=_MAX_QUANTITY, of="slide"
    ),
    "position_noise_deg": Quantity(
        meaning="standard deviation of white noise on hinges' positions", unit="deg", low=0.0, high=360.0, of="hinge"
    ),
    "position_noise_m": Quantity(
        meaning="standard deviation of white noise on slides' positions", unit="m", low=0.0, high=_MAX_QUANTITY, of="slide"
    ),
    "velocity_noise_deg_s": Quantity(
        meaning="standard deviation of white noise on hinges' velocities, if these are measured directly",
        unit="deg/s",
        low=0.0,
        high=_MAX_QUANTITY,
        of="hinge",
    ),
    "velocity_noise_m_s": Quantity(
        meaning="standard deviation of white noise on slides' velocities, if these are measured directly",
        unit="m/s",
        low=0.0,
        high=_MAX_QUANTITY,
        of="slide",
    ),
    "velocity_filter_hz": Quantity(
        meaning="velocity is the difference of measured positions, filtered by a first-order low-pass of this cutoff",
        unit="Hz",
        low=1e-6,
        high=_MAX_QUANTITY,
    ),
    "torque_resolution": Quantity(
        meaning="step to which commands are rounded", unit="N.m or N", low=0.0, high=_MAX_QUANTITY, of="actuator"
    ),
    "torque_bandwidth_hz": Quantity(
        meaning="bandwidth of the drive's first-order lag", unit="Hz", low=1e-6, high=_MAX_QUANTITY, of="actuator"
    ),
    "torque_rate": Quantity(
        meaning="largest rate of the drive's effort", unit="N.m/s or N/s", low=1e-9, high=1e15, of="actuator"
    ),
    "torque_constant_factor": Quantity(
        meaning="ratio of actual to commanded effort", unit="1", low=0.01, high=100.0, of="actuator"
    ),
    "viscous_friction": Quantity(
        meaning="damping of any joint, added to the model's",
        unit="N.m.s/rad or N.s/m",
        low=0.0,
        high=_MAX_QUANTITY,
        of="joint",
    ),
    "coulomb_friction": Quantity(
        meaning="dry friction of any joint", unit="N.m or N", low=0.0, high=_MAX_QUANTITY, of="joint"
    ),
    "payload_mass_factor": Quantity(
        meaning="factor on the mass and inertia of the payload, or of all moving bodies if there is none",
        unit="1",
        low=1e-3,
        high=1e3,
    ),
    "payload_com_x_m": Quantity(
        meaning="shift of the payload's centre of mass along x of its body", unit="m", low=-_MAX_QUANTITY, high=_MAX_QUANTITY
    ),
    "payload_com_y_m": Quantity(meaning="shift along y", unit="m", low=-_MAX_QUANTITY, high=_MAX_QUANTITY),
    "payload_com_z_m": Quantity(meaning="shift along z", unit="m", low=-_MAX_QUANTITY, high=_MAX_QUANTITY),
    "link_length_factor": Quantity(
        meaning="scales all points fixed to a link about its joint; the loop is assembled again",
        unit="1",
        low=0.1,
        high=10.0,
        of="body",
    ),
    "push_start_s": Quantity(meaning="time at which a push begins", unit="s", low=0.0, high=_MAX_QUANTITY, otherwise="0"),
    "push_duration_s": Quantity(meaning="duration of the push", unit="s", low=0.0, high=_MAX_QUANTITY, otherwise="none"),
    "push_force_x_n": Quantity(
        meaning="force along x of the world on push_body's centre of mass",
        unit="N",
        low=-_MAX_QUANTITY,
        high=_MAX_QUANTITY,
        otherwise="none",
    ),
    "push_force_y_n": Quantity(meaning="force along y", unit="N", low=-_MAX_QUANTITY, high=_MAX_QUANTITY, otherwise="none"),
    "push_force_z_n": Quantity(meaning="force along z", unit="N", low=-_MAX_QUANTITY, high=_MAX_QUANTITY, otherwise="none"),
    "push_effort": Quantity(
        meaning="effort on push_joint", unit="N.m or N", low=-_MAX_QUANTITY, high=_MAX_QUANTITY, otherwise="none"
    ),
    "start_error_deg": Quantity(
        meaning="hinges' initial distance from the path", unit="deg", low=-360.0, high=360.0, of="hinge"
    ),
    "start_error_m": Quantity(
        meaning="slides' initial distance from the path", unit="m", low=-_MAX_QUANTITY, high=_MAX_QUANTITY, of="slide"
    ),
    "start_velocity_error_deg_s": Quantity(
        meaning="hinges' initial velocity error", unit="deg/s", low=-_MAX_QUANTITY, high=_MAX_QUANTITY, of="hinge"
    ),
    "start_velocity_error_m_s": Quantity(
        meaning="slides' initial velocity error", unit="m/s", low=-_MAX_QUANTITY, high=_MAX_QUANTITY, of="slide"
    ),
    "loop_time_constant_s": Quantity(
        meaning="time constant of the loop constraint in MuJoCo's solref; at least two simulator steps",
        unit="s",
        low=1e-9,
        high=_MAX_QUANTITY,
    ),
    "loop_damping_ratio": Quantity(meaning="damping ratio of the loop constraint", unit="1", low=1e-3, high=1e3),
}
# Keys whose values are names and not distributions.
WORDS: Mapping[str, str] = {
    "push_body": "the body that a push's force acts on",
    "push_joint": "the joint that a push's effort acts on",
}
# The legal forms of a value.
FORMS = "a number, a range [low, high], { uniform = [low, high] } or { normal = [mean, std] }"


def spread_schema(quantity: Quantity) -> dict[str, Any]:
    """Return the JSON Schema of a quantity's value: `FORMS`, or a table of these by name."""
    value = {"type": "number", "minimum": quantity.low, "maximum": quantity.high}
    deviation = {"type": "number", "minimum": 0, "maximum": 1e15}
    uniform = {"type": "array", "items": value, "minItems": 2, "maxItems": 2}
    normal = {"type": "array", "prefixItems": [value, deviation], "minItems": 2, "maxItems": 2}
    laws = {"uniform": uniform, "normal": normal}
    law = {"type": "object", "properties": laws, "additionalProperties": False, "minProperties": 1, "maxProperties": 1}
    forms = [value, uniform, law]
    if quantity.of:
        names = {"not": {"enum": list(laws)}}
        forms.append({"type": "object", "additionalProperties": {"anyOf": [*forms]}, "propertyNames": names})
    return {"anyOf": forms}
