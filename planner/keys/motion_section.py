"""The sections of a motion: from where to where, by way of what, and the reference that it follows."""

from typing import Annotated

from msgspec import Meta

from linkplan.planner.keys import kinds
from linkplan.planner.keys.section import ABSENT, Section, key


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
            max_length=kinds.MOST_WAYPOINTS,
            extra={
                "said": f"a list of at most {kinds.MOST_WAYPOINTS} tables with keys"
                f" {', '.join(WaypointSection.__struct_fields__)}",
                "numbered": True,
            },
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
