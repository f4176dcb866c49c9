"""What a finer mesh would gain, against closed forms of a pure inertia."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.hamiltonian import hamiltonian_gaps
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.mesh import uniform
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_problem


def solved(intervals: int, *overrides: str, duration: str = '"free"') -> Solution:
    """Return the solution of the hinge's quarter turn on an even mesh whose intervals' ends are fixed."""
    problem = body_problem(HINGE, QUARTER_TURN + f"duration_s = {duration}\n", *overrides)
    guess = first_guess(problem, problem.start_pose())
    found = attempt(case_of(problem), guess, uniform(intervals), np.array([guess.duration_s]), "once")
    assert found is not None
    return found.solution


@pytest.mark.parametrize("scheme", ["radau-3", "radau-5"])
@pytest.mark.parametrize("intervals", [5, 15])
def test_an_effort_that_should_jump_inside_an_interval_loses_what_the_least_time_lacks(scheme, intervals):
    """In the quickest turn the effort jumps at half time: inside the middle interval if their number is odd."""
    solution = solved(intervals, 'objective.minimize="time"', f'mesh.scheme="{scheme}"')
    gaps, least = hamiltonian_gaps(solution), 2 * np.sqrt(HINGE_INERTIA * TURN / 4)
    assert gaps.sum() == pytest.approx(solution.objective - least, rel=0.15)
    assert gaps.argmax() == intervals // 2
    assert np.delete(gaps, intervals // 2).max() < 1e-6 * gaps.max()


def test_nothing_is_lost_where_the_effort_jumps_at_the_end_of_an_interval():
    solution = solved(6, 'objective.minimize="time"')
    assert abs(hamiltonian_gaps(solution)).sum() < 1e-8 * solution.objective


def test_a_kink_of_the_effort_inside_an_interval_loses_more_than_the_least_effort_on_a_finer_mesh_gains():
    """Squared effort with a limit below its free maximum of 1.26 N.m: kinks at two instants."""
    limited = ('objective.minimize="effort"', "limits.effort.motor=[-0.9, 0.9]")
    solution, finest = solved(9, *limited, duration="1.5"), solved(90, *limited, duration="1.5")
    gaps, lacks = hamiltonian_gaps(solution), solution.objective - finest.objective
    assert lacks < gaps.sum() < 1.5 * lacks
    assert np.count_nonzero(gaps > 1e-3 * gaps.sum()) == 2
    assert hamiltonian_gaps(finest).sum() < 1e-2 * gaps.sum()


def test_a_smooth_effort_within_its_limits_loses_nothing():
    """Without active limits the least effort is linear in time."""
    solution = solved(5, 'objective.minimize="effort"', duration="1.5")
    assert abs(hamiltonian_gaps(solution)).sum() < 1e-9 * solution.objective
