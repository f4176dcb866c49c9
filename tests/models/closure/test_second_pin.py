"""A hinge made by two connects: five rows wherever it stands, the hinge's own motion, forces shared by both pins."""

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import follow
from tests.support.mechanisms import replaced
from tests.support.spins import TWO_BALLS
from tests.support.tolerances import SWEPT_GAP_M

# Forces, relative.
FORCE = 1e-8


def turned(mechanism: Mechanism, n: int = 40) -> np.ndarray:
    """Return poses through a whole turn of the crank."""
    return follow(mechanism, np.column_stack([np.linspace(0.0, 2 * np.pi, n), np.zeros(n)]))


def test_five_rows_serve_through_a_whole_turn_without_normal_equations():
    mechanism = load_mechanism(TWO_BALLS)
    assert mechanism.n_closure_rows == 6
    assert len(mechanism.closure_rows) == 5
    assert not mechanism.dynamics.projected
    poses = turned(mechanism)
    values = [np.linalg.svd(np.array(mechanism.dynamics.closure_jacobian(q)), compute_uv=False) for q in poses]
    assert min(value[4] for value in values) > 0.01
    assert max(value[5] for value in values) < 1e-12


def test_the_simulators_own_gaps_stay_closed_along_the_turn():
    mechanism = load_mechanism(TWO_BALLS)
    data = mujoco.MjData(mechanism.model)
    for q in turned(mechanism):
        data.qpos[:] = mechanism.qpos_of(q)
        mujoco.mj_forward(mechanism.model, data)
        assert np.abs(data.efc_pos[: data.ne]).max() < SWEPT_GAP_M


def test_both_pins_bear_the_least_forces_that_hold():
    mechanism = load_mechanism(TWO_BALLS)
    rng = np.random.default_rng(0)
    for q in turned(mechanism, 7):
        motion = (q, rng.normal(size=2), rng.normal(size=2), rng.normal(size=1))
        force = np.array(mechanism.dynamics.closure_force(*motion)).ravel()
        J = np.array(mechanism.dynamics.closure_jacobian(q))
        least = np.linalg.pinv(J.T) @ (J.T @ force)
        assert np.linalg.norm(force) > 0.1
        assert np.linalg.norm(force - least) < FORCE * np.linalg.norm(force)


def test_pins_that_are_not_as_far_apart_in_both_bodies_keep_all_their_rows():
    off = load_mechanism(replaced(TWO_BALLS, 'name="p2" pos="0.03 0.09 -0.1"', 'name="p2" pos="0.03 0.09 -0.1000001"'))
    assert off.home_gap_m > 1e-8
    assert off.gap_m(off.home) > 1e-9, "what gapes is said"
