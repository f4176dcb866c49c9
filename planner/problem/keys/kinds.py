"""Types of the values under keys: numbers in ranges, words, intervals, places, tables of these by name."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from msgspec import Meta

from linkplan.models.catalogue import PAYLOADS
from linkplan.planner.transcription.scheme_names import EFFORTS, MAX_DEGREE, MAX_INTERVALS, NAMES

# Larger numbers, in SI units or degrees, are typing errors.
MAX_NUMBER = 1e15
# Angles beyond this many turns are typing errors; solving the loops along them would take minutes.
MAX_TURNS = 100
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

# A function that raises for an unknown name, of the kind of object ("joint", "actuator", "site", "body", "closure",
# "pin"), the name and its table's key.
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
Sharing = Literal["least_squares", "least_peak"]
Kind = Literal["reach", "hold", "periodic", "track", "follow"]
Contacts = Literal["refuse", "note"]
Refine = Literal["both", "intervals", "degree"]
Compile = Literal["auto", "always", "never"]
Spline = Literal["periodic", "clamped", "natural"]
Interpolation = Literal["linear", "cubic"]
Shape = Literal["polyline", "spline", "arc"]
Axis = Literal["x", "y", "z"]
Term = Literal[
    "effort", "time", "tracking", "work", "copper_loss", "effort_rate", "jerk", "peak_effort", "closure_force",
    "shaking_force",
]  # fmt: skip

if TYPE_CHECKING:
    Scheme = PayloadName = EffortForm = str
else:  # their texts are defined elsewhere
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
        extra={"said": "a table of some coordinates, such as { x = 0.1, z = 0.2 }"},
        extra_json_schema={"propertyNames": {"enum": list(get_args(Axis))}},
    ),
]
Place = Point | Coordinates
Path = Annotated[list[Number], Meta(min_length=2, extra={"said": "a list of two or more positions"})]
AxisColumns = Annotated[
    dict[Axis, Path],
    Meta(
        min_length=1,
        extra={"said": "a table of lists such as { x = [0.1, 0.2], z = [0.3, 0.3] }"},
        extra_json_schema={"propertyNames": {"enum": list(get_args(Axis))}},
    ),
]
_BY_SITE = "site = {{ x = [...], y = [...], z = [...] }} in {}"
PlaceColumns = Annotated[dict[str, AxisColumns], Meta(extra={"of": _BY_SITE.format("metres"), "noun": "site"})]
ForceColumns = Annotated[dict[str, AxisColumns], Meta(extra={"of": _BY_SITE.format("newtons"), "noun": "site"})]
Breaks = Annotated[
    list[Number],
    Meta(
        min_length=3,
        max_length=MAX_INTERVALS + 1,
        extra={"said": BREAKS},
    ),
]
Names = Annotated[list[str], Meta(min_length=1, extra={"said": "a list of joint names"})]
Closures = Annotated[list[str], Meta(extra={"said": "a list of names of closures"})]
Sites = Annotated[list[str], Meta(extra={"said": "a list of names of sites"})]
ParameterNames = Annotated[list[str], Meta(extra={"said": "a list of names in [parameters]"})]
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
ActuatorGears = Annotated[dict[str, Number], Meta(extra={"of": "actuator = gear ratio"})]
RotorInertias = Annotated[dict[str, AtLeastZero], Meta(extra={"of": "actuator = inertia"})]
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
ActuatorEfforts = Annotated[dict[str, Number], Meta(extra=_ACTUATORS)]
ActuatorLimits = Annotated[dict[str, Positive | Interval], Meta(extra=_ACTUATORS)]
ClosureLimits = Annotated[dict[str, Positive], Meta(extra={"of": "closure = newtons", "noun": "closure"})]
Friction = Annotated[float, Meta(ge=0, extra={"said": "a number from 0, or inf"})]
Frictions = Annotated[dict[str, Friction], Meta(extra={"of": "closure = coefficient", "noun": "closure"})]
PinLimits = Annotated[dict[str, Positive], Meta(extra={"of": "joint or closure = newtons", "noun": "pin"})]
SiteSpeeds = Annotated[dict[str, Positive], Meta(extra={"of": "site = metres per second", "noun": "site"})]
SiteAccelerations = Annotated[dict[str, Positive], Meta(extra={"of": "site = metres per second squared", "noun": "site"})]
SiteJerks = Annotated[dict[str, Positive], Meta(extra={"of": "site = metres per second cubed", "noun": "site"})]
Force = Annotated[list[Number], Meta(min_length=3, max_length=3, extra={"said": "[x, y, z] in newtons", "numbered": True})]
Forces = Annotated[dict[str, Force], Meta(extra={"of": "site = [x, y, z] in newtons"})]
Footing = Annotated[
    list[Number],
    Meta(min_length=3, max_length=6, extra={"said": "[x, y, z] in metres, and the ground's normal if it is not z"}),
]
Footings = Annotated[dict[str, Footing], Meta(extra={"of": "site = [x, y, z] in metres"})]
Points = Annotated[dict[str, Point], Meta(extra={"of": "contact = [x, y, z] in metres"})]
_BODIES = {"of": "body = angle in degrees", "noun": "body"}
BodyAngles = Annotated[dict[str, Angle], Meta(extra=_BODIES)]
BodyPaths = Annotated[dict[str, Path], Meta(extra=_BODIES | {"of": "body = angles in degrees"})]
BodyRanges = Annotated[dict[str, Interval], Meta(extra=_BODIES | {"of": "body = [low, high] in degrees"})]
Places = Annotated[dict[str, Place], Meta(extra={"of": "site = [x, y, z] in metres", "noun": "site"})]
