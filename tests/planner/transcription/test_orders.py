"""The order that every transcription claims, measured on an oscillator: s'' = -s over a few of its periods."""

import numpy as np
import pytest

from linkplan.planner.transcription.schemes import MAX_DEGREE, NAMES, Scheme, scheme

# Over this time [rad of phase] the error of the coarsest meshes is large enough for nine nodes to leave rounding alone.
PHASE = 20.0
# Between these errors a scheme is neither too coarse to show its order nor at the machine's rounding.
WINDOW = (3e-11, 3e-3)
# Orders are measured on three meshes or more; what is left of the next terms keeps them this close [1]; from order ten on,
# where rounding leaves meshes of a radian or two an interval only, this close relative to the order.
MEASURED, MEASURED_HIGH = 0.35, 0.09
CLAIMED = {"trapezoid": 2, "trapezoid-consistent": 2, "hermite-simpson": 4, "hermite-simpson-consistent": 4}
CLAIMED |= {f"radau-{m}": 2 * m - 1 for m in range(1, MAX_DEGREE + 1)}
CLAIMED |= {f"gauss-{m}": 2 * m for m in range(1, MAX_DEGREE + 1)}


def error_after(constants: Scheme, steps: int) -> float:
    """Return how far s and v are from cos and -sin after `steps` equal intervals, each collocated: a_i = -s_i."""
    h, m = PHASE / steps, constants.n_nodes
    a = np.linalg.solve(np.eye(m) + h**2 * constants.position, -np.column_stack([np.ones(m), h * constants.nodes]))
    interval = np.vstack([[1.0, h] + h**2 * constants.position_end @ a, [0.0, 1.0] + h * constants.velocity_end @ a])
    s, v = np.linalg.matrix_power(interval, steps) @ [1.0, 0.0]
    return float(np.hypot(s - np.cos(PHASE), v + np.sin(PHASE)))


@pytest.mark.parametrize("name", NAMES)
def test_every_scheme_has_the_order_that_it_claims(name):
    constants = scheme(name)
    order = CLAIMED[name]
    steps = np.unique(np.round(np.geomspace(3, 60_000 if order < 3 else 3000, 60)).astype(int))
    errors = np.array([error_after(constants, int(n)) for n in steps if n * order < 120_000])
    steps = steps[: len(errors)]
    inside = (errors > WINDOW[0]) & (errors < WINDOW[1])
    assert inside.sum() >= 3
    slope = -np.polyfit(np.log(steps[inside]), np.log(errors[inside]), 1)[0]
    assert slope == pytest.approx(order, abs=max(MEASURED, MEASURED_HIGH * order))


def test_no_scheme_is_without_a_claim():
    assert set(CLAIMED) == set(NAMES)
