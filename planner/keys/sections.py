"""The sections of a problem file, one struct each: their keys in order, what each takes, its default, and what it means.

Everything else is made of these: the reader, the JSON Schema, the table of keys. Angles are in degrees with `_deg` in the
key, slides in metres with `_m`; all else is SI.
"""

from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta, defstruct

from linkplan.models.catalogue import MODELS
from linkplan.planner.keys import kinds
from linkplan.planner.keys.limits_section import LimitsSection, Motor, RobustSection
from linkplan.planner.keys.motion_section import MotionSection, ReferenceSection
from linkplan.planner.keys.quantities import FORMS, QUANTITIES, WORDS, Quantity, spread_schema
from linkplan.planner.keys.section import ABSENT, Section, key


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
    friction_transition_deg_s: Annotated[
        kinds.Positive,
        key(
            "the speed v_0 about which dry friction f tanh(v / v_0) turns over; of slides and tendons as many rad/s times"
            " the mechanism's size",
            "deg/s",
            "2",
        ),
    ] = ABSENT


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

    compile: Annotated[
        kinds.Compile, key("C functions where the cache has them, made beside the second solve; or always; or never")
    ] = "auto"
    max_time_s: Annotated[
        kinds.SolveTime, key("processor time of a whole plan at the most: search, refinement, certificate", "s")
    ] = 600.0
    starts: Annotated[kinds.Starts, key("of so many motions to start from, the best answer is kept")] = 1


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


_MOTORS = Meta(extra={"of": "actuator = its motor", "noun": "actuator of [motors]"})


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
