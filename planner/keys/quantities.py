"""Imperfections of a simulated machine: the keys of [imperfections] with meanings, units and ranges. Quick to import."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

# The bound of quantities without a natural one, in their own units.
_MAX_QUANTITY = 1e9
# Independent joints with the unit of their positions and the bound of a position in it.
_JOINTS = (("hinge", "deg", 360.0), ("slide", "m", _MAX_QUANTITY))


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that can be wrong: its meaning, unit, an example of a careful build, its range, and what has it.

    `of` is "" for the whole machine, "hinge" or "slide" (independent joints of that kind), "joint" (any), "actuator" or
    "body". `otherwise` is the default in words.
    """

    meaning: str
    unit: str
    example: str
    low: float = -_MAX_QUANTITY
    high: float = _MAX_QUANTITY
    of: str = ""
    otherwise: str = "as modelled"


def _of_joints(
    key: str, meaning: str, hinge_example: str, slide_example: str, *, signed: bool = False, rate: str = ""
) -> dict[str, Quantity]:
    """Return the quantities of hinges and slides, by keys with their units; `rate` is "_s" for velocities."""
    found = {}
    for (of, unit, bound), example in zip(_JOINTS, (hinge_example, slide_example), strict=True):
        high = _MAX_QUANTITY if rate else bound
        unit_text = f"{unit}/s" if rate else unit
        words = meaning.format(f"{of}s")
        found[f"{key}_{unit}{rate}"] = Quantity(words, unit_text, example, -high if signed else 0.0, high, of=of)
    return found


QUANTITIES: Mapping[str, Quantity] = {
    "period_factor": Quantity(
        "ratio of the controller's actual to its nominal period", "1", "{ normal = [1.0, 1e-4] }", 0.5, 2.0
    ),
    "phase_periods": Quantity(
        "delay of the first control instant after the motion begins", "control periods", "[0.0, 1.0]", 0.0, 1.0
    ),
    "delay_periods": Quantity(
        "added to tracking.delay_periods; may be fractional", "control periods", "[0.5, 1.5]", 0.0, 1000.0
    ),
    **_of_joints("encoder_resolution", "step to which {}' positions are rounded", "0.01", "1e-5"),
    **_of_joints(
        "encoder_offset",
        "error of {}' measured positions",
        "{ normal = [0.0, 0.02] }",
        "{ normal = [0.0, 1e-4] }",
        signed=True,
    ),
    **_of_joints("position_noise", "standard deviation of white noise on {}' positions", "0.005", "1e-5"),
    **_of_joints(
        "velocity_noise",
        "standard deviation of white noise on {}' velocities, if these are measured directly",
        "1.0",
        "0.01",
        rate="_s",
    ),
    "velocity_filter_hz": Quantity(
        "velocity is the difference of measured positions, filtered by a first-order low-pass of this cutoff",
        "Hz",
        "1000.0",
        1e-06,
    ),
    "torque_resolution": Quantity("step to which commands are rounded", "N.m or N", "0.05", 0.0, of="actuator"),
    "torque_bandwidth_hz": Quantity(
        "bandwidth of the drive's first-order lag", "Hz", "[500.0, 1500.0]", 1e-06, of="actuator"
    ),
    "torque_rate": Quantity(
        "largest rate of the drive's effort", "N.m/s or N/s", "5000.0", 1e-09, 1000000000000000.0, of="actuator"
    ),
    "torque_constant_factor": Quantity(
        "ratio of actual to commanded effort", "1", "{ normal = [1.0, 0.03] }", 0.01, 100.0, of="actuator"
    ),
    "viscous_friction": Quantity(
        "damping of any joint, added to the model's", "N.m.s/rad or N.s/m", "{ {joint} = [0.0, 0.05] }", 0.0, of="joint"
    ),
    "coulomb_friction": Quantity("dry friction of any joint", "N.m or N", "{ {joint} = [0.0, 2.0] }", 0.0, of="joint"),
    "payload_mass_factor": Quantity(
        "factor on the mass and inertia of the payload, or of all moving bodies if there is none",
        "1",
        "[0.9, 1.1]",
        0.001,
        1000.0,
    ),
    "payload_com_x_m": Quantity("shift of the payload's centre of mass along x of its body", "m", "[-0.005, 0.005]"),
    "payload_com_y_m": Quantity("shift along y", "m", "[-0.005, 0.005]"),
    "payload_com_z_m": Quantity("shift along z", "m", "[-0.005, 0.005]"),
    "link_length_factor": Quantity(
        "scales all points fixed to a link about its joint; the loop is assembled again",
        "1",
        "{ normal = [1.0, 2e-4] }",
        0.1,
        10.0,
        of="body",
    ),
    "push_start_s": Quantity("time at which a push begins", "s", "[0.0, 0.1]", 0.0, otherwise="0"),
    "push_duration_s": Quantity("duration of the push", "s", "0.01", 0.0, otherwise="none"),
    "push_force_x_n": Quantity(
        "force along x of the world on push_body's centre of mass", "N", "[-20.0, 20.0]", otherwise="none"
    ),
    "push_force_y_n": Quantity("force along y", "N", "[-20.0, 20.0]", otherwise="none"),
    "push_force_z_n": Quantity("force along z", "N", "[-20.0, 20.0]", otherwise="none"),
    "push_effort": Quantity("effort on push_joint", "N.m or N", "[-5.0, 5.0]", otherwise="none"),
    **_of_joints(
        "start_error",
        "{}' initial distance from the path",
        "{ normal = [0.0, 0.05] }",
        "{ normal = [0.0, 1e-4] }",
        signed=True,
    ),
    **_of_joints(
        "start_velocity_error",
        "{}' initial velocity error",
        "{ normal = [0.0, 1.0] }",
        "{ normal = [0.0, 0.01] }",
        signed=True,
        rate="_s",
    ),
    "loop_time_constant_s": Quantity(
        "time constant of the loop constraint in MuJoCo's solref; at least two simulator steps", "s", "0.005", 1e-09
    ),
    "loop_damping_ratio": Quantity("damping ratio of the loop constraint", "1", "1.0", 0.001, 1000.0),
}
# Keys whose values are names and not distributions, with their meanings and examples.
WORDS: Mapping[str, tuple[str, str]] = {
    "push_body": ("the body that a push's force acts on", "{body}"),
    "push_joint": ("the joint that a push's effort acts on", "{joint_name}"),
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
