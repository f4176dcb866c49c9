"""Values that files may hold, on both sides of their bounds, and the sentences that refuse others."""

from typing import Literal

import msgspec
import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.keys import kinds
from linkplan.planner.problem.keys.imperfections import QUANTITIES
from linkplan.planner.problem.keys.key_table import _range, key_table
from linkplan.planner.problem.keys.motion import MotionSection
from linkplan.planner.problem.keys.reading import checked, fault, read, words
from linkplan.planner.problem.keys.section import Section, by_joint, key, required

BOUNDS = [
    (kinds.Number, 1e15, 1.01e15),
    (kinds.Number, -1e15, -1.01e15),
    (kinds.Angle, 36000.0, 36001.0),
    (kinds.Angle, -36000.0, -36001.0),
    (kinds.Delay, 1000.0, 1000.5),
    (kinds.LqrError, 1e-9, 0.9e-9),
    (kinds.LqrError, 1e9, 1.1e9),
    (kinds.Tolerance, 0.01, 0.011),
    (kinds.Mass, 1e12, 1.1e12),
    (kinds.Moment, 0.0, -1e-9),
    (kinds.Margin, 0.999, 1.0),
    (kinds.Turns, 100, 101),
    (kinds.Intervals, 20_000, 20_001),
    (kinds.Corners, [[0.0, 0.0, float(k)] for k in range(200)], [[0.0, 0.0, float(k)] for k in range(201)]),
    (kinds.Breaks, [k / 20_000 for k in range(20_001)], [k / 20_001 for k in range(20_002)]),
    (kinds.Breaks, [0.0, 0.5, 1.0], [0.0, 1.0]),
]

# Quantities without a natural bound are at most a billion of their unit.
BILLION = 1e9


@pytest.mark.parametrize(("kind", "legal", "beyond"), BOUNDS)
def test_the_last_legal_value_is_taken_and_the_next_is_refused(kind, legal, beyond):
    assert read(kind, legal, "here") == legal
    with pytest.raises(ProblemError, match=r"^here"):
        read(kind, beyond, "here")


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("motion.duration_s", -1.0, "motion.duration_s must be a positive number, got -1.0"),
        ("limits.reserve", 1.5, "limits.reserve must be from 0 to below 1, got 1.5"),
        ("limits.reserve", -0.5, "limits.reserve must be a number of at least 0, got -0.5"),
        ("limits.reserve", "much", "limits.reserve must be a number of at least 0, got 'much'"),
        (
            "tracking.delay_periods",
            10**20,
            "tracking.delay_periods must be a number of at least 0 below 1e+15, got one of 21 digits",
        ),
        ("tracking.delay_periods", 2000, "tracking.delay_periods must be from 0 to 1000, got 2000"),
        ("mesh.intervals", 1, "mesh.intervals must be a whole number from 2 to 20000, got 1"),
        ("mesh.refine", "bth", "unknown mesh.refine 'bth' (did you mean 'both'?); legal: both, intervals, degree"),
        ("motion.duration_s", "soon", "motion.duration_s must be a positive number or \"free\", got 'soon'"),
        ("motion.kind", 5, "motion.kind must be one of reach, hold, periodic, track, follow, got 5"),
        ("motion.start_deg", {"J": "x"}, "motion.start_deg of joint J must be a number, got 'x'"),
        ("limits.effort", {"m": [1.0, "x"]}, "limits.effort.m must be a number, got 'x'"),
        ("limits.effort", {"m": [1.0, 2.0, 3.0]}, "limits.effort.m must be [low, high], got 3 of them"),
        ("motion.start_deg", 5, "motion.start_deg must be a table of joint = value, got 5"),
        ("limits.closure_force", {"B": -1}, "limits.closure_force.B must be a positive number, got -1"),
    ],
)
def test_a_value_that_is_not_legal_is_refused_by_its_key_what_is_legal_and_itself(key, value, sentence):
    with pytest.raises(ProblemError) as refused:
        checked(key, value)
    assert "\n" not in str(refused.value)
    assert str(refused.value) == sentence


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (Literal["one"], '"one"'),
        (Literal["one", "two"], "one of one, two"),
        (kinds.Positive, "a positive number"),
        (kinds.Turns, "a whole number from -100 to 100"),
        (kinds.Positive | Literal["free"], 'a positive number or "free"'),
    ],
)
def test_a_type_in_words(kind, said):
    assert words(kind) == said


def test_a_motion_has_at_most_a_thousand_waypoints():
    table = {"kind": "reach", "waypoints": [{"at_deg": {"J": 1.0}}] * 1000}
    assert len(read(MotionSection, table, "motion").waypoints) == 1000
    with pytest.raises(ProblemError, match=r"must be a list of at most 1000 tables .*, got 1001 of them"):
        read(MotionSection, table | {"waypoints": [{"at_deg": {"J": 1.0}}] * 1001}, "motion")


def test_quantities_of_slides_and_of_rates_are_within_a_billion_of_their_unit():
    bounds = {name: (one.low, one.high) for name, one in QUANTITIES.items()}
    assert bounds["encoder_offset_m"] == (-BILLION, BILLION)
    assert bounds["encoder_offset_deg"] == (-360.0, 360.0)
    assert bounds["encoder_resolution_m"] == (0.0, BILLION)


def test_a_value_of_several_types_is_judged_by_the_one_that_it_resembles():
    either = kinds.Positive | Literal["free", "held"] | kinds.Interval
    assert fault(either, "fre", "here") == "unknown here 'fre' (did you mean 'free'?); legal: free, held"
    assert fault(either, -2.0, "here") == "here must be a positive number, got -2.0"
    assert fault(kinds.Positive | Literal["free"], "fre", "here") == "here must be a positive number or \"free\", got 'fre'"


@pytest.mark.parametrize(
    ("kind", "within"),
    [
        (kinds.Delay, "from 0 to 1000"),
        (kinds.Number, ""),
        (kinds.Positive | Literal["free"], ""),
        (kinds.Duration | Literal["free"], "from 1e-06 to 100000"),
    ],
)
def test_the_table_of_keys_has_the_ranges_that_a_user_may_choose_from(kind, within):
    assert _range(kind) == within


class Example(Section, frozen=True):
    """A section with a twin key."""

    name: str = required("the name")
    time_s: kinds.Positive = key("the time", "s", "1 s")
    speed_deg_s: kinds.Angles = by_joint("hinges' angles by second", "deg/s", "none", twin=(("by second", "per second"),))


def test_a_key_s_description_ends_with_its_unit_and_its_default():
    words = [kind.__metadata__[-1].description for kind in Example.__annotations__.values()]
    assert words[:2] == ["The name.", "The time [s]. Default: 1 s."]


def test_a_key_of_hinges_declares_its_twin_of_slides_in_metres():
    assert Example.__struct_fields__ == ("name", "time_s", "speed_deg_s", "speed_m_s")
    (row,) = (row for row in key_table(Example) if row.name == "speed_m_s")
    assert (row.unit, row.doc) == ("m/s", "slides' positions per second")
    assert msgspec.convert({"name": "it", "speed_m_s": {"S": 1e9}}, Example).speed_m_s == {"S": 1e9}
