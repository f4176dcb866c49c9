"""The sections of problem and batch files, one struct each, with the type, default and meaning of every key in order.

The reader, the JSON Schema and the table of keys are derived from them. Angles are in degrees with `_deg` in the key, slides
in metres with `_m`; all else is SI.
"""

import functools
import math
from typing import Annotated, Any

from msgspec import Meta, field

from linkplan.models.catalogue import MODELS
from linkplan.planner.problem.keys import kinds
from linkplan.planner.problem.keys.imperfections import ImperfectionsSection
from linkplan.planner.problem.keys.limits import LimitsSection, MotorTable, RobustSection
from linkplan.planner.problem.keys.motion import ForceTable, MotionSection, PathTable, ReferenceTable
from linkplan.planner.problem.keys.section import Section, by_joint, by_name, key, required

# Each case and phase has a folder with its name, next to the JSON records of results. So names have no separators,
# wildcards or unprintable characters, and do not end in .json.
FOLDER_NAME = Meta(
    pattern=r"""^(?!.*\.[jJ][sS][oO][nN]$)[^./\\:*?"<>|\x00-\x1f\x7f][^/\\:*?"<>|\x00-\x1f\x7f]*$""",
    max_length=99,
    extra={"said": "a word that can name a folder, without .json at its end"},
)
# The transcription and the number of intervals of a first mesh, unless the file gives them.
DEFAULT_SCHEME, JERK_SCHEME = "radau-3", "radau-5"  # the least jerk is quadratic between limits, and the acceleration cubic
# Along a path there are three times as many intervals, because the program of one degree of freedom is small. With 40, 80
# and 120, least times exceed those of an independent path parameterisation by 5e-4, 1.5e-4 and 1e-4 for a five-bar's
# polyline with two corners, and by less than 1e-7 for a line.
DEFAULT_INTERVALS, PATH_INTERVALS = 40, 120
# The default control period [s]; if the model's timestep is longer, the period is one timestep.
DEFAULT_PERIOD_S = 1e-4
# Control periods in which the whole effort limit reaches a default LQR error from rest. With 4, 13 of 400 light machines
# with default imperfections chatter between their limits; with 5 none does, and 6 leaves a reserve.
LQR_RESPONSE_PERIODS = 6
# The default LQR errors of heavier machines, of position and speed: of hinges [deg, deg/s] and of slides [m, m/s].
LQR_DEFAULTS = {"deg": (1.0, 100.0), "m": (0.01, 1.0)}
_PROBLEM = Meta(min_length=1, extra={"said": "a built-in name or a TOML file"})
_CASES = Meta(min_length=1, extra={"said": "a list of tables ([[case]])"})
_SWEEP = Meta(min_length=1, extra={"said": "a table of key = list of values", "of": "key = list of values"})
_MODEL = Meta(
    min_length=1, extra={"said": "a built-in name or a path to an MJCF file"}, extra_json_schema={"examples": list(MODELS)}
)
_PAYLOAD = Meta(extra={"said": f"a built-in name ({', '.join(kinds.PAYLOADS)}, none) or a table"})
_SWITCH = Meta(extra={"said": "true or false"})
_PLAN = Meta(extra={"said": "a saved plan's folder"})
PARAMETERS = Meta(extra={"of": "name = its value or table"})
_MOTORS = Meta(extra={"of": "actuator = its motor", "noun": "actuator of [motors]"})


class PayloadSection(Section, frozen=True):
    """A rigid payload welded to a body of the model."""

    body: str = required("the body that carries it")
    mass_kg: kinds.Mass = required("its mass", "kg")
    com_m: kinds.Centre = required("its centre of mass in the body's frame", "m")
    inertia_kgm2: kinds.Moments = key(
        "moments about axes parallel to the body's through the centre of mass",
        "kg m2",
        "0, a point mass",
        default=field(default_factory=functools.partial(list, (0.0, 0.0, 0.0))),
    )


