"""No more digits than are known."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from linkplan.studies.output.plan_blocks import figure, objective_digits, objective_unit, plan_blocks, radius_figure
from linkplan.studies.output.text import text_of
from tests.support.plans import optimal, problem_of


@pytest.mark.parametrize(("error_deg", "digits"), [(1e-9, 8), (1e-4, 6), (1e-2, 4), (5.0, 3)])
def test_a_plan_s_figures_have_the_digits_that_its_integration_leaves_of_its_motion(error_deg, digits):
    plan = optimal("knee-reach")  # over 105.34 deg
    worse = replace(plan, certificate=structs.replace(plan.certificate, integration_error_deg=error_deg))
    assert objective_digits(worse) == digits
    said = next(line for line in text_of(plan_blocks(worse)).splitlines() if line.startswith("objective")).split()[2]
    assert said == f"{plan.objective:.{digits}g}"


def test_errors_have_two_digits_and_rounding_none():
    assert figure(1.2345e-6, 2) == "1.2e-06"
    assert figure(3e-17, 2) == "< 1e-14"
    assert figure(0.0, 2) == "0"
    assert figure(float(np.float64(0.25)), 2) == "0.25"


def test_every_effort_and_limit_has_its_unit():
    lines = [line for line in text_of(plan_blocks(optimal("knee-reach"))).splitlines() if line.startswith("effort act_O")]
    assert len(lines) == 1
    assert lines[0].count("N.m") == 2


@pytest.mark.parametrize(
    ("radius", "said"),
    [(0.97936, "0.9794"), (1 - 2.31e-5, "1-2.3e-05"), (1 + 4e-7, "1+4.0e-07"), (9.864, "9.864"), (1.0, "1")],
)
def test_a_pole_next_to_the_unit_circle_is_said_by_its_distance_from_it(radius, said):
    assert radius_figure(radius) == said


@pytest.mark.parametrize(
    ("name", "overrides", "unit"),
    [
        ("knee-reach", [], " N2 m2 s"),
        ("knee-linear-reach", [], " N2 s"),
        ("knee-linear-reach", ["objective.minimize=effort_rate"], " N2 / s"),
        ("knee-sine", [], " rad2 s"),
        ("knee-sprint", [], " s"),
        ("knee-reach", ["objective.minimize={ time = 1.0, effort = 1e-5 }", "motion.duration_s=free"], ""),
    ],
)
def test_an_objective_has_the_unit_of_what_its_actuators_give(name, overrides, unit):
    assert objective_unit(problem_of(name, *overrides)) == unit
