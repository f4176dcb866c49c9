"""The actions of a refinement. Each returns the state after it; what it solves is noted in the history."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.planner.limits.limit import WhichJoints
from linkplan.planner.refinement.case import Case, Iterate, attempt, certify_iterate, with_scheme
from linkplan.planner.refinement.constrained_arcs import FixedArcs, interval_breaks, released
from linkplan.planner.refinement.history import add_step, progress, step_of
from linkplan.planner.refinement.marking import most_overrun
from linkplan.planner.refinement.state import RefinementState, observed
from linkplan.planner.refinement.switches import mesh_with_switches, settle_switch_times
from linkplan.planner.solvers.newton import nearest_feasible
from linkplan.planner.solvers.solve import SUCCEEDED
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh, halved


class Action(Protocol):
    """One step of a refinement."""

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state after the action; `ended` if no motion was found."""
        ...


@dataclass(frozen=True, slots=True)
class ReadSwitches:
    """Read the switch times from the motion and solve for them as unknowns."""

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state with switch times, or the same state if they do not improve it."""
        found = state.iterate.found
        better = settle_switch_times(state.case, found, position_rows=state.position_rows)
        counted = replace(state, readings=state.readings + 1)
        if better.solution is found.solution:
            return replace(counted, ended=state.finished)
        everything = better.fixed is not None and better.fixed.everything
        # If everything is fixed on arcs, halving removes an overrun, so the number of rounds starts again.
        counted = replace(counted, rounds=state.rounds + 1, read_in=state.rounds if everything else state.read_in)
        return observed(counted, certify_iterate(state.asked, better))


@dataclass(frozen=True, slots=True)
class ImposeRanges:
    """Impose the states' ranges at every instant, by rows on Bernstein coefficients, on the same mesh."""

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state with ranges imposed. If this leads to no motion, return a state that never imposes them again."""
        rows = replace(state, position_rows=True)
        what = "state limits imposed at every instant"
        found = _solved_on(rows, np.zeros(state.iterate.n_intervals, dtype=bool), what)
        if found is None:  # the overrun is an error of this mesh, which a finer mesh removes
            return replace(state, rows_lost=True, rounds=state.rounds + 1)
        if state.target.switches:
            found = settle_switch_times(state.case, replace(found, fixed=None), position_rows=True)
        return observed(replace(rows, rounds=state.rounds + 1), certify_iterate(state.asked, found))


@dataclass(frozen=True, slots=True)
class RaiseDegree:
    """Solve with a scheme of higher degree, on the same mesh."""

    scheme: str

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state with the scheme; if no motion is found, a motion that does not pass is halved instead."""
        higher = replace(state, case=with_scheme(state.case, self.scheme))
        after = _after(higher, np.zeros(state.iterate.n_intervals, dtype=bool), f"higher degree, {self.scheme}")
        lost = after.ended and after.iterate is state.iterate and not state.iterate.passed
        return replace(state, degree_lost=True, rounds=state.rounds + 1) if lost else after


@dataclass(frozen=True, eq=False, slots=True)
class Halve:
    """Halve the marked intervals (n,), and tighten limits by their overrun if `tightens`; see `observed` for `tells`."""

    marked: np.ndarray
    tightens: bool = False
    tells: bool = True

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state on the finer mesh."""
        finer, what = state, "finer mesh"
        if self.tightens:
            finer, what = _tightened(state), "finer mesh, constraints tightened between the nodes"
        return _after(finer, self.marked, what, tells=self.tells)


@dataclass(frozen=True, slots=True)
class Tighten:
    """Tighten limits by their overrun between the nodes, on the same mesh."""

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state within tightened limits."""
        none = np.zeros(state.iterate.n_intervals, dtype=bool)
        return _after(_tightened(state), none, "constraints tightened between the nodes")


@dataclass(frozen=True, slots=True)
class Loosen:
    """Solve with the problem's own limits, first on the mesh of the best motion, later halved where they were overrun."""

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state with the problem's own limits."""
        best, loose = state.best.found, state.loosened
        asked = with_scheme(state.asked, best.solution.transcribed.scheme.name)
        coarse = best if loose is None else loose.found
        marked = np.zeros(best.mesh.n_intervals, dtype=bool) if loose is None else most_overrun(loose)
        mesh, durations = halved(coarse.mesh, marked), coarse.durations
        found = attempt(
            asked, asked.start_from(coarse.motion), mesh, durations, "the problem's own limits",
            warm=True, fixed=_held_in(best), position_rows=state.position_rows,
        )  # fmt: skip
        new = replace(
            state,
            case=asked,
            rounds=state.rounds + 1,
            tightenings=0,
            loosenings_without_gain=state.loosenings_without_gain + 1,
            warm=True,
            ended=False,
        )
        if found is None:
            return replace(new, ended=True, loosened=state.best)
        at = certify_iterate(state.asked, found)
        return observed(replace(new, loosened=at), at)


