"""The switch times of a motion: read from the coefficients of its efforts, then unknowns of further solves.

They are unknowns until they no longer move. A duration that ends at a bound of its guess has not converged: the objective
still falls there.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.refinement.case import Case, Iterate, attempt
from linkplan.planner.refinement.constrained_arcs import (
    INTERVALS_TO_SAME_SWITCH,
    SHARE_AT_LIMIT,
    FixedArcs,
    arc_ends,
    arcs_against_their_limits,
    find_constrained_paths,
    own_arcs,
    path_arcs,
)
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh, segmented

# Up to this many intervals between two arcs at limits are one smeared switch; more are a separate arc.
SMEARED_INTERVALS = 3
# A switch time within this share of half an interval of a phase boundary is that boundary; the share depends on whether arcs
# can be short (True).
SHARE_BESIDE_OTHERS = {True: 1e-3, False: 0.1}
# A solve with switch times replaces the last iterate if its objective is at most this share worse: the error of a mesh
# without switch times.
MESH_ERROR_SHARE = 1e-4
# A segment's duration is at its bound if its logarithm is within this share of the range.
SHARE_AT_BOUND = 1e-3
# Switch times next to arcs within the limits are solved again until the objective gains less than this share.
SETTLED_GAIN = 1e-9
# A duration this close to its bound (relative) counts as at the bound.
SHARE_AT_GUESS_BOUND = 0.01

LONGER, SHORTER = "longer", "shorter"


def settle_switch_times(
    case: Case,
    found: Iterate,
    *,
    position_rows: bool = False,
) -> Iterate:
    """Return a solution with switch times at its switches, or the same solution if switch times do not improve it.

    Efforts and path quantities are first fixed at the limits of the arcs, so that only the switch times are unknown. If this
    is worse than the solution without switch times, the arcs were read wrongly, and nothing is fixed.
    """
    no_worse = SETTLED_GAIN if position_rows else MESH_ERROR_SHARE
    for _ in range(4):  # largest number of solves until switch times next to arcs within the limits settle
        before = found.solution.objective
        boundaries = found.motion.breaks_s[found.mesh.boundaries()]
        switch_times, fixed = _arcs_of(case, found, boundaries)
        if not 0 < len(switch_times) <= found.mesh.n_intervals // 6:
            break
        if _known(found.solution.transcribed, fixed) and not at_bounds(found.solution):
            return replace(found, fixed=fixed)
        better, start = None, case.start_from(found.motion)
        finer, durations = mesh_with_switches(boundaries, switch_times, case.problem.mesh.intervals)
        for held, what in ((fixed, "switch times as unknowns"), (None, "switch times as unknowns, efforts free")):
            tried = attempt(case, start, finer, durations, what, warm=True, position_rows=position_rows, fixed=held)
            # If everything is fixed, nothing can be gained between the nodes: the remaining difference is the mesh error.
            whole = held is not None and held.everything and bool(held.paths.any())
            allowed = MESH_ERROR_SHARE if whole else no_worse
            if tried is not None and len(arcs_against_their_limits(tried.solution)):
                continue  # the arcs were read wrongly
            if tried is not None and tried.solution.objective <= before + allowed * abs(before):
                better = tried
                break
        if better is None:
            break
        settled = better.solution.objective > before - SETTLED_GAIN * abs(before) and not at_bounds(better.solution)
        found = better
        no_worse = SETTLED_GAIN  # from here on both have switch times, so only a better one replaces the other
        if settled or fixed.everything:
            break
    return found


def _arcs_of(case: Case, found: Iterate, boundaries: np.ndarray) -> tuple[np.ndarray, FixedArcs]:
    """Return the ends (n,) [s] of a solution's arcs between phase boundaries [s], and the quantities fixed along them.

    Arcs shorter than an interval are bang arcs if no other limit is active; otherwise they are ends of arcs along a limit.
    """
    motion, transcribed, x, target = found.motion, found.solution.transcribed, found.solution.x, case.target
    on_path = path_arcs(transcribed, x)
    arcs = own_arcs(transcribed, x, ("motor", "acceleration", "jerk", "speed", "effort_rate"))
    switch_times = find_switch_times(
        motion,
        target.effort_limit,
        boundaries,
        np.any(on_path, axis=1),
        short=is_bang_bang(case, transcribed),
        continuous_efforts=target.continuous_efforts,
    )
    along = np.hstack([on_path, arcs])
    switch_times = np.append(switch_times, _jumps_between(along, motion, switch_times))
    further = arc_ends(along, motion.breaks_s, switch_times, boundaries)
    switch_times = np.sort(np.append(switch_times, further))
    ends = np.sort(np.concatenate([boundaries, switch_times]))
    bang_efforts = find_bang_efforts(motion, target.effort_limit, ends[1:-1])
    paths = find_constrained_paths(on_path, motion.breaks_s, ends, bang_efforts)
    return switch_times, FixedArcs(efforts=bang_efforts, paths=paths)


def _jumps_between(along: np.ndarray, motion: Trajectory, known_s: np.ndarray) -> np.ndarray:
    """Return the times (n,) [s] at which efforts jump in smeared intervals between two arcs (n_intervals, n_arcs).

    The impulse of the effort that jumps most gives the time. Times near known ones are omitted.
    """
    breaks, mean = motion.breaks_s, motion.effort.mean(axis=0)
    at_limit = np.flatnonzero(along.any(axis=1))
    found = []
    for a, b in itertools.pairwise(at_limit):
        if not 1 < b - a <= SMEARED_INTERVALS:
            continue
        j = int(np.argmax(np.abs(mean[b] - mean[a]) / np.ptp(mean, axis=0).clip(1e-300)))
        time = _switch_time_in(breaks[a + 1 : b + 1], motion.effort[:, a + 1 : b, j], mean[a, j], mean[b, j])
        if np.abs(known_s - time).min(initial=np.inf) > INTERVALS_TO_SAME_SWITCH * float(np.diff(breaks[a : b + 2]).max()):
            found.append(time)
    return np.array(found)


def is_bang_bang(case: Case, transcribed: Transcribed) -> bool:
    """Return True if all efforts are at their limits: time is the objective, and ranges are the only other limits."""
    interval = transcribed.program.interval
    return case.target.bang_bang and interval.n_path == 0 and {*interval.own_kinds} <= {"continuity", "position"}


def _known(transcribed: Transcribed, fixed: FixedArcs) -> bool:
    """Return True if a program already fixes all of these arcs and leaves nothing free."""
    before = transcribed.bang_efforts
    if before is None or before.shape != fixed.efforts.shape or not fixed.everything:
        return False
    same_paths = (
        not fixed.paths.any()
        if transcribed.constrained_paths is None
        else np.array_equal(transcribed.constrained_paths, fixed.paths)
    )
    return bool(same_paths and np.array_equal(before, fixed.efforts, equal_nan=True))


def at_bounds(solution: Solution) -> bool:
    """Return True if the duration of a segment is at its bound, so that its ends would move further.

    The comparison is by factors, because a bang arc may be a millionth of its largest possible duration and still far from
    its bound.
    """
    transcribed, place = solution.transcribed, solution.transcribed.program.layout.durations()
    free = transcribed.lower[place] < transcribed.upper[place]
    lower, upper, at = (values[place][free] for values in (transcribed.lower, transcribed.upper, solution.x))
    near = SHARE_AT_BOUND * np.log(upper / lower)
    return bool(np.any((np.log(at / lower) < near) | (np.log(upper / at) < near)))


def mesh_with_switches(
    boundaries_s: np.ndarray, switch_times_s: np.ndarray, n_intervals: int, *, least: int = 3
) -> tuple[Mesh, np.ndarray]:
    """Return a mesh with switch times (n_switches,) [s] between phase boundaries [s], and its segments' durations [s].

    It has about `n_intervals`, and a least number in each segment.
    """
    ends = np.sort(np.concatenate([boundaries_s, switch_times_s]))
    phase = np.searchsorted(boundaries_s, ends[:-1], side="right") - 1
    durations = np.diff(ends)
    return segmented(durations, n_intervals, phase=phase, least=least), durations


def bounded_by_guess(solution: Solution, shortest_s: float, longest_s: float) -> str | None:
    """Return `LONGER` or `SHORTER`, as the motion would be without a bound that is not the user's; else None.

    A free duration is searched between a fiftieth and a hundred times its guess. A motion with switch times has settled near
    them, and None is returned.

    Args:
        solution: of a program.
        shortest_s: the user's bounds on the duration [s], equal where it is fixed.
        longest_s: infinite where there is none.
    """
    transcribed = solution.transcribed
    place, mesh = transcribed.program.layout.durations(), transcribed.program.mesh
    if shortest_s == longest_s or np.any(np.bincount(mesh.phase) > 1):
        return None
    at, lower, upper = solution.x[place], transcribed.lower[place], transcribed.upper[place]
    free, duration = (
        lower < upper,
        float(at.sum()) * transcribed.units.time_s,
    )  # phases up to given instants are not free
    if duration < (1 - SHARE_AT_GUESS_BOUND) * longest_s and np.any(free & (at >= (1 - SHARE_AT_GUESS_BOUND) * upper)):
        return LONGER
    if duration > (1 + SHARE_AT_GUESS_BOUND) * shortest_s and np.any(free & (at <= (1 + SHARE_AT_GUESS_BOUND) * lower)):
        return SHORTER
    return None


def find_switch_times(
    trajectory: Trajectory,
    limit: np.ndarray,
    boundaries_s: np.ndarray | None = None,
    on_path: np.ndarray | None = None,
    *,
    short: bool = False,
    continuous_efforts: bool = False,
) -> np.ndarray:
    """Return the times (n,) [s] at which efforts jump between their limits or leave them, increasing.

    Args:
        trajectory: a solution on a fixed mesh.
        limit: (n_u, 2) of the efforts.
        boundaries_s: instants [s] at which the mesh is cut already; its ends by default.
        on_path: intervals (n,) along a path limit, which are never a smeared switch.
        short: whether arcs at limits may be shorter than an interval. With limits other than those of effort, an effort that
            leaves its limit for so short a time follows another limit.
        continuous_efforts: whether efforts have no jumps; intervals between two limits are then an arc, however short.

    A switch inside an interval shows as one smeared interval, with efforts between the limits. Its time follows from their
    impulse: u_before (t - t_0) + u_after (t_1 - t) = int u dt. The two switch times of an arc shorter than an interval
    follow from the impulse and its middle.
    """
    breaks = trajectory.breaks_s
    boundaries = breaks[[0, -1]] if boundaries_s is None else boundaries_s
    known_boundaries = np.searchsorted(breaks, boundaries[1:-1] - 1e-12 * breaks[-1]) if short else np.empty(0, dtype=int)
    at_boundaries = {0, len(breaks) - 1, *known_boundaries.tolist()}
    found: list[list[float]] = []
    for j, (low, high) in enumerate(limit):
        if not (np.isfinite(low) and np.isfinite(high) and high > low):
            continue
        coefficients = trajectory.effort[:, :, j]
        slack = SHARE_AT_LIMIT * (high - low)
        arc = np.where(coefficients.min(axis=0) > high - slack, 1, np.where(coefficients.max(axis=0) < low + slack, -1, 0))
        # Not np.union1d, which loads numpy.ma: a tenth of the time of a command that plans one motion.
        edges = np.array(sorted({*(np.flatnonzero(np.diff(arc)) + 1).tolist(), *known_boundaries.tolist()}), dtype=int)
        starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(arc)]])
        for a, b in zip(starts, ends, strict=True):
            piece = _Piece(
                breaks=breaks[a : b + 1],
                coefficients=coefficients[:, a:b],
                at_limit=int(arc[a]),
                before=0 if a in at_boundaries else int(arc[a - 1]),
                after=0 if b in at_boundaries else int(arc[b]),
                on_path=on_path is not None and bool(on_path[a:b].any()),
            )
            found += piece.switches(float(low), float(high), short=short, continuous_efforts=continuous_efforts)
    return _spread(found, breaks, boundaries, SHARE_BESIDE_OTHERS[short])


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Piece:
    """Successive intervals (n,) on which one effort is always at the same limit, or at none.

    `at_limit`, and `before` and `after` of the pieces beside it, is 1 at the upper limit, -1 at the lower, 0 at none or
    where the mesh is cut. `on_path` says that an interval of it follows a path limit.
    """

    breaks: np.ndarray  # (n + 1,) [s]
    coefficients: np.ndarray  # (degree + 1, n)
    at_limit: int
    before: int
    after: int
    on_path: bool

    def switches(self, low: float, high: float, *, short: bool, continuous_efforts: bool) -> list[list[float]]:
        """Return the switch times [s] found in the piece, in groups; the two switch times of a pulse are one group."""
        breaks, before, after, n = self.breaks, self.before, self.after, len(self.breaks) - 1
        if self.at_limit:
            return [[float(breaks[0])]] if before else []
        if self.on_path and n <= 2:
            return [[float(time)] for time, neighbour in ((breaks[0], before), (breaks[-1], after)) if neighbour]
        if self.on_path or n > SMEARED_INTERVALS:
            return self._ends_of_arc(low, high)
        if before * after > 0 and short:
            return [_pulse_in(breaks, self.coefficients, (low, high) if before < 0 else (high, low))]
        if before * after < 0 and continuous_efforts:
            return [[float(breaks[0]), float(breaks[-1])]]
        if before * after < 0 or (short and before + after):
            # Next to a phase boundary or an end, the arc on the other side is shorter than an interval and at the other
            # limit.
            u_before, u_after = (high, low) if before > 0 or after < 0 else (low, high)
            return [[_switch_time_in(breaks, self.coefficients, u_before, u_after)]]
        return []

    def _ends_of_arc(self, low: float, high: float) -> list[list[float]]:
        """Return the ends of an arc within the limits; its end intervals may belong partly to neighbouring arcs."""
        found, n = [], len(self.breaks) - 1
        for k, inner, neighbour in ((0, 1, self.before), (n - 1, n - 2, self.after)):
            if neighbour:
                at_limit, within = (high if neighbour > 0 else low), self.coefficients[:, inner].mean()
                u_before, u_after = (at_limit, within) if k == 0 else (within, at_limit)
                found.append([_switch_time_in(self.breaks[k : k + 2], self.coefficients[:, k : k + 1], u_before, u_after)])
        return found


def _switch_time_in(breaks: np.ndarray, coefficients: np.ndarray, u_before: float, u_after: float) -> float:
    """Return the time at which a jump between two efforts gives the impulse of the efforts of these intervals."""
    impulse = float(np.sum(coefficients.mean(axis=0) * np.diff(breaks)))
    jump = u_before - u_after
    if jump == 0:
        return float(breaks[0])
    return float(np.clip((impulse + u_before * breaks[0] - u_after * breaks[-1]) / jump, breaks[0], breaks[-1]))


def _pulse_in(breaks: np.ndarray, coefficients: np.ndarray, limits: tuple[float, float]) -> list[float]:
    """Return the times at which smeared intervals change to the other limit and back, from their impulse and its middle."""
    widths, missing = np.diff(breaks), limits[0] - coefficients.mean(axis=0)
    lengths = missing * widths / (limits[0] - limits[1])
    length = float(lengths.sum())
    middle = float(lengths @ (breaks[1:] + breaks[:-1]) / (2 * length))
    middle = float(np.clip(middle, breaks[0] + length / 2, breaks[-1] - length / 2))
    return [middle - length / 2, middle + length / 2]


def find_bang_efforts(trajectory: Trajectory, limit: np.ndarray, switch_times: np.ndarray) -> np.ndarray:
    """Return the efforts (n_switches + 1, n_u) of bang arcs between switch times: a limit, or NaN where they vary.

    Efforts are read away from the switch times, near which the fixed mesh smears the switch.
    """
    ends = np.concatenate([trajectory.breaks_s[:1], switch_times, trajectory.breaks_s[-1:]])
    bang_efforts = np.full((len(ends) - 1, trajectory.effort.shape[2]), np.nan)
    for k, (begin, end) in enumerate(itertools.pairwise(ends)):
        effort = trajectory.effort_at(begin + np.linspace(0.15, 0.85, 50) * (end - begin))
        for j, (low, high) in enumerate(limit):
            slack = SHARE_AT_LIMIT * (high - low) if np.isfinite(high - low) else 0.0
            for bound in (low, high):
                if slack and np.all(np.abs(effort[:, j] - bound) < slack):
                    bang_efforts[k, j] = bound
    return bang_efforts


def _spread(switch_times: list[list[float]], breaks: np.ndarray, boundaries: np.ndarray, share: float) -> np.ndarray:
    """Return switch times in order, a pulse's together, without those close to others or to a phase boundary."""
    apart = 0.5 * float(np.diff(breaks).min())
    kept: list[float] = []
    for together in sorted(switch_times):
        beside = min(float(np.abs(switch_time - boundaries).min()) for switch_time in together)
        if beside > share * apart and (not kept or together[0] - kept[-1] > apart):
            kept += together
    return np.array(kept)
