"""`linkplan.experiment`: the same study from Python."""

import inspect

import numpy as np
import pytest

import linkplan
from linkplan.studies.cli.command_line import build_parser


@pytest.fixture(scope="module")
def plan():
    knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    tracking = {"kp": 200.0, "kd": 20.0, "duration_s": 0.01}
    problem = linkplan.Problem.reach(
        knee, start_deg={"O": -49.07}, goal_deg={"O": 56.27}, duration_s=0.16, tracking=tracking
    )
    return linkplan.plan(problem).require()


def test_trackers_are_by_default_those_of_the_command():
    """Python ran all seven, with MPC."""
    asked = build_parser().parse_args(["experiment", "knee-reach"])
    assert inspect.signature(linkplan.experiment).parameters["trackers"].default == asked.trackers


def test_an_experiment_is_a_table_columns_and_runs_again(plan):
    tried = linkplan.experiment(plan, ["pd", "lqr"], samples=4, imperfections={"delay_periods": [0.5, 2.0]})
    assert "4 machines" in str(tried)
    assert set(tried.results["tracker"]) == {"pd", "lqr"}
    assert [name for name in tried.results if name.startswith("imperfection.")] == ["imperfection.delay_periods"]
    run = tried.replay("lqr", 2)
    row = (tried.results["sample"] == 2) & (tried.results["tracker"] == "lqr")
    assert np.degrees(np.sqrt(np.mean(run.error_rad**2))) == pytest.approx(tried.results["rms_error_deg"][row][0])
    assert tried.to_dict()["asked"]["settings"]["samples"] == 4


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"trackers": "pd"}, "a list of names"),
        ({"imperfections": {"dealy_periods": 1}}, "did you mean 'delay_periods'"),
    ],
)
def test_what_makes_no_sense_is_refused(plan, asked, said):
    with pytest.raises(linkplan.LinkplanError, match=said):
        linkplan.experiment(plan, **asked)


class Held:
    """A law that holds the first position by a stiff spring: as a class, an object, or by a function of the reference."""

    name = "held"

    def __init__(self, reference):
        self.reference = reference

    def effort(self, k, position, velocity):
        del velocity
        return self.reference.effort[k] + 200.0 * (self.reference.position_rad[k] - position)


def test_an_experiment_takes_classes_objects_and_functions(plan):
    given = {"delay_periods": [0.5, 2.0]}
    by_class = linkplan.experiment(plan, [Held, "pd"], samples=3, imperfections=given)
    by_function = linkplan.experiment(plan, [lambda reference: Held(reference)], samples=3, imperfections=given)
    assert list(by_class.results["tracker"][:2]) == ["own:held", "pd"]
    ours = by_class.results["rms_error_deg"][by_class.results["tracker"] == "own:held"]
    np.testing.assert_allclose(by_function.results["rms_error_deg"], ours, rtol=1e-12)
    run = by_class.replay("own:held", 1)
    assert np.degrees(np.sqrt(np.mean(run.error_rad**2))) == pytest.approx(ours[1])


def test_an_experiment_with_an_object_goes_on_and_tells_another_object(plan, tmp_path):
    given = {"samples": 2, "imperfections": {"delay_periods": [0.5, 2.0]}, "folder": tmp_path / "tried"}
    first = linkplan.experiment(plan, [Held], **given)
    again = linkplan.experiment(plan, [Held], **given)
    np.testing.assert_array_equal(first.results["rms_error_deg"], again.results["rms_error_deg"])

    class Other(Held):
        pass

    with pytest.raises(linkplan.LinkplanError, match="another experiment"):
        linkplan.experiment(plan, [Other], **given)


def test_what_no_other_process_can_be_given_is_refused(plan):
    with pytest.raises(linkplan.LinkplanError, match="cannot be sent to other processes"):
        linkplan.experiment(plan, [lambda reference: Held(reference)], workers=2)
