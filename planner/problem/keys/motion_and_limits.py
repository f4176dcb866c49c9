"""The sections [motion], [reference], [limits], [motors] and [robust] of a problem file, with the tables in them."""

import math
from typing import Annotated, Any, Self

from msgspec import Meta, field

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
        "from start to goal; at rest at the start; back to its first state; exactly the reference; or a site on its path"
    )
    start_deg: kinds.Angles = by_joint("hinges' angles at the start", "deg", _OPEN)
    start_at: kinds.Places = by_name(f"sites' places at the start, {_PLACES}", "m", "by the joints")
    start_body_deg: kinds.BodyAngles = by_name(f"bodies' angles at the start, {_ANGLES}", "deg", "by the joints")
    goal_deg: kinds.Angles = by_joint(f"hinges' angles {_END}", "deg", _OPEN)
    goal_at: kinds.Places = by_name(f"sites' places at the end, {_PLACES}", "m", "by the joints")
    goal_body_deg: kinds.BodyAngles = by_name(f"bodies' angles at the end, {_ANGLES}", "deg", "by the joints")
    start_speed_deg_s: kinds.Numbers = by_joint("hinges' speeds at the start", "deg/s", "at rest")
    goal_speed_deg_s: kinds.Numbers = by_joint("hinges' speeds at the end", "deg/s", "at rest")
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
        "the time after which the first row follows the last", "s", "the last row is the first one again, or no period"
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
    on: kinds.ForceColumns = by_name("sites' forces in every row; a direction that is left out has none", "N", "none")
    period_s: kinds.Positive = key(
        "the time after which the first row follows the last",
        "s",
        "of a periodic motion the last row, which is the first one again; of others none, and the last row is held",
    )
    interpolation: kinds.Interpolation = key("between the rows: linear, or the cubic spline through them", default="linear")


ForceTable = Annotated[ForceSection, Meta(extra_json_schema={"anyOf": [{"required": [key]} for key in ("file", "time_s")]})]


class PathSection(Section, frozen=True):
    """A path that a site follows exactly from rest at its first point to rest at its last, for motion.kind "follow"."""

    site: str = required("the site that follows the path")
    points: kinds.Corners = key("points of the path in the world, in order; or a file", "m", "those of the file", default=[])
    file: str = key("a CSV file with columns x_m, y_m, z_m, in place of points", "", "none")
    shape: kinds.Shape = key(
        "of the curve through the points: polyline with rounded corners, natural cubic spline, or the arc through three",
        default="polyline",
    )
    blend_m: kinds.Positive = key("the distance from a polyline's corners at which they begin to be rounded", "m", "none")


_PATH_ONE_OF = [{"required": [key]} for key in ("points", "file")]
PathTable = Annotated[PathSection, Meta(extra_json_schema={"anyOf": _PATH_ONE_OF})]


class Box(Section, frozen=True):
    """Bounds on a site's coordinates."""

    x: kinds.Interval = key("[low, high] of x; ends may be infinite", "m", "any")
    y: kinds.Interval = key("[low, high] of y", "m", "any")
    z: kinds.Interval = key("[low, high] of z", "m", "any")


class Wall(Section, frozen=True):
    """A plane that a site stays on one side of."""

    normal: kinds.Point = required("points to the side that is free")
    at: kinds.Point = required("a point of the wall", "m")


