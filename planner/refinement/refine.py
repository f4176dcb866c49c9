"""From a first solution to a certified one: cuts at its switches, finer meshes and higher degrees until it passes."""

import re
from typing import Any, NamedTuple

import numpy as np

from linkplan.planner.refinement.case import Case, attempt
from linkplan.planner.refinement.constrained_arcs import standing_off
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.refinement.switch_search import all_held, at_bounds, bangs_alone, settle_switches
from linkplan.planner.solvers.outcome import SUCCEEDED
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.mesh import Mesh, halved
from linkplan.planner.transcription.schemes import MAX_DEGREE

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
# So often switches are read again from a motion that passes.
_POLISHED = 3
# Touched limits are refined until the objective changes by no more than this, relative.
_TOUCHED = 1e-7
# Answers on two meshes that are no further apart are the same motion, relative.
_SAME = 1e-6


class Refined(NamedTuple):
    """A refined motion."""

    motion: Any
    solution: Solution
    certificate: Any
    settled: bool


def refine(case: Case, found, history: list[Step], say: Say, *, warm: bool = False):
    """Return the best motion towards the tolerance: (motion, solution, certificate, settled), or None without a certificate.

    The certificate may not pass: then the motion is the last one tried. `settled` says whether the objective has, where
    that is asked for. Warm, finer meshes are solved from next to the coarser one's answer: less exact, but a motion that is
    unstable is not lost on the way.
    """
    motion, solution = found
    mesh = solution.transcribed.program.mesh
    arcs: dict[str, Any] = {}
    if case.switches:
        motion, solution, mesh, arcs = settle_switches(case, motion, solution, mesh, history, say)
    certificate = _certify(case, motion, history)
    position_rows, kept, finest = False, case, _MOST * case.mesh.intervals
    passed, before = None, np.inf  # the last that passed, to go back to where a finer one does not; the objective before
    settled, again, polished = True, 0, 0
    for turn in range(_ROUNDS):
        if certificate is not None and not certificate.passed and not case.mendable(certificate):
            break
        off = standing_off(solution.transcribed, solution.x) if case.bangs else np.zeros(mesh.n_intervals, dtype=bool)
        if certificate is not None and certificate.passed:
            passed = motion, solution, certificate
            wanted = case.objective_tolerance
            change = abs(solution.objective - before)
            settled = wanted is None or change <= wanted * abs(solution.objective)
            if case.exact(certificate) and settled and (not off.any() or change <= _TOUCHED * abs(solution.objective)):
                known = all_held(arcs) and not at_bounds(solution)
                if polished == _POLISHED or known or not bangs_alone(case, solution.transcribed):
                    break
                # Efforts were left free, or cuts have further to go: switches are read again, from a motion that is right.
                polished += 1
                better = settle_switches(kept, motion, solution, mesh, history, say, position_rows=position_rows, arcs=arcs)
                if better[1] is solution:
                    break
                motion, solution, mesh, arcs = better
                certificate = _certify(case, motion, history)
                continue
            before = solution.objective
        begun = position_rows
        position_rows = position_rows or certificate is None or case.leaves_positions(certificate)
        marked = _marked(mesh, certificate, case.strictness()) | off
        over = _overrunning(case, certificate, mesh)
        if over.any() and case.switches and turn and turn % 2 == 0 and again < _AGAIN and not all_held(arcs):
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
        if over.any() and case.switches and not all_held(arcs):
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
        finer, arcs = _finer(
            kept, motion, solution, mesh, durations, what, history, say,
            warm=warm, again=passed is not None, position_rows=position_rows, arcs=arcs,
        )  # fmt: skip
        if finer is None:
            break
        motion, solution = finer
        if position_rows and not begun and case.switches:
            motion, solution, mesh, arcs = settle_switches(kept, motion, solution, mesh, history, say, position_rows=True)
        certificate = _certify(case, motion, history)
    if passed is not None and (certificate is None or not certificate.passed):
        motion, solution, certificate = passed
    return None if certificate is None else Refined(motion, solution, certificate, settled)


def _finer(
    case: Case, motion: Any, solution: Solution, mesh: Mesh, durations: np.ndarray, what: str, history: list[Step], say: Say,
    *, warm: bool, again: bool, position_rows: bool, arcs: dict[str, Any],
) -> tuple[tuple[Any, Solution] | None, dict[str, Any]]:  # fmt: skip
    """Return the motion and solution on a finer mesh, or None, and what is held there.

    Where one passed before, it is looked for `again` where it is lost, in the end with nothing held; one of bangs is looked
    for right at the coarser one's, and from afar too where that gives another.
    """
    start, rows = case.start_from(motion), {"position_rows": position_rows}

    def tried(word: str, **options: Any) -> tuple[Any, Solution] | None:
        return attempt(case, start, mesh, durations, what + word, history, say, **rows, **options)

    ways = [("", {"warm": warm}), (", from next to it", {"close": True})][: 2 if again else 1]
    found = []
    for word, how in reversed(ways) if case.bangs else ways:
        finer = tried(word, **how, **arcs)
        if finer is not None:
            found.append(finer)
            changed = abs(finer[1].objective - solution.objective) > _SAME * abs(solution.objective)
            if finer[1].status == SUCCEEDED and not (case.bangs and changed):
                break
    if again and arcs and all(finer[1].status != SUCCEEDED for finer in found):
        loose = tried(", nothing held", close=True)
        if loose is not None:
            return loose, {}
    return min(found, key=lambda finer: (finer[1].status != SUCCEEDED, finer[1].objective), default=None), arcs


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
