"""The start of a program from a guess: at every node it keeps closure, dynamics, and what limits' unknowns stand for."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.formulate import formulate
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import _start, choose_scales
from linkplan.planner.problem.problem import load_problem
from tests.support.tolerances_planner import ROWS

WORK = "objective.minimize=work"


@pytest.mark.parametrize(
    ("name", "overrides", "n_unknowns"),
    [
        ("five-bar-reach", [], 0),
        ("gripper-close", ["limits.power_w.pull=40"], 1),  # the cable's leverage
        ("five-bar-reach", ["limits.closure_force.E2=300"], 3),  # the components of a pin's force
        ("knee-reach", [WORK], 1),  # the positive power
        ("knee-sprint", [WORK, "limits.closure_force.B=3000"], 4),
    ],
)
def test_the_equations_of_a_node_hold_where_a_guess_starts_it(name, overrides, n_unknowns):
    problem = load_problem(name, overrides)
    guess = first_guess(problem, problem.start_pose())
    scales = choose_scales(problem, guess)
    formulation = formulate(problem, scales, enclosed=True)
    system, start = formulation.build_system(), _start(problem, guess, scales, formulation)
    time = guess.duration_s * np.array([0.2, 0.5, 0.9])
    acceleration, _, algebraic, effort = start.nodes(time)
    assert algebraic.shape[1] == len(problem.mechanism.dependent) + n_unknowns
    xi = np.hstack([start.states(time), acceleration, algebraic, effort / scales.effort])
    for node, theta in zip(xi, formulation.theta(time[None])[0], strict=True):
        rows = np.array(system.node(node, theta)).ravel()[: system.n_equations]
        assert np.abs(rows).max() < ROWS