class Tube(Section, frozen=True):
    """A polyline that a site stays near to."""

    along: kinds.Corners = required("the corners of the polyline", "m")
    radius_m: kinds.Positive = required("the largest distance of the site from the polyline", "m")


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

    effort: kinds.Efforts = by_name("[low, high] by actuator", "N.m, N", "the model's own")
    range_deg: kinds.Ranges = by_joint(
        "hinges' ranges, dependent joints too, within the model's own",
        "deg",
        "the model's own",
    )
    speed_deg_s: kinds.Speeds = by_joint(
        "hinges' speeds, dependent joints too: a number for both ways, or [low, high]",
        "deg/s",
        "none",
    )
    acceleration_deg_s2: kinds.Speeds = by_joint(
        "hinges' accelerations, dependent joints too: a number for both ways, or [low, high]", "deg/s2", "none"
    )
    jerk_deg_s3: kinds.Speeds = by_joint(
        "hinges' jerk, dependent joints too; accelerations then have no jumps, not even from rest", "deg/s3", "none"
    )
    site_acceleration_m_s2: kinds.SiteAccelerations = by_name("the largest acceleration of a site", "m/s2", "none")
    site_jerk_m_s3: kinds.SiteJerks = by_name(
        "the largest jerk of a site; accelerations then have no jumps, not even from rest", "m/s3", "none"
    )
    effort_rate: kinds.ActuatorLimits = by_name(
        "rate of efforts by actuator; efforts then have no jumps", "N.m/s, N/s", "none"
    )
    power_w: kinds.ActuatorLimits = by_name("mechanical power by actuator: a number, or [low, high]", "W", "none")
    closure_force: kinds.ClosureLimits = by_name("the largest force on a closure's pin", "N", "none")
    reserve: kinds.Margin = key("the share of every effort limit that a plan leaves to feedback", default=0.0)
    singular_margin: kinds.Margin = key("the least |det J_z| along the motion, relative to its value at home", default=0.0)
    site: Annotated[dict[str, SiteLimitTable | list[SiteLimitTable]], _SITES] = by_name(
        "boxes, walls and tubes that sites stay within, one or a list of them",
        "m",
        "none",
    )
    body_deg: kinds.BodyRanges = by_name(
        "bodies' angles, [low, high]; infinite ends limit nothing and show the angle", "deg", "none"
    )
    contacts: kinds.Contacts = key(
        "refuse a plan along which geoms collide, or note it and plan without contact forces", default="refuse"
    )
    unhonoured: kinds.Contacts = key(
        "refuse a model with forces that plans neglect, or note them and plan without them", default="refuse"
    )


class Motor(Section, frozen=True):
    """The motor behind an actuator, in the actuator's own effort and speed."""

    torque_constant: kinds.Positive = key(
        "effort per current; with resistance_ohm it gives the copper loss", "N.m/A, N/A", "unknown"
    )
    resistance_ohm: kinds.Positive = key("of the winding", "ohm", "unknown")
    stall_effort: kinds.Positive = key("at rest; with the no-load speed it gives the torque-speed line", "N.m, N", "unknown")
    no_load_speed_deg_s: kinds.Positive = key(
        "of an actuator that turns", "deg/s", "unknown", twin=(("that turns", "whose effort is a force"),)
    )

    @property
    def no_load_speed(self) -> float | None:
        """The no-load speed [rad/s or m/s]."""
        turning = self.no_load_speed_deg_s
        return self.no_load_speed_m_s if turning is None else math.radians(turning)

    @property
    def line(self) -> tuple[float, float] | None:
        """The stall effort and no-load speed of the line |u / stall + w / no_load| <= 1, w the actuator's speed."""
        return None if self.stall_effort is None or self.no_load_speed is None else (self.stall_effort, self.no_load_speed)

    @property
    def loss(self) -> float:
        """Copper loss per squared effort, R / k^2; 0 where unknown."""
        k, R = self.torque_constant, self.resistance_ohm
        return 0.0 if k is None or R is None else R / k**2

    def with_line(self, factor: float) -> Self:
        """Return the motor with its line multiplied by a factor; without one if that is infinite."""
        given = {name: getattr(self, name) for name in ("stall_effort", "no_load_speed_deg_s", "no_load_speed_m_s")}
        return self.replace(**{name: end and end * factor if math.isfinite(factor) else None for name, end in given.items()})


_TOGETHER = {"torque_constant": ["resistance_ohm"], "resistance_ohm": ["torque_constant"]}
MotorTable = Annotated[Motor, Meta(extra_json_schema={"dependentRequired": _TOGETHER})]


_ONE = field(default_factory=lambda: [1.0, 1.0])


class RobustSection(Section, frozen=True):
    """Ranges of machines, at every corner of which one motion keeps all effort limits."""

    payload_factor: kinds.Interval = key(
        "[low, high] of the factor on the payload's mass and inertia", "", "[1, 1]", default=_ONE
    )
    torque_constant_factor: kinds.Interval = key(
        "[low, high] of the ratio of an actuator's actual to commanded effort", "", "[1, 1]", default=_ONE
    )
    viscous_friction: kinds.Ranges = by_name(
        "[low, high] of a joint's damping, added to the model's",
        "N.m.s/rad, N.s/m",
        "none",
    )
    coulomb_friction: kinds.Ranges = by_name("[low, high] of a joint's dry friction, of either sign", "N.m, N", "none")
