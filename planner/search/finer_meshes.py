"""The refinement of motions of several motors: one solve per mesh, until a mesh hardly improves the objective.

One joint determines the time of a fast motion, and only its jumps of effort matter. They become ends of segments with
unknown durations, between which efforts are free. Elsewhere the mesh is refined in one step by as much as the certificate
requires. Once the objective has settled, the motion only changes where it overruns a limit between the nodes or needs more
effort than a proof allows: to the nearest motion on a finer mesh (`nearest_feasible`), at a small distance from the limits
on efforts and within limits tightened by the overruns.

The first solves keep a distance from singular poses that the problem does not require, so that no iterate leaves its
assembly branch (`FIRST_MARGIN`). On finer meshes, which start from a motion on its branch, the distance is smaller.
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.deadline import Deadline, OutOfTimeError, check
from linkplan.models.errors import AssemblyError
from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.certificate.further_checks import objective_value
from linkplan.planner.closed_chain.case import MechanismCase
from linkplan.planner.closed_chain.formulate import TIE_WEIGHT
from linkplan.planner.closed_chain.guess import guess_from, with_force_times
from linkplan.planner.closed_chain.prescribed import in_more_time
from linkplan.planner.limits.efforts import INVERSE_DYNAMICS_SHARE, within_efforts
from linkplan.planner.limits.joints import bounds_of_state
from linkplan.planner.limits.limit import with_limits
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.actions import nearest_on
from linkplan.planner.refinement.case import CertifiedIterate, Iterate, attempt, certify_iterate, share_gained, with_scheme
from linkplan.planner.refinement.constrained_arcs import path_multipliers
from linkplan.planner.refinement.hamiltonian import COSTS_OF_HAMILTONIAN, hamiltonian_gaps
from linkplan.planner.refinement.marking import rough_of
from linkplan.planner.refinement.state import Refined
from linkplan.planner.refinement.switches import mesh_with_switches
from linkplan.planner.search.jumps import apart, jumps_of
from linkplan.planner.search.pieces import for_a_correction, for_a_solve
from linkplan.planner.solvers.newton import FEASIBLE, NEAR_INTERVALS
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import Mesh, divided, uniform, with_ends, without_empty
from linkplan.planner.transcription.scheme_names import MAX_INTERVALS

# Least |det J_z| relative to home: of the first solves, and of the last ones if the first bound is active and the problem
# permits less. Near a singular pose no mesh is fine enough, and a tenth of the last one saves only a two-thousandth of the
# time.
FIRST_MARGIN, LAST_MARGIN = 0.05, 0.01
# The last distance is tried if the multipliers of the first one predict a gain of this share of the objective. They predict
# 2e-3 to 3e-3 for legs, which gain 7e-4 to 3e-3, but 6e-5 for an excavator, whose finer meshes near singular poses are not
# solved.
_WORTH_COMING_NEARER = 2e-4
# The transcription of finer meshes, and their number of intervals as a share of the required one, because degree 5 is more
# exact.
_FINER_SCHEME, _SHARE_OF_INTERVALS = "radau-5", 0.75
# The same share if products of efforts and speeds or of forces are limited at every instant, because along a limit on power
# an effort is not a polynomial. With 0.75, least times and efforts of three problems are 7e-5 to 4e-4 above those of the
# finest meshes.
_SHARE_ALONG_PRODUCTS = 1.5
# Largest number of meshes, and the relative change below which the objective has settled. With piecewise constant efforts
# (least work) its error is only of first order in the interval's length.
_MAX_MESHES, SETTLED_CHANGE, _SETTLED_CHANGE_OF_STEPS = 8, 2e-5, 1e-3
# A tracking objective below this share of its unit counts as exact tracking: an rms error of 1e-5 of the motion's range.
EXACT_TRACKING_SHARE = 1e-10
# Changes of a tracking objective are compared with at least this share of its unit. A change as small as the objective of
# exact tracking has then settled. Without this, meshes are refined for rounding errors.
_LEAST_TRACKING = EXACT_TRACKING_SHARE / SETTLED_CHANGE
# If a finer mesh's objective is worse by more than this share, it belongs to another motion.
_LOST_SHARE = 1e-3
# The same for the first finer mesh with a given duration: the objective of the first mesh is 0.9 and 1.6 % too small for the
# excavator, and at most 3e-4 for the other 30 problems of the set.
_LOST_SHARE_AT_FIRST = 2e-2
# A segment shorter than this share of a mean interval is removed: its switch times have met, and rounding errors determine
# its accelerations.
_MET_SHARE = 1e-2
# Most iterations of a solve that starts from the last mesh's motion. If a solve needs more, its result is the motion nearest
# to its last iterate, and a further mesh follows, however little the objective has improved. With 75 or 100 in place of 150,
# the objectives of 14 problems change by at most 6e-5.
_MOST_ITERATIONS = 150
# After the first finer mesh with a motion, further meshes take at most this share of the time. The rest is for correcting
# the motion so that it passes and can be proved.
_SHARE_OF_MESHES = 2.0 / 3.0
# Most meshes on which the best motion is corrected; with corners of [robust] up to five are needed.
_MAX_RESTORATIONS = 6
# A joint is at an end of its range within this share of it.
_NEAR_RANGE = 1e-3
# Corrected motions keep this distance from the limits on efforts, in units of a proof's allowance, because the largest
# effort lies between the nodes. It lengthens least times by 2e-6. Together with up to six parts of an interval it avoids 14
# of the 24 second corrections in 38 problems.
_DISTANCE_OF_EFFORTS = 2.0
# The largest number of intervals of a mesh, as a multiple of the required one.
_MAX_GROWTH = 6


@dataclass(frozen=True, eq=False, slots=True)
class Way:
    """The next solve: its case, mesh, segments' durations [s] and name."""

    case: MechanismCase
    mesh: Mesh
    durations: np.ndarray
    what: str


