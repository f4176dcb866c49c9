"""What a plan's summary says of a least time whose speeds or pin forces have no limits."""

from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.problem import load_problem
from linkplan.studies.output.plan_blocks import facts
from tests.support.plans import planned
from tests.support.virtual_cuts import virtual_cuts


def row(name: str, *settings: str) -> str | None:
    return dict(facts(planned(name, *settings))).get("left free")


def test_a_least_time_names_its_peak_speed_and_its_most_loaded_pin_without_limits():
    said = row("knee-sprint")
    plan = planned("knee-sprint")
    at = samples_of(plan.problem, plan.trajectory)
    pins = virtual_cuts(plan.problem.mechanism, at.q, at.v, at.a, at.u)
    assert pins["O"].max() > 100 * at.closure_forces.max()  # the crank carries the payload
    assert said == (
        "O moves at up to 1715 deg/s, no speed limit is set;"
        f" pin O carries up to {pins['O'].max():.4g} N, no limit on pin forces is set"
    )


def test_what_has_a_limit_and_what_is_no_least_time_is_left_out():
    assert load_problem("knee-reach").objective.name == "effort"
    assert row("knee-reach") is None
    limited = ("limits.speed_deg_s.O=2000", "limits.closure_force.B=10")
    assert row("knee-sprint", *limited) is None
