"""Types of the values under keys: numbers in ranges, words, intervals, places, tables of these by name; imperfections."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from msgspec import Meta

from linkplan.models.catalogue import PAYLOADS
from linkplan.planner.transcription.scheme_names import EFFORTS, MAX_DEGREE, NAMES

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


# No quantity of a mechanism is larger in SI units or degrees.
MAX_NUMBER = 1e15
# Angles beyond this many turns are typing errors; following the loops through them would take minutes.
MAX_TURNS = 100
# Larger meshes take minutes and are probably typing errors.
MAX_INTERVALS = 20_000
# Each waypoint at a free time needs a segment of three or more intervals.
MAX_WAYPOINTS = 1000
# Largest error of the integrated state in a certificate [deg]: a tenth of what a good encoder resolves.
INTEGRATION_DEG = 0.01
# Largest delay [control periods].
MAX_DELAY = 1000
# Range of the errors with weight 1 in LQR, in degrees or metres and per second: outside it Riccati equations are
# ill-conditioned.
LQR_ERRORS = (1e-9, 1e9)
# Largest number of corners of a tube's polyline: each segment is an expression at every node.
MAX_TUBE_CORNERS = 200
# The shortest interval of a mesh as a share of the duration: after refinement, it must still be longer than rounding.
MIN_INTERVAL_SHARE = 1e-9
# The legal breaks of a mesh; a type can check them only partly.
BREAKS = (
    "three or more increasing numbers from 0 to 1, the ends of the intervals as shares of the duration, at least"
    f" {MIN_INTERVAL_SHARE:g} apart"
)
# Largest mass, length and moment of inertia of a payload, in SI units.
MAX_PAYLOAD = 1e12

# Raises for an unknown name; takes the kind of object ("joint", "actuator", "site", "closure"), the name and its table's
# key.
Known = Callable[[str, str, str], None]

Number = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Positive = Annotated[float, Meta(gt=0, le=MAX_NUMBER)]
AtLeastZero = Annotated[float, Meta(ge=0, le=MAX_NUMBER)]
Angle = Annotated[
    float,
    Meta(
        ge=-360 * MAX_TURNS,
        le=360 * MAX_TURNS,
        extra={"range": f"within {MAX_TURNS} turns either way ({360 * MAX_TURNS} deg)"},
    ),
]
# Durations below a microsecond or above a day would only waste memory and time.
Duration = Annotated[float, Meta(ge=1e-6, le=1e5)]
ShortDuration = Annotated[float, Meta(ge=1e-9, le=1e5)]
Frequency = Annotated[float, Meta(ge=1e-5, le=1e5)]
Period = Annotated[float, Meta(ge=1e-7, le=10.0)]
SolveTime = Annotated[float, Meta(ge=1e-9, le=1e7)]
Gain = Annotated[float, Meta(ge=0.0, le=1e12)]
Delay = Annotated[float, Meta(ge=0, le=MAX_DELAY)]
LqrError = Annotated[float, Meta(ge=LQR_ERRORS[0], le=LQR_ERRORS[1])]
Margin = Annotated[float, Meta(ge=0.0, lt=1.0)]
# The certificate's integration has an error of about 1e-10 deg.
Tolerance = Annotated[float, Meta(ge=1e-9, le=INTEGRATION_DEG)]
Mass = Annotated[float, Meta(gt=0, le=MAX_PAYLOAD)]
Moment = Annotated[float, Meta(ge=0, le=MAX_PAYLOAD)]
Weight = Annotated[float, Meta(gt=0, le=MAX_NUMBER, extra={"said": "a positive weight"})]
Turns = Annotated[int, Meta(ge=-MAX_TURNS, le=MAX_TURNS)]
Intervals = Annotated[int, Meta(ge=2, le=MAX_INTERVALS)]
Starts = Annotated[int, Meta(ge=1, le=1000)]

Free = Literal["free"]
Softness = Literal["stiff"]
Kind = Literal["reach", "hold", "periodic", "track"]
Contacts = Literal["refuse", "note"]
Refine = Literal["both", "intervals", "degree"]
Compile = Literal["auto", "always", "never"]
Axis = Literal["x", "y", "z"]
Term = Literal["effort", "time", "tracking", "work", "copper_loss", "effort_rate", "closure_force"]

if TYPE_CHECKING:
    Scheme = PayloadName = EffortForm = str
else:  # their words are defined elsewhere
    _SCHEMES = f"schemes are {', '.join(NAMES[:4])}, radau-1 to radau-{MAX_DEGREE} and gauss-1 to gauss-{MAX_DEGREE}"
    Scheme = Annotated[Literal[NAMES], Meta(extra={"choices": _SCHEMES})]
    PayloadName = Literal[(*PAYLOADS, "none")]
    EffortForm = Annotated[Literal[tuple(EFFORTS)], Meta(extra={"choices": f"efforts are {', '.join(EFFORTS)}"})]

# Ends may be infinite. A type cannot check that the first is below the second.
Interval = Annotated[list[float], Meta(min_length=2, max_length=2, extra={"said": "[low, high]"})]
Point = Annotated[list[Number], Meta(min_length=3, max_length=3, extra={"said": "[x, y, z] in metres", "numbered": True})]
Moments = Annotated[
    list[Moment], Meta(min_length=3, max_length=3, extra={"said": "three moments [xx, yy, zz]", "numbered": True})
]
Centre = Annotated[
    list[Annotated[float, Meta(ge=-MAX_PAYLOAD, le=MAX_PAYLOAD)]],
    Meta(min_length=3, max_length=3, extra={"said": "three coordinates [x, y, z] in metres", "numbered": True}),
]
Corners = Annotated[
    list[Point],
    Meta(
        min_length=2,
        max_length=MAX_TUBE_CORNERS,
        extra={"said": f"a list of 2 to {MAX_TUBE_CORNERS} points [x, y, z] in metres", "numbered": True},
    ),
]
Coordinates = Annotated[
    dict[Axis, Number],
    Meta(
        min_length=1,
        extra={"said": "a table of those coordinates that matter, such as { x = 0.1, z = 0.2 }"},
        extra_json_schema={"propertyNames": {"enum": list(get_args(Axis))}},
    ),
]
Place = Point | Coordinates
Path = Annotated[list[Number], Meta(min_length=2, extra={"said": "a list of two or more positions"})]
Breaks = Annotated[
    list[Number],
    Meta(
        min_length=3,
        max_length=MAX_INTERVALS + 1,
        extra={"said": BREAKS},
    ),
]
Names = Annotated[list[str], Meta(min_length=1, extra={"said": "a list of joint names"})]
Settings = Annotated[list[str], Meta(extra={"said": 'a list of "section.key=value"'})]
Weights = Annotated[
    dict[Term, Weight],
    Meta(
        min_length=1,
        extra={"said": "a table of at least one of them = its weight"},
        extra_json_schema={"propertyNames": {"enum": list(get_args(Term))}},
    ),
]

_BY_JOINT = {"of": "joint = value", "noun": "joint"}
_STATE = _BY_JOINT | {"item": " of joint {}"}
_ACTUATORS = {"of": "actuator = value", "noun": "actuator"}
Angles = Annotated[dict[str, Angle], Meta(extra=_STATE)]
Numbers = Annotated[dict[str, Number], Meta(extra=_STATE)]
HomeAngles = Annotated[dict[str, Angle], Meta(extra=_BY_JOINT)]
HomeLengths = Annotated[dict[str, Number], Meta(extra=_BY_JOINT)]
Locks = Annotated[dict[str, Number], Meta(extra={"of": "joint = position"})]
Kept = Annotated[list[str], Meta(min_length=1, extra={"said": "a list of names of bodies or joints"})]
BallJoints = Annotated[list[str], Meta(extra={"said": "a list of names of ball joints"})]
_PAIRS = {"said": 'a list of pairs of names of bodies, such as [["base", "rod"]]'}
BodyPairs = Annotated[
    list[Annotated[list[Annotated[str, Meta(extra=_PAIRS)]], Meta(min_length=2, max_length=2, extra=_PAIRS)]],
    Meta(extra=_PAIRS),
]
Phases = Annotated[dict[str, Number], Meta(extra=_BY_JOINT)]
WholeTurns = Annotated[dict[str, Turns], Meta(extra=_BY_JOINT | {"of": "joint = whole turns"})]
Paths = Annotated[dict[str, Path], Meta(extra=_BY_JOINT | {"of": "joint = positions"})]
Ranges = Annotated[dict[str, Interval], Meta(extra=_BY_JOINT | {"of": "joint = [low, high]"})]
Speeds = Annotated[dict[str, Positive | Interval], Meta(extra=_BY_JOINT)]
Gains = Annotated[dict[str, Gain], Meta(extra={"of": "joint = gain"})]
LqrErrors = Annotated[dict[str, LqrError], Meta(extra={"of": "joint = error"})]
Efforts = Annotated[dict[str, Interval], Meta(extra=_ACTUATORS | {"of": "actuator = [low, high]"})]
ActuatorLimits = Annotated[dict[str, Positive | Interval], Meta(extra=_ACTUATORS)]
ClosureLimits = Annotated[dict[str, Positive], Meta(extra={"of": "closure = newtons", "noun": "closure"})]
Places = Annotated[dict[str, Place], Meta(extra={"of": "site = [x, y, z] in metres", "noun": "site"})]
