"""`linkplan.experiment`: the same study from Python."""

import numpy as np
import pytest

import linkplan


@pytest.fixture(scope="module")
def plan():
    knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    tracking = {"kp": 200.0, "kd": 20.0, "duration_s": 0.01}
    problem = linkplan.Problem.reach(
        knee, start_deg={"O": -49.07}, goal_deg={"O": 56.27}, duration_s=0.16, tracking=tracking
    )
    return linkplan.plan(problem).require()


def test_an_experiment_is_a_table_columns_and_runs_again(plan):
    tried = linkplan.experiment(plan, ["pd", "lqr"], samples=4, imperfections={"delay_periods": [0.5, 2.0]})
    assert "4 machines" in str(tried)
    assert set(tried.results["tracker"]) == {"pd", "lqr"}
    assert [name for name in tried.results if name.startswith("imperfection.")] == ["imperfection.delay_periods"]
    run = tried.replay("lqr", 2)
    row = (tried.results["sample"] == 2) & (tried.results["tracker"] == "lqr")
    assert np.degrees(np.sqrt(np.mean(run.error**2))) == pytest.approx(tried.results["rms_error_deg"][row][0])
    assert tried.to_dict()["asked"]["settings"]["samples"] == 4


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"trackers": "pd"}, "a list of names"),
        ({"trackers": ["pid"]}, "unknown tracker 'pid'"),
        ({"imperfections": {"dealy_periods": 1}}, "did you mean 'delay_periods'"),
        ({"samples": 1.5}, "samples is a whole number"),
    ],
)
def test_what_makes_no_sense_is_refused(plan, asked, said):
    with pytest.raises(linkplan.LinkplanError, match=said):
        linkplan.experiment(plan, **asked)
