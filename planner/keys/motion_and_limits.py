"""The sections [motion], [reference], [limits], [motors] and [robust] of a problem file, with the tables in them."""

from typing import Annotated, Any

from msgspec import Meta

from linkplan.planner.keys import kinds
from linkplan.planner.keys.kinds import ABSENT, Section, key


class WaypointSection(Section, frozen=True):
    """A state between start and goal: a position, a speed or both, at a given or free time."""

    at_deg: Annotated[kinds.Angles, key("hinges' angles", "deg", "free")] = {}
    at_m: Annotated[kinds.Numbers, key("slides' positions", "m", "free")] = {}
    at: Annotated[kinds.Places, key("sites' places, instead of joints' positions", "m", "free")] = {}
    speed_deg_s: Annotated[kinds.Numbers, key("hinges' speeds", "deg/s", "free")] = {}
    speed_m_s: Annotated[kinds.Numbers, key("slides' speeds", "m/s", "free")] = {}
    time_s: Annotated[kinds.Positive | kinds.Free, key("the time of passage", "s")] = "free"


# Examples of values at home and at rest.
_HINGE_HOME = "{ {free_hinge} = {free_hinge_home} }"
_SLIDE_HOME = "{ {free_slide} = {free_slide_home} }"
_SITE_HOME = "{ {site} = {site_home} }"
_HINGE_ZERO = "{ {free_hinge} = 0.0 }"
_SLIDE_ZERO = "{ {free_slide} = 0.0 }"
# The default of start and goal.
_OPEN = "free in a periodic motion; a reach needs it, and a hold its start"


class MotionSection(Section, frozen=True):
    """The motion: start, goal, waypoints and duration."""

    kind: Annotated[
        kinds.Kind,
        key(
            "from start to goal; at rest at the start; back to its first state; or exactly the reference", example='"reach"'
        ),
    ]
    start_deg: Annotated[kinds.Angles, key("hinges' angles at the start", "deg", _OPEN, _HINGE_HOME)] = {}
    start_m: Annotated[kinds.Numbers, key("slides' positions at the start", "m", _OPEN, _SLIDE_HOME)] = {}
    start_at: Annotated[
        kinds.Places, key("sites' places at the start, instead of joints' positions", "m", "by the joints", _SITE_HOME)
    ] = {}
    goal_deg: Annotated[
        kinds.Angles, key("hinges' angles at the end, or after half a period", "deg", _OPEN, _HINGE_HOME)
    ] = {}
    goal_m: Annotated[
        kinds.Numbers, key("slides' positions at the end, or after half a period", "m", _OPEN, _SLIDE_HOME)
    ] = {}
    goal_at: Annotated[
        kinds.Places, key("sites' places at the end, instead of joints' positions", "m", "by the joints", _SITE_HOME)
    ] = {}
    start_speed_deg_s: Annotated[kinds.Numbers, key("hinges' speeds at the start", "deg/s", "at rest", _HINGE_ZERO)] = {}
    start_speed_m_s: Annotated[kinds.Numbers, key("slides' speeds at the start", "m/s", "at rest", _SLIDE_ZERO)] = {}
    goal_speed_deg_s: Annotated[kinds.Numbers, key("hinges' speeds at the end", "deg/s", "at rest", _HINGE_ZERO)] = {}
    goal_speed_m_s: Annotated[kinds.Numbers, key("slides' speeds at the end", "m/s", "at rest", _SLIDE_ZERO)] = {}
    duration_s: Annotated[
        kinds.Duration | kinds.Free, key('the duration, or "free"', "s", "free, or the reference's period", example='"free"')
    ] = ABSENT
    min_duration_s: Annotated[kinds.ShortDuration, key("the shortest free duration", "s", "any", "0.1")] = ABSENT
    max_duration_s: Annotated[kinds.Duration, key("the longest free duration", "s", "any", "10.0")] = ABSENT
    waypoints: Annotated[
        list[WaypointSection],
        Meta(
            max_length=kinds.MAX_WAYPOINTS,
            extra={
                "said": f"a list of at most {kinds.MAX_WAYPOINTS} tables with keys"
                f" {', '.join(WaypointSection.__struct_fields__)}",
                "numbered": True,
            },
        ),
        key(
            "states between start and goal, in order: at_deg, at_m or at (of sites), speed_deg_s, speed_m_s, each at its"
            " time_s or at a free time",
            default="none",
            example="[{ {waypoint} }]",
        ),
    ] = []
    turns: Annotated[
        kinds.WholeTurns,
        key(
            "whole turns of hinges over a period of a periodic motion",
            default="none: it returns in full",
            example="{ {free_hinge} = 1 }",
        ),
    ] = ABSENT


class ReferenceSection(Section, frozen=True):
    """A sinusoid for each independent joint: bias + amplitude sin(2 pi frequency t + phase)."""

    frequency_hz: Annotated[kinds.Frequency, key("common to all joints; its period is the motion's", "Hz", example="1.0")]
    amplitude_deg: Annotated[
        kinds.Angles, key("hinges' amplitudes", "deg", "none: each joint needs one", "{ {free_hinge} = 10.0 }")
    ] = {}
    amplitude_m: Annotated[
        kinds.Numbers, key("slides' amplitudes", "m", "none: each joint needs one", "{ {free_slide} = 0.01 }")
    ] = {}
    bias_deg: Annotated[kinds.Angles, key("hinges' mean angles", "deg", "0", _HINGE_ZERO)] = {}
    bias_m: Annotated[kinds.Numbers, key("slides' mean positions", "m", "0", _SLIDE_ZERO)] = {}
    phase_deg: Annotated[kinds.Phases, key("phases by joint", "deg", "0", "{ {joint} = 0.0 }")] = {}


