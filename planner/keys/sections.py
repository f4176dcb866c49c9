"""The sections of problem and batch files, one struct each, with the type, default and meaning of every key in order.

The reader, the JSON Schema and the table of keys are derived from them. Angles are in degrees with `_deg` in the key, slides
in metres with `_m`; all else is SI.
"""

from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta, defstruct

from linkplan.models.catalogue import MODELS
from linkplan.planner.keys import kinds
from linkplan.planner.keys.kinds import ABSENT, FORMS, QUANTITIES, WORDS, Quantity, Section, Settings, key, spread_schema
from linkplan.planner.keys.motion_and_limits import LimitsSection, MotionSection, MotorTable, ReferenceSection, RobustSection

# Each case has a folder with its name, next to the JSON records of results: so names have no separators, wildcards or
# unprintable characters, and do not end in .json.
_FOLDER_NAME = Meta(
    pattern=r"""^(?!.*\.[jJ][sS][oO][nN]$)[^./\\:*?"<>|\x00-\x1f\x7f][^/\\:*?"<>|\x00-\x1f\x7f]*$""",
    max_length=99,
    extra={"said": "a word that can name a folder, without .json at its end"},
)
_PROBLEM = Meta(min_length=1, extra={"said": "a built-in name or a TOML file"})
_CASES = Meta(min_length=1, extra={"said": "a list of tables ([[case]])"})
_SWEEP = Meta(min_length=1, extra={"said": "a table of key = list of values", "of": "key = list of values"})


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


_PAYLOAD_EXAMPLE = "{ body = {body}, mass_kg = 1.0, com_m = [0.0, 0.0, 0.0], inertia_kgm2 = [1e-3, 1e-3, 1e-3] }"


class MechanismSection(Section, frozen=True):
    """The machine: its model, its assembly and its payload."""

    model: Annotated[str, _MODEL, key("a built-in name, a path to an MJCF file, or MJCF text", example='"{model}"')]
    payload: Annotated[
        kinds.PayloadName | PayloadSection,
        Meta(extra={"said": f"a built-in name ({', '.join(kinds.PAYLOADS)}, none) or a table"}),
        key("a built-in payload's name, or a table", default="none", example=_PAYLOAD_EXAMPLE),
    ] = ABSENT
    home_deg: Annotated[
        kinds.HomeAngles,
        key(
            "hinges' angles for the assembly, which determine the branch",
            "deg",
            "the model's keyframe home",
            "{ {hinge} = {hinge_home} }",
        ),
    ] = {}
    home_m: Annotated[
        kinds.HomeLengths,
        key("slides' positions for the assembly", "m", "the model's keyframe home", "{ {slide} = {slide_home} }"),
    ] = {}
    independent: Annotated[
        kinds.Names,
        key(
            "the joints in which the motion is planned",
            default="the driven joints, or those that the motion names",
            example="[{independent}]",
        ),
    ] = ABSENT
    keep: Annotated[
        kinds.Kept,
        key(
            "bodies or joints: of a larger robot, only these are read, with what hangs on them and the loops over them",
            default="the whole model",
            example="[{bodies}]",
        ),
    ] = ABSENT
    fix_base: Annotated[
        bool,
        Meta(extra={"said": "true or false"}),
        key(
            "whether what lies between the world and the kept bodies is locked, and a base that nothing drives",
            default="false",
            example="true",
        ),
    ] = ABSENT
    lock: Annotated[kinds.Locks, key("positions of joints that do not move", "deg, m on slides", "none", "{}")] = {}
    keyframe: Annotated[
        str, key("the model's keyframe that gives the home pose", default="home, or the reference pose", example='"home"')
    ] = ABSENT
    exclude_contacts: Annotated[
        kinds.BodyPairs,
        key(
            "pairs of bodies that pass through each other in simulation and in the search for contacts",
            default="none",
            example="[]",
        ),
    ] = []
    drive: Annotated[
        kinds.Names,
        key(
            "joints that get a motor, within their effort limits",
            default="none: the model's actuators",
            example="[{independent}]",
        ),
    ] = ABSENT
    lock_spin: Annotated[
        kinds.BallJoints,
        key("ball joints of rods that do not spin about their own line", default="none", example="[]"),
    ] = []
    closure_tolerance_m: Annotated[
        kinds.Positive,
        key("the largest gap of a loop that counts as rounding of the model", "m", "by the mechanism's size", "1e-6"),
    ] = ABSENT
    solref: Annotated[
        kinds.Softness,
        key(
            "closures as stiff in simulation as the timestep admits",
            default="the model's own",
            example='"stiff"',
            needs="closure",
        ),
    ] = ABSENT
    friction_transition_deg_s: Annotated[
        kinds.Positive,
        key(
            "the speed v_0 of dry friction f tanh(v / v_0); for slides and tendons as many rad/s times the mechanism's size",
            "deg/s",
            "2",
            "2.0",
        ),
    ] = ABSENT