@dataclass(frozen=True, eq=False, slots=True)
class Kept:
    """A motion that passes, the case that it solves, and the coordinates with rows for their ranges between the nodes."""

    case: MechanismCase
    at: CertifiedIterate
    rows: frozenset[int]


def refine_several(case: MechanismCase, found: Iterate) -> Refined | None:
    """Return the best motion whose certificate passes, else the last one; None without a certificate.

    Args:
        case: the problem, with its own limits.
        found: a first solution.
    """
    case = at_a_distance(case, found.motion.start_pose)
    at: CertifiedIterate | None = None  # of the last finer mesh
    latest, gain, moved = found, np.inf, 0.0
    kept: list[Kept] = []  # the motions that pass, each better than the previous one, then the last motion
    last: Kept | None = None
    way: Way | None = first_way(case, found)
    deadline = case.problem.solver.deadline
    rows: frozenset[int] = frozenset()  # coordinates with rows for their ranges between nodes
    in_time, until, took_s = deadline.within_share(_SHARE_OF_MESHES), deadline, 0.0
    for _ in range(_MAX_MESHES):
        check()
        if way is None or until.left_s <= took_s:  # a solve on a finer mesh would take at least as long, without benefit
            break
        rows |= along_ranges(case.asked, latest.motion)
        begun_s = until.left_s
        finer = _solved(way, latest, rows, until)
        took_s = begun_s - until.left_s
        if finer is None:
            break
        last_gain, gain = gain, _gained(case, latest, finer)
        latest, at = finer, certify_iterate(case, finer)
        left = gain
        if gain > 0 and 0 < last_gain < np.inf and not case.enclosed:  # along limits on power, gains decrease irregularly
            left *= min(1.0, gain / last_gain)
        left = np.inf if finer.solution.status == FEASIBLE else min(left, _share_of_gaps(way.case, at))
        better = not kept or finer.solution.objective < kept[-1].at.found.solution.objective
        last = Kept(way.case, at, rows) if better and at.certificate is not None else None
        way = next_way(way.case, at, left) if at.passed or better else None
        until = until if last is None else in_time
        if last is not None and at.passed:
            # Nearer to singular poses the objective also changes, for another reason than the mesh.
            alike = bool(kept) and _margin_of(kept[-1].case) == _margin_of(last.case)
            moved = max(gain, 0.0) if alike else 0.0
            kept.append(last)
    if last is not None and last not in kept:
        kept.append(last)
    corrected: list[CertifiedIterate] = []
    for one in reversed(kept):
        at = repaired(one)
        moved = max(moved, _gained(case, at.found, one.at.found))
        corrected.append(at)
        if is_sound(at.certificate):
            break
    at = min(corrected, key=_shortcoming, default=at) or certify_iterate(case, found)
    if at.certificate is None:
        return None
    return Refined(
        motion=at.found.motion, solution=at.found.solution, certificate=at.certificate,
        settled=moved <= _settled_change(case), moved=moved,
    )  # fmt: skip