class LoadSection(Section, frozen=True):
    """A force over a place or a speed: the monotone cubic through rows, and beyond them the last row's."""

    effort: kinds.Path = required("the force or torque in every row", "N, N.m")
    joint: str = key("the joint on which it acts, positive along its position", "", "none: a site")
    site: str = key("the site on which it acts", "", "none: a joint")
    direction: kinds.Point = key("the direction in the world in which it acts on the site", "", "none")
    over: str = key(
        "another joint, over whose position it is given", "", "the joint itself, or the site along the direction"
    )
    at_deg: kinds.Path = key("the rows' angles", "deg", "none")
    at_m: kinds.Path = key("the rows' places", "m", "none")
    at_deg_s: kinds.Path = key("the rows' speeds", "deg/s", "none")
    at_m_s: kinds.Path = key("the rows' speeds", "m/s", "none")


_LOADS = Meta(extra={"said": f"a list of tables with keys {', '.join(LoadSection.__struct_fields__)}", "numbered": True})


class MechanismSection(Section, frozen=True):
    """The machine: its model, its assembly and its payload."""

    model: Annotated[str, _MODEL] = required("a built-in name, a path to an MJCF file, or MJCF text")
    payload: Annotated[kinds.PayloadName | PayloadSection, _PAYLOAD] = key(
        "a built-in payload's name, or a table",
        otherwise="none",
        default="none",
    )
    home_deg: kinds.HomeAngles = by_joint(
        "hinges' angles for the assembly, which determine the branch",
        "deg",
        "the model's keyframe home",
    )
    independent: kinds.Names = key(
        "the joints in which the motion is planned",
        otherwise="the driven joints, or those that the motion names",
    )
    keep: kinds.Kept = key(
        "bodies or joints of a larger robot: only these are read, with everything attached to them and their loops",
        otherwise="the whole model",
    )
    fix_base: Annotated[bool, _SWITCH] = key(
        "whether the joints between the world and the kept bodies are locked, and a base without actuators",
        otherwise="false",
        default=False,
    )
    lock: kinds.Locks = by_name("positions of joints that do not move", "deg, m on slides", "none")
    keyframe: str = key("the model's keyframe that gives the home pose", otherwise="home, or the reference pose")
    exclude_contacts: kinds.BodyPairs = key(
        "pairs of bodies that pass through each other in simulation and in the search for contacts",
        otherwise="none",
        default=[],
    )
    drive: kinds.Names = key(
        "joints that get a motor, within their effort limits",
        otherwise="none: the model's actuators",
    )
    lock_spin: kinds.BallJoints = key(
        "ball joints of rods that do not spin about their own line", otherwise="none", default=[]
    )
    force: kinds.Forces = by_name(
        "constant forces [x, y, z] in the world's axes by site: a load on a foot or hook", "N", "none"
    )
    load: Annotated[list[LoadSection], _LOADS] = key("forces over a place or a speed", otherwise="none", default=[])
    gear: kinds.ActuatorGears = by_name(
        "gears of motors by actuator: the motor's position over that of its joint or tendon", "1, rad/m", "the model's own"
    )
    rotor_inertia: kinds.RotorInertias = by_name(
        "inertia of the motors' rotors by actuator, before the gear", "kg m2, kg", "the model's own"
    )
    stand: kinds.Footings = by_name(
        "points [x, y, z] of the world on which sites stand, with the ground's normal if it is not z", "m", "none"
    )
    open: kinds.Closures = key("closures that are switched off", otherwise="none", default=[])
    effort_sharing: kinds.Sharing = key(
        "how more actuators than degrees of freedom share an effort outside the optimiser, always within their limits: by"
        " least squares, or with the least peak",
        default="least_squares",
    )
    pre_tension: kinds.ActuatorEfforts = by_name(
        "efforts by actuator, nearest to which they do so: the tension of cables", "N, N.m", "0"
    )
    closure_tolerance_m: kinds.Positive = key(
        "the largest gap of a loop that counts as rounding of the model", "m", "by the mechanism's size"
    )
    solref: kinds.Softness = key("closures as stiff in simulation as the timestep permits", "", "the model's own")
    friction_transition_deg_s: kinds.Positive = key(
        "the speed v_0 of dry friction f tanh(v / v_0); for slides and tendons as many rad/s times the mechanism's size",
        "deg/s",
        default=2.0,
    )


