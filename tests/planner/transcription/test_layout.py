"""The places of a program's unknowns: each index is used by one of them."""

import casadi as ca
import numpy as np

from linkplan.planner.transcription.mesh import Layout
from linkplan.planner.transcription.system import System, build_node, node_symbols


def test_every_unknown_has_one_place_of_its_own():
    counts = {"n_s": 2, "n_z": 3, "n_u": 2, "n_nodes": 3, "n_intervals": 4, "n_segments": 3, "n_x": 1, "n_effort": 2}
    layout = Layout(**counts, n_extra=2, n_open_ends=1, n_z_open_end=2)
    of_intervals = {
        "acceleration": (layout.acceleration(), (4, 3, 2)),
        "rate": (layout.rate(), (4, 3, 1)),
        "dependent": (layout.dependent(), (4, 3, 3)),
        "effort": (layout.effort(), (4, 2, 2)),
        "open end": (layout.open_end_dependent(), (4, 1, 2)),
    }
    for name, (places, shape) in of_intervals.items():
        assert places.shape == shape, name
    ends = [layout.states(), layout.durations(), layout.extra()]
    everything = np.concatenate([places.ravel() for places in (*ends, *(places for places, _ in of_intervals.values()))])
    np.testing.assert_array_equal(np.sort(everything), np.arange(layout.size))
    assert layout.states().shape == (5, 5)  # two positions, two speeds and a state of first order
    np.testing.assert_array_equal(layout.states(), [layout.state(k) for k in range(5)])
    np.testing.assert_array_equal(layout.durations(), layout.states().max() + 1 + np.arange(3))
    np.testing.assert_array_equal(layout.extra(), layout.durations().max() + 1 + np.arange(2))


def test_unknowns_at_open_ends_are_the_algebraic_ones_in_the_rows_there():
    """A closure of the second of three unknowns, and of two quantities the one of the third unknown and of the effort."""
    node = node_symbols(1, 1, 3, 2)
    column = ca.vertcat(node.z[1] - node.s, node.a - node.u[0] - node.z[0], node.r, node.v, node.z[2] * node.u[1], 0)
    system = System(
        n_s=1, n_x=1, n_z=3, n_u=2, node=ca.Function("node", [node.stacked, ca.SX.sym("p", 0)], [column]),
        n_equations=3, n_path=2, kinds=("closure", "dynamics", "dynamics", "speed", "power"),
    )  # fmt: skip
    assert (system.n_xi, system.n_state) == (3 + 2 + 3 + 2, 3)
    functions = build_node(system, (1,))
    assert functions.open_end_rows == (0, 4)
    assert functions.open_end_z == (1, 2)