def _solved(way: Way, coarse: Iterate, rows: frozenset[int], until: Deadline) -> Iterate | None:
    """Return the solution of the next solve from a motion; None without one, or without one by a deadline.

    With a free duration the barrier parameter follows the iterates. With a given duration it decreases from a small value,
    which takes fewer iterations. If the motion is lost, the other way is tried too.
    """
    start, settings = replace(guess_from(coarse.motion), share_of_effort=1.0), way.case.problem.solver
    another = coarse.solution.transcribed.scheme.name != way.case.problem.mesh.scheme
    mesh, durations = _without_met(way.mesh, way.durations)
    few = settings.replace(max_iterations=min(_MOST_ITERATIONS, settings.max_iterations or _MOST_ITERATIONS), deadline=until)
    case = replace(way.case, problem=way.case.problem.varied(solver=few))
    free = case.asked.motion.duration_s is None
    lost = _LOST_SHARE_AT_FIRST if another and not free else _LOST_SHARE
    found: list[Iterate] = []
    for adaptive in (free, not free):
        finer = attempt(case, start, mesh, durations, way.what, close=True, adaptive=adaptive, position_rows=rows)
        if finer is not None:
            found.append(finer)
            if _gained(case, finer, coarse) <= lost:
                break
    return min(found, key=lambda finer: finer.solution.objective, default=None)


def _share_of_gaps(case: MechanismCase, at: CertifiedIterate) -> float:
    """Return the share of the objective that efforts on a finer mesh would gain; infinite where it is unknown.

    It is known if the motion passes and its dynamics are exact on this mesh, so that only the efforts can improve.
    """
    solution = at.found.solution
    known = solution.multipliers is not None and set(case.asked.objective.weights) <= COSTS_OF_HAMILTONIAN
    if not known or case.enclosed or not at.passed or for_a_solve(case, at).max() > 1:
        return np.inf
    return share_gained(solution.objective, solution.objective - float(hamiltonian_gaps(solution).sum()))


def _gained(case: MechanismCase, before: Iterate, after: Iterate) -> float:
    """Return the share of its objective that a motion gains; for tracking, of at least `_LEAST_TRACKING`."""
    least = _LEAST_TRACKING * after.solution.transcribed.units.objective if case.asked.objective.has("tracking") else 0.0
    return share_gained(before.solution.objective, after.solution.objective, least)


