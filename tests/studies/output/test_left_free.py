"""What a plan's summary says of a least time whose speeds or pin forces have no limits."""

from linkplan.planner.problem.problem import load_problem
from linkplan.studies.output.plan_blocks import facts
from tests.support.plans import planned


def row(name: str, *settings: str) -> str | None:
    return dict(facts(planned(name, *settings))).get("left free")


def test_a_least_time_names_its_peak_speed_and_pin_force_without_limits():
    assert row("knee-sprint") == (
        "O moves at up to 1715 deg/s, no speed limit is set; pin B carries up to 2.812 N, no limit is set"
    )


def test_what_has_a_limit_and_what_is_no_least_time_is_left_out():
    assert load_problem("knee-reach").objective.name == "effort"
    assert row("knee-reach") is None
    limited = ("limits.speed_deg_s.O=2000", "limits.closure_force.B=10")
    assert row("knee-sprint", *limited) is None
