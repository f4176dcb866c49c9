"""The sections of a problem file, one struct each: their keys in order, what each takes, its default, and what it means.

Everything else is made of these: the reader, the JSON Schema, the table of keys. Angles are in degrees with `_deg` in the
key, slides in metres with `_m`; all else is SI.
"""

from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta, Struct, defstruct

from linkplan.models.catalogue import MODELS
from linkplan.planner.keys import kinds
from linkplan.planner.keys.quantities import FORMS, QUANTITIES, WORDS, Quantity, spread_schema

# The value of a key that is left out and has no single default. No file can say it: no kind of value admits it.
ABSENT: Any = None


def key(meaning: str, unit: str = "", default: str = "") -> Meta:
    """Return what is said of a key: its meaning, its unit, and its default in words where that is no single value."""
    said = f"{meaning[0].upper()}{meaning[1:]}" + (f" [{unit}]" if unit else "") + "."
    shown = {"x-unit": unit} if unit else {}
    return Meta(
        description=f"{said} Default: {default}." if default else said,
        extra={"meaning": meaning, "unit": unit, "default": default},
        extra_json_schema=shown,
    )


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """A table of known keys."""


class PayloadSection(Section, frozen=True):
    """A rigid payload welded to a body of the model."""

    body: Annotated[str, key("the body that carries it")]
    mass_kg: Annotated[kinds.Mass, key("its mass", "kg")]
    com_m: Annotated[kinds.Centre, key("its centre of mass in the body's frame", "m")]
    inertia_kgm2: Annotated[
        kinds.Moments,
        key("moments about axes parallel to the body's through the centre of mass", "kg m2", "0, a point mass"),
    ] = ABSENT


_MODEL = Meta(
    min_length=1, extra={"said": "a built-in name or a path to an MJCF file"}, extra_json_schema={"examples": list(MODELS)}
)


class MechanismSection(Section, frozen=True):
    """The machine: its model, how it is assembled, and what it carries."""

    model: Annotated[str, _MODEL, key("a built-in name, a path to an MJCF file, or MJCF text")]
    payload: Annotated[
        kinds.PayloadName | PayloadSection,
        Meta(extra={"said": f"a built-in name ({', '.join(kinds.PAYLOADS)}, none) or a table"}),
        key("a built-in payload's name, or a table of one", default="none"),
    ] = ABSENT
    home_deg: Annotated[
        kinds.HomeAngles,
        key("hinges' angles at which to assemble, which choose the branch", "deg", "the model's keyframe home"),
    ] = {}
    home_m: Annotated[
        kinds.HomeLengths, key("slides' positions at which to assemble", "m", "the model's keyframe home")
    ] = {}
    independent: Annotated[
        kinds.Names,
        key("the joints in which the motion is planned", default="the driven ones, or those that the motion names"),
    ] = ABSENT
    closure_tolerance_m: Annotated[
        kinds.Positive,
        key("the gap up to which a motion that the model's rounding alone forbids is free", "m", "by the mechanism's size"),
    ] = ABSENT
    solref: Annotated[
        kinds.Softness, key("closures as stiff in simulation as the timestep admits", default="the model's own")
    ] = ABSENT


class WaypointSection(Section, frozen=True):
    """A state on the way: a position, a speed or both, at a time or at one that is free."""

    at_deg: Annotated[kinds.Angles, key("hinges' angles there", "deg", "free")] = {}
    at_m: Annotated[kinds.Numbers, key("slides' positions there", "m", "free")] = {}
    at: Annotated[kinds.Places, key("where sites are there, in place of joints", "m", "free")] = {}
    speed_deg_s: Annotated[kinds.Numbers, key("hinges' speeds there", "deg/s", "free")] = {}
    speed_m_s: Annotated[kinds.Numbers, key("slides' speeds there", "m/s", "free")] = {}
    time_s: Annotated[kinds.Positive | kinds.Free, key("when it is passed", "s")] = "free"