class ObjectiveSection(Section, frozen=True):
    """The quantity that the motion minimises."""

    minimize: kinds.Term | kinds.Weights = key(
        "a term, or a weighted sum of terms: squared effort, duration, distance from the reference, positive work, copper"
        " loss, squared effort rate, squared closure force",
        otherwise="effort; tracking if there is a reference to follow",
    )


class ParameterTable(Section, frozen=True):
    """A number of the model that stays a symbol in its equations: its value, and how well it is known."""

    value: kinds.Number | None = key("its value; also written as NAME = value", "SI", "the model's own")
    range: kinds.Interval = key("[low, high] that contains it", "SI", "none")
    sd: kinds.AtLeastZero = key("its standard deviation", "SI", "none")
    tolerance: kinds.AtLeastZero = key("the largest error of its manufacture, of either sign", "SI", "none")

    @property
    def errors(self) -> tuple[float, float] | None:
        """Its largest error and its standard deviation [SI]; None without `tolerance` and `sd`.

        Errors within a tolerance alone are spread evenly; of an `sd` alone, three standard deviations are the largest error.
        """
        if not self.tolerance and not self.sd:
            return None
        largest = 3 * self.sd if self.tolerance is None else self.tolerance
        return largest, largest / math.sqrt(3) if self.sd is None else self.sd


class GuessSection(Section, frozen=True):
    """The initial guess: positions at equidistant times, or a saved plan's motion."""

    plan: Annotated[str, _PLAN] = key("a saved plan's folder, whose motion is the guess", "", "none")
    path_deg: kinds.Paths = by_joint("hinges' angles at equidistant times", "deg", "none")
    duration_s: kinds.Duration = key("the duration of the guess", "s", "the motion's own, or guessed")


class MeshSection(Section, frozen=True):
    """The discretisation: the transcription and the first mesh."""

    scheme: kinds.Scheme = key("the transcription", otherwise=f"{DEFAULT_SCHEME}; {JERK_SCHEME} for least jerk")
    intervals: kinds.Intervals = key(
        "the initial number of equal intervals", otherwise=f"{DEFAULT_INTERVALS}; {PATH_INTERVALS} along a path"
    )
    effort: kinds.EffortForm = key(
        "the shape of efforts on an interval",
        otherwise="polynomial; for least work constant, or linear if limits.effort_rate is given",
    )
    tolerance_deg: kinds.Tolerance = key("tolerance of the integrated state", "deg", "1e-6 while the mesh stays small")
    refine: kinds.Refine = key(
        "the refinement of a mesh that is too coarse", otherwise="both; intervals if a scheme is named"
    )
    breaks: kinds.Breaks = key("ends of the first mesh's intervals as shares of the duration", "", "equal intervals")


class SolverSection(Section, frozen=True):
    """Settings of the solver."""

    compile: kinds.Compile = key(
        "C functions, of mpc too, from the cache or compiled at the second use; or always; or never", default="auto"
    )
    max_time_s: kinds.SolveTime = key(
        "limit on the processor time of a whole plan: search, refinement, certificate", "s", default=600.0
    )
    starts: kinds.Starts = key("number of initial guesses; the best answer is kept", default=1)


def _lqr_defaults(rank: int) -> dict[str, Any]:
    """Return the phrases on default LQR errors of position (0) or speed (1), of hinges and of slides."""
    light = f"if larger, the error reached from rest in {LQR_RESPONSE_PERIODS} control periods at the effort limit"
    of_hinges, of_slides = (f"{LQR_DEFAULTS[unit][rank]:g}, or" for unit in ("deg", "m"))
    return {"otherwise": f"{of_hinges}, {light}", "twin": ((of_hinges, of_slides),)}


_BY_INERTIA = "from the inertia at the start pose and the control period"


