"""What the bench of rounding changes and counts."""

from tests.bench.record import changed
from tests.bench.rounding import unlike


def test_every_decimal_number_is_changed_by_its_share_and_equal_ones_remain_equal():
    model = '<mujoco><option timestep="0.002"/><geom contype="1" size="0.1 -2.5e-3"/></mujoco>'
    tables = {"mechanism": {"model": model}, "motion": {"start_deg": {"q": 30.5}, "goal_deg": {"q": 30.5}, "kind": "reach"}}
    after = changed(tables, 1e-12)
    assert after["motion"]["start_deg"] == after["motion"]["goal_deg"]
    assert 0 < abs(after["motion"]["start_deg"]["q"] / 30.5 - 1) < 1.1e-12
    assert after["motion"]["kind"] == "reach"
    assert 'contype="1"' in after["mechanism"]["model"]
    for number in ("0.002", "0.1 ", "-2.5e-3"):
        assert number in model
        assert f'"{number}"' not in after["mechanism"]["model"]
    assert changed(tables, 0.0) == tables


def test_an_answer_is_unlike_another_by_its_status_or_by_more_than_a_millionth():
    before = {("fourbar", "1"): {"status": "optimal", "objective": 1.0}}
    assert not unlike(before, {("fourbar", "1"): {"status": "optimal", "objective": 1.0 + 5e-7}})
    assert len(unlike(before, {("fourbar", "1"): {"status": "optimal", "objective": 1.0 + 5e-6}})) == 1
    assert len(unlike(before, {("fourbar", "1"): {"status": "failed", "objective": None}})) == 2
