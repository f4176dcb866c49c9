"""The search for a motion in phases: one program of all phases, refined like those of several motors, then a plan of each.

Every phase is an ordinary problem whose ends are free where neighbours determine them. Links tie the ends together. A solve
is one of all phases; meshes are refined phase by phase, by the same rules as for one. Once the objective has settled, the
ends are known, and each phase is certified and saved like every other motion.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from linkplan.models.compiled.functions import compiler
from linkplan.models.deadline import OutOfTimeError, check
from linkplan.models.errors import AssemblyError
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.whole_body import unit_acceleration
from linkplan.planner.closed_chain.case import MechanismCase
from linkplan.planner.closed_chain.guess import Guess, first_guess, guess_from
from linkplan.planner.plan.phased import PhasedRecord
from linkplan.planner.plan.verdict import Verdict, failed, out_of_time
from linkplan.planner.problem.objective import objective_from
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import CertifiedIterate, Iterate, certify_iterate, share_gained
from linkplan.planner.refinement.history import Say, add_step, progress, recorded, recording, silent, step_of
from linkplan.planner.search.finer_meshes import SETTLED_CHANGE, Way, along_ranges, first_way, is_sound, next_way
from linkplan.planner.search.phase_links import links_of, weights_of
from linkplan.planner.search.phase_plan import PhasedMotion, phased_plan, with_ends
from linkplan.planner.search.phase_poses import phase_poses
from linkplan.planner.search.phase_set import PhaseSet, phase_set
from linkplan.planner.search.pieces import for_a_correction
from linkplan.planner.search.solving import first_mesh
from linkplan.planner.solvers.solve import OUT_OF_ITERATIONS, Solution, build_solver, run_solver
from linkplan.planner.transcription.collocation import Transcribed, with_compiled_code
from linkplan.planner.transcription.linked import Linked, link_programs
from linkplan.planner.transcription.mesh import divided
from linkplan.planner.transcription.program import Program

# First starts: whether a release is guessed with a raised body, and the durations of phases in units of the time in which a
# body falls by half of the mechanism's extent. The best of the first is refined; the others follow while there is none.
_STARTS = ((True, 1.0), (True, 0.4), (False, 1.0), (False, 0.4), (True, 2.5), (False, 2.5))
_TRIED_STARTS = 3
# The weights, of the first solve and of the others, on time and effort that choose among motions of equal height.
_FIRST_TIE_WEIGHT, _LAST_TIE_WEIGHT = 1e-1, 1e-3
# The largest number of meshes; the most iterations of a solve, and those after which its functions are compiled.
_MAX_MESHES, _MOST_ITERATIONS, _PATIENT_ITERATIONS = 12, 200, 30
# Limits are tightened by overruns below this share, and meshes are refined for larger ones.
_SMALL_OVERRUN = 1e-6
# Changes of the objective are compared with at least this share of its unit: a passive motion has no effort at all.
_LEAST_OBJECTIVE = 1e-6


def plan_phases(asked: PhasedProblem, say: Say = silent) -> PhasedRecord:
    """Return the plan of a motion in phases, or the reason why there is none.

    Raises:
        LinkplanError: if the problem is invalid.
    """
    with recording(say):
        found = _first_motion(asked)
        if isinstance(found, Verdict):
            return PhasedRecord(problem=asked.name, tables=asked.to_dict(), verdict=found, plans=())
        of, motion = found
        return phased_plan(of, *_refined(of, motion))


def _first_motion(asked: PhasedProblem) -> tuple[PhaseSet, PhasedMotion] | Verdict:
    """Return the best of the first solutions with its phases; the verdict without any."""
    of = phase_set(asked, phase_poses(asked, _STARTS[0][0]))
    best: tuple[PhaseSet, PhasedMotion] | None = None
    for number, (extended, pace) in enumerate(_STARTS):
        if best is not None and number >= _TRIED_STARTS:
            break
        if number and extended != _STARTS[number - 1][0]:
            at = phase_poses(asked, extended)
            if not all(np.any(np.diff(at.poses, axis=0) != 0.0, axis=1)):
                continue  # a phase that does not move is no start
            of = phase_set(asked, at, of.solver)
        found = _first_solution(of, pace)
        if found is not None and (best is None or found.objective < best[1].objective):
            best = of, found
    if best is not None:
        return best
    if of.solver.deadline.passed:
        return out_of_time(of.solver.max_time_s)
    steps = recorded()
    status = steps[-1].solver_status if steps else "the loops do not close along any guess"
    return failed(f"the solver found no motion through the phases {', '.join(p.name for p in of.phases)} ({status})")


def _first_solution(of: PhaseSet, pace: float) -> PhasedMotion | None:
    """Return a first solution from smooth paths between the guessed poses; None without one."""
    total, given = of.asked.sections.motion.duration_s, [phase.problem.motion.duration_s for phase in of.phases]
    falls = [pace * float(np.sqrt(one.mechanism.extent_m / unit_acceleration(one.mechanism))) for one in of.phases]
    if total != "free":
        free_s = sum(fall for fall, known in zip(falls, given, strict=True) if known is None)
        left = max(float(total) - sum(known or 0.0 for known in given), 1e-3 * float(total))
        falls = [fall * left / max(free_s, 1e-300) for fall in falls]
    guesses = []
    for phase, fall, pose in zip(of.phases, falls, of.at.poses, strict=False):
        guess = _guess(phase.problem, fall, pose)
        if guess is None:
            return None
        guesses.append(guess)
    meshes = [first_mesh(phase.problem, guess) for phase, guess in zip(of.phases, guesses, strict=True)]
    ways = [Way(phase.first, *mesh, "first solve") for phase, mesh in zip(of.phases, meshes, strict=True)]
    none = [frozenset[int]()] * len(ways)
    return _solved(of, ways, guesses, none, None, close=False, adaptive=True)


def _guess(problem: Problem, duration_s: float, pose: np.ndarray) -> Guess | None:
    """Return the smooth path of a phase from a closed pose (n_q,), in about a duration; None if the loops open along it."""
    motion = problem.motion
    if motion.duration_s is None:
        within = float(np.clip(duration_s, motion.min_duration_s or 0.0, motion.max_duration_s or np.inf))
        timed = replace(motion, duration_s=within, min_duration_s=None, max_duration_s=None)
        problem = problem.varied(motion=timed, objective=objective_from("effort"))
    assert motion.start is not None  # of a phase
    try:
        return first_guess(problem, close_at(problem.mechanism, motion.start, pose))
    except (AssemblyError, OutOfTimeError):
        return None


def _solved(
    of: PhaseSet,
    ways: Sequence[Way],
    guesses: Sequence[Guess],
    rows: Sequence[frozenset[int]],
    before: PhasedMotion | None,
    *,
    close: bool,
    adaptive: bool = False,
) -> PhasedMotion | None:
    """Return the solution of one program of all phases; None without a motion or without time.

    Args:
        of: the phases.
        ways: the case and mesh of each.
        guesses: where to start.
        rows: the independent coordinates of each whose ranges hold between the nodes too.
        before: the last solution.
        close: as of `build_solver`.
        adaptive: likewise.
    """
    if of.solver.deadline.passed:
        return None
    several = f"{len(ways)} phase{'s'[: len(ways) - 1]}"
    progress(f"{ways[0].what}: {several}, {sum(way.mesh.n_intervals for way in ways)} intervals")
    try:
        # Those of the first solve: units of a passive motion, which needs no effort, would scale its equations badly.
        units = [None] * len(ways) if before is None else [part.origin.scales for part in before.linked.parts]
        parts = [
            way.case.transcribe(guess, way.mesh, way.durations, position_rows=along, scales=scales)
            for way, guess, along, scales in zip(ways, guesses, rows, units, strict=True)
        ]
    except (AssemblyError, OutOfTimeError):
        return None

    def attempt(most: int) -> tuple[Linked, Solution]:
        links = links_of(of, parts, None if before is None else before.own)
        linked = link_programs(
            parts, links, *weights_of(of, parts, _FIRST_TIE_WEIGHT if before is None else _LAST_TIE_WEIGHT)
        )
        few = of.solver.replace(max_iterations=min(most, of.solver.max_iterations or most))
        solver = build_solver(cast("Program", linked.program), few, close=close, adaptive=adaptive)
        return linked, run_solver(solver, cast("Transcribed", linked))  # which a solver reads alike

    compiled = all(part.program.interval.compiled for part in parts)
    waits = of.solver.compile == "auto" and compiler() is not None and not compiled
    linked, solution = attempt(_PATIENT_ITERATIONS if waits else _MOST_ITERATIONS)
    if waits and solution.status == OUT_OF_ITERATIONS:
        parts = [with_compiled_code(part, of.solver.deadline) for part in parts]
        linked, solution = attempt(_MOST_ITERATIONS)
    add_step(step_of(ways[0].what, parts[0], replace(solution, transcribed=parts[0])))
    return _motion(of, ways, linked, solution) if solution.converged else None


def _motion(of: PhaseSet, ways: Sequence[Way], linked: Linked, solution: Solution) -> PhasedMotion | None:
    """Return the phases' iterates of a solution; None if one leaves its branch."""
    xs, found = linked.split(solution.x), []
    known = solution.multipliers is not None and of.asked.sections.objective.maximize is None
    rows = linked.split_rows(solution.multipliers) if known and solution.multipliers is not None else None
    for k, (way, part) in enumerate(zip(ways, linked.parts, strict=True)):
        value = float(part.program.functions["grad_f"](xs[k], part.parameters)[0]) * part.objective_scale
        of_rows = None if rows is None else rows[k] / linked.weights[k]
        changed: dict[str, Any] = {
            "transcribed": part,
            "x": xs[k],
            "objective": value,
            "multipliers": of_rows,
            "bound_multipliers": None,
        }
        own = replace(solution, **changed)
        motion = way.case.motion(own)
        if motion is None:
            return None
        found.append(Iterate(motion=motion, solution=own))
    own_of_links = tuple(xs[len(linked.parts) :])
    return PhasedMotion(found=tuple(found), linked=linked, own=own_of_links, objective=solution.objective)


