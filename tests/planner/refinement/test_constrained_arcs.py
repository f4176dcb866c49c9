"""Intervals along limits, read from the rows of a program: the values of the rows are given, without a mechanism."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.refinement.constrained_arcs import (
    arc_ends,
    find_constrained_paths,
    own_arcs,
    path_arcs,
)

LOW, HIGH = -2.0, 4.0


def program_of(
    rows, *, limit=(LOW, HIGH), kind="speed", n_path=0, n_equations=0, n_nodes=0, jerk_path=()
) -> SimpleNamespace:
    """Return a program with rows (n, n_rows): of each interval's own limit, then of its nodes' equations and path limit."""
    rows = np.array(rows, dtype=float)
    n_own = rows.shape[1] - n_nodes * (n_equations + n_path)
    interval = SimpleNamespace(
        n_rows=rows.shape[1],
        n_own=n_own,
        own_kinds=(kind,) * n_own,
        own_items=(0,) * n_own,
        n_nodes=n_nodes,
        n_equations=n_equations,
        n_path=n_path,
        node_kinds=("dynamics",) * n_equations + (kind,) * n_path,
    )
    functions = {"nlp": lambda _x, _parameters: (0.0, rows.ravel())}
    program = SimpleNamespace(mesh=SimpleNamespace(n_intervals=len(rows)), interval=interval, functions=functions)
    own, path = ({} if n_path else {kind: [np.array(limit)]}), np.array([limit])
    formulation = SimpleNamespace(own=own, path=path, rows=SimpleNamespace(jerk_path=jerk_path))
    return SimpleNamespace(program=program, parameters=None, formulation=formulation)


def test_an_interval_is_an_arc_where_all_of_its_coefficients_are_at_one_limit():
    rows = [(HIGH, HIGH, HIGH), (HIGH, HIGH, 0.0), (LOW, LOW, LOW), (0.0, 0.0, 0.0)]
    assert own_arcs(program_of(rows), np.zeros(0), ("speed",)).ravel().tolist() == [1, 0, -1, 0]
    assert own_arcs(program_of(rows), np.zeros(0), ("motor",)).shape == (4, 0)


@pytest.mark.parametrize(("kind", "arcs"), [("power", [1, 0, -1, 0]), ("work", [0, 0, 0, 0])])
def test_an_interval_is_an_arc_of_a_path_limit_where_all_of_its_nodes_are_at_one_limit(kind, arcs):
    """Every node has the row of an equation before that of the limit, and the interval one row of its own before them."""
    nodes = [(HIGH, HIGH), (HIGH, 0.0), (LOW, LOW), (0.0, 0.0)]
    rows = [(7.0, 0.0, first, 0.0, second) for first, second in nodes]
    transcribed = program_of(rows, kind=kind, n_path=1, n_equations=1, n_nodes=2)
    assert path_arcs(transcribed, np.zeros(0)).ravel().tolist() == arcs


def test_arcs_along_a_limit_on_the_size_of_a_jerk_end_where_it_reverses_and_are_not_held():
    rows = [(HIGH, HIGH), (HIGH, 0.0), (HIGH, HIGH), (HIGH, HIGH)]
    transcribed = program_of(rows, kind="site_jerk", n_path=1, n_nodes=2, jerk_path=(0,))
    transcribed.scheme = SimpleNamespace(acceleration_coefficients=np.eye(2))
    transcribed.program.layout = SimpleNamespace(acceleration=lambda: np.arange(8).reshape(4, 2, 1))
    x = np.array([0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 2.0])  # accelerations at both nodes of each interval
    assert own_arcs(transcribed, x, ("jerk",)).ravel().tolist() == [1, 0, 1, -1]
    assert own_arcs(transcribed, x, ("speed",)).size == 0
    assert not path_arcs(transcribed, x).any()


def test_a_path_equation_is_no_arc():
    transcribed = program_of([(HIGH, HIGH)], limit=(HIGH, HIGH), kind="power", n_path=1, n_nodes=2)
    assert path_arcs(transcribed, np.zeros(0)).tolist() == [[0]]


@pytest.mark.parametrize(
    ("switch", "boundary", "ends"),
    [
        (3.0, 9.0, [1.0]),  # intervals of 0.1 s and 0.4 s meet there
        (1.9, 9.0, []),  # within 2.5 of the longer ones
        (2.1, 9.0, [1.0]),
        (3.0, 1.0, []),
        (3.0, 1.04, []),  # within half of the shorter one
        (3.0, 1.1, [1.0]),
    ],
)
def test_an_arc_ends_where_no_switch_and_no_phase_boundary_is_near(switch, boundary, ends):
    breaks = np.array([0.8, 0.9, 1.0, 1.4, 1.8])
    arcs = np.array([[0], [0], [1], [1]])
    assert arc_ends(arcs, breaks, np.array([switch]), np.array([boundary])).tolist() == ends


@pytest.mark.parametrize(
    ("breaks", "arcs"),
    [
        # Intervals next to the ends of the segment from 1 to 2 do not count, nor those that reach out of it.
        (np.linspace(0.0, 3.0, 31), [0] * 11 + [1] * 8 + [0] * 11),
        ([0.0, 0.8, 1.3, 1.6, 2.4, 3.0], [0, 0, 1, 0, 0]),
    ],
)
def test_a_segment_follows_a_limit_if_all_intervals_well_within_it_do(breaks, arcs):
    free = np.full((3, 1), np.nan)
    held = find_constrained_paths(np.array(arcs)[:, None], np.array(breaks), np.arange(4.0), free)
    assert held.tolist() == [[0], [1], [0]]