class ObjectiveSection(Section, frozen=True):
    """The quantity that the motion minimises."""

    minimize: Annotated[
        kinds.Term | kinds.Weights,
        key(
            "a term, or a weighted sum of terms: squared effort, duration, distance from the reference, positive work,"
            " copper loss, squared effort rate, squared closure force",
            default="effort; tracking if there is a reference to follow",
            example="{ time = 1.0, effort = 1e-5 }",
        ),
    ] = ABSENT


class GuessSection(Section, frozen=True):
    """The initial guess: positions at equidistant times, or a saved plan's motion."""

    plan: Annotated[
        str,
        Meta(extra={"said": "a saved plan's folder"}),
        key("a saved plan's folder, whose motion is the guess", default="none", example='"planned"'),
    ] = ABSENT
    path_deg: Annotated[
        kinds.Paths,
        key(
            "hinges' angles at equidistant times", "deg", "none", "{ {free_hinge} = [{free_hinge_home}, {free_hinge_home}] }"
        ),
    ] = {}
    path_m: Annotated[
        kinds.Paths,
        key(
            "slides' positions at equidistant times",
            "m",
            "none",
            "{ {free_slide} = [{free_slide_home}, {free_slide_home}] }",
        ),
    ] = {}
    duration_s: Annotated[kinds.Duration, key("the duration of the guess", "s", "the motion's own, or guessed", "1.0")] = (
        ABSENT
    )


class MeshSection(Section, frozen=True):
    """The discretisation: the transcription and the first mesh."""

    scheme: Annotated[kinds.Scheme, key("the transcription")] = "radau-3"
    intervals: Annotated[kinds.Intervals, key("the initial number of equal intervals")] = 40
    effort: Annotated[
        kinds.EffortForm,
        key(
            "the shape of efforts on an interval",
            default="polynomial; for least work constant, or linear if limits.effort_rate is given",
        ),
    ] = "polynomial"
    tolerance_deg: Annotated[
        kinds.Tolerance, key("of the integrated state", "deg", "1e-6 while the mesh stays small", "1e-6")
    ] = ABSENT
    refine: Annotated[
        kinds.Refine, key("the refinement of a mesh that is too coarse", default="both; intervals if a scheme is named")
    ] = "both"
    breaks: Annotated[
        kinds.Breaks,
        key(
            "ends of the first mesh's intervals as shares of the duration",
            default="equal intervals",
            example="[0.0, 0.5, 1.0]",
        ),
    ] = ABSENT


class SolverSection(Section, frozen=True):
    """Settings of the solver."""

    compile: Annotated[
        kinds.Compile, key("C functions, of mpc too, from the cache or compiled beside the second use; or always; or never")
    ] = "auto"
    max_time_s: Annotated[
        kinds.SolveTime, key("limit on the processor time of a whole plan: search, refinement, certificate", "s")
    ] = 600.0
    starts: Annotated[kinds.Starts, key("number of motions to start from; the best answer is kept")] = 1


_MORE_IF_LIGHT = "or more: what six control periods at the whole limit reach from rest"


class TrackingSection(Section, frozen=True):
    """The tracking of the plan in simulation: gains, sampling, delay."""

    kp: Annotated[
        kinds.Gain | kinds.Gains, key("proportional gain on the independent joints, for all or by joint", "N.m/rad, N/m")
    ] = 200.0
    kd: Annotated[kinds.Gain | kinds.Gains, key("derivative gain, for all or by joint", "N.m.s/rad, N.s/m")] = 1.0
    period_s: Annotated[
        kinds.Period, key("the control period", "s", "1e-4, or the model's timestep if that is longer", "0.0001")
    ] = ABSENT
    delay_periods: Annotated[
        kinds.Delay, key("control periods from a measurement to its effort, a whole number in tracking")
    ] = 0
    duration_s: Annotated[kinds.Duration, key("the duration of the run", "s", "the plan's own, and a rest", "2.0")] = ABSENT
    lqr_position_deg: Annotated[
        kinds.LqrError | kinds.LqrErrors,
        key(
            "a hinge's position error with the weight of the whole effort limit, for all or by joint",
            "deg",
            f"1, {_MORE_IF_LIGHT}",
            "1.0",
        ),
    ] = ABSENT
    lqr_velocity_deg_s: Annotated[
        kinds.LqrError | kinds.LqrErrors,
        key("a hinge's speed error with that weight", "deg/s", f"100, {_MORE_IF_LIGHT}", "100.0"),
    ] = ABSENT
    lqr_position_m: Annotated[
        kinds.LqrError | kinds.LqrErrors,
        key("a slide's position error with that weight", "m", f"0.01, {_MORE_IF_LIGHT}", "0.01"),
    ] = ABSENT
    lqr_velocity_m_s: Annotated[
        kinds.LqrError | kinds.LqrErrors, key("a slide's speed error with that weight", "m/s", f"1, {_MORE_IF_LIGHT}", "1.0")
    ] = ABSENT
    bandwidth_hz: Annotated[kinds.Positive, key("natural frequency of the errors under ct and gs-pd+ff", "Hz")] = 20.0
    damping_ratio: Annotated[kinds.Positive, key("damping ratio of the errors under ct and gs-pd+ff")] = 1.0
    integral_time_s: Annotated[
        kinds.Positive, key("lqi: time in which a position error's integral gains the weight of the error", "s")
    ] = 0.05
    horizon_s: Annotated[kinds.Positive, key("mpc: the horizon over which efforts keep their limits", "s")] = 0.1


