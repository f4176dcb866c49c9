"""Pontryagin's principle on arcs that are held at a limit: the arcs that the optimum would leave.

A solver that holds an effort or a path quantity finds the best motion with it held. The multipliers show whether the limit
or the holding restricts this motion. The reduced gradient of an effort is the integral of the switching function (Betts
2010, section 4.4). On every interval of a correct arc it has the sign of the limit.
"""

import numpy as np

from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.solvers.solve import Solution

# A multiplier of the wrong sign above this share of the largest one is more than rounding.
WRONG_SIGN_SHARE = 1e-2
# A multiplier of an inequality below this share of the largest of an equation is left by the barrier: the limit does not
# bind.
BINDING_SHARE = 1e-7
# No effort changes the rate of these quantities at once: held, they are constraints of second order. Their multiplier is a
# measure with impulses at the ends of an arc (Hartl, Sethi and Vickson 1995). A transcription gives values that alternate
# from interval to interval, so only the sum over the arc has a sign. Path quantities of a differential equation can be of
# this kind.
_SECOND_ORDER = ("site", "tube", "tendon", "singular", "path")


def arcs_against_their_limits(solution: Solution) -> np.ndarray:
    """Return the instants (n,) [s], middles of intervals, at which the optimum would leave a held limit."""
    breaks = interval_breaks(solution)
    wrong = np.hstack(held_wrongly(solution)).any(axis=1)
    return 0.5 * (breaks[1:] + breaks[:-1])[wrong]


def limits_bind(solution: Solution) -> bool:
    """Return True if a limit binds on any unknown or row, or if the solver gave no multipliers."""
    rows, unknowns, transcribed = solution.multipliers, solution.bound_multipliers, solution.transcribed
    if rows is None or unknowns is None:
        return True
    equal = transcribed.row_lower == transcribed.row_upper
    most = BINDING_SHARE * np.abs(rows[equal]).max(initial=np.finfo(float).tiny)
    of_unknowns = np.abs(unknowns[transcribed.lower < transcribed.upper])
    return bool(max(np.abs(rows[~equal]).max(initial=0.0), of_unknowns.max(initial=0.0)) > most)


def interval_breaks(solution: Solution) -> np.ndarray:
    """Return the ends of a solution's intervals (n + 1,) [s]."""
    program, transcribed = solution.transcribed.program, solution.transcribed
    return program.mesh.breaks(solution.x[program.layout.durations()] * transcribed.units.time_s)


def held_wrongly(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Return True where the optimum would leave a held effort (n, n_u) or path quantity (n, n_path) of an interval."""
    transcribed, multipliers = solution.transcribed, solution.multipliers
    program, mesh = transcribed.program, transcribed.program.mesh
    efforts = np.zeros((mesh.n_intervals, program.layout.n_u), dtype=bool)
    paths = np.zeros((mesh.n_intervals, program.interval.n_path), dtype=bool)
    # An effort with a limited rate is a state: its multiplier acts on the whole arc and has no sign at each instant.
    if multipliers is not None and transcribed.bang_efforts is not None and "effort_rate" not in program.interval.own_kinds:
        _, gradient = program.functions["grad_f"](solution.x, transcribed.parameters)
        _, jacobian = program.functions["jac_g"](solution.x, transcribed.parameters)
        reduced = np.array(gradient).ravel() + np.array(jacobian.T @ multipliers).ravel()
        efforts = _wrong(_of_efforts(transcribed, reduced))
    if multipliers is not None and transcribed.constrained_paths is not None:
        paths = _wrong(_of_paths(transcribed, multipliers))
    return efforts, paths


def _wrong(pushes: np.ndarray) -> np.ndarray:
    """Return True (n, k) where a push is away from its limit, compared with the largest push."""
    return pushes < -WRONG_SIGN_SHARE * np.abs(pushes).max(initial=np.finfo(float).tiny)


def _of_efforts(transcribed, reduced: np.ndarray) -> np.ndarray:
    """Return the pushes of efforts onto their limits (n_intervals, n_u): negative if away from them, 0 if not held."""
    segment, held = transcribed.program.mesh.segment, transcribed.bang_efforts
    limit = transcribed.formulation.effort
    side = np.where(held == limit[:, 1], -1.0, np.where(held == limit[:, 0], 1.0, 0.0))[segment]
    return side * reduced[transcribed.program.layout.effort()].sum(axis=1)


def _of_paths(transcribed, multipliers: np.ndarray) -> np.ndarray:
    """Return the pushes of path quantities onto their limits (n_intervals, n_path), with the same signs."""
    mesh, interval = transcribed.program.mesh, transcribed.program.interval
    rows = multipliers[: mesh.n_intervals * interval.n_rows].reshape(mesh.n_intervals, -1)
    of_nodes = rows[:, interval.n_own :][:, : interval.n_nodes * (interval.n_equations + interval.n_path)]
    of_paths = of_nodes.reshape(mesh.n_intervals, interval.n_nodes, -1)[:, :, interval.n_equations :].sum(axis=1)
    second = np.isin(interval.node_kinds[interval.n_equations :], _SECOND_ORDER)
    of_arcs = np.zeros((mesh.n_segments, of_paths.shape[1]))
    np.add.at(of_arcs, mesh.segment, of_paths)
    return transcribed.constrained_paths[mesh.segment] * np.where(second, of_arcs[mesh.segment], of_paths)


def released(solution: Solution) -> tuple[np.ndarray, FixedArcs] | None:
    """Return the ends (n_segments + 1,) [s] of segments and what to hold on them; None if nothing is held wrongly."""
    transcribed, mesh = solution.transcribed, solution.transcribed.program.mesh
    wrong = np.hstack(held_wrongly(solution))
    if not wrong.any():
        return None
    first = np.concatenate([[True], (np.diff(mesh.segment) != 0) | np.any(wrong[1:] != wrong[:-1], axis=1)])
    n_u, n_path = transcribed.program.layout.n_u, transcribed.program.interval.n_path
    efforts, paths = transcribed.bang_efforts, transcribed.constrained_paths
    efforts = np.full((mesh.n_segments, n_u), np.nan) if efforts is None else efforts
    paths = np.zeros((mesh.n_segments, n_path), dtype=int) if paths is None else paths
    held = np.hstack([efforts, np.where(paths == 0, np.nan, paths)])[mesh.segment][first]
    held[wrong[first]] = np.nan
    fixed = FixedArcs(efforts=held[:, :n_u], paths=np.nan_to_num(held[:, n_u:]).astype(int))
    return interval_breaks(solution)[np.append(first, True)], fixed
