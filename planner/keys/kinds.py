"""What a value under a key may be: numbers within ranges, words, intervals, places, and tables of these by name.

`Meta` holds what msgspec checks. What it cannot know stands in its `extra`, for messages: `said`, the kind in words;
`range`, what is said of a number beyond its ends; `of`, the entries of a table; `noun`, what their names are names of;
`item`, how an entry is named after its table; `numbered`, whether items of a list are; `choices`, words for many words.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from msgspec import Meta

from linkplan.models.catalogue import PAYLOADS
from linkplan.planner.transcription.scheme_names import EFFORTS, MAX_DEGREE, NAMES

# No quantity of a mechanism is larger in SI units or degrees.
LARGEST = 1e15
# Positions further than so many turns away are a typing error: loops are followed there turn by turn, for minutes.
MOST_TURNS = 100
# Meshes beyond this take minutes; a typing slip of a zero should not.
MAX_INTERVALS = 20_000
# States on the way: each at a free time is a segment of three intervals or more.
MOST_WAYPOINTS = 1000
# What a certificate allows the integrated state [deg]: a hundredth of a degree, a tenth of what a good encoder resolves.
INTEGRATION_DEG = 0.01
# The integration that judges is good to about a tenth of this.
TIGHTEST_DEG = 1e-9
# Starts beyond this take minutes without finding more.
MAX_STARTS = 1000
# Delays of more control periods are no delays.
MAX_DELAY = 1000
# Errors that LQR weighs, in degrees or metres and per second: beyond these a Riccati equation has no numbers left.
LQR_ERRORS = (1e-9, 1e9)
# Corners of a tube's polyline at the most: each segment is an expression at every node.
MOST_CORNERS = 200
# The shortest interval of a mesh, as a share of the duration: refined, it is still longer than roundings.
LEAST_SHARE = 1e-9
# What the breaks of a mesh are, of which a type says but the half.
BREAKS = (
    "three or more increasing numbers from 0 to 1, the ends of the intervals as shares of the duration, at least"
    f" {LEAST_SHARE:g} apart"
)
# Masses, lengths and moments of a payload beyond this are no mechanism's.
HEAVIEST = 1e12

# Raises where a name is of nothing that its noun says: "joint", "actuator", "site", "closure"; the last is its table's key.
Known = Callable[[str, str, str], None]

Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Meta(gt=0, le=LARGEST)]
AtLeastZero = Annotated[float, Meta(ge=0, le=LARGEST)]
Angle = Annotated[
    float,
    Meta(
        ge=-360 * MOST_TURNS,
        le=360 * MOST_TURNS,
        extra={"range": f"within {MOST_TURNS} turns either way ({360 * MOST_TURNS} deg)"},
    ),
]
# Durations of less than a microsecond or more than a day ask for nothing but memory and time.
Duration = Annotated[float, Meta(ge=1e-6, le=1e5)]
ShortDuration = Annotated[float, Meta(ge=1e-9, le=1e5)]
Frequency = Annotated[float, Meta(ge=1e-5, le=1e5)]
Period = Annotated[float, Meta(ge=1e-7, le=10.0)]
SolveTime = Annotated[float, Meta(ge=1e-9, le=1e7)]
Gain = Annotated[float, Meta(ge=0.0, le=1e12)]
Delay = Annotated[float, Meta(ge=0, le=MAX_DELAY)]
LqrError = Annotated[float, Meta(ge=LQR_ERRORS[0], le=LQR_ERRORS[1])]
Margin = Annotated[float, Meta(ge=0.0, lt=1.0)]
Tolerance = Annotated[float, Meta(ge=TIGHTEST_DEG, le=INTEGRATION_DEG)]
Mass = Annotated[float, Meta(gt=0, le=HEAVIEST)]
Moment = Annotated[float, Meta(ge=0, le=HEAVIEST)]
Weight = Annotated[float, Meta(gt=0, le=LARGEST, extra={"said": "a positive weight"})]
Turns = Annotated[int, Meta(ge=-MOST_TURNS, le=MOST_TURNS)]
Intervals = Annotated[int, Meta(ge=2, le=MAX_INTERVALS)]
Starts = Annotated[int, Meta(ge=1, le=MAX_STARTS)]

Free = Literal["free"]
Softness = Literal["stiff"]
Kind = Literal["reach", "periodic", "track"]
Contacts = Literal["refuse", "note"]
Refine = Literal["both", "intervals", "degree"]
Compile = Literal["auto", "always", "never"]
Axis = Literal["x", "y", "z"]
Term = Literal["effort", "time", "tracking", "work", "copper_loss", "effort_rate", "closure_force"]
if TYPE_CHECKING:
    Scheme = PayloadName = EffortForm = str
else:  # their words stand where they are made
    _SCHEMES = f"schemes are {', '.join(NAMES[:4])}, radau-1 to radau-{MAX_DEGREE} and gauss-1 to gauss-{MAX_DEGREE}"
    Scheme = Annotated[Literal[NAMES], Meta(extra={"choices": _SCHEMES})]
    PayloadName = Literal[(*PAYLOADS, "none")]
    EffortForm = Annotated[Literal[tuple(EFFORTS)], Meta(extra={"choices": f"efforts are {', '.join(EFFORTS)}"})]

# Ends may be infinite; that the first is below the second no type says.
Interval = Annotated[list[float], Meta(min_length=2, max_length=2, extra={"said": "[low, high]"})]
Point = Annotated[list[Number], Meta(min_length=3, max_length=3, extra={"said": "[x, y, z] in metres", "numbered": True})]
Moments = Annotated[
    list[Moment], Meta(min_length=3, max_length=3, extra={"said": "three moments [xx, yy, zz]", "numbered": True})
]
Centre = Annotated[
    list[Annotated[float, Meta(ge=-HEAVIEST, le=HEAVIEST)]],
    Meta(min_length=3, max_length=3, extra={"said": "three coordinates [x, y, z] in metres", "numbered": True}),
]
Corners = Annotated[
    list[Point],
    Meta(
        min_length=2,
        max_length=MOST_CORNERS,
        extra={"said": f"a list of 2 to {MOST_CORNERS} points [x, y, z] in metres", "numbered": True},
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

_JOINTS = {"of": "joint = value", "noun": "joint"}
_STATE = _JOINTS | {"item": " of joint {}"}
_ACTUATORS = {"of": "actuator = value", "noun": "actuator"}
Angles = Annotated[dict[str, Angle], Meta(extra=_STATE)]
Numbers = Annotated[dict[str, Number], Meta(extra=_STATE)]
HomeAngles = Annotated[dict[str, Angle], Meta(extra=_JOINTS)]
HomeLengths = Annotated[dict[str, Number], Meta(extra=_JOINTS)]
Phases = Annotated[dict[str, Number], Meta(extra=_JOINTS)]
WholeTurns = Annotated[dict[str, Turns], Meta(extra=_JOINTS | {"of": "joint = whole turns"})]
Paths = Annotated[dict[str, Path], Meta(extra=_JOINTS | {"of": "joint = positions"})]
Ranges = Annotated[dict[str, Interval], Meta(extra=_JOINTS | {"of": "joint = [low, high]"})]
Speeds = Annotated[dict[str, Positive | Interval], Meta(extra=_JOINTS)]
Gains = Annotated[dict[str, Gain], Meta(extra={"of": "joint = gain"})]
Efforts = Annotated[dict[str, Interval], Meta(extra=_ACTUATORS | {"of": "actuator = [low, high]"})]
ActuatorLimits = Annotated[dict[str, Positive | Interval], Meta(extra=_ACTUATORS)]
ClosureLimits = Annotated[dict[str, Positive], Meta(extra={"of": "closure = newtons", "noun": "closure"})]
Places = Annotated[dict[str, Place], Meta(extra={"of": "site = [x, y, z] in metres", "noun": "site"})]
