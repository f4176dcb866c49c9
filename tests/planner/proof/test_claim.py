"""Claims and their records: allowances, ranges over several boxes, and findings at either end."""

import math

import pytest

from linkplan.planner.limits.efforts import share_of
from linkplan.planner.proof.claim import Claim, Record, finding_of_claim, undecided_reason
from linkplan.planner.proof.taylor import Verdict


def claim(low: float = -2.0, high: float = 5.0, slack: tuple[float, float] = (0.25, 0.5), per_unit: float = 1.0) -> Claim:
    return Claim(name="q", unit="N", bounds=(low, high), slack=slack, values=lambda _: [], per_unit=per_unit)


def bound(least: float, greatest: float, answer: bool | None = True) -> Verdict:
    return Verdict(answer=answer, least=least, greatest=greatest)


def test_a_claim_s_marks_are_its_limits_moved_outwards_by_its_allowances():
    assert claim().marks == (-2.25, 5.5)
    assert share_of((-2.0, 5.0), 0.1) == pytest.approx((0.2, 0.5))
    assert share_of((0.0, 5.0), 0.1) == pytest.approx((0.5, 0.5))


def test_a_record_has_the_widest_range_and_its_instants():
    record = Record()
    for k, (least, greatest) in enumerate([(0.0, 1.0), (0.5, 3.0), (-1.0, 2.0), (0.1, 0.2)]):
        record.add(bound(least, greatest), float(k))
    assert (record.least, record.least_at, record.greatest, record.greatest_at) == (-1.0, 2.0, 3.0, 1.0)


@pytest.mark.parametrize(
    ("least", "greatest", "end", "mark", "margin", "when"),
    [(-1.0, 5.2, 5.2, 5.5, 0.3, 7.0), (-2.0, 5.2, -2.0, -2.25, 0.25, 3.0), (-2.25, 0.0, -2.25, -2.25, 0.0, 3.0)],
)
def test_a_proved_claim_is_told_at_the_end_that_is_nearer_to_its_mark(least, greatest, end, mark, margin, when):
    record = Record(least=least, least_at=3.0, greatest=greatest, greatest_at=7.0, boxes=4)
    found = finding_of_claim(claim(per_unit=10.0), record)
    assert (found.answer, found.boxes, found.time_s, found.reason) == ("proved", 4, when, "")
    assert (found.bound, found.mark, found.margin) == pytest.approx((10 * end, 10 * mark, 10 * margin))


@pytest.mark.parametrize(
    ("least", "greatest", "value", "mark"), [(5.75, 6.0, 5.75, 5.5), (-3.0, -2.5, -2.5, -2.25), (-9.0, -8.0, -8.0, -2.25)]
)
def test_a_refuted_claim_is_told_by_the_value_that_is_surely_beyond(least, greatest, value, mark):
    record = Record(refuted=bound(least, greatest, False), refuted_at=0.125)
    found = finding_of_claim(claim(per_unit=2.0), record)
    assert (found.answer, found.time_s) == ("refuted", 0.125)
    assert (found.bound, found.mark, found.margin) == pytest.approx((2 * value, 2 * mark, -2 * abs(value - mark)))
    assert found.reason == f"{2 * value:g} N at t = 0.125 s, beyond {2 * mark:g}"


def test_undecided_boxes_are_counted():
    assert undecided_reason([(0.25, 0.5)]) == "not decided between t = 0.25 s and 0.5 s"
    assert undecided_reason([(0.25, 0.5), (1, 2), (3, 4)]).endswith("and in 2 more boxes")
    assert undecided_reason([(0.25, 0.5), (1, 2)]).endswith("and in 1 more boxes")
    assert finding_of_claim(claim(), Record(undecided=[(0.25, 0.5)], least=0.0, greatest=math.pi)).answer == "undecided"
