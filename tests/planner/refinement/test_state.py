"""What a refinement knows of the objective's change from mesh to mesh."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.refinement.state import RefinementState


def moved(best: float | None, loose: float | None, change: float = np.inf) -> float:
    """Return what the objective moved by, with tightened limits (`best`) and with loosened ones (`loose`)."""

    def at(objective: float | None) -> SimpleNamespace | None:
        solution = SimpleNamespace(objective=objective)
        return None if objective is None else SimpleNamespace(found=SimpleNamespace(solution=solution))

    state = SimpleNamespace(best=at(best), loose=at(loose), change=change)
    return RefinementState.moved.fget(state)


@pytest.mark.parametrize(("best", "share"), [(2.0, 0.5), (-2.0, 0.0), (0.8, 0.0)])
def test_tightened_limits_cost_what_loosened_ones_save(best, share):
    assert moved(best, 1.0) == pytest.approx(share)


def test_of_negative_objectives_the_cost_is_a_share_of_their_size():
    assert moved(-1.0, -1.5) == pytest.approx(0.5)


def test_without_loosened_limits_the_objective_moves_by_its_last_change():
    assert moved(1.0, None, change=0.25) == 0.25
    assert moved(1.0, None) == 0.0
