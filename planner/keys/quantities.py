"""What can be wrong with a simulated machine: the keys of [imperfections], their meanings, units and ranges. Light."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

_MOST = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A quantity that can be wrong: its meaning, its unit, what is legal, and what has one each.

    `of` is "" for the whole machine, "hinge" or "slide" (independent joints of that kind), "joint" (any), "actuator" or
    "body".
    """

    meaning: str
    unit: str
    low: float
    high: float
    of: str = ""
    otherwise: str = "as modelled"  # what holds where the key is left out, in words


QUANTITIES: Mapping[str, Quantity] = {
    "period_factor": Quantity(
        meaning="the controller's clock: instant k comes at k control periods times this", unit="1", low=0.5, high=2.0
    ),
    "phase_periods": Quantity(
        meaning="the first instant comes so much later than the motion begins", unit="control periods", low=0.0, high=1.0
    ),
    "delay_periods": Quantity(
        meaning="of computing, beside tracking.delay_periods; fractions too", unit="control periods", low=0.0, high=1000.0
    ),
    "encoder_resolution_deg": Quantity(
        meaning="hinges' positions are rounded to such steps", unit="deg", low=0.0, high=360.0, of="hinge"
    ),
    "encoder_resolution_m": Quantity(
        meaning="slides' positions are rounded to such steps", unit="m", low=0.0, high=_MOST, of="slide"
    ),
    "encoder_offset_deg": Quantity(
        meaning="hinges' positions are read so much too large", unit="deg", low=-360.0, high=360.0, of="hinge"
    ),
    "encoder_offset_m": Quantity(
        meaning="slides' positions are read so much too large", unit="m", low=-_MOST, high=_MOST, of="slide"
    ),
    "position_noise_deg": Quantity(
        meaning="standard deviation of white noise on hinges' positions", unit="deg", low=0.0, high=360.0, of="hinge"
    ),
    "position_noise_m": Quantity(
        meaning="standard deviation of white noise on slides' positions", unit="m", low=0.0, high=_MOST, of="slide"
    ),
    "velocity_noise_deg_s": Quantity(
        meaning="standard deviation of white noise on hinges' velocities that are measured as they are",
        unit="deg/s",
        low=0.0,
        high=_MOST,
        of="hinge",
    ),
    "velocity_noise_m_s": Quantity(
        meaning="standard deviation of white noise on slides' velocities that are measured as they are",
        unit="m/s",
        low=0.0,
        high=_MOST,
        of="slide",
    ),
    "velocity_filter_hz": Quantity(
        meaning="velocity is the measured position's difference, low-pass filtered to the first order",
        unit="Hz",
        low=1e-6,
        high=_MOST,
    ),
    "torque_resolution": Quantity(
        meaning="commands are rounded to such steps", unit="N.m or N", low=0.0, high=_MOST, of="actuator"
    ),
    "torque_bandwidth_hz": Quantity(meaning="the drive's first-order lag", unit="Hz", low=1e-6, high=_MOST, of="actuator"),
    "torque_rate": Quantity(meaning="the drive's fastest change", unit="N.m/s or N/s", low=1e-9, high=1e15, of="actuator"),
    "torque_constant_factor": Quantity(
        meaning="what acts over what was commanded", unit="1", low=0.01, high=100.0, of="actuator"
    ),
    "viscous_friction": Quantity(
        meaning="damping of any joint beside the model's", unit="N.m.s/rad or N.s/m", low=0.0, high=_MOST, of="joint"
    ),
    "coulomb_friction": Quantity(meaning="dry friction of any joint", unit="N.m or N", low=0.0, high=_MOST, of="joint"),
    "payload_mass_factor": Quantity(
        meaning="on the payload's mass and inertia; on all moving bodies' without one", unit="1", low=1e-3, high=1e3
    ),
    "payload_com_x_m": Quantity(
        meaning="the payload's centre of mass is so far away, in its body's axes", unit="m", low=-_MOST, high=_MOST
    ),
    "payload_com_y_m": Quantity(meaning="the same along y", unit="m", low=-_MOST, high=_MOST),
    "payload_com_z_m": Quantity(meaning="the same along z", unit="m", low=-_MOST, high=_MOST),
    "link_length_factor": Quantity(
        meaning="scales all points fixed to a link about its joint; the loop is assembled anew",
        unit="1",
        low=0.1,
        high=10.0,
        of="body",
    ),
    "push_start_s": Quantity(meaning="when a push begins", unit="s", low=0.0, high=_MOST, otherwise="0"),
    "push_duration_s": Quantity(meaning="how long it lasts", unit="s", low=0.0, high=_MOST, otherwise="none"),
    "push_force_x_n": Quantity(
        meaning="a force on push_body's centre of mass, in the world's axes",
        unit="N",
        low=-_MOST,
        high=_MOST,
        otherwise="none",
    ),
    "push_force_y_n": Quantity(meaning="the same along y", unit="N", low=-_MOST, high=_MOST, otherwise="none"),
    "push_force_z_n": Quantity(meaning="the same along z", unit="N", low=-_MOST, high=_MOST, otherwise="none"),
    "push_effort": Quantity(meaning="an effort on push_joint", unit="N.m or N", low=-_MOST, high=_MOST, otherwise="none"),
    "start_error_deg": Quantity(
        meaning="hinges start so far beside the path", unit="deg", low=-360.0, high=360.0, of="hinge"
    ),
    "start_error_m": Quantity(meaning="slides start so far beside the path", unit="m", low=-_MOST, high=_MOST, of="slide"),
    "start_velocity_error_deg_s": Quantity(
        meaning="hinges start so much too fast", unit="deg/s", low=-_MOST, high=_MOST, of="hinge"
    ),
    "start_velocity_error_m_s": Quantity(
        meaning="slides start so much too fast", unit="m/s", low=-_MOST, high=_MOST, of="slide"
    ),
    "loop_time_constant_s": Quantity(
        meaning="the loop constraint's time constant, of MuJoCo's solref; at least two simulator steps",
        unit="s",
        low=1e-9,
        high=_MOST,
    ),
    "loop_damping_ratio": Quantity(meaning="its damping ratio", unit="1", low=1e-3, high=1e3),
}
# Names of what is pushed: words, not spreads.
WORDS: Mapping[str, str] = {
    "push_body": "the body that a push's force acts on",
    "push_joint": "the joint that a push's effort acts on",
}
# What a value may be, in words.
FORMS = "a number, a range [low, high], { uniform = [low, high] } or { normal = [mean, std] }"
_MOST_DEVIATION = 1e15


def spread_schema(quantity: Quantity) -> dict[str, Any]:
    """Return the JSON Schema of what a quantity may be: `FORMS`, or a table of these by name where each has its own."""
    value = {"type": "number", "minimum": quantity.low, "maximum": quantity.high}
    deviation = {"type": "number", "minimum": 0, "maximum": _MOST_DEVIATION}
    uniform = {"type": "array", "items": value, "minItems": 2, "maxItems": 2}
    normal = {"type": "array", "prefixItems": [value, deviation], "minItems": 2, "maxItems": 2}
    laws = {"uniform": uniform, "normal": normal}
    law = {"type": "object", "properties": laws, "additionalProperties": False, "minProperties": 1, "maxProperties": 1}
    forms = [value, uniform, law]
    if quantity.of:
        names = {"not": {"enum": list(laws)}}
        forms.append({"type": "object", "additionalProperties": {"anyOf": [*forms]}, "propertyNames": names})
    return {"anyOf": forms}
