"""A plan of a motion in phases: a plan of each phase, and what happens between them."""

from msgspec import Struct

from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import Verdict


class Junction(Struct, frozen=True, kw_only=True):
    """The instant between two phases, or between the last and the first of a gait.

    Args:
        time_s: from the start of the motion [s].
        released: contacts that leave the ground.
        touched: contacts that reach it.
        impulse_ns: of the ground or of what holds on each site that stands afterwards, its axes in the world (3,) [N s].
        energy_lost_j: in the plastic impact [J].
        moved_m: how far the origin of the coordinates along the ground moves from the phase before to the one after, by
            joint [m].
        fault: what is impossible about the impulse; empty if nothing is.
        note: what else is to know about it.
    """

    time_s: float
    released: tuple[str, ...]
    touched: tuple[str, ...]
    impulse_ns: dict[str, tuple[float, float, float]]
    energy_lost_j: float
    moved_m: dict[str, float]
    fault: str = ""
    note: str = ""


class PhaseQuantities(Struct, frozen=True, kw_only=True):
    """What a motion in phases does with the whole body.

    Args:
        com_start_m: the centre of mass of all bodies at the start (3,) [m].
        com_end_m: at the end.
        com_velocity_end_m_s: its velocity there (3,) [m/s].
        apex_m: the height that it reaches in free flight after the end [m].
        distance_m: how far it moves along the ground, along x [m].
        cost_of_transport: positive work over weight and distance of a gait; None without one.
    """

    com_start_m: tuple[float, float, float]
    com_end_m: tuple[float, float, float]
    com_velocity_end_m_s: tuple[float, float, float]
    apex_m: float
    distance_m: float
    cost_of_transport: float | None = None


class PhaseRow(Struct, frozen=True, kw_only=True):
    """One phase of a plan: its contacts, when it begins, how long it takes, its status and its own objective."""

    name: str
    on: tuple[str, ...]
    begins_s: float
    duration_s: float | None
    status: str
    objective: float | None
    message: str


class PhasedRecord(Struct, frozen=True, kw_only=True, eq=False):
    """The certified motions of all phases of a motion, or the reason why there are none.

    Args:
        problem: its name.
        tables: those of its file.
        verdict: what was found, and by what it is known.
        objective: its value [SI]; None without a motion.
        duration_s: of all phases.
        phases: a row for each.
        junctions: what happens between them.
        body: the centre of mass and the distance.
        plans: of the phases: ordinary plans, each with its motion, certificate and problem.
    """

    problem: str
    tables: dict
    verdict: Verdict
    objective: float | None = None
    duration_s: float | None = None
    phases: tuple[PhaseRow, ...] = ()
    junctions: tuple[Junction, ...] = ()
    body: PhaseQuantities | None = None
    plans: Beside[tuple[Plan, ...]] = NOT_READ

    @property
    def folders(self) -> list[str]:
        """The names of the phases' folders in that of a saved plan."""
        return [f"{k + 1}-{phase.name}" for k, phase in enumerate(self.phases)]

    @property
    def status(self) -> str:
        """What planning found: "optimal", "feasible", "infeasible" or "failed"."""
        return self.verdict.kind

    @property
    def passed(self) -> bool:
        """Whether every phase's certificate and every junction passes."""
        return self.verdict.passed

    @property
    def message(self) -> str:
        """The verdict in a sentence."""
        return self.verdict.sentence