# Of where a motion starts and ends.
_OPEN = "free in a periodic motion; a reach needs it"


class MotionSection(Section, frozen=True):
    """The motion: from where to where, by way of what, in how long."""

    kind: Annotated[
        kinds.Kind,
        key("from start to goal; back to its own first state; or the reference itself, followed exactly"),
    ]
    start_deg: Annotated[kinds.Angles, key("where it starts: hinges' angles by joint", "deg", _OPEN)] = {}
    start_m: Annotated[kinds.Numbers, key("where it starts: slides' positions", "m", _OPEN)] = {}
    start_at: Annotated[kinds.Places, key("where sites are at the start, in place of joints", "m", "joints say it")] = {}
    goal_deg: Annotated[kinds.Angles, key("where it ends, or is after half a period: hinges' angles", "deg", _OPEN)] = {}
    goal_m: Annotated[kinds.Numbers, key("where it ends: slides' positions", "m", _OPEN)] = {}
    goal_at: Annotated[kinds.Places, key("where sites are at the end, in place of joints", "m", "joints say it")] = {}
    start_speed_deg_s: Annotated[kinds.Numbers, key("hinges' speeds at the start", "deg/s", "at rest")] = {}
    start_speed_m_s: Annotated[kinds.Numbers, key("slides' speeds at the start", "m/s", "at rest")] = {}
    goal_speed_deg_s: Annotated[kinds.Numbers, key("hinges' speeds at the end", "deg/s", "at rest")] = {}
    goal_speed_m_s: Annotated[kinds.Numbers, key("slides' speeds at the end", "m/s", "at rest")] = {}
    duration_s: Annotated[
        kinds.Duration | kinds.Free, key('how long it takes, or "free"', "s", "free, or the reference's period")
    ] = ABSENT
    min_duration_s: Annotated[kinds.ShortDuration, key("the shortest free duration", "s", "any")] = ABSENT
    max_duration_s: Annotated[kinds.Duration, key("the longest free duration", "s", "any")] = ABSENT
    waypoints: Annotated[
        list[WaypointSection],
        Meta(
            extra={
                "said": f"a list of tables with keys {', '.join(WaypointSection.__struct_fields__)}",
                "numbered": True,
            }
        ),
        key(
            "states on the way, passed in order: at_deg, at_m or at (of sites), speed_deg_s, speed_m_s, each at its time_s"
            " or at a free time",
            default="none",
        ),
    ] = []
    turns: Annotated[
        kinds.WholeTurns,
        key("whole turns by which hinges of a periodic motion go on in a period", default="none: it returns in full"),
    ] = ABSENT


class ReferenceSection(Section, frozen=True):
    """A sinusoid for each independent joint: bias + amplitude sin(2 pi frequency t + phase)."""

    frequency_hz: Annotated[kinds.Frequency, key("common to all joints: its period is the motion's", "Hz")]
    amplitude_deg: Annotated[kinds.Angles, key("hinges' amplitudes", "deg", "none: each joint needs one")] = {}
    amplitude_m: Annotated[kinds.Numbers, key("slides' amplitudes", "m", "none: each joint needs one")] = {}
    bias_deg: Annotated[kinds.Angles, key("hinges' mean angles", "deg", "0")] = {}
    bias_m: Annotated[kinds.Numbers, key("slides' mean positions", "m", "0")] = {}
    phase_deg: Annotated[kinds.Phases, key("phases by joint", "deg", "0")] = {}


class ObjectiveSection(Section, frozen=True):
    """What the motion is best in."""

    minimize: Annotated[
        kinds.Term | kinds.Weights,
        key(
            "a term, or a weighted sum of terms: squared effort, duration, distance from the reference, positive work,"
            " copper loss, squared effort rate, squared closure force",
            default="effort; tracking where there is a reference to follow",
        ),
    ] = ABSENT


