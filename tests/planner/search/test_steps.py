"""The periodic step of a five-link walker with heel strike, against an independent collocation (parameters of RABBIT)."""

import numpy as np
import pytest

from linkplan.models.poses.joint_forces import closure_rows_along
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.search.phases import plan_phases
from tests.support.phases import SIMPLEST, step


def needed_friction(plan):
    one = plan.plans[0]
    at, mechanism = samples_of(one.problem, one.trajectory), one.problem.mechanism
    force = closure_rows_along(mechanism, at.q, at.v, at.a, at.u)[:, mechanism.closure_slice(0)]
    return float(np.max(np.abs(force[:, 0]) / force[:, 2]))


def test_a_step_costs_what_an_independent_collocation_says():
    plan = step(0.8, distance_m=0.5)
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(390.7905381708, rel=1e-9)
    assert plan.junctions[0].energy_lost_j == pytest.approx(25.7956, abs=1e-4)
    assert needed_friction(plan) == pytest.approx(0.366, abs=5e-4)
    assert plan.body.distance_m == pytest.approx(0.5, abs=1e-9)


def test_a_given_speed_of_travel_gives_the_same_step():
    assert step(0.8, speed_m_s=0.5 / 0.7).objective == pytest.approx(390.7905381708, rel=1e-8)


def test_on_slippery_ground_a_step_changes_and_stays_in_the_friction_cone():
    plan = step(0.3, distance_m=0.5)
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(392.53798, rel=1e-6)
    assert needed_friction(plan) == pytest.approx(0.3, abs=1e-6)
    assert "slips" in plan.verdict.sentence  # of the heel strike, whose impulse needs more


def test_the_simplest_walker_walks_down_its_slope_without_effort_as_printed():
    # Garcia, Chatterjee, Ruina & Coleman, J. Biomech. Eng. 120 (1998).
    angle, rate = 0.200310900544287, 0.199832473004977 * np.sqrt(9.81)
    tables = {
        "contacts": {"foot": {"site": "st_foot", "friction": 2.0}},
        "motion": {"repeat": True, "mirror": {"st": "sw"}, "distance_m": 2.0 * np.sin(angle)},
    }
    tables["mechanism"] = {"model": SIMPLEST, "independent": ["st", "sw"]}
    plan = plan_phases(PhasedProblem.from_tables("simplest", tables | {"phases": [{"name": "step", "on": ["foot"]}]}))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(0.0, abs=1e-12)
    first = plan.plans[0].trajectory
    assert abs(first.velocity_at(np.zeros(1))[0, 0]) == pytest.approx(rate, rel=1e-4)  # for feet without any mass
