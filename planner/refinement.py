"""From a first solution to a certified one: cuts at its switches, finer meshes and higher degrees until it passes.

What is planned for stands behind `Case`: a mechanism's problem and a user's differential equation are refined by the
same code.
"""

import re
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from models.errors import AssemblyError
from planner.arcs import arc_ends, free_ends, held_paths, path_arcs
from planner.collocation import Transcribed
from planner.mesh import Mesh, halved, segmented
from planner.plan import Step
from planner.problem import MeshSettings, SolverSettings
from planner.schemes import MAX_DEGREE
from planner.solve import Solution, solve
from planner.switches import find_cuts, pinned_efforts

# Rounds of refinement after the first solve, and the share of its allowance that marks an interval for halving.
_ROUNDS = 12
# From this round on limits are drawn in while the mesh still grows; from the later one on even those that it could mend.
_MERGED, _MERGED_ALL = 4, 8
# How often switches are looked for again where limits are overrun next to ends of arcs that a finer mesh shows.
_AGAIN = 2
# A mesh that has grown by this factor without passing will not pass by growing on.
_MOST = 120
# Where no tolerance is asked for, the target is followed as far as a mesh of so many intervals carries it; how far below the
# worst interval's error another may be to be halved with it.
_COMFORTABLE = 100
_WORST = 0.01
_MARK = 0.5
# A limit overrun between the nodes by more than this share of itself is a matter for the mesh; less is drawn in, which costs
# the objective about as much.
_FINE = 1e-7
# The degree is raised where at least this share of the intervals asks for more, and none stands out by more than this
# factor: the motion is smooth there, and nodes are worth more than intervals.
_EVERYWHERE = 0.5
_STANDS_OUT = 30.0
# Fewer intervals in a row than these are no arc along a limit, but the end of one inside an interval.
_AN_ARC = 3
# Intervals with at least this share of the largest bend of an effort are rough: halved where the objective has not settled.
_ROUGH = 0.01
# A solve with cuts at its switches replaces the one before when it is no slower than the error of a mesh without cuts.
NO_WORSE = 1e-4
# Cuts next to arcs within the limits settle in a few solves: until the objective gains less than this share, relative.
_SETTLINGS = 4
_SETTLED = 1e-9

Say = Callable[[str], None]


def silent(text: str) -> None:
    """Say nothing: the default for progress."""
    del text


class Case(Protocol):
    """A problem as refinement sees it. Motions, starts and certificates are its own."""

    mesh: MeshSettings
    solver: SolverSettings
    effort_limit: np.ndarray  # (n_u, 2)
    switches: bool  # whether efforts may jump between their limits: cuts are then looked for
    tolerance_given: bool  # whether the user asked for a tolerance
    objective_tolerance: float | None  # on the objective's change from mesh to mesh, relative

    def transcribe(self, start: Any, mesh: Mesh, durations: np.ndarray, **options: Any) -> Transcribed:
        """Return the program from a start; options are position_rows, pinned, held and least_limit."""
        ...

    def motion(self, solution: Solution, limit: np.ndarray) -> Any | None:
        """Return the motion of a solution, efforts cut at `limit`; None where it is none."""
        ...

    def start_from(self, motion: Any) -> Any:
        """Return a motion as a start."""
        ...

    def certify(self, motion: Any) -> Any | None:
        """Return a motion's certificate: passed, growth, residual_share; None where it has none."""
        ...

    def strictness(self) -> float:
        """Return how many times more exact than a certificate demands the integrated state is to be."""
        ...

    def exact(self, certificate: Any) -> bool:
        """Return whether a certificate's integration error is within the tolerance."""
        ...

    def noted(self, step: Step, certificate: Any) -> Step:
        """Return a step with the certificate's error in it."""
        ...

    def leaves_positions(self, certificate: Any) -> bool:
        """Return whether states leave their bounds between the nodes."""
        ...

    def overruns(self, certificate: Any) -> bool:
        """Return whether a limit is left between the nodes that tightening mends."""
        ...

    def mendable(self, certificate: Any) -> bool:
        """Return whether another mesh may mend why a certificate does not pass."""
        ...

    def overrun(self, certificate: Any) -> np.ndarray:
        """Return by what share of themselves limits are overrun between the nodes, at most, on each interval (n,)."""
        ...

    def tightened(self, certificate: Any, motion: Any) -> "Case":
        """Return the case with limits drawn in by what a motion overran them."""
        ...

    def with_scheme(self, name: str) -> "Case":
        """Return the case with another transcription."""
        ...


