"""Programs of a differential equation: the start that a solver gets, and the curves of its answer."""

import time
from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.transcription.collocation import Transcribed, curves_of, renumbered_with
from tests.support.first_order import NAN, FirstOrder

LIMITS = np.array([[-2.0, 6.0], [-10.0, 4.0]])
DURATION_S = 3.0


def transcribed(
    efforts: tuple[float, float] = (1.0, 1.0), name: str = "radau-3", *, least_limit: bool = False
) -> Transcribed:
    """Return the program of x' = u_0 + u_1 on three intervals, from a straight line."""
    problem = FirstOrder(
        rate=lambda x, u, t: [u[0] + u[1]], start=[1.0], goal=[NAN], effort_limit=LIMITS, duration_s=DURATION_S,  # noqa: ARG005
        running_cost=lambda x, u, t: u[0] ** 2 + u[1] ** 2, way=[[1.0], [7.0]], effort=efforts,  # noqa: ARG005
    )  # fmt: skip
    return problem.transcribed(3, name, least_limit=least_limit)


@pytest.mark.parametrize(
    ("given", "started"), [((1.0, 1.0), (1.0, 1.0)), ((9.0, 9.0), (5.8, 3.65)), ((-9.0, -12.0), (-1.8, -9.65))]
)
def test_a_start_keeps_a_fortieth_of_the_range_from_the_limits(given, started):
    program = transcribed(given)
    effort = program.start[program.program.layout.effort()] * program.units.effort
    assert effort == pytest.approx(np.broadcast_to(started, effort.shape))


@pytest.mark.parametrize(("given", "factor"), [((3.0, 1.0), 0.5), ((-1.0, 8.0), 0.8), ((0.0, -20.0), 2.0)])
def test_the_search_for_the_least_limits_starts_a_tenth_above_what_the_guess_needs(given, factor):
    """Of limits of 6 and 10, the larger ones of each effort."""
    program = transcribed(given, least_limit=True)
    layout = program.program.layout
    assert program.start[layout.extra()] == pytest.approx([1.1 * factor])
    effort = program.start[layout.effort()] * program.units.effort
    assert effort == pytest.approx(np.broadcast_to(given, effort.shape))


@pytest.mark.parametrize("name", ["trapezoid", "hermite-simpson", "radau-3", "gauss-2"])
def test_the_curves_of_a_straight_line_are_the_line(name):
    program = transcribed(name=name)
    curves = curves_of(program, program.start, LIMITS)
    assert curves.breaks_s == pytest.approx([0.0, 1.0, 2.0, 3.0])
    degree = len(curves.state) - 1
    line = 1.0 + 2.0 * (np.arange(3)[None, :] + np.arange(degree + 1)[:, None] / degree)
    assert curves.state[:, :, 0] == pytest.approx(line)
    assert curves.effort == pytest.approx(np.ones_like(curves.effort))


def test_efforts_that_a_solver_left_beyond_their_limits_are_inside_them_but_for_rounding():
    program = transcribed()
    effort, x = program.program.layout.effort(), np.array(program.start)
    for end, beyond in ((0, 1 + 1e-8), (1, 1 + 1e-8)):
        x[effort] = beyond * LIMITS[:, end] / program.units.effort
        found = curves_of(program, x, LIMITS).effort
        assert found == pytest.approx(np.broadcast_to(LIMITS[:, end], found.shape), rel=1e-13)
        assert np.all((found > LIMITS[:, 0]) & (found < LIMITS[:, 1]))


def test_building_takes_a_part_of_the_time_that_passes():
    begin = time.perf_counter()
    program = transcribed()
    again = renumbered_with(program, program.formulation, program.start)
    passed = time.perf_counter() - begin
    assert 0 < program.build_s < passed
    assert 0 < again.build_s < passed


def test_a_program_with_other_numbers_has_the_start_within_its_new_limits():
    """Limits of a half: efforts of 1 stay, efforts of 5.8 and 3.65 do not."""
    program = transcribed((9.0, 9.0))
    narrower = replace(program.formulation, effort=0.5 * LIMITS)
    again = renumbered_with(program, narrower, program.start)
    effort = again.start[again.program.layout.effort()] * again.units.effort
    assert effort == pytest.approx(np.broadcast_to([3.0, 2.0], effort.shape))
    assert again.upper[again.program.layout.effort()] * again.units.effort == pytest.approx(
        np.broadcast_to([3.0, 2.0], effort.shape)
    )
