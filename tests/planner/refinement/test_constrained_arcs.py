"""Intervals along limits, and durations at theirs, read from a program of a hinge at unknowns that a test gives."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.refinement.constrained_arcs import arc_ends, find_constrained_paths, own_arcs, path_arcs
from linkplan.planner.refinement.switches import at_bounds
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import uniform
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem

# Power of the hinge's motor [W].
LOW, HIGH = -2.0, 4.0
POWER = f"limits.power_w.motor=[{LOW}, {HIGH}]"


def program_of(*overrides: str) -> Transcribed:
    """Return the program of a hinge's quarter turn on four intervals."""
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 4.0\n", *overrides)
    return case_of(problem).transcribe(first_guess(problem, problem.start_pose()), uniform(4), np.array([4.0]))


def unknowns(transcribed: Transcribed, speed, power=0.0, slope=(0.0, 0.0, 0.0, 0.0)) -> np.ndarray:
    """Return unknowns with a speed (5,) at the breaks, an acceleration from -slope to slope and a power [W] (4,)."""
    layout, x = transcribed.program.layout, np.array(transcribed.start)
    x[layout.states()[:, 1]] = speed
    x[layout.acceleration()[:, :, 0]] = np.outer(slope, 2 * np.array(transcribed.scheme.nodes) - 1)
    units = transcribed.units
    x[layout.effort()[:, :, 0]] = (power / (units.effort[0] * units.state[1] * np.array(speed)[:-1]))[:, None]
    return x


def test_an_interval_is_an_arc_where_all_of_its_coefficients_are_at_one_limit():
    transcribed = program_of("limits.speed_deg_s.J=[-20.0, 40.0]")
    ((low, high),) = transcribed.formulation.own["speed"]
    x = unknowns(transcribed, [high, high, low, 0.1, 0.1], slope=[0.0, 1.0, 0.0, 0.0])
    assert own_arcs(transcribed, x, ("speed",)).ravel().tolist() == [1, 0, -1, 0]
    assert own_arcs(transcribed, x, ("motor",)).shape == (4, 0)


def test_an_interval_is_an_arc_of_a_path_limit_where_all_of_its_nodes_are_at_one_limit():
    transcribed = program_of(POWER)
    x = unknowns(transcribed, np.ones(5), np.array([HIGH, HIGH, LOW, 0.0]), slope=[0.0, 1.0, 0.0, 0.0])
    assert path_arcs(transcribed, x).ravel().tolist() == [1, 0, -1, 0]


def test_the_positive_power_of_least_work_is_on_no_arc_where_it_is_the_power():
    transcribed = program_of("objective.minimize=work")
    assert "work" in transcribed.program.interval.node_kinds
    x = unknowns(transcribed, np.ones(5), np.array([HIGH, HIGH, LOW, 0.0]))
    assert not path_arcs(transcribed, x).any()


def test_arcs_along_a_limit_on_the_size_of_a_jerk_end_where_it_reverses_and_are_not_held():
    """The limit on power stands in for that on a jerk; the slopes of the acceleration are too small to change it."""
    transcribed = program_of(POWER)
    rows = replace(transcribed.formulation.rows, jerk_path=(0,))
    transcribed = replace(transcribed, formulation=replace(transcribed.formulation, rows=rows))
    x = unknowns(transcribed, np.ones(5), np.array([HIGH, 0.0, HIGH, HIGH]), slope=np.array([1, 1, 1, -1]) * 1e-9)
    assert own_arcs(transcribed, x, ("jerk",)).ravel().tolist() == [1, 0, 1, -1]
    assert own_arcs(transcribed, x, ("speed",)).size == 0
    assert not path_arcs(transcribed, x).any()


def test_a_path_equation_is_no_arc():
    transcribed = program_of(POWER)
    fixed = replace(transcribed.formulation, path=transcribed.formulation.path[..., 1:].repeat(2, axis=-1))
    x = unknowns(transcribed, np.ones(5), np.full(4, HIGH))
    assert path_arcs(transcribed, x).any()
    assert not path_arcs(replace(transcribed, formulation=fixed), x).any()


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


@pytest.mark.parametrize(("duration", "at_bound"), [(1.0, True), (3.0, False), (9.0, True)])
def test_a_duration_as_short_or_as_long_as_it_may_be_is_at_its_bound(duration, at_bound):
    transcribed = program_of()
    place = transcribed.program.layout.durations()
    lower, upper, x = (np.array(values) for values in (transcribed.lower, transcribed.upper, transcribed.start))
    lower[place], upper[place], x[place] = 1.0, 9.0, duration
    transcribed = replace(transcribed, lower=lower, upper=upper)
    result = {"objective": 0.0, "converged": True, "status": "", "iterations": 0, "build_s": 0.0, "solve_s": 0.0}
    assert at_bounds(Solution(transcribed=transcribed, x=x, **result)) is at_bound