class TrackingSection(Section, frozen=True):
    """The tracking of the plan in simulation: gains, sampling, delay."""

    kp: kinds.Gain | kinds.Gains = key(
        "proportional gain on the independent joints, for all or by joint", "N.m/rad, N/m", _BY_INERTIA
    )
    kd: kinds.Gain | kinds.Gains = key("derivative gain, for all or by joint", "N.m.s/rad, N.s/m", _BY_INERTIA)
    period_s: kinds.Period = key(
        "the control period", "s", f"{DEFAULT_PERIOD_S:g}, or the model's timestep if that is longer"
    )
    delay_periods: kinds.Delay = key(
        "control periods from a measurement to its effort, a whole number in tracking", default=0
    )
    duration_s: kinds.Duration = key("the duration of the run", "s", "the plan's own, plus a rest")
    lqr_position_deg: kinds.LqrError | kinds.LqrErrors = key(
        "a hinge's position error with the same weight as the whole effort limit, for all or by joint",
        "deg",
        **_lqr_defaults(0),
    )
    lqr_velocity_deg_s: kinds.LqrError | kinds.LqrErrors = key(
        "a hinge's speed error with the same weight", "deg/s", **_lqr_defaults(1)
    )
    bandwidth_hz: kinds.Positive = key(
        "natural frequency of the errors under ct, gs-pd+ff and default gains", "Hz", default=20.0
    )
    damping_ratio: kinds.Positive = key("damping ratio of these errors", default=1.0)
    integral_time_s: kinds.Positive = key(
        "lqi: time in which a position error's integral gains the weight of the error", "s", default=0.05
    )
    horizon_s: kinds.Positive = key("mpc: the horizon over which efforts satisfy their limits", "s", default=0.1)


class OutputSection(Section, frozen=True):
    """What the plan's table, figures and report show besides joints and efforts."""

    sites: kinds.Sites = key(
        "sites whose path, speed, acceleration and jerk are shown, besides those that the problem names elsewhere",
        otherwise="none",
        default=[],
    )


class ProblemFile(Section, frozen=True, kw_only=True):
    """A problem: a motion of a mechanism that minimises an objective within limits."""

    description: str = key("the problem in a sentence", otherwise="none", default="")
    mechanism: MechanismSection = required("the machine")
    motion: MotionSection = required("the motion")
    reference: ReferenceTable = key("the sinusoid or table to follow exactly or approximately", otherwise="none")
    force_over_time: ForceTable = key("forces on sites over the time of the motion", otherwise="none")
    path: PathTable = key("the path that a site follows exactly", otherwise="none")
    objective: ObjectiveSection = key("what to minimise", otherwise="by the kind of motion", default=ObjectiveSection())
    limits: LimitsSection = key("limits at every instant", otherwise="the model's own", default=LimitsSection())
    robust: RobustSection = key(
        "machines for which one motion satisfies every effort limit",
        otherwise="the nominal machine",
        default=RobustSection(),
    )
    parameters: Annotated[dict[str, kinds.Number | ParameterTable], PARAMETERS] = by_name(
        "numbers of the model by name, which `check` with `parameters` lists: values, ranges, tolerances",
        otherwise="none: every number is a constant",
    )
    motors: Annotated[dict[str, MotorTable], _MOTORS] = by_name(
        "the motor behind an actuator, by the actuator's name",
        otherwise="unknown",
    )
    guess: GuessSection = key("the initial guess", otherwise="found by the planner", default=GuessSection())
    mesh: MeshSection = key("the discretisation", otherwise="chosen", default=MeshSection())
    solver: SolverSection = key("the solver's settings", otherwise="chosen", default=SolverSection())
    tracking: TrackingSection = key("the plan's tracking", otherwise="PD", default=TrackingSection())
    output: OutputSection = key("what is shown in addition", otherwise="nothing", default=OutputSection())
    imperfections: ImperfectionsSection = key(
        "imperfections of the machines that an experiment simulates",
        otherwise="those of a carefully built machine",
    )


class CaseSection(Section, frozen=True):
    """One problem of a batch."""

    name: Annotated[str, FOLDER_NAME] = key("names its folder", otherwise="its number", default="")
    set: kinds.Settings = key('settings on the problem, "section.key=value"', otherwise="none", default=[])


class BatchFile(Section, frozen=True):
    """Many variations of one problem: a list of cases, or every combination of a sweep."""

    problem: Annotated[str, _PROBLEM] = required("the problem that is varied: a built-in name or a TOML file")
    set: kinds.Settings = key("settings for all cases", otherwise="none", default=[])
    case: Annotated[list[CaseSection], _CASES] = key("the cases", otherwise="those of the sweep", default=[])
    sweep: Annotated[dict[str, Any], _SWEEP] = by_name(
        "lists of values by key; every combination is a case", otherwise="none"
    )
