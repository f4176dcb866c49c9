"""The sections of a file with phases: [contacts], [[phases]], and what its [motion] and [objective] have in addition."""

from typing import Annotated, Literal

from msgspec import Meta

from linkplan.planner.problem.keys import kinds
from linkplan.planner.problem.keys.limits import LimitsSection
from linkplan.planner.problem.keys.motion import WaypointSection
from linkplan.planner.problem.keys.section import Section, by_joint, by_name, key, required
from linkplan.planner.problem.keys.sections import (
    FOLDER_NAME,
    PARAMETERS,
    MechanismSection,
    MeshSection,
    MotorTable,
    OutputSection,
    ParameterTable,
    PayloadSection,
    SolverSection,
    TrackingSection,
)

_CONTACTS = Meta(extra={"said": "a list of names in [contacts]"})
_PHASES = Meta(min_length=1, max_length=50, extra={"said": "a list of tables ([[phases]])", "numbered": True})
_SITES = Meta(extra={"said": "a site, or a list of sites of one body"})
_MIRROR = Meta(extra={"of": "joint = joint"})
# What a motion with phases can maximise, and where: of the body's centre of mass.
Highest = Literal["apex", "end"]
Furthest = Literal["end"]


class ContactSection(Section, frozen=True):
    """A site, or the corners of a foot, that stands on the ground in some phases."""

    site: Annotated[str | list[str], _SITES] = required("the site, or the sites of a flat foot")
    friction: kinds.AtLeastZero = key("the coefficient of friction", otherwise="it does not slip")
    plane: str = key("a fixed geom whose upper side is the ground", otherwise="z = 0")


class PhaseSection(Section, frozen=True):
    """A part of a motion with its own contacts. States that are not given are those of its neighbours.

    Example::

        push, flight = linkplan.Phase("push", on=["toe"]), linkplan.Phase("flight")
        print(push.to_dict())
    """

    name: Annotated[str, FOLDER_NAME] = required("a word that names the phase")
    on: Annotated[list[str], _CONTACTS] = key("the contacts that stand on the ground", otherwise="none", default=[])
    at: kinds.Points = by_name("the places on which contacts stand from this phase on", "m", "where they touch down")
    open: kinds.Closures = key("closures of the model that are switched off", otherwise="none", default=[])
    start_deg: kinds.Angles = by_joint("hinges' angles at its start", "deg", "free; home at the first")
    goal_deg: kinds.Angles = by_joint("hinges' angles at its end", "deg", "free")
    start_speed_deg_s: kinds.Numbers = by_joint("hinges' speeds at its start", "deg/s", "free; at rest at the first")
    goal_speed_deg_s: kinds.Numbers = by_joint(
        "hinges' speeds at its end", "deg/s", "free; zero at the last for joints with a goal"
    )
    rest: bool = key("whether it begins and ends at rest", otherwise="false", default=False)
    duration_s: kinds.Duration | kinds.Free = key("its duration", "s", default="free")
    min_duration_s: kinds.ShortDuration = key("its shortest duration", "s", "any")
    max_duration_s: kinds.Duration = key("its longest duration", "s", "any")
    payload_kg: kinds.AtLeastZero = key(
        "mass of the mechanism's payload in this phase; without one it is a point mass at the only site of the last body, or"
        " at its centre of mass",
        "kg",
        "its own",
    )
    payload: Annotated[kinds.PayloadName | PayloadSection, Meta(extra={"said": "a built-in name or a table"})] = key(
        "the payload in this phase", otherwise="the mechanism's"
    )
    waypoints: list[WaypointSection] = key("states that it passes", otherwise="none", default=[])
    limits: LimitsSection = key(
        "limits in this phase, key by key in place of those of the whole motion",
        otherwise="those of the whole",
        default=LimitsSection(),
    )
    weight: kinds.Weight = key("the factor on its part of the objective", default=1.0)


class PhasedMotionSection(Section, frozen=True):
    """The whole motion of a file with phases."""

    duration_s: kinds.Duration | kinds.Free = key("the duration of all phases", "s", default="free")
    repeat: bool = key("whether the last phase leads to the first: a gait", otherwise="false", default=False)
    mirror: Annotated[dict[str, str], _MIRROR] = by_name(
        "joints that exchange their parts with every repetition", "", "none"
    )
    distance_m: kinds.Number = key("how far a repetition moves the base along the ground", "m", "free")
    speed_m_s: kinds.Number = key("the distance over the duration", "m/s", "free")


class MaximizeSection(Section, frozen=True):
    """What a motion with phases maximises, of the centre of mass of all bodies."""

    com_height: Highest = key(
        "its height at the apex of the flight after the last phase, or at the end", "m", "not maximised"
    )
    distance: Furthest = key("its distance along the ground at the end", "m", "not maximised")


class PhasedObjectiveSection(Section, frozen=True):
    """The quantity that a motion with phases minimises or maximises."""

    minimize: kinds.Term | kinds.Weights = key("as for one phase", otherwise="effort")
    maximize: MaximizeSection = key("the height or the distance of a jump", otherwise="nothing")


class PhasedFile(Section, frozen=True, kw_only=True):
    """A motion in phases with contacts."""

    description: str = key("the problem in a sentence", otherwise="none", default="")
    mechanism: MechanismSection = required("the machine, without contacts")
    contacts: Annotated[dict[str, ContactSection], Meta(extra={"of": "name = its contact"})] = by_name(
        "the contacts by name", "", "none"
    )
    phases: Annotated[list[PhaseSection], _PHASES] = required("the phases in order")
    motion: PhasedMotionSection = key("the whole motion", otherwise="free", default=PhasedMotionSection())
    objective: PhasedObjectiveSection = key(
        "what to minimise or maximise", otherwise="effort", default=PhasedObjectiveSection()
    )
    limits: LimitsSection = key("limits at every instant", otherwise="the model's own", default=LimitsSection())
    parameters: Annotated[dict[str, kinds.Number | ParameterTable], PARAMETERS] = by_name(
        "numbers of the model by name, as in other problem files", otherwise="none: every number is a constant"
    )
    motors: Annotated[dict[str, MotorTable], Meta(extra={"of": "actuator = its motor"})] = by_name(
        "the motor behind an actuator, by the actuator's name", otherwise="unknown"
    )
    mesh: MeshSection = key("the discretisation of each phase", otherwise="chosen", default=MeshSection())
    solver: SolverSection = key("the solver's settings", otherwise="chosen", default=SolverSection())
    tracking: TrackingSection = key("the plan's tracking", otherwise="PD", default=TrackingSection())
    output: OutputSection = key("what is shown in addition", otherwise="nothing", default=OutputSection())