class Box(Section, frozen=True):
    """Bounds on where a site is, coordinate by coordinate."""

    x: Annotated[kinds.Interval, key("[low, high] of x; ends may be infinite", "m", "any")] = ABSENT
    y: Annotated[kinds.Interval, key("[low, high] of y", "m", "any")] = ABSENT
    z: Annotated[kinds.Interval, key("[low, high] of z", "m", "any")] = ABSENT


class Wall(Section, frozen=True):
    """A plane that a site stays on one side of."""

    normal: Annotated[kinds.Point, key("points to the side that is free")]
    at: Annotated[kinds.Point, key("a point of the wall", "m")]


class Tube(Section, frozen=True):
    """A polyline that a site stays near to."""

    along: Annotated[kinds.Corners, key("the corners of the polyline", "m")]
    radius_m: Annotated[kinds.Positive, key("how far from the polyline the site may be", "m")]


# Told apart by their keys, in this order.
SITE_LIMITS: tuple[type[Section], ...] = (Wall, Tube, Box)
_SITE_LIMIT = Meta(
    extra={"said": "a box, a wall or a tube", "shapes": SITE_LIMITS},
    extra_json_schema={"minProperties": 1, "anyOf": [{"$ref": f"#/$defs/{shape.__name__}"} for shape in SITE_LIMITS]},
)
SiteLimit = Annotated[dict[str, Any], _SITE_LIMIT]
_SITES = Meta(extra={"of": "site = limits", "noun": "site"})


class LimitsSection(Section, frozen=True):
    """What holds at every instant."""

    effort: Annotated[kinds.Efforts, key("by actuator, [low, high]", "N.m, N", "the model's own")] = {}
    range_deg: Annotated[
        kinds.Ranges, key("hinges' ranges, dependent ones too, within the model's own", "deg", "the model's own")
    ] = {}
    range_m: Annotated[kinds.Ranges, key("slides' ranges", "m", "the model's own")] = {}
    speed_deg_s: Annotated[
        kinds.Speeds, key("hinges' speeds, dependent ones too: a number for both ways, or [low, high]", "deg/s", "none")
    ] = {}
    speed_m_s: Annotated[kinds.Speeds, key("slides' speeds", "m/s", "none")] = {}
    effort_rate: Annotated[
        kinds.ActuatorLimits, key("of efforts, which then have no jumps, by actuator", "N.m/s, N/s", "none")
    ] = {}
    power_w: Annotated[kinds.ActuatorLimits, key("mechanical power by actuator: a number, or [low, high]", "W", "none")] = {}
    closure_force: Annotated[kinds.ClosureLimits, key("what a closure's pin is rated at", "N", "none")] = {}
    reserve: Annotated[kinds.Margin, key("the share of every effort limit that a plan leaves to feedback")] = 0.0
    singular_margin: Annotated[kinds.Margin, key("the least det J_z along the motion, as a share of that at home")] = 0.0
    site: Annotated[
        dict[str, SiteLimit | list[SiteLimit]],
        _SITES,
        key("boxes, walls and tubes that sites stay within, one or a list of them", "m", "none"),
    ] = {}
    contacts: Annotated[
        kinds.Contacts, key("a plan on whose way geoms meet is refused, or noted and planned without their forces")
    ] = "refuse"


class MotorSection(Section, frozen=True):
    """The motor behind an actuator, in the actuator's own effort and speed."""

    torque_constant: Annotated[
        kinds.Positive, key("effort per current; with resistance_ohm it gives the copper loss", "N.m/A, N/A", "unknown")
    ] = ABSENT
    resistance_ohm: Annotated[kinds.Positive, key("of the winding", "ohm", "unknown")] = ABSENT
    stall_effort: Annotated[
        kinds.Positive, key("at rest; with the no-load speed it gives the torque-speed line", "N.m, N", "unknown")
    ] = ABSENT
    no_load_speed_deg_s: Annotated[kinds.Positive, key("of an actuator that turns", "deg/s", "unknown")] = ABSENT
    no_load_speed_m_s: Annotated[kinds.Positive, key("of one that slides", "m/s", "unknown")] = ABSENT


