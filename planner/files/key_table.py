"""Every key of a problem file with an example and what it means: for files that are begun anew, and for completion. Light.

The reader has the last word on what is legal; a test holds this table against it in both directions. Examples have names in
braces in place of a mechanism's own, {hinge}, {slide}, {actuator}, ..., see `NEEDS`.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """A key of a problem file.

    `example` is its value as TOML: its default, unless `otherwise` says what holds without it. `needs`, of `NEEDS`, are
    what a mechanism must have for it.
    """

    section: str
    key: str
    example: str
    doc: str
    otherwise: str = ""
    needs: tuple[str, ...] = ()

    @property
    def path(self) -> str:
        """The key as settings name it."""
        return f"{self.section}.{self.key}"


# What an example may name, of a mechanism: joints of either kind, independent ones of either kind, ...
NEEDS = ("hinge", "slide", "free_hinge", "free_slide", "actuator", "closure", "site", "body")

# Of each section in a few words.
SECTIONS = {
    "mechanism": "the machine",
    "motion": "what it is to do",
    "reference": 'a sinusoid to follow, for kind = "track" and minimize = "tracking"',
    "objective": "what is to be least",
    "limits": "what every instant keeps, beside the model's own limits",
    "motors": "the motor behind an actuator, where it is known",
    "guess": "where the solver begins, if not by itself",
    "mesh": "the transcription",
    "solver": "how it is solved",
    "tracking": "how the plan is tracked afterwards",
}


def _key(path: str, example: str, doc: str, otherwise: str = "", needs: str = "") -> Key:
    section, _, key = path.rpartition(".")
    return Key(section=section, key=key, example=example, doc=doc, otherwise=otherwise, needs=tuple(needs.split()))


KEYS: tuple[Key, ...] = (
    _key("mechanism.model", '"{model}"', "a built-in name or a path to an MJCF file, from this file's folder", "required"),
    _key(
        "mechanism.payload",
        '{ body = "{body}", mass_kg = 1.0, com_m = [0.0, 0.0, 0.0], inertia_kgm2 = [1e-3, 1e-3, 1e-3] }',
        "a rigid body welded on, or a built-in name",
        "none",
        "body",
    ),
    _key(
        "mechanism.home_deg", "{ {hinge} = {hinge_home} }", "where it is assembled, on which branch", "the model's", "hinge"
    ),
    _key("mechanism.home_m", "{ {slide} = {slide_home} }", "the same of slides", "the model's", "slide"),
    _key("mechanism.independent", "[{independent}]", "the joints whose motion is planned; the loops give the others"),
    _key("mechanism.closure_tolerance_m", "1e-6", "gap up to which a motion that the file's rounding alone forbids is free"),
    _key("mechanism.solref", '"stiff"', "loops as stiff in simulation as the timestep admits", "the model's", "closure"),
    _key("motion.kind", '"reach"', "reach, periodic (returns to its own state), track (follows the reference)", "required"),
    _key("motion.start_deg", "{ {free_hinge} = {free_hinge_home} }", "where it begins", "home", "free_hinge"),
    _key("motion.start_m", "{ {free_slide} = {free_slide_home} }", "where slides begin", "home", "free_slide"),
    _key("motion.start_at", "{ {site} = {site_home} }", "where a site begins, in place of joints", "by joints", "site"),
    _key(
        "motion.goal_deg",
        "{ {free_hinge} = {free_hinge_home} }",
        "where it ends; of kind periodic, half-way",
        "",
        "free_hinge",
    ),
    _key("motion.goal_m", "{ {free_slide} = {free_slide_home} }", "where slides end", "", "free_slide"),
    _key("motion.goal_at", "{ {site} = {site_home} }", "where a site ends, in place of joints", "by joints", "site"),
    _key("motion.start_speed_deg_s", "{ {free_hinge} = 0.0 }", "speed at the start", "", "free_hinge"),
    _key("motion.start_speed_m_s", "{ {free_slide} = 0.0 }", "speed of slides at the start", "", "free_slide"),
    _key("motion.goal_speed_deg_s", "{ {free_hinge} = 0.0 }", "speed at the end", "", "free_hinge"),
    _key("motion.goal_speed_m_s", "{ {free_slide} = 0.0 }", "speed of slides at the end", "", "free_slide"),
    _key("motion.duration_s", '"free"', 'seconds, or "free"'),
    _key("motion.min_duration_s", "0.1", "of a free duration", "none"),
    _key("motion.max_duration_s", "10.0", "of a free duration", "none"),
    _key(
        "motion.waypoints",
        "[{ {waypoint} }]",
        "passed in order: at_deg, at_m, at (of sites), speed_deg_s, speed_m_s, each at time_s or at a free time",
        "none",
    ),
    _key(
        "motion.turns", "{ {free_hinge} = 1 }", "of kind periodic: whole turns that a hinge goes on by", "none", "free_hinge"
    ),
    _key("reference.amplitude_deg", "{ {free_hinge} = 10.0 }", "of each independent joint", "required", "free_hinge"),
    _key("reference.amplitude_m", "{ {free_slide} = 0.01 }", "of each independent slide", "required", "free_slide"),
    _key("reference.bias_deg", "{ {free_hinge} = 0.0 }", "its middle", "", "free_hinge"),
    _key("reference.bias_m", "{ {free_slide} = 0.0 }", "its middle, of slides", "", "free_slide"),
    _key("reference.phase_deg", "{ {independent_joint} = 0.0 }", "at t = 0"),
    _key("reference.frequency_hz", "1.0", "of all joints", "required"),
    _key(
        "objective.minimize",
        '"effort"',
        "effort (integral of squared effort), time, tracking, work, copper_loss, effort_rate, closure_force,"
        " or a weighted sum { time = 1.0, effort = 1e-5 }",
    ),
    _key("limits.effort", "{ {actuator} = {effort_range} }", "[N.m or N]; the model's own", "", "actuator"),
    _key("limits.range_deg", "{ {hinge} = {hinge_range} }", "any joint, dependent ones too; the model's own", "", "hinge"),
    _key("limits.range_m", "{ {slide} = {slide_range} }", "the same of slides", "", "slide"),
    _key("limits.speed_deg_s", "{ {hinge} = 900.0 }", "or [low, high]; any joint", "none", "hinge"),
    _key("limits.speed_m_s", "{ {slide} = 1.0 }", "or [low, high]; any slide", "none", "slide"),
    _key("limits.effort_rate", "{ {actuator} = 5000.0 }", "[N.m/s or N/s]; efforts then have no jumps", "none", "actuator"),
    _key("limits.power_w", "{ {actuator} = 500.0 }", "mechanical, or [low, high]", "none", "actuator"),
    _key("limits.closure_force", "{ {closure} = 1000.0 }", "[N] of a pin", "none", "closure"),
    _key("limits.singular_margin", "0.0", "least det J_z along the motion, as a share of that at home"),
    _key("limits.site", "{ {site} = { z = [-inf, inf] } }", "boxes, walls and tubes that a site stays within", "", "site"),
    _key("limits.contacts", '"refuse"', 'a plan on whose way geoms meet; or "note": plan without contact forces'),
    _key(
        "motors.{actuator}",
        "{ torque_constant = 0.5, resistance_ohm = 0.1, stall_effort = {effort_high}, {no_load} }",
        "copper loss, and the torque-speed line kept at every instant; either pair may stand alone",
        "unknown",
        "actuator",
    ),
    _key("guess.plan", '"planned"', "the folder of a saved plan", "none"),
    _key(
        "guess.path_deg",
        "{ {free_hinge} = [{free_hinge_home}, {free_hinge_home}] }",
        "positions at equal times",
        "none",
        "free_hinge",
    ),
    _key(
        "guess.path_m",
        "{ {free_slide} = [{free_slide_home}, {free_slide_home}] }",
        "the same of slides",
        "none",
        "free_slide",
    ),
    _key("guess.duration_s", "1.0", "of that path", "none"),
    _key(
        "mesh.scheme", '"radau-3"', "radau-1 to 9, gauss-1 to 9, trapezoid, hermite-simpson; the latter two also -consistent"
    ),
    _key("mesh.intervals", "40", "of the first mesh"),
    _key("mesh.effort", '"polynomial"', 'over an interval; or "linear", "constant" (the default for least work)'),
    _key("mesh.tolerance_deg", "1e-6", "on the integrated state", "towards 1e-6 while the mesh stays small"),
    _key("mesh.refine", '"both"', 'finer "intervals", higher "degree", or both; a scheme that is named keeps its degree'),
    _key("mesh.breaks", "[0.0, 0.5, 1.0]", "of the first mesh, as shares of the duration, in place of intervals", "even"),
    _key("solver.name", '"ipopt"', 'or "fatrop"'),
    _key("solver.compile", '"auto"', 'C functions where the cache has them; "always", "never"'),
    _key("solver.max_time_s", "600.0", "of the whole plan"),
    _key("solver.starts", "1", "of so many motions to start from, the best answer"),
    _key("tracking.kp", "200.0", "[N.m/rad; N/m on a slide] on the independent joints, or { joint = gain } for each"),
    _key("tracking.kd", "1.0", "[N.m.s/rad; N.s/m on a slide]"),
    _key("tracking.period_s", "1e-4", "the control period"),
    _key("tracking.delay_periods", "0", "of computing, in control periods"),
    _key("tracking.duration_s", "2.0", "of the run", "the plan's own"),
    _key("tracking.lqr_position_deg", "1.0", "the error that weighs as much as the whole effort limit"),
    _key("tracking.lqr_velocity_deg_s", "100.0", "the same of speed"),
    _key("tracking.lqr_position_m", "0.01", "the same of slides"),
    _key("tracking.lqr_velocity_m_s", "1.0", "the same of the speed of slides"),
)
