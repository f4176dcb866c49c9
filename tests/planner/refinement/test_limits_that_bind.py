"""Which multipliers say that a limit binds, and which that an arc is held wrongly."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.refinement.constrained_arcs import _of_paths, _wrong, limits_bind
from linkplan.planner.transcription.mesh import segmented


def binds(row: float, unknown: float) -> bool:
    """Return the answer for an equation of multiplier 1, an inequality's, and those of a free and of a given unknown."""
    transcribed = SimpleNamespace(
        row_lower=np.array([0.0, -1.0, -1.0]), row_upper=np.array([0.0, 1.0, 1.0]),
        lower=np.array([-1.0, -1.0, 3.0]), upper=np.array([1.0, 1.0, 3.0]),
    )  # fmt: skip
    solution = SimpleNamespace(
        multipliers=np.array([-1.0, row, 0.0]), bound_multipliers=np.array([unknown, 0.0, 7.0]), transcribed=transcribed
    )
    return limits_bind(solution)


@pytest.mark.parametrize("size", [1.0, -1.0])
def test_a_limit_binds_if_its_multiplier_is_above_a_ten_millionth_of_an_equation_s(size):
    assert not binds(0.5e-7 * size, 0.5e-7 * size)
    assert binds(3e-7 * size, 0.0)
    assert binds(0.0, 3e-7 * size)


def test_a_push_away_from_a_limit_is_wrong_above_a_hundredth_of_the_largest():
    pushes = np.array([[1.0, -0.005], [-0.02, 0.0]])
    assert _wrong(pushes).tolist() == [[False, False], [True, False]]


@pytest.mark.parametrize(("kind", "of_arc"), [("power", False), ("tendon", True)])
def test_the_push_of_a_path_quantity_is_that_of_its_rows_on_an_interval_or_on_the_whole_arc(kind, of_arc):
    """Segments of three intervals; each has an own row, then two nodes of two equations and one quantity."""
    mesh = segmented(np.array([1.0, 1.0]), 6)
    interval = SimpleNamespace(
        n_rows=7, n_own=1, n_nodes=2, n_equations=2, n_path=1, node_kinds=("dynamics", "closure", kind)
    )  # fmt: skip
    program = SimpleNamespace(mesh=mesh, interval=interval)
    transcribed = SimpleNamespace(program=program, constrained_paths=np.array([[-1], [1]]))
    rows = np.full((6, 7), 99.0)
    rows[:, 3], rows[:, 6] = np.arange(6.0), 10.0
    pushes = _of_paths(transcribed, np.append(rows.ravel(), 5.0))[:, 0]
    each = np.arange(6.0) + 10.0
    expected = np.repeat([each[:3].sum(), each[3:].sum()], 3) if of_arc else each
    assert pushes == pytest.approx(expected * [-1, -1, -1, 1, 1, 1])