def _spread(quantity: Quantity) -> Any:
    forms = f"{FORMS}, or a table of these by name" if quantity.of else FORMS
    return Annotated[Any, Meta(extra={"said": forms}, extra_json_schema=spread_schema(quantity))]


# The need of a quantity, by the kind of object that it belongs to.
_NEEDS = {"hinge": "free_hinge", "slide": "free_slide", "actuator": "actuator", "body": "body"}


def _quantity_key(one: Quantity) -> Meta:
    unit = "" if one.unit == "1" else one.unit
    return key(one.meaning, unit, one.otherwise, example=one.example, needs=_NEEDS.get(one.of, ""))


if TYPE_CHECKING:

    class ImperfectionsSection(Section, frozen=True):
        """Imperfections of simulated machines, as a value or a distribution for each quantity."""
else:  # its keys are defined with their ranges
    _NAME = Annotated[str, Meta(min_length=1, extra={"said": "a name"})]
    ImperfectionsSection = defstruct(
        "ImperfectionsSection",
        [
            *((name, Annotated[_spread(one), _quantity_key(one)], ABSENT) for name, one in QUANTITIES.items()),
            *(
                (name, Annotated[_NAME, key(meaning, default="none", example=example)], ABSENT)
                for name, (meaning, example) in WORDS.items()
            ),
        ],
        bases=(Section,),
        frozen=True,
        namespace={"__doc__": "Imperfections of simulated machines, as a value or a distribution for each quantity."},
        module=__name__,
    )


_MOTORS = Meta(extra={"of": "actuator = its motor", "noun": "actuator of [motors]"})


_MOTOR_EXAMPLE = "{ torque_constant = 0.5, resistance_ohm = 0.1, stall_effort = {effort_high}, {no_load} }"


class ProblemFile(Section, frozen=True, kw_only=True):
    """A problem: a motion of a mechanism that minimises an objective within limits."""

    description: Annotated[str, key("the problem in a sentence", default="none")] = ""
    mechanism: Annotated[MechanismSection, key("the machine")]
    motion: Annotated[MotionSection, key("the motion")]
    reference: Annotated[ReferenceSection, key("the sinusoid to follow exactly or approximately", default="none")] = ABSENT
    objective: Annotated[ObjectiveSection, key("what to minimise", default="by the kind of motion")] = ObjectiveSection()
    limits: Annotated[LimitsSection, key("limits at every instant", default="the model's own")] = LimitsSection()
    robust: Annotated[
        RobustSection, key("machines for which one motion keeps every effort limit", default="the nominal machine")
    ] = RobustSection()
    motors: Annotated[
        dict[str, MotorTable],
        _MOTORS,
        key("the motor behind an actuator, by the actuator's name", default="unknown", example=_MOTOR_EXAMPLE),
    ] = {}
    guess: Annotated[GuessSection, key("the initial guess", default="found by the planner")] = GuessSection()
    mesh: Annotated[MeshSection, key("the discretisation", default="chosen")] = MeshSection()
    solver: Annotated[SolverSection, key("the solver's settings", default="chosen")] = SolverSection()
    tracking: Annotated[TrackingSection, key("the plan's tracking", default="PD")] = TrackingSection()
    imperfections: Annotated[
        ImperfectionsSection,
        key("imperfections of the machines that an experiment simulates", default="those of a careful build"),
    ] = ImperfectionsSection()


class CaseSection(Section, frozen=True):
    """One problem of a batch."""

    name: Annotated[str, _FOLDER_NAME, key("names its folder", default="its number")] = ""
    set: Annotated[Settings, key('settings on the problem, "section.key=value"', default="none")] = []


class BatchFile(Section, frozen=True):
    """Many variations of one problem: a list of cases, or every combination of a sweep."""

    problem: Annotated[str, _PROBLEM, key("the problem that is varied: a built-in name or a TOML file")]
    set: Annotated[Settings, key("settings for all cases", default="none")] = []
    case: Annotated[list[CaseSection], _CASES, key("the cases", default="those of the sweep")] = []
    sweep: Annotated[dict[str, Any], _SWEEP, key("lists of values by key; every combination is a case", default="none")] = {}