def attempt(
    case: Case, start: Any, mesh: Mesh, durations, what: str, history: list[Step], say: Say, *, warm=False, **options: Any
) -> tuple[Any, Solution] | None:
    """Return the motion and solution of one solve, noted in the history; None where it found none."""
    say(f"{what}: {case.mesh.scheme}, {mesh.n_intervals} intervals, {mesh.n_segments} segment(s)")
    try:
        transcribed = case.transcribe(start, mesh, durations, **options)
    except AssemblyError:  # a start whose loops open between the instants at which it was looked at
        return None
    solution = solve(transcribed, case.solver, warm=warm)
    history.append(step_of(what, transcribed, solution))
    if not solution.converged:
        return None
    motion = case.motion(solution, case.effort_limit)
    return None if motion is None else (motion, solution)


def step_of(what: str, transcribed: Transcribed, solution: Solution) -> Step:
    """Return the record of one solve."""
    mesh = transcribed.program.mesh
    return Step(
        what=what,
        scheme=transcribed.scheme.name,
        intervals=mesh.n_intervals,
        segments=mesh.n_segments,
        converged=solution.converged,
        solver_status=solution.status,
        objective=solution.objective,
        integration_error_deg=None,
        build_s=transcribed.build_s + solution.build_s,
        solve_s=solution.solve_s,
    )


def refine(case: Case, found: tuple[Any, Solution], mesh: Mesh, history: list[Step], say: Say, *, warm: bool = False):
    """Return the best motion towards the tolerance: (motion, solution, certificate, settled), or None without a certificate.

    The certificate may not pass: then the motion is the last one tried. `settled` says whether the objective has, where
    that is asked for. Warm, finer meshes are solved from next to the coarser one's answer: less exact, but a motion that is
    unstable is not lost on the way.
    """
    motion, solution = found
    arcs: dict[str, Any] = {}
    if case.switches:
        motion, solution, mesh, arcs = settle_switches(case, motion, solution, mesh, history, say)
    certificate = _certify(case, motion, history)
    position_rows, kept, finest = False, case, _MOST * case.mesh.intervals
    passed, before = None, np.inf  # the last that passed, to go back to where a finer one does not; the objective before
    settled, again = True, 0
    for turn in range(_ROUNDS):
        if certificate is not None and not certificate.passed and not case.mendable(certificate):
            break
        if certificate is not None and certificate.passed:
            passed = motion, solution, certificate
            wanted = case.objective_tolerance
            settled = wanted is None or abs(solution.objective - before) <= wanted * abs(solution.objective)
            if case.exact(certificate) and settled:
                break
            before = solution.objective
        begun = position_rows
        position_rows = position_rows or certificate is None or case.leaves_positions(certificate)
        marked = _marked(mesh, certificate, case.strictness())
        over = _overrunning(case, certificate, mesh)
        if over.any() and case.switches and turn and turn % 2 == 0 and again < _AGAIN and not _all_held(arcs):
            again += 1
            settled_again = settle_switches(
                kept, motion, solution, mesh, history, say, position_rows=position_rows, arcs=arcs
            )
            if settled_again[1] is not solution:
                motion, solution, mesh, arcs = settled_again
                certificate = _certify(case, motion, history)
                continue
        if not settled and not (marked | over).any():
            marked = _rough(motion)
        higher = _higher_on_arcs(kept, certificate, mesh, over, arcs)
        if over.any() and case.switches and not _all_held(arcs):
            marked = over  # an arc that is shorter than an interval must be seen before it can be cut out
        else:
            higher = higher or _higher(kept, certificate, marked)
        if _grown(mesh, marked | over) <= (finest if case.tolerance_given else _COMFORTABLE):
            marked = marked | over
        what = "finer mesh"
        if position_rows and not begun and certificate is not None:
            what, marked = "states kept within their limits at every instant", np.zeros(mesh.n_intervals, dtype=bool)
        elif higher is not None:
            kept, what, marked = kept.with_scheme(higher), f"higher degree, {higher}", np.zeros(mesh.n_intervals, dtype=bool)
        elif not marked.any() and certificate is not None and case.overruns(certificate):
            # Only a limit is left, between the nodes: ask the solver for a little less than it.
            kept, what = kept.tightened(certificate, motion), "limits kept between the nodes"
        elif not marked.any():
            marked[:] = True
        elif turn >= (_MERGED_ALL if over.any() else _MERGED) and certificate is not None and case.overruns(certificate):
            kept, what = kept.tightened(certificate, motion), "finer mesh, limits kept between the nodes"
        n_finer = _grown(mesh, marked)
        if n_finer > finest or (passed is not None and not case.tolerance_given and n_finer > _COMFORTABLE):
            break
        mesh = halved(mesh, marked)
        durations = np.bincount(mesh.segment, weights=_widths(motion, marked))
        start = kept.start_from(motion)
        finer = attempt(kept, start, mesh, durations, what, history, say, warm=warm, position_rows=position_rows, **arcs)
        if finer is None:
            break
        motion, solution = finer
        if position_rows and not begun and case.switches:
            motion, solution, mesh, arcs = settle_switches(kept, motion, solution, mesh, history, say, position_rows=True)
        certificate = _certify(case, motion, history)
    if passed is not None and (certificate is None or not certificate.passed):
        motion, solution, certificate = passed
    return None if certificate is None else (motion, solution, certificate, settled)


