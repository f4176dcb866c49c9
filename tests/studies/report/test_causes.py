"""Bar charts of what errors are made of and owe to what: every bar is the record's figure."""

import msgspec
import pytest

from linkplan.studies.output.document import Bars
from linkplan.studies.variations.decompose.decomposition import Decomposition
from linkplan.studies.variations.decompose.decomposition_blocks import decomposition_charts
from linkplan.studies.variations.experiment.sensitivity import Sensitivity
from linkplan.studies.variations.experiment.sensitivity_blocks import sensitivity_charts

PARTS = {"plan": "discretisation of the plan", "sampling": "sampling and delay", "model": "model error: masses, lengths"}
SHARES = {"rms_error": 0.5, "parts": {"plan": 0.1, "sampling": -0.05, "model": 0.45}}
DECOMPOSED = msgspec.convert(
    {
        "decomposition": "reach",
        "machines": 4,
        "seed": 0,
        "imperfections": {},
        "control_period_s": 1e-3,
        "delay_periods": 0.0,
        "timestep_s": 1e-3,
        "duration_s": 0.2,
        "parts": PARTS,
        "trackers": {
            "lqr": {
                "machines": 4,
                "failures": {},
                "deg": {**SHARES, "parts_of_joints": {}, "rms_of_increment": {}, "rms_error_on_rung": {}},
            }
        },
    },
    Decomposition,
)


def record(design: str, effects: dict, middle: float = 0.3) -> Sensitivity:
    """Return a sensitivity of one tracker and metric, its imperfections in the order of their importance."""
    one = {"middle": middle, "left_out": 0, "ranking": list(effects), "effects": effects}
    said = {
        "design": design,
        "measure": "what it is",
        "groups": 5,
        "group_size": 3,
        "imperfections": {label: {"unit": "N.m", "range": [0.0, 2.0]} for label in effects},
        "metrics": {"rms_error_deg": {"text": "rms error", "unit": "deg", "metric_unit": "deg"}},
        "trackers": {"lqr": {"rms_error_deg": one}},
    }
    return msgspec.convert(said, Sensitivity)


def chart(said: Sensitivity) -> Bars:
    (found,) = sensitivity_charts(said, "rms_error_deg")
    return found


def test_each_part_of_an_error_begins_where_the_one_before_ends_and_the_last_at_the_whole():
    (found,) = decomposition_charts(DECOMPOSED)
    parts = [row.spans[0] for row in found.rows[:-1]]
    assert [span.end - span.start for span in parts] == pytest.approx([0.1, -0.05, 0.45])
    assert [span.start for span in parts[1:]] == [span.end for span in parts[:-1]]
    assert parts[-1].end == pytest.approx(found.rows[-1].spans[0].end) == pytest.approx(0.5)
    assert found.axis.unit == "deg"
    assert [row.label for row in found.rows] == [
        "discretisation of the plan",
        "sampling and delay",
        "model error",
        "rms error",
    ]


def test_one_at_a_time_bars_go_from_the_middle_to_what_each_end_makes():
    found = chart(
        record("one-at-a-time", {"friction": {"importance": 0.4, "interval95": [0.4, 0.4], "at_low": 0.2, "at_high": 0.6}})
    )
    (row,) = found.rows
    assert found.line == 0.3
    assert [(span.start, span.end) for span in row.spans] == [(0.3, 0.2), (0.3, 0.6)]
    assert row.label == "friction, 0 to 2 N.m"


def test_an_end_at_which_the_figure_is_lost_is_said_and_not_drawn():
    found = chart(
        record("one-at-a-time", {"delay": {"importance": None, "interval95": [None, None], "at_low": 0.2, "at_high": None}})
    )
    (row,) = found.rows
    assert [span.name for span in row.spans] == ["at the low end"]
    assert row.note == "lost at the high end"


def test_morris_bars_together_are_the_mean_size_and_their_difference_the_mean():
    found = chart(record("morris", {"mass": {"importance": 0.4, "interval95": [0.3, 0.5], "mean": -0.1, "spread": 0.2}}))
    raises, lowers = (span.end for span in found.rows[0].spans)
    assert raises - lowers == pytest.approx(0.4)
    assert raises + lowers == pytest.approx(-0.1)
    assert found.rows[0].note == "0.4 ± 0.1"


def test_sobol_bars_are_shares_in_per_cent_with_their_intervals():
    effect = {"importance": 0.6, "interval95": [0.5, 0.7], "first_order": 0.4, "first_order_half": 0.15}
    found = chart(record("sobol", {"mass": effect}))
    total, first = found.rows[0].spans
    assert (total.end, total.low, total.high) == pytest.approx((60, 50, 70))
    assert (first.end, first.low, first.high) == pytest.approx((40, 25, 55))
    assert found.axis.unit == "%"
