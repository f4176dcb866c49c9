"""The sections [motion], [reference], [force_over_time] and [path] of a problem file, with the tables in them."""

from typing import Annotated

from msgspec import Meta

from linkplan.planner.problem.keys import kinds
from linkplan.planner.problem.keys.section import Section, by_joint, by_name, key, required


class WaypointSection(Section, frozen=True):
    """A state between start and goal: a position, a speed or both, at a given or free time."""

    at_deg: kinds.Angles = by_joint("hinges' angles", "deg", "free")
    at: kinds.Places = by_name("sites' places, instead of joints' positions", "m", "free")
    body_deg: kinds.BodyAngles = by_name("bodies' angles, instead of joints' positions or beside `at`", "deg", "free")
    speed_deg_s: kinds.Numbers = by_joint("hinges' speeds", "deg/s", "free")
    time_s: kinds.Positive | kinds.Free = key("the time of passage", "s", default="free")


# The default of start and goal.
_OPEN = "free in a periodic motion; a reach needs it, and a hold its start"
_END = "at the end, or after half a period"
_PLACES = "instead of joints' positions"
_AS_ENDS = "free; 0 at rest"
_ANGLES = f"{_PLACES} or beside sites' places"
_WAYPOINTS = Meta(
    max_length=kinds.MAX_WAYPOINTS,
    extra={
        "said": f"a list of at most {kinds.MAX_WAYPOINTS} tables with keys {', '.join(WaypointSection.__struct_fields__)}",
        "numbered": True,
    },
)


class MotionSection(Section, frozen=True):
    """The motion: start, goal, waypoints and duration."""

    kind: kinds.Kind = required(
        "from start to goal; at rest at the start; back to the initial state; exactly along the reference; or with a site"
        " on its path"
    )
    start_deg: kinds.Angles = by_joint("hinges' angles at the start", "deg", _OPEN)
    start_at: kinds.Places = by_name(f"sites' places at the start, {_PLACES}", "m", "by the joints")
    start_body_deg: kinds.BodyAngles = by_name(f"bodies' angles at the start, {_ANGLES}", "deg", "by the joints")
    goal_deg: kinds.Angles = by_joint(f"hinges' angles {_END}", "deg", _OPEN)
    goal_at: kinds.Places = by_name(f"sites' places at the end, {_PLACES}", "m", "by the joints")
    goal_body_deg: kinds.BodyAngles = by_name(f"bodies' angles at the end, {_ANGLES}", "deg", "by the joints")
    start_speed_deg_s: kinds.Numbers = by_joint("hinges' speeds at the start", "deg/s", "at rest")
    goal_speed_deg_s: kinds.Numbers = by_joint("hinges' speeds at the end", "deg/s", "at rest")
    start_acceleration_deg_s2: kinds.Numbers = by_joint(
        "hinges' accelerations at a start with a speed, if a limit keeps them from jumping", "deg/s2", _AS_ENDS
    )
    goal_acceleration_deg_s2: kinds.Numbers = by_joint("the same at the end", "deg/s2", _AS_ENDS)
    duration_s: kinds.Duration | kinds.Free = key('the duration, or "free"', "s", "free, or the reference's period")
    min_duration_s: kinds.ShortDuration = key("the shortest free duration", "s", "any")
    max_duration_s: kinds.Duration = key("the longest free duration", "s", "any")
    waypoints: Annotated[list[WaypointSection], _WAYPOINTS] = key(
        "states between start and goal, in order: at_deg, at_m, at (of sites) or body_deg, speed_deg_s, speed_m_s, each at"
        " its time_s or at a free time",
        otherwise="none",
        default=[],
    )
    turns: kinds.WholeTurns = key(
        "whole turns of hinges over a period of a periodic motion",
        otherwise="none: it returns in full",
    )


_EACH = "none: each joint needs one"