def _without_met(mesh: Mesh, durations: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """Return a mesh without segments whose switch times have met, and the other segments' durations [s]."""
    return without_empty(mesh, durations, _MET_SHARE * durations.sum() / len(mesh.fraction))


def is_sound(certificate: Certificate | None) -> bool:
    """True if a motion passes."""
    return certificate is not None and certificate.passed


def _shortcoming(at: CertifiedIterate) -> tuple[bool, float]:
    """Return whether a motion fails, and its largest excess of effort in units of the allowance; the least is the best."""
    return not at.passed, np.inf if at.certificate is None else float(at.certificate.effort_overrun.max(initial=0.0))


def at_a_distance(case: MechanismCase, start_pose: np.ndarray) -> MechanismCase:
    """Return a case whose solves keep a distance from singular poses: `FIRST_MARGIN`, or half of what the start has."""
    if not len(case.asked.mechanism.dependent):
        return case
    margin = min(FIRST_MARGIN, 0.5 * float(singularity_ratios(case.asked.mechanism, start_pose[None]).min()))
    return _at_margin(case, max(case.asked.limits.singular_margin, margin))


def along_ranges(problem: Problem, motion: Trajectory) -> frozenset[int]:
    """Return the independent coordinates with a coefficient of their position at an end of their range or beyond.

    The first and last intervals, in which a motion begins and ends, are ignored.
    """
    limit = bounds_of_state(problem)[0]
    near = _NEAR_RANGE * np.where(np.isfinite(np.ptp(limit, axis=1)), np.ptp(limit, axis=1), 0.0)
    inside = (motion.position > limit[:, 0] + near) & (motion.position < limit[:, 1] - near)
    return frozenset(np.flatnonzero(~np.all(inside[:, 1:-1], axis=(0, 1))).tolist())


def repaired(kept: Kept) -> CertifiedIterate:
    """Return a motion corrected with the least change on finer meshes until it is sound, or the last one that passes."""
    at, problem, margin = kept.at, kept.case.problem, kept.case.asked.limits.singular_margin
    solver = problem.solver.replace(deadline=problem.solver.certificate_deadline)
    # A margin that the problem does not require may be violated by the mesh error.
    case = _with_distance(_loosened(kept.case, max(margin, 0.5 * problem.limits.singular_margin)))
    case = replace(case, problem=case.problem.varied(solver=solver), asked=case.asked.varied(solver=solver))
    asked = replace(case, problem=case.asked)
    until, took_s = solver.deadline, 0.0  # for an interval
    for steps in range(_MAX_RESTORATIONS):
        at = _slowed(asked, at) or at
        if is_sound(at.certificate):
            break
        pieces = for_a_correction(case, at, bent=steps > 0)
        if steps and at.certificate is not None and at.overruns:
            # Halving removes an overrun that is an error of this mesh. Tightening removes any other.
            pieces = np.maximum(pieces, 1 + (at.report.overrun > 0))
            case = case.tightened(at.certificate, at.found.motion)
        mesh, durations = _without_met(divided(at.found.mesh, pieces), at.found.durations)
        changed_intervals = np.sum(pieces[pieces > 1] + 2 * NEAR_INTERVALS)
        if mesh.n_intervals > MAX_INTERVALS or until.left_s <= took_s * min(changed_intervals, mesh.n_intervals):
            break
        begun_s = until.left_s
        found = nearest_on(case, at.found, mesh, durations, position_rows=kept.rows)
        if found is not None and _gained(case, found, at.found) > _LOST_SHARE:
            found = None
        if found is None and not at.passed:  # if efforts and other limits are active together, no freedom is left
            mesh = divided(at.found.mesh, for_a_solve(case, at))
            way = Way(_at_margin(case, _margin_of(kept.case)), mesh, at.found.durations, "finer mesh")
            found = _solved(way, at.found, kept.rows, kept.case.problem.solver.deadline)
        changed = None if found is None else certify_iterate(asked, found)
        took_s = (begun_s - until.left_s) / mesh.n_intervals
        if changed is None or changed.certificate is None or (at.passed and not changed.passed):
            break
        at = changed
    return at


def _slowed(case: MechanismCase, at: CertifiedIterate) -> CertifiedIterate | None:
    """Return a motion in slightly more time if it is sound; None if the duration is given or would change too much.

    Inertial efforts are inversely proportional to the square of the duration. The planned efforts become those of inverse
    dynamics, which must be within their limits without an allowance.
    """
    if is_sound(at.certificate) or not at.passed or case.asked.motion.duration_s is not None:
        return None
    found, motion, asked = at.found, at.found.motion, case.asked
    share = INVERSE_DYNAMICS_SHARE * (1.0 + float(at.report.effort_overrun.max()))
    if share > SETTLED_CHANGE or (1.0 + share) * motion.duration_s > (asked.motion.max_duration_s or np.inf):
        return None
    try:
        slow = in_more_time(asked, motion, 1.0 + share)
    except (AssemblyError, OutOfTimeError):
        return None
    dearer = objective_value(asked, slow)[0] - objective_value(asked, motion)[0]
    solution = replace(found.solution, objective=found.solution.objective + dearer)
    slowed = certify_iterate(case, replace(found, motion=slow, solution=solution))
    return slowed if is_sound(slowed.certificate) else None


def first_way(case: MechanismCase, found: Iterate) -> Way:
    """Return the solve in the finer transcription, with the jumps of efforts as ends of segments."""
    asked, motion = case.asked, found.motion
    case = replace(case if asked.motion.duration_s is None else _nearer(case, found), ties=TIE_WEIGHT)
    if asked.mesh.refine != "intervals":
        case = with_scheme(case, _FINER_SCHEME)
    share = _SHARE_ALONG_PRODUCTS if case.enclosed else _SHARE_OF_INTERVALS
    n = max(8, round(share * asked.mesh.intervals))
    boundaries, jumps = motion.breaks_s[found.mesh.boundaries()], jumps_of(case, found)
    if len(boundaries) == 2 and not len(jumps):
        durations = np.array([motion.duration_s])
        return Way(case, with_force_times(case.problem, uniform(n), durations), durations, "finer transcription")
    return Way(case, *mesh_with_switches(boundaries, jumps, n, least=1), "jumps of efforts as unknowns")


def next_way(case: MechanismCase, at: CertifiedIterate, left: float) -> Way | None:
    """Return the next solve after a motion; None where it is done.

    `left` is the share of the objective that a further mesh is expected to gain.
    """
    if at.certificate is None:
        return None
    pieces, mesh, durations = for_a_solve(case, at), at.found.mesh, at.found.durations
    further = apart(jumps_of(case, at.found), np.concatenate([[0.0], np.cumsum(durations)]), at.found.motion)
    if (nearer := _nearer(case, at.found)) is not case:
        return Way(nearer, mesh, durations, "nearer to singular poses")
    if abs(left) <= _settled_change(case):
        return None
    if len(further) and mesh.n_segments + len(further) <= mesh.n_intervals // 3:
        what = "more jumps as unknowns"
        if case.enclosed:  # the mesh along limits on power is fine where efforts bend
            return Way(case, *with_ends(divided(mesh, pieces), durations, further), what)
        boundaries = at.found.motion.breaks_s[mesh.boundaries()]
        ends = np.concatenate([np.cumsum(durations)[:-1], further])
        ends = np.sort(ends[np.abs(ends[:, None] - boundaries).min(axis=1) > 1e-9 * boundaries[-1]])
        return Way(case, *mesh_with_switches(boundaries, ends, mesh.n_intervals, least=1), what)
    if pieces.max() == 1 or pieces.sum() > _MAX_GROWTH * case.asked.mesh.intervals:
        pieces = 1 + rough_of(at.found.motion)
    if pieces.sum() > MAX_INTERVALS:
        return None
    return Way(case, divided(mesh, pieces), durations, "finer mesh")


def _nearer(case: MechanismCase, found: Iterate) -> MechanismCase:
    """Return a case that comes nearer to singular poses if that is worth a solve; else the same."""
    last = max(case.asked.limits.singular_margin, LAST_MARGIN)
    return _at_margin(case, last) if gain_at_margin(case, found, last) > _WORTH_COMING_NEARER else case


def gain_at_margin(case: MechanismCase, found: Iterate, margin: float) -> float:
    """Return the share of the objective that a smaller distance from singular poses gains, to first order."""
    solution, transcribed, asked = found.solution, found.solution.transcribed, _margin_of(case)
    if solution.multipliers is None or margin >= asked:
        return 0.0
    of_margin = np.all(transcribed.formulation.path == (asked, np.inf), axis=1)
    slope = path_multipliers(transcribed, solution.multipliers)[:, of_margin].sum()
    change = slope * (asked - margin) * transcribed.objective_scale
    return share_gained(solution.objective, solution.objective + change)


def _at_margin(case: MechanismCase, margin: float) -> MechanismCase:
    """Return a case whose solves keep this distance from singular poses."""
    return replace(case, problem=with_limits(case.problem, singular_margin=margin))


def _loosened(case: MechanismCase, margin: float) -> MechanismCase:
    """Return a case with the problem's own limits, and at this distance from singular poses."""
    problem = case.problem.varied(limits=replace(case.asked.limits, singular_margin=margin))
    return replace(case, problem=problem, tightenings=(), n_tightenings=0)


def _with_distance(case: MechanismCase) -> MechanismCase:
    """Return a case whose solves keep a distance from the limits on efforts that are wider than ten such distances."""
    return replace(case, problem=within_efforts(case.problem, _DISTANCE_OF_EFFORTS * INVERSE_DYNAMICS_SHARE))


def _settled_change(case: MechanismCase) -> float:
    return _SETTLED_CHANGE_OF_STEPS if case.problem.mesh.effort == "constant" else SETTLED_CHANGE


def _margin_of(case: MechanismCase) -> float:
    return case.problem.limits.singular_margin