@dataclass(frozen=True, slots=True)
class ReleaseArcs:
    """Let held arcs begin and end where the sign of their multipliers changes (Pontryagin's principle)."""

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state with the arcs released."""
        best = state.best.found
        release = released(best.solution)
        if release is None:
            return replace(state, releases=state.releases + 1, ended=True)
        ends, fixed = release
        finest = with_scheme(state.asked, best.solution.transcribed.scheme.name)
        boundaries = interval_breaks(best.solution)[best.mesh.boundaries()]
        switch_times = ends[1:-1][~np.isin(ends[1:-1], boundaries)]
        mesh, durations = mesh_with_switches(boundaries, switch_times, state.asked.problem.mesh.intervals)
        what = "arcs with multipliers of the wrong sign released"
        found = attempt(finest, finest.start_from(best.motion), mesh, durations, what, warm=True, fixed=fixed)
        counted = replace(state, case=finest, releases=state.releases + 1, rounds=state.rounds + 1)
        if found is None:
            return replace(counted, ended=True)
        return observed(replace(counted, ended=False, warm=True), certify_iterate(state.asked, found))


def _held_in(found: Iterate) -> FixedArcs | None:
    transcribed = found.solution.transcribed
    if transcribed.bang_efforts is None or transcribed.constrained_paths is None:
        return None
    return FixedArcs(efforts=transcribed.bang_efforts, paths=transcribed.constrained_paths)


def _tightened(state: RefinementState) -> RefinementState:
    certificate = state.iterate.certificate
    assert certificate is not None  # it overruns a limit
    case = state.case.tightened(certificate, state.iterate.found.motion)
    return replace(state, case=case, tightenings=state.tightenings + 1)


def _after(state: RefinementState, marked: np.ndarray, what: str, *, tells: bool = True) -> RefinementState:
    """Return the state after a solve with marked intervals (n,) halved."""
    found = _solved_on(state, marked, what)
    if found is None:
        return replace(state, ended=True)
    return observed(replace(state, rounds=state.rounds + 1), certify_iterate(state.asked, found), tells=tells)


def _solved_on(state: RefinementState, marked: np.ndarray, what: str) -> Iterate | None:
    """Solve with the marked intervals (n,) halved and return the iterate, or None.

    The solver starts at the coarser solution (warm) if efforts are bang arcs or jump inside intervals, else with a large
    barrier parameter (cold). If one way finds no solution, the other is tried.
    """
    coarse, case, target = state.iterate.found, state.case, state.target
    mesh, start = halved(coarse.mesh, marked), case.start_from(coarse.motion)

    def alike(finer: Iterate) -> bool:
        # Objectives on two meshes that differ by at most a millionth belong to the same motion.
        change = abs(finer.solution.objective - coarse.solution.objective)
        return change <= 1e-6 * abs(coarse.solution.objective)

    ways = [("", state.warm, False)]
    if state.best is not None or target.enclosed:
        ways.append((", warm start", False, True))
    found: list[Iterate] = []
    for word, warm, close in reversed(ways) if target.bang_bang or target.enclosed else ways:
        finer = attempt(
            case, start, mesh, coarse.durations, what + word,
            position_rows=state.position_rows, fixed=coarse.fixed, warm=warm, close=close,
        )  # fmt: skip
        if finer is not None:
            found.append(finer)
            if finer.solution.status == SUCCEEDED and (target.enclosed or not target.bang_bang or alike(finer)):
                break
    return min(found, key=lambda finer: (finer.solution.status != SUCCEEDED, finer.solution.objective), default=None)


@dataclass(frozen=True, eq=False, slots=True)
class ReduceEffortOverrun:
    """Halve the marked intervals (n,) of the best motion, and correct it with the least change on the finer mesh."""

    marked: np.ndarray

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state with the motion as its best one, if it passes and its effort overrun is smaller."""
        best = state.best
        coarse, counted = best.found, replace(state, restored=state.restored + 1, ended=True)
        if state.asked.problem.solver.deadline.passed:
            return counted
        case = with_scheme(state.case, coarse.solution.transcribed.scheme.name)
        mesh = halved(coarse.mesh, self.marked)
        found = nearest_on(case, coarse, mesh, coarse.durations, position_rows=state.position_rows)
        if found is None:
            return counted
        at = certify_iterate(state.asked, found)
        better = at.passed and at.report.effort_overrun.max() < best.report.effort_overrun.max()
        return replace(counted, iterate=at, best=at, ended=False) if better else counted


def nearest_on(
    case: Case, coarse: Iterate, mesh: Mesh, durations: np.ndarray, *, position_rows: WhichJoints
) -> Iterate | None:
    """Return the motion on a finer mesh that is nearest to that of a coarser one; None without one.

    Args:
        case: what is solved.
        coarse: the coarser motion.
        mesh: the finer mesh.
        durations: (n_segments,) [s] of its segments.
        position_rows: as of `attempt`.
    """
    what, before = "the same motion on a finer mesh", coarse.solution.transcribed
    progress(f"{what}: {mesh.n_intervals} intervals")
    try:
        transcribed = case.transcribe(
            case.start_from(coarse.motion),
            mesh,
            durations,
            position_rows=position_rows,
            bang_efforts=before.bang_efforts,
            constrained_paths=before.constrained_paths,
        )
    except (AssemblyError, OutOfTimeError):
        return None
    solution = nearest_feasible(transcribed, _with_efforts(transcribed, coarse), case.problem.solver.deadline)
    add_step(step_of(what, transcribed, solution))
    motion = case.motion(solution) if solution.converged else None
    return None if motion is None else Iterate(motion=motion, solution=solution, fixed=coarse.fixed)


def _with_efforts(transcribed: Transcribed, coarse: Iterate) -> np.ndarray:
    """Return the program's start with the efforts (n_intervals, n_coefficients, n_u) of a motion, up to their limits."""
    x, layout, scheme = np.array(transcribed.start), transcribed.program.layout, transcribed.scheme
    breaks = transcribed.program.mesh.breaks(x[layout.durations()] * transcribed.units.time_s)
    nodes = np.clip(scheme.nodes, 1e-9, 1.0 - 1e-9)
    effort = coarse.motion.effort_at((breaks[:-1, None] + np.diff(breaks)[:, None] * nodes).ravel())
    effort = effort.reshape(layout.n_intervals, len(nodes), -1)
    x[layout.effort()] = np.einsum("ij,kju->kiu", np.linalg.pinv(scheme.effort_at), effort) / transcribed.units.effort
    return x