class Box(Section, frozen=True):
    """Bounds on a site's coordinates."""

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
    radius_m: Annotated[kinds.Positive, key("the largest distance of the site from the polyline", "m")]


# The reader distinguishes them by their keys, in this order.
SITE_LIMITS: tuple[type[Wall] | type[Tube] | type[Box], ...] = (Wall, Tube, Box)
_SITE_LIMIT = Meta(
    extra={"said": "a box, a wall or a tube", "shapes": SITE_LIMITS},
    extra_json_schema={"minProperties": 1, "anyOf": [{"$ref": f"#/$defs/{shape.__name__}"} for shape in SITE_LIMITS]},
)
SiteLimitTable = Annotated[dict[str, Any], _SITE_LIMIT]
_SITES = Meta(extra={"of": "site = limits", "noun": "site"})


class LimitsSection(Section, frozen=True):
    """Limits at every instant."""

    effort: Annotated[
        kinds.Efforts, key("[low, high] by actuator", "N.m, N", "the model's own", "{ {actuator} = {effort_range} }")
    ] = {}
    range_deg: Annotated[
        kinds.Ranges,
        key(
            "hinges' ranges, dependent joints too, within the model's own",
            "deg",
            "the model's own",
            "{ {hinge} = {hinge_range} }",
        ),
    ] = {}
    range_m: Annotated[kinds.Ranges, key("slides' ranges", "m", "the model's own", "{ {slide} = {slide_range} }")] = {}
    speed_deg_s: Annotated[
        kinds.Speeds,
        key(
            "hinges' speeds, dependent joints too: a number for both ways, or [low, high]",
            "deg/s",
            "none",
            "{ {hinge} = 900.0 }",
        ),
    ] = {}
    speed_m_s: Annotated[kinds.Speeds, key("slides' speeds", "m/s", "none", "{ {slide} = 1.0 }")] = {}
    effort_rate: Annotated[
        kinds.ActuatorLimits,
        key("rate of efforts by actuator; efforts then have no jumps", "N.m/s, N/s", "none", "{ {actuator} = 5000.0 }"),
    ] = {}
    power_w: Annotated[
        kinds.ActuatorLimits,
        key("mechanical power by actuator: a number, or [low, high]", "W", "none", "{ {actuator} = 500.0 }"),
    ] = {}
    closure_force: Annotated[
        kinds.ClosureLimits, key("the largest force on a closure's pin", "N", "none", "{ {closure} = 1000.0 }")
    ] = {}
    reserve: Annotated[kinds.Margin, key("the share of every effort limit that a plan leaves to feedback")] = 0.0
    singular_margin: Annotated[kinds.Margin, key("the least |det J_z| along the motion, relative to its value at home")] = (
        0.0
    )
    site: Annotated[
        dict[str, SiteLimitTable | list[SiteLimitTable]],
        _SITES,
        key(
            "boxes, walls and tubes that sites stay within, one or a list of them",
            "m",
            "none",
            "{ {site} = { z = [-inf, inf] } }",
        ),
    ] = {}
    contacts: Annotated[
        kinds.Contacts, key("refuse a plan along which geoms collide, or note it and plan without contact forces")
    ] = "refuse"
    unhonoured: Annotated[
        kinds.Contacts, key("refuse a model with forces that the planner does not honour, or note and omit them")
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
    no_load_speed_m_s: Annotated[kinds.Positive, key("of an actuator whose effort is a force", "m/s", "unknown")] = ABSENT


_TOGETHER = {"torque_constant": ["resistance_ohm"], "resistance_ohm": ["torque_constant"]}
MotorTable = Annotated[MotorSection, Meta(extra_json_schema={"dependentRequired": _TOGETHER})]


class RobustSection(Section, frozen=True):
    """Ranges of machines, at every corner of which one motion keeps all effort limits."""

    payload_factor: Annotated[
        kinds.Interval,
        key(
            "[low, high] of the factor on the payload's mass and inertia",
            default="[1, 1]",
            example="[0.8, 1.2]",
            needs="fully_driven",
        ),
    ] = ABSENT
    torque_constant_factor: Annotated[
        kinds.Interval,
        key(
            "[low, high] of the ratio of an actuator's actual to commanded effort",
            default="[1, 1]",
            example="[0.95, 1.05]",
            needs="fully_driven",
        ),
    ] = ABSENT
    viscous_friction: Annotated[
        kinds.Ranges,
        key(
            "[low, high] of a joint's damping, added to the model's",
            "N.m.s/rad, N.s/m",
            "none",
            "{ {joint} = [0.0, 0.05] }",
            needs="fully_driven",
        ),
    ] = {}
    coulomb_friction: Annotated[
        kinds.Ranges,
        key(
            "[low, high] of a joint's dry friction, of either sign",
            "N.m, N",
            "none",
            "{ {joint} = [0.0, 2.0] }",
            needs="fully_driven",
        ),
    ] = {}
