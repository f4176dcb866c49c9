"""A batch of motions in phases."""

import numpy as np
import pytest

import linkplan
from tests.support.phases import HIGHEST, ROTOR, SOLE


def test_a_batch_over_the_ratio_of_a_gear_finds_the_highest_jump(tmp_path):
    push = linkplan.Phase("push", on=["toe"], start_m={"leg": 0.0})
    asked = linkplan.Problem.phases(ROTOR, [push], contacts=SOLE, objective=HIGHEST)
    ratios = [235.0, 240.553752199, 246.0]  # m g/T + sqrt((m g/T)^2 + m/J)
    found = linkplan.batch({"problem": asked, "sweep": {"parameters.rotor.gear": ratios}}, tmp_path / "ratios")
    assert found.passed
    rises = [plan.objective - 0.3 for plan in found.plans]
    assert np.argmax(rises) == 1
    assert rises[1] == pytest.approx(1.906915158, abs=1e-8)
    assert (tmp_path / "ratios/2/1-push/trajectory.npz").is_file()
    assert [row.objective_unit for row in found.rows] == ["m"] * 3
    assert linkplan.read_plan(tmp_path / "ratios/2").objective == found.plans[1].objective


def test_a_setting_names_a_key_of_a_phase():
    push = linkplan.Phase("push", on=["toe"], start_m={"leg": 0.0})
    asked = linkplan.Problem.phases(ROTOR, [push], contacts=SOLE, objective=HIGHEST)
    assert asked.replace("phases.push.max_duration_s", 0.2).phases[0].max_duration_s == 0.2
    with pytest.raises(linkplan.LinkplanError, match="unknown phase 'pull'"):
        asked.replace("phases.pull.max_duration_s", 0.2)