def _refined(of: PhaseSet, at: PhasedMotion) -> tuple[PhasedMotion, list[CertifiedIterate], bool]:
    """Return the motion on finer meshes, its certificates, and whether its objective has settled."""
    cases = [_with_ends_of(phase.case, one) for phase, one in zip(of.phases, at.found, strict=True)]
    ways = [first_way(case, one) for case, one in zip(cases, at.found, strict=True)]
    certified = [certify_iterate(*pair) for pair in zip(cases, at.found, strict=True)]
    rows, settled = [frozenset[int]()] * len(ways), False
    for _ in range(_MAX_MESHES):
        check()
        guesses = [replace(guess_from(one.motion), share_of_effort=1.0) for one in at.found]
        named = [replace(way, what="finer meshes") for way in ways]
        finer = _solved(of, named, guesses, rows, at, close=True, adaptive=True)
        finer = finer or _solved(of, named, guesses, rows, at, close=True)
        if finer is None:
            break
        gained = share_gained(at.objective, finer.objective, _LEAST_OBJECTIVE * finer.linked.objective_scale)
        at, settled = finer, abs(gained) <= SETTLED_CHANGE
        cases = [_with_ends_of(way.case, one) for way, one in zip(ways, at.found, strict=True)]
        certified = [certify_iterate(*pair) for pair in zip(cases, at.found, strict=True)]
        rows = [along | _left_range(case, one) for along, case, one in zip(rows, cases, certified, strict=True)]
        further = [_next(case, one, gained) for case, one in zip(cases, certified, strict=True)]
        if not any(further):
            settled = all(one.certificate is not None for one in certified)
            break
        ways = [
            Way(case, one.found.mesh, one.found.durations, "") if way is None else way
            for way, case, one in zip(further, cases, certified, strict=True)
        ]
    return at, certified, settled


