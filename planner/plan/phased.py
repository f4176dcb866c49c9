"""A plan of a motion in phases: a plan of each phase, and what happens between them."""

from dataclasses import dataclass

import numpy as np
from msgspec import Struct

from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import Verdict
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.refinement.history import Step


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


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhasedPlan:
    """The certified motions of all phases, or the reason why there are none.

    `plans` are ordinary plans, one for each phase, each with its own certificate; together with the `junctions` they are the
    whole motion. Both are empty without a motion.
    """

    problem: PhasedProblem
    verdict: Verdict
    plans: tuple[Plan, ...] = ()
    junctions: tuple[Junction, ...] = ()
    objective: float | None = None
    body: PhaseQuantities | None = None
    history: tuple[Step, ...] = ()

    @property
    def status(self) -> str:
        """What planning found: "optimal", "feasible", "infeasible" or "failed"."""
        return self.verdict.kind

    @property
    def passed(self) -> bool:
        """Whether every phase's certificate and every junction passes."""
        return self.verdict.passed

    @property
    def duration_s(self) -> float | None:
        """The duration of all phases [s]; None without a motion."""
        found = [plan.duration_s for plan in self.plans if plan.duration_s is not None]
        return sum(found) if found and len(found) == len(self.plans) else None

    @property
    def begins_s(self) -> np.ndarray:
        """The times (n_phases,) [s] at which the phases begin."""
        return np.cumsum([0.0, *(plan.duration_s or 0.0 for plan in self.plans)])[:-1]