_TOGETHER = {"torque_constant": ["resistance_ohm"], "resistance_ohm": ["torque_constant"]}
Motor = Annotated[MotorSection, Meta(extra_json_schema={"dependentRequired": _TOGETHER})]
_MOTORS = Meta(extra={"of": "actuator = its motor", "noun": "actuator of [motors]"})


class GuessSection(Section, frozen=True):
    """Where to start from: positions at equal times, or a saved plan's motion."""

    plan: Annotated[
        str,
        Meta(extra={"said": "a saved plan's folder"}),
        key("a saved plan's folder, whose motion is begun from", default="none"),
    ] = ABSENT
    path_deg: Annotated[kinds.Paths, key("hinges' angles at equal times", "deg", "none")] = {}
    path_m: Annotated[kinds.Paths, key("slides' positions at equal times", "m", "none")] = {}
    duration_s: Annotated[kinds.Duration, key("how long the guessed motion takes", "s", "the motion's own, or guessed")] = (
        ABSENT
    )


class MeshSection(Section, frozen=True):
    """How the motion is written down: the transcription, and the first mesh."""

    scheme: Annotated[kinds.Scheme, key("the transcription")] = "radau-3"
    intervals: Annotated[kinds.Intervals, key("how many equal intervals to begin with")] = 40
    effort: Annotated[
        kinds.EffortForm,
        key(
            "what efforts are over an interval",
            default="polynomial; of least work constant, or linear where limits.effort_rate is given",
        ),
    ] = "polynomial"
    tolerance_deg: Annotated[
        kinds.Tolerance,
        key("on the integrated state", "deg", "refined towards 1e-6 while the mesh stays small"),
    ] = ABSENT
    refine: Annotated[
        kinds.Refine,
        key("what is added where the mesh is too coarse", default="both; intervals where a scheme is named"),
    ] = "both"
    breaks: Annotated[
        kinds.Breaks,
        key("ends of the first mesh's intervals as shares of the duration", default="equal intervals"),
    ] = ABSENT


class SolverSection(Section, frozen=True):
    """How the program is solved."""

    name: Annotated[kinds.Solver, key("the solver")] = "ipopt"
    compile: Annotated[
        kinds.Compile, key("C functions where the cache has them, made beside the second solve; or always; or never")
    ] = "auto"
    max_time_s: Annotated[
        kinds.SolveTime, key("the longest that a whole plan may take: search, refinement, certificate", "s")
    ] = 600.0
    starts: Annotated[kinds.Starts, key("of so many motions to start from, the best answer is kept")] = 1


class RobustSection(Section, frozen=True):
    """Machines for which one motion keeps every effort limit: all within these ranges, at every corner."""

    payload_factor: Annotated[
        kinds.Interval, key("[low, high] of the factor on the payload's mass and inertia", default="[1, 1]")
    ] = ABSENT
    torque_constant_factor: Annotated[
        kinds.Interval,
        key("[low, high] of the factor on what an actuator gives for the effort that it is told", default="[1, 1]"),
    ] = ABSENT
    viscous_friction: Annotated[
        kinds.Ranges, key("[low, high] of a joint's damping beside the model's", "N.m.s/rad, N.s/m", "none")
    ] = {}
    coulomb_friction: Annotated[
        kinds.Ranges, key("[low, high] of a joint's dry friction, against the motion or with it", "N.m, N", "none")
    ] = {}