def _certify(case: Case, motion: Any, history: list[Step]) -> Any | None:
    """Return a motion's certificate, its error noted in the history."""
    certificate = case.certify(motion)
    if certificate is not None:
        history[-1] = case.noted(history[-1], certificate)
    return certificate


def _marked(mesh: Mesh, certificate: Any | None, strictness: float) -> np.ndarray:
    """Return which intervals (n,) to halve: those with more than their share of an error that is too large."""
    if certificate is None or not np.all(np.isfinite(certificate.growth)):
        return np.ones(mesh.n_intervals, dtype=bool)
    growth = certificate.growth * strictness
    marked = np.zeros(mesh.n_intervals, dtype=bool)
    if certificate.residual_share.max() > 1.0:
        marked |= certificate.residual_share > _MARK
    if growth.sum() > 1.0:
        marked |= growth > _MARK * max(1.0, _WORST * growth.max() * mesh.n_intervals) / mesh.n_intervals
    return marked


def _overrunning(case: Case, certificate: Any | None, mesh: Mesh) -> np.ndarray:
    """Return on which intervals (n,) a limit is overrun between the nodes by more than should be drawn in."""
    if certificate is None:
        return np.zeros(mesh.n_intervals, dtype=bool)
    overrun = case.overrun(certificate)
    return overrun > max(_FINE, _WORST * overrun.max(initial=0.0))


def _grown(mesh: Mesh, marked: np.ndarray) -> int:
    return mesh.n_intervals + int(marked.sum())


def _rough(motion: Any) -> np.ndarray:
    """Return the intervals (n,) on which the efforts' polynomials bend most in their highest degree: next to kinks."""
    widths, degree = np.diff(motion.breaks_s), motion.effort.shape[0] - 1
    bend = np.abs(np.diff(motion.effort, n=degree, axis=0)[0]) if degree else np.abs(motion.effort[0])
    size = np.maximum(np.abs(motion.effort).max(axis=(0, 1)), np.finfo(float).tiny)
    rough = widths * (bend / size).max(axis=1)
    return rough >= _ROUGH * rough.max()


def _higher(case: Case, certificate: Any | None, marked: np.ndarray) -> str | None:
    """Return the transcription of higher degree that is worth more than a finer mesh, or None."""
    if certificate is None or not marked.any():
        return None
    growth = certificate.growth[marked]
    even = marked.mean() >= _EVERYWHERE and growth.max() <= _STANDS_OUT * max(float(np.median(growth)), 1e-300)
    return _raised(case) if even or case.mesh.refine == "degree" else None


def _higher_on_arcs(case: Case, certificate: Any | None, mesh: Mesh, over: np.ndarray, arcs: dict[str, Any]) -> str | None:
    """Return the transcription of higher degree where motions along limits overrun them evenly: the arcs are smooth."""
    if certificate is None or not over.any():
        return None
    if case.switches and (not arcs or not np.all(arcs["held"][mesh.segment[over]].any(axis=1))):
        return None  # an arc that is not held may end inside an interval, which wants to be cut
    overrun = case.overrun(certificate)[over]
    even = len(overrun) >= _AN_ARC and overrun.max() <= _STANDS_OUT * float(np.median(overrun))
    return _raised(case) if even or case.mesh.refine == "degree" else None


