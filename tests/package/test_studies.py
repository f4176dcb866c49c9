"""The studies' functions: `check`, `track`, `compare`, `bode`, `tune`, `experiment`, and trackers of one's own."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from matplotlib.figure import Figure

import linkplan
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.controllers.trackers.pd import pd
from linkplan.models.errors import LinkplanError, ProblemError
from tests.support.refusals import assert_refused


@dataclass(frozen=True)
class Stiff:
    """PD about the needed effort, on a mechanism of one degree of freedom."""

    reference: object
    kp: float = 200.0
    kd: float = 1.0
    name: str = "stiff"

    def effort(self, k, position_rad, velocity_rad_s):
        reference = self.reference
        return (
            reference.effort[k]
            + self.kp * (reference.position_rad[k] - position_rad)
            + self.kd * (reference.velocity_rad_s[k] - velocity_rad_s)
        )


@dataclass(frozen=True)
class Idle:
    """A law that does nothing."""

    name: str = "idle"
    value: object = (0.0,)

    def effort(self, k, position_rad, velocity_rad_s):  # noqa: ARG002
        return self.value


@pytest.fixture(scope="module")
def problem():
    return linkplan.Problem.from_file("knee-reach", {"tracking.period_s": 1e-3, "tracking.kp": 200.0, "tracking.kd": 1.0})


@pytest.fixture(scope="module")
def plan(problem):
    return linkplan.plan(problem).require()


@pytest.fixture(scope="module")
def compared(plan):
    return linkplan.compare(plan, ["pd", "lqr", Stiff, Idle()])


def test_ones_own_tracker_runs_as_the_built_in_one_of_the_same_law(plan):
    mine = linkplan.track(plan, lambda reference: pd(plan.problem.mechanism, reference, 200.0, 1.0))
    known = linkplan.track(plan, "pd")
    assert np.array_equal(mine.runs["pd"].applied, known.runs["pd"].applied)
    assert known.to_dict()["trackers"]["pd"]["rms_error_deg"] > 1e-3


def test_trackers_of_ones_own_stand_beside_the_built_in_ones(compared):
    assert list(compared.runs) == list(compared.mismatched) == ["pd", "lqr", "stiff", "idle"]
    errors = {name: of["rms_error_deg"] for name, of in compared.to_dict()["trackers"].items()}
    assert errors["stiff"] < errors["pd"] < errors["idle"]
    assert "stiff" in str(compared)
    json.dumps(compared.to_dict(), allow_nan=False)


def test_a_run_has_positions_errors_and_efforts_by_name_as_a_plan_has(plan, compared):
    run, planned = compared.runs["lqr"], plan.sample(np.minimum(compared.runs["lqr"].time_s, plan.duration_s))
    assert list(run.position_deg) == list(planned.position_deg)
    assert run.reference_deg["O"][:100] == pytest.approx(planned.position_deg["O"][:100], abs=1e-9)
    assert run.error_deg["O"] == pytest.approx(run.reference_deg["O"] - run.position_deg["O"], abs=1e-9)
    assert np.abs(run.position_deg["C"][:100] - planned.position_deg["C"][:100]).max() < 2.0
    assert run.effort["act_O"] == pytest.approx(run.applied[:, 0])
    assert compared.mismatched["lqr"].speed_deg_s["O"] == pytest.approx(
        np.degrees(compared.mismatched["lqr"].velocity_rad_s[:, 0])
    )
    pytest.importorskip("pandas")
    assert list(run.to_frame()["O_deg"]) == pytest.approx(list(run.position_deg["O"]))


def test_every_table_of_a_result_is_a_pandas_table(compared):
    pytest.importorskip("pandas")
    frame = compared.to_frame()
    assert list(frame["tracker"]) == ["pd", "lqr", "stiff", "idle"]
    known = compared.to_dict()["trackers"]
    assert list(frame["rms error [deg]"]) == pytest.approx(
        [known[name]["rms_error_deg"] for name in frame["tracker"]], rel=1e-3
    )
    assert list(compared.to_frame(1).columns) != []
    loop = linkplan.bode("knee-reach", at_deg=[{"O": 0.0}], measure=False)
    margins = loop.to_frame("Margins")
    assert margins["phase margin [deg]"][0] == pytest.approx(loop.points[0].phase_margin_deg, rel=1e-3)
    assert_refused(lambda: loop.to_frame("Poles"), "unknown table 'Poles'; this result has 0 'Margins at every pose'")
    assert_refused(lambda: loop.to_frame(7), "unknown table 7")


def test_every_tracker_has_a_colour_of_its_own(compared, tmp_path):
    figure = compared.plot(tmp_path / "compared.png")
    assert isinstance(figure, Figure)
    assert (tmp_path / "compared.png").is_file()
    drawn = [line.get_color() for line in figure.axes[0].lines if line.get_label() in compared.runs]
    assert len(drawn) == len(set(drawn)) == 4


def test_a_tracker_object_is_taken_as_it_is(plan):
    run = linkplan.track(plan, Idle()).runs["idle"]
    assert np.all(run.commanded == 0.0)


def test_tracking_settings_stand_in_for_the_problems(plan):
    soft = linkplan.track(plan, "pd", tracking={"kp": 20.0}).to_dict()
    own = linkplan.track(plan, "pd").to_dict()
    assert soft["gains"]["kp"] == 20.0
    assert own["gains"]["kp"] == 200.0
    assert soft["trackers"]["pd"]["rms_error_deg"] > own["trackers"]["pd"]["rms_error_deg"]


def test_a_mismatch_is_named(plan):
    result = linkplan.track(plan, "lqr", mass_factor=1.2, delay_periods=1)
    assert "payload +20 %, 1 control period of delay" in str(result)
    assert "delay 1 period\n" in str(result)
    assert not linkplan.compare(plan, ["lqr"], mass_factor=1, delay_periods=0).mismatched


class Nameless:
    def effort(self, k, position_rad, velocity_rad_s):  # noqa: ARG002
        return [0.0]


@pytest.mark.parametrize(
    ("use", "words"),
    [
        (
            lambda plan: linkplan.track(plan, "smc"),
            "unknown tracker 'smc' (did you mean 'mpc'?); legal: pd, pd+ff, lqr, lqi, gs-pd+ff, ct",
        ),
        (
            lambda plan: linkplan.track(plan, 7),
            f"a tracker must be one of {', '.join(TRACKERS)}, an object with a name and effort",
        ),
        (lambda plan: linkplan.track(plan, lambda reference: None), "must return an object with a name"),  # noqa: ARG005
        (lambda plan: linkplan.track(plan, Nameless()), "a tracker's name must have at most 50 printable characters"),
        (lambda plan: linkplan.track(plan, Idle(value=[0.0, 0.0])), "shape (1,), got shape (2,)"),
        (lambda plan: linkplan.track(plan, Idle(value="much")), "tracker 'idle' must return one effort"),
        (lambda plan: linkplan.track(plan, mass_factor=0), "mass_factor must be a positive number, got 0"),
        (lambda plan: linkplan.track(plan, delay_periods=2000), "delay_periods must be from 0 to 1000, got 2000"),
        (lambda plan: linkplan.track(plan, tracking={"kp": "much"}), "tracking.kp must be a number of at least 0"),
        (lambda plan: linkplan.track(plan.problem.mechanism), "to track, give a Plan"),
        (lambda plan: linkplan.compare(plan, "lqr"), "trackers must be a list"),
        (lambda plan: linkplan.compare(plan, []), "got none"),
        (lambda plan: linkplan.compare(plan, ["lqr", "lqr"]), "trackers with different names, got lqr, lqr"),
    ],
)
def test_what_cannot_be_tracked_is_refused_in_one_sentence(plan, use, words):
    assert_refused(lambda: use(plan), words)


@pytest.mark.parametrize("subject", ["optimus-knee", "knee-reach"])
def test_a_check_has_findings_text_record_and_figure(subject, tmp_path):
    found = linkplan.check(subject, at_deg=[{"O": 10}])
    assert found.problems == ()
    assert found.to_dict()["points"][0]["q_deg"]["O"] == pytest.approx(10.0)
    assert str(found).startswith("optimus-knee: 1 degree of freedom")
    assert isinstance(found.plot(tmp_path / "knee.png"), Figure)
    json.dumps(found.to_dict(), allow_nan=False)


def test_a_result_without_tables_is_not_saved_as_parquet(tmp_path):
    with pytest.raises(LinkplanError, match=r"parquet applies to the tables of .*; a WholeCheck has no such table"):
        linkplan.check("five-bar").save(tmp_path / "checked", parquet=True)
    assert list(tmp_path.iterdir()) == []


def test_a_problem_that_cannot_be_planned_is_checked_all_the_same(tmp_path):
    text = linkplan.Problem.from_file("knee-reach").to_toml()
    (tmp_path / "bad.toml").write_text(text.replace("duration_s = 0.16", "duration_s = -1"), encoding="utf-8")
    assert_refused(lambda: linkplan.Problem.from_file(tmp_path / "bad.toml"), "duration_s", kind=ProblemError)
    found = linkplan.check(tmp_path / "bad.toml")
    assert found.problems == linkplan.check("optimus-knee").problems
    assert any("cannot be planned: motion.duration_s must be a positive number, got -1" in note for note in found.notes)


def test_a_check_names_what_is_wrong():
    assert any("is open by" in sentence for sentence in linkplan.check("optimus-knee-source").problems)


@pytest.mark.slow
def test_a_loops_response_is_measured_and_drawn(problem, tmp_path):
    told = []
    result = linkplan.bode(
        problem, tracking={"delay_periods": 0.5}, at_deg={"O": 10.0}, frequency_hz=(20.0, 100.0), progress=told.append
    )
    assert result.stable
    assert result.message.startswith(
        "stable at the pose: kp = 200 N.m/rad, kd = 1 N.m.s/rad sampled every 0.001 s with a delay of 0.5"
    )
    loop = result.to_dict()["points"][0]["loops"]["pd"]
    assert loop["measured"]["complementary"]["frequency_hz"] == pytest.approx([20.0, 100.0], rel=0.01)
    assert np.abs(loop["measured"]["complementary"]["less_predicted_db"]).max() < 0.1
    assert isinstance(result.plot(tmp_path / "bode.png"), Figure)
    assert all(word in str(result) for word in ("phase margin", "[deg]"))
    assert told


@pytest.mark.parametrize(
    ("use", "words"),
    [
        (lambda: linkplan.check(5), "a mechanism, a Problem, or the name or path of either, got 5"),
        (lambda: linkplan.check("optimus-knee", at_deg=[{"O": 120}]), "the pose O = 120 deg is beyond reach"),
        (lambda: linkplan.check("optimus-knee", at_deg=[{"A": 1}]), "a pose names independent joints (O); A follows"),
        (lambda: linkplan.check("optimus-knee", at_deg=[{"O": np.nan}]), "at_deg of joint O must be a number, got nan"),
        (lambda: linkplan.check("optimus-knee", at_deg=["3"]), "at_deg must be a list of poses"),
        (lambda: linkplan.check("optimus-knee", at_m=[{"O": 0.1}]), "use poses[0].at_deg, not at_m"),
        (lambda: linkplan.bode("optimus-knee", frequency_hz=[1, 6000]), "Nyquist"),
        (lambda: linkplan.tune("optimus-knee", bandwidth_hz=-5), "bandwidth_hz must be a positive number, got -5"),
        (
            lambda: linkplan.tune("five-bar", bandwidth_hz=5, tracker="lqr"),
            "one degree of freedom only, and 'five-bar' has 2",
        ),
    ],
)
def test_a_study_refuses_in_one_sentence(use, words):
    assert_refused(use, words)


@pytest.fixture(scope="module")
def shank_plan():
    knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    tracking = {"kp": 200.0, "kd": 20.0, "duration_s": 0.01}
    problem = linkplan.Problem.reach(
        knee, start_deg={"O": -49.07}, goal_deg={"O": 56.27}, duration_s=0.16, tracking=tracking
    )
    return linkplan.plan(problem).require()


def test_an_experiment_is_a_table_columns_and_runs_again(shank_plan):
    tried = linkplan.experiment(shank_plan, ["pd", "lqr"], samples=4, imperfections={"delay_periods": [0.5, 2.0]})
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
def test_what_makes_no_sense_is_refused(shank_plan, asked, said):
    with pytest.raises(linkplan.LinkplanError, match=said):
        linkplan.experiment(shank_plan, **asked)


class Held:
    """A law that holds the first position by a stiff spring: as a class, an object, or by a function of the reference."""

    name = "held"

    def __init__(self, reference):
        self.reference = reference

    def effort(self, k, position, velocity):
        del velocity
        return self.reference.effort[k] + 200.0 * (self.reference.position_rad[k] - position)


def test_an_experiment_takes_classes_objects_and_functions(shank_plan):
    given = {"delay_periods": [0.5, 2.0]}
    by_class = linkplan.experiment(shank_plan, [Held, "pd"], samples=3, imperfections=given)
    by_function = linkplan.experiment(shank_plan, [lambda reference: Held(reference)], samples=3, imperfections=given)
    assert list(by_class.results["tracker"][:2]) == ["own:held", "pd"]
    ours = by_class.results["rms_error_deg"][by_class.results["tracker"] == "own:held"]
    np.testing.assert_allclose(by_function.results["rms_error_deg"], ours, rtol=1e-12)
    run = by_class.replay("own:held", 1)
    assert np.degrees(np.sqrt(np.mean(run.error_rad**2))) == pytest.approx(ours[1])


def test_an_experiment_with_an_object_goes_on_and_tells_another_object(shank_plan, tmp_path):
    given = {"samples": 2, "imperfections": {"delay_periods": [0.5, 2.0]}, "folder": tmp_path / "tried"}
    first = linkplan.experiment(shank_plan, [Held], **given)
    again = linkplan.experiment(shank_plan, [Held], **given)
    np.testing.assert_array_equal(first.results["rms_error_deg"], again.results["rms_error_deg"])

    class Other(Held):
        pass

    assert_refused(lambda: linkplan.experiment(shank_plan, [Other], **given), "another experiment")


def test_what_no_other_process_can_be_given_is_refused(shank_plan):
    with pytest.raises(linkplan.LinkplanError, match="cannot be sent to other processes"):
        linkplan.experiment(shank_plan, [lambda reference: Held(reference)], workers=2)
