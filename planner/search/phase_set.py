"""The phases of a motion in the search: their problems between guessed poses, and which states at their ends are free."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.whole_body import total_mass
from linkplan.planner.closed_chain.case import MechanismCase, case_of
from linkplan.planner.closed_chain.junction import Exchange
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.search.finer_meshes import at_a_distance
from linkplan.planner.search.phase_poses import PhasePoses, mirror_of


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhaseCase:
    """A phase: its problem and its case, whose ends are free where links determine them.

    The first solve has no ground under sites in the air (`first`): with it, jumps became hops of a millimetre.
    """

    name: str
    problem: Problem
    case: MechanismCase
    first: MechanismCase

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism with the closures of the phase."""
        return self.problem.mechanism


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhaseSet:
    """All phases of a motion, with the guessed poses between them."""

    asked: PhasedProblem
    at: PhasePoses
    phases: tuple[PhaseCase, ...]

    @property
    def first(self) -> Mechanism:
        """The mechanism of the first phase."""
        return self.phases[0].mechanism

    @property
    def solver(self) -> SolverSettings:
        """The solver's settings, with one deadline for all phases."""
        return self.phases[0].problem.solver

    def exchange(self, k: int) -> Exchange:
        """Return the exchange of coordinates after phase k: that of a gait after the last one."""
        last = k + 1 == len(self.phases)
        order = mirror_of(self.asked, self.first) if last else np.arange(self.first.n_q)
        return Exchange(order=order, slides=self.at.slides[k])

    def inertia(self, before: int, after: int) -> Mechanism:
        """Return the mechanism of what moves both before and after a junction."""
        one, other = (self.phases[k].mechanism for k in (before, after))
        return one if total_mass(one) <= total_mass(other) else other


def phase_set(asked: PhasedProblem, at: PhasePoses, solver: SolverSettings | None = None) -> PhaseSet:
    """Return the phases between guessed poses; `solver` has the deadline of a search that has begun."""
    found: list[PhaseCase] = []
    for k, phase in enumerate(asked.phases):
        between = k, at.stand[k], at.poses[k : k + 2]
        problem = problem_between(asked, *between)
        solver = solver or problem.solver.begun()
        free, speeds = _ends(asked, k, problem.mechanism)
        motion = replace(problem.motion, start_speed=speeds[0], goal_speed=speeds[1])
        problem = problem.varied(solver=solver, motion=motion)
        in_the_air = problem_between(asked, *between, problem.mechanism, walls=False)
        cases = case_of(problem), case_of(problem.varied(limits=in_the_air.limits))
        case, first = (at_a_distance(replace(one, free_ends=free), at.poses[k]) for one in cases)
        found.append(PhaseCase(name=phase.name, problem=problem, case=case, first=first))
    _refuse_places_after_sliding(asked, at, found)
    return PhaseSet(asked=asked, at=at, phases=tuple(found))


def problem_between(
    asked: PhasedProblem,
    k: int,
    stand: Mapping[str, np.ndarray],
    ends: np.ndarray,
    mechanism: Mechanism | None = None,
    **options: Any,
) -> Problem:
    """Return the problem of a phase between two closed poses (2, n_q); the arguments are those of its tables.

    Raises:
        ProblemError: with the name of the phase.
    """
    mechanism = mechanism or asked.mechanism(k, stand)
    tables = asked.problem_tables(k, stand, ends, mechanism, **options)
    try:
        return Problem.from_tables(f"{asked.name}-{asked.phases[k].name}", tables, asked.folder, mechanism)
    except ProblemError as error:
        raise ProblemError(f"phase {asked.phases[k].name}: {error}") from error


def _ends(asked: PhasedProblem, k: int, mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask (2, 2 n_s) of free states at both ends of a phase, and the speeds (2, n_s) of the others."""
    n_s, phase, columns = mechanism.dof, asked.phases[k], mechanism.independent.tolist()
    free, speeds = np.ones((2, 2 * n_s), dtype=bool), np.zeros((2, n_s))
    repeat = asked.sections.motion.repeat
    first, last = k == 0 and not repeat, k + 1 == len(asked.phases) and not repeat
    for end, name in enumerate(("start", "goal")):
        at, moving = asked.given(k, name, mechanism), asked.given(k, f"{name}_speed_s", mechanism)
        begins = first and end == 0
        for column, index in enumerate(columns):
            free[end, column] = not (begins or index in at)
            resting = begins or phase.rest or (last and end == 1 and index in at)
            free[end, n_s + column] = not (resting or index in moving)
            speeds[end, column] = moving.get(index, 0.0)
    return free, speeds


def _refuse_places_after_sliding(asked: PhasedProblem, at: PhasePoses, phases: list[PhaseCase]) -> None:
    """Refuse given coordinates along the ground after a touch-down whose place is free.

    Raises:
        ProblemError: with the key that would do.
    """
    sliding: set[int] = set()
    for k, phase in enumerate(phases):
        for name in ("start", "goal"):
            for index in sliding & set(asked.given(k, name, phase.mechanism)):
                joint = phase.mechanism.joints[index].name
                raise ProblemError(
                    f"phases[{k}].{name}_m.{joint}: the contacts touch down at a free place before; give it by phases[].at"
                )
        sliding |= set(at.slides[k])