def _raised(case: Case) -> str | None:
    """Return the case's transcription two degrees up; None where there is none, or none is wanted."""
    family = re.fullmatch(r"(radau|gauss)-(\d)", case.mesh.scheme)
    if family is None or case.mesh.refine == "intervals" or int(family[2]) == MAX_DEGREE:
        return None
    return f"{family[1]}-{min(int(family[2]) + 2, MAX_DEGREE)}"


def _widths(motion: Any, marked: np.ndarray) -> np.ndarray:
    widths = np.diff(motion.breaks_s)
    pieces = np.where(marked, 2, 1)
    return np.repeat(widths / pieces, pieces)


def settle_switches(
    case: Case,
    motion: Any,
    solution: Solution,
    mesh: Mesh,
    history: list[Step],
    say: Say,
    *,
    position_rows: bool = False,
    arcs: dict[str, Any] | None = None,
):
    """Return a solution with mesh cuts at its switches: motion, solution, mesh, and what is held between the cuts.

    First with efforts and path quantities held at the limits that the arcs showed, which leaves the cuts alone to be found;
    where that is slower than the solution without cuts, the arcs were read wrongly and all is set free again.
    """
    chosen, no_worse = arcs or {}, _SETTLED if position_rows else NO_WORSE
    for _ in range(_SETTLINGS):
        knots = motion.breaks_s[mesh.knots()]
        on_path = path_arcs(solution.transcribed, solution.x)
        cuts = find_cuts(motion, case.effort_limit, knots, on_path.any(axis=1))
        cuts = np.sort(np.append(cuts, arc_ends(on_path, motion.breaks_s, cuts, knots)))
        if len(cuts) == 0 or len(cuts) > mesh.n_intervals // 6:
            break
        ends = np.sort(np.concatenate([knots, cuts]))
        pinned, start = pinned_efforts(motion, case.effort_limit, ends[1:-1]), case.start_from(motion)
        held = {"pinned": pinned, "held": held_paths(on_path, motion.breaks_s, ends, pinned)}
        if _known(solution.transcribed, held):
            return motion, solution, mesh, held
        readings = [("cuts at the switches", cuts, held)]
        if held["held"].any():
            inner, loose = free_ends(ends, **held)
            readings.append(("cuts at the switches, ends of arcs free", np.sort(np.append(cuts, inner)), loose))
        better = None
        for what, cut, options in [*readings, ("cuts at the switches, efforts free", cuts, {})]:
            finer, durations = cut_mesh(knots, cut, case.mesh.intervals)
            found = attempt(
                case, start, finer, durations, what, history, say, warm=True, position_rows=position_rows, **options
            )
            if found is not None and found[1].objective <= solution.objective + no_worse * abs(solution.objective):
                better = found
                break
        if better is None:
            break
        settled = better[1].objective > solution.objective - _SETTLED * abs(solution.objective)
        (motion, solution), mesh, chosen = better, finer, options
        no_worse = _SETTLED  # from now on both have cuts, and only a better one replaces the other
        if settled or _all_held(held):
            break
    return motion, solution, mesh, chosen


def _known(transcribed: Transcribed, held: dict[str, np.ndarray]) -> bool:
    """Return whether a program has held all of this already, and nothing was left free: there is nothing new to cut."""
    before, paths = transcribed.pinned, held["held"]
    if before is None or before.shape != held["pinned"].shape or not _all_held(held):
        return False
    same_paths = not paths.any() if transcribed.held is None else np.array_equal(transcribed.held, paths)
    return bool(same_paths and np.array_equal(before, held["pinned"], equal_nan=True))


def _all_held(held: dict[str, np.ndarray]) -> bool:
    """Return whether every segment holds as much as it has efforts: then the cuts alone were to be found."""
    if not held:
        return False
    return bool(np.all(np.isnan(held["pinned"]).sum(axis=1) == np.count_nonzero(held["held"], axis=1)))


def cut_mesh(knots_s: np.ndarray, cuts_s: np.ndarray, n_intervals: int) -> tuple[Mesh, np.ndarray]:
    """Return a mesh with movable cuts (n_cuts,) [s] between knots (n_knots,) [s], and its segments' durations [s]."""
    ends = np.sort(np.concatenate([knots_s, cuts_s]))
    leg = np.searchsorted(knots_s, ends[:-1], side="right") - 1
    durations = np.diff(ends)
    return segmented(durations, n_intervals, leg=leg), durations