def _with_ends_of(case: MechanismCase, found: Iterate) -> MechanismCase:
    """Return a case whose certificate asks for the ends of a motion."""
    return replace(case, asked=with_ends(case.asked, found.motion))


def _left_range(case: MechanismCase, at: CertifiedIterate) -> frozenset[int]:
    """Return the coordinates at the ends of their ranges, if one leaves its range between the nodes."""
    leaves = at.report is not None and at.report.leaves_positions
    return along_ranges(case.asked, at.found.motion) if leaves else frozenset()


def _next(case: MechanismCase, at: CertifiedIterate, gained: float) -> Way | None:
    """Return the next mesh of a phase; None where it is done: its objective has settled, and its certificate passes."""
    way = next_way(case, at, gained)
    if at.certificate is None or at.report is None or is_sound(at.certificate):
        return way
    if at.overruns and at.report.overrun.max() < _SMALL_OVERRUN:
        case = case.tightened(at.certificate, at.found.motion)
    if way is not None:
        return replace(way, case=replace(way.case, problem=case.problem, tightenings=case.tightenings))
    pieces = for_a_correction(case, at, bent=False)
    if pieces.max() == 1:
        pieces = 1 + (at.report.overrun > 0) + (at.report.effort_overrun > 0)
    return Way(case, divided(at.found.mesh, pieces), at.found.durations, "finer mesh")