class TrackingSection(Section, frozen=True):
    """How the plan is tracked in simulation: gains, sampling, delay."""

    kp: Annotated[
        kinds.Gain | kinds.Gains, key("proportional gain on the independent joints, for all or by joint", "N.m/rad, N/m")
    ] = 200.0
    kd: Annotated[kinds.Gain | kinds.Gains, key("derivative gain, for all or by joint", "N.m.s/rad, N.s/m")] = 1.0
    period_s: Annotated[kinds.Period, key("the control period", "s")] = 1e-4
    delay_periods: Annotated[
        kinds.Delay, key("control periods from a measurement to its effort, a whole number where a motion is tracked")
    ] = 0
    duration_s: Annotated[kinds.Duration, key("how long the run lasts", "s", "the plan's own, and a rest")] = ABSENT
    lqr_position_deg: Annotated[
        kinds.LqrError, key("a hinge's error that weighs as much as the whole effort limit", "deg")
    ] = 1.0
    lqr_velocity_deg_s: Annotated[kinds.LqrError, key("the same of its speed", "deg/s")] = 100.0
    lqr_position_m: Annotated[kinds.LqrError, key("the same of a slide", "m")] = 0.01
    lqr_velocity_m_s: Annotated[kinds.LqrError, key("the same of a slide's speed", "m/s")] = 1.0
    bandwidth_hz: Annotated[kinds.Positive, key("natural frequency of the errors under ct and gs-pd+ff", "Hz")] = 20.0
    damping_ratio: Annotated[kinds.Positive, key("damping ratio of the errors under ct and gs-pd+ff")] = 1.0
    integral_time_s: Annotated[
        kinds.Positive, key("lqi: a position error that lasts this long weighs as much again by its integral", "s")
    ] = 0.05
    horizon_s: Annotated[kinds.Positive, key("mpc: how far ahead efforts are kept within their limits", "s")] = 0.1


def _spread(quantity: Quantity) -> Any:
    said = f"{FORMS}, or a table of these by name" if quantity.of else FORMS
    return Annotated[Any, Meta(extra={"said": said}, extra_json_schema=spread_schema(quantity))]


if TYPE_CHECKING:

    class ImperfectionsSection(Section, frozen=True):
        """What is wrong with simulated machines: where each quantity's value lies."""
else:  # its keys stand where their ranges are
    _NAME = Annotated[str, Meta(min_length=1, extra={"said": "a name"})]
    ImperfectionsSection = defstruct(
        "ImperfectionsSection",
        [
            *(
                (name, Annotated[_spread(one), key(one.meaning, "" if one.unit == "1" else one.unit, one.otherwise)], ABSENT)
                for name, one in QUANTITIES.items()
            ),
            *((name, Annotated[_NAME, key(meaning, default="none")], ABSENT) for name, meaning in WORDS.items()),
        ],
        bases=(Section,),
        frozen=True,
        namespace={"__doc__": "What is wrong with simulated machines: where each quantity's value lies."},
        module=__name__,
    )


class ProblemFile(Section, frozen=True, kw_only=True):
    """A problem: which motion of which mechanism, best in which sense, within which limits."""

    description: Annotated[str, key("the problem in a sentence", default="none")] = ""
    mechanism: Annotated[MechanismSection, key("the machine")]
    motion: Annotated[MotionSection, key("the motion")]
    reference: Annotated[ReferenceSection, key("the sinusoid to follow or come near to", default="none")] = ABSENT
    objective: Annotated[ObjectiveSection, key("what is least", default="by the kind of motion")] = ObjectiveSection()
    limits: Annotated[LimitsSection, key("what holds at every instant", default="the model's own")] = LimitsSection()
    robust: Annotated[
        RobustSection,
        key("machines for which one motion keeps every effort limit", default="all is as modelled"),
    ] = RobustSection()
    motors: Annotated[
        dict[str, Motor],
        _MOTORS,
        key(
            "the motor behind an actuator, by the actuator's name",
            default="unknown",
        ),
    ] = {}
    guess: Annotated[GuessSection, key("where the search starts from", default="found by the planner")] = GuessSection()
    mesh: Annotated[MeshSection, key("how the motion is written down", default="chosen")] = MeshSection()
    solver: Annotated[SolverSection, key("how it is solved", default="chosen")] = SolverSection()
    tracking: Annotated[TrackingSection, key("how the plan is tracked", default="PD")] = TrackingSection()
    imperfections: Annotated[
        ImperfectionsSection,
        key("what is wrong with the machines that an experiment simulates", default="those of a careful build"),
    ] = ImperfectionsSection()
