"""The sections of a motion: start, goal, waypoints, and the reference."""

from typing import Annotated

from msgspec import Meta

from linkplan.planner.keys import kinds
from linkplan.planner.keys.section import ABSENT, Section, key


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
_OPEN = "free in a periodic motion; a reach needs it"


class MotionSection(Section, frozen=True):
    """The motion: start, goal, waypoints and duration."""

    kind: Annotated[
        kinds.Kind, key("from start to goal; back to its first state; or exactly the reference", example='"reach"')
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
