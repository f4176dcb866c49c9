"""Switch times at which an effort's limit and a limit on a quantity that contains the effort bind together."""

import numpy as np
import pytest

from linkplan.planner.transcription.bounds import _with_junctions, find_junctions
from linkplan.planner.transcription.formulation import Start
from linkplan.planner.transcription.interval import IntervalRows
from linkplan.planner.transcription.mesh import Layout, segmented
from tests.support.formulations import formulation

NAN, DURATIONS = np.nan, np.array([1.0, 2.0, 1.0])
FORMULATION = formulation(rows=IntervalRows(open_end_path=(0,)), effort=np.array([[-4.0, 4.0]]))
# Between two bangs the power is held. The arc goes on from the first without a jump, or into the last.
ONTO = np.array([[4.0], [NAN], [-4.0]]), np.array([[0], [1], [0]])
OFF = np.array([[-4.0], [NAN], [4.0]]), np.array([[0], [1], [0]])


def found(held: tuple[np.ndarray, np.ndarray], along: float) -> np.ndarray | None:
    """Return the junctions of a motion whose effort is `along` on the arc from 1 s to 3 s."""

    def nodes(times: np.ndarray):
        return None, None, None, np.full((len(times), 1), along)

    return find_junctions(FORMULATION, segmented(DURATIONS, 12), DURATIONS, Start(states=nodes, nodes=nodes), *held)


@pytest.mark.parametrize(
    ("held", "along", "ways"), [(ONTO, 4.0, [1, 0]), (ONTO, -4.0, [0, -1]), (OFF, 4.0, [0, -1]), (OFF, -4.0, [1, 0])]
)
def test_an_effort_that_does_not_change_its_sign_goes_on_without_a_jump(held, along, ways):
    assert found(held, along).ravel().tolist() == ways


def test_between_two_bangs_there_is_no_junction():
    assert found((np.array([[4.0], [-4.0], [4.0]]), np.zeros((3, 1), dtype=int)), 5.0) is None


@pytest.mark.parametrize(("held", "way"), [(ONTO, 1), (OFF, -1)])
def test_beside_a_junction_the_effort_of_the_arc_may_exceed_its_limit(held, way):
    mesh = segmented(DURATIONS, 12)
    of_arc = np.flatnonzero(mesh.segment == 1)
    layout = Layout(n_s=1, n_z=0, n_u=1, n_nodes=2, n_intervals=mesh.n_intervals, n_segments=3)
    lower, upper, expected = np.full(layout.size, -1.0), np.ones(layout.size), np.ones(layout.size)
    _with_junctions(lower, upper, FORMULATION, layout, mesh, held[0], np.array([[1], [0]] if way > 0 else [[0], [-1]]))
    widened = layout.effort()[of_arc[0] if way > 0 else of_arc[-1], :, 0]
    expected[widened] = 3.0  # by the distance of the two limits
    if way < 0:
        expected[widened[-1]] = 1.0  # where the arc ends, the effort is at the bang's limit
        assert lower[widened[-1]] == 1.0
    np.testing.assert_array_equal(upper, expected)
    others = np.setdiff1d(np.arange(layout.size), widened[-1:] if way < 0 else [])
    np.testing.assert_array_equal(lower[others], -expected[others])