class ReferenceSection(Section, frozen=True):
    """A sinusoid for each independent joint, bias + amplitude sin(2 pi frequency t + phase), or a table of rows."""

    frequency_hz: kinds.Frequency = key("common to all joints; its period is the motion's", "Hz", "none: rows are given")
    amplitude_deg: kinds.Angles = by_joint("hinges' amplitudes", "deg", _EACH)
    bias_deg: kinds.Angles = by_joint("hinges' mean angles", "deg", "0")
    phase_deg: kinds.Phases = by_name("phases by joint", "deg", "0")
    file: str = key(
        "a CSV file with a column time_s and columns of joints (O_deg, slide_m), or of sites (foot_x_m) and bodies"
        " (body_shank_deg)",
        "",
        "none",
    )
    time_s: kinds.Path = key("the rows' times, in place of a file", "s", "none")
    position_deg: kinds.Paths = by_joint("hinges' angles in every row", "deg", "none")
    at: kinds.PlaceColumns = by_name("sites' coordinates in every row, in place of joints", "m", "none")
    body_deg: kinds.BodyPaths = by_name("bodies' angles in every row, in place of joints or beside `at`", "deg", "none")
    period_s: kinds.Positive = key(
        "the time after which the first row follows the last", "s", "none; the last row must equal the first to repeat"
    )
    spline: kinds.Spline = key(
        "of the cubic spline through the rows: periodic, clamped (at rest at both ends) or natural (no acceleration there)",
        "",
        "periodic if the last row equals the first, else clamped",
    )


_ONE_OF = [{"required": [key]} for key in ("frequency_hz", "file", "time_s")]
ReferenceTable = Annotated[ReferenceSection, Meta(extra_json_schema={"anyOf": _ONE_OF})]


class ForceSection(Section, frozen=True):
    """Forces on sites in the world's axes as a table over the time of the motion, whose first row is at its start."""

    file: str = key("a CSV file with a column time_s and columns of sites' forces (foot_x_N, foot_z_N)", "", "none")
    time_s: kinds.Path = key("the rows' times, in place of a file", "s", "none")
    on: kinds.ForceColumns = by_name("sites' forces in every row; omitted directions have no force", "N", "none")
    period_s: kinds.Positive = key(
        "the time after which the first row follows the last",
        "s",
        "for a periodic motion the last row, which must equal the first; otherwise none, and the last row is held",
    )
    interpolation: kinds.Interpolation = key("between the rows: linear, or the cubic spline through them", default="linear")


ForceTable = Annotated[ForceSection, Meta(extra_json_schema={"anyOf": [{"required": [key]} for key in ("file", "time_s")]})]


class PathSection(Section, frozen=True):
    """A path that a site follows exactly from its first point to its last, for motion.kind "follow"."""

    site: str = required("the site that follows the path")
    points: kinds.Corners = key("points of the path in the world, in order; or a file", "m", "those of the file", default=[])
    file: str = key("a CSV file with columns x_m, y_m, z_m, in place of points", "", "none")
    shape: kinds.Shape = key(
        "of the curve through the points: polyline with rounded corners, natural cubic spline, or the arc through three",
        default="polyline",
    )
    blend_m: kinds.Positive = key("the distance from a polyline's corners at which their rounding begins", "m", "none")
    feed_m_s: kinds.Positive | kinds.Free = key(
        'the constant speed of the site from the first point to the last; "free": the length over the duration, or the'
        " largest within the limits",
        "m/s",
        "none",
    )
    start_speed_m_s: kinds.Positive = key("the site's speed along the path at its beginning", "m/s", "at rest")
    goal_speed_m_s: kinds.Positive = key("the same at its end", "m/s", "at rest")
    start_acceleration_m_s2: kinds.Number = key(
        "the site's acceleration along the path at its beginning, if it moves there and a limit keeps it from jumping",
        "m/s2",
        _AS_ENDS,
    )
    goal_acceleration_m_s2: kinds.Number = key("the same at its end", "m/s2", _AS_ENDS)


_PATH_ONE_OF = [{"required": [key]} for key in ("points", "file")]
PathTable = Annotated[PathSection, Meta(extra_json_schema={"anyOf": _PATH_ONE_OF})]
