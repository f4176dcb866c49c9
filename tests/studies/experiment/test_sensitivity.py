"""The influence of imperfections: regression of ranks against closed forms, known physics, table, record and figure."""

import json

import numpy as np
import pytest
from scipy.stats import norm

from linkplan.planner.files.folders import plain_record
from linkplan.planner.search.planning import silent
from linkplan.studies.output.text import text_of
from linkplan.studies.variations.experiment.experiment import Settings, experiment_of
from linkplan.studies.variations.experiment.experiment_blocks import sensitivity
from linkplan.studies.variations.experiment.sensitivity import regressed
from linkplan.studies.variations.experiment.study import RECORD, run_experiment, saved_outcome
from tests.support.plans import optimal

SHORT, START = "tracking.duration_s=0.01", "tracking.duration_s=0.05"
NO_PUSH = ("push_joint='O'", "push_effort=[-50.0, 50.0]", "push_duration_s=0.0")
PAYLOAD, DELAY = "payload_mass_factor=[0.9, 1.1]", "delay_periods=[0.0, 2.0]"
RANDOM = np.random.default_rng(1)


def tried(imperfections, *overrides, target=None, trackers=("pd+ff",), samples=24):
    plan = optimal("knee-reach", *overrides, *(f"imperfections.{one}" for one in imperfections))
    settings = Settings(trackers=trackers, samples=samples)
    return run_experiment({"name": "knee-reach"}, None, lambda: plan, settings, target, silent)


def test_coefficients_of_normal_values_are_the_closed_form_of_their_correlations():
    """Spearman's coefficient of normal values with the correlation r is 6 / pi asin(r / 2) (Pearson 1907)."""
    even = norm.ppf((np.arange(60) + 0.5) / 60)
    x = np.array([[a, b] for a in even for b in even])
    value, low, high, _ = regressed(x, (0.8 * x[:, 0] - 0.6 * x[:, 1])[:, None])[..., 0]
    assert value == pytest.approx(6 / np.pi * np.arcsin([0.4, -0.3]), abs=2e-3)
    assert np.all((low < value) & (value < high) & (high - low < 0.1))


def test_a_law_that_only_grows_has_the_coefficient_one_whatever_its_form():
    x = RANDOM.random((60, 2))
    for y in (x[:, 0], np.exp(20 * x[:, 0]), x[:, 0] ** 9):
        assert regressed(x, y[:, None])[0, :, 0] == pytest.approx([1.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("column", [np.ones(50), 1.0 + 1e-14 * RANDOM.random(50)])
def test_a_figure_that_changes_by_rounding_alone_owes_nothing_to_anything(column):
    assert not regressed(RANDOM.random((50, 3)), column[:, None]).any()


@pytest.mark.parametrize("strength", [0.0, 0.3])
def test_intervals_contain_the_coefficient_of_very_many_machines_in_nineteen_of_twenty_experiments(strength):
    rng = np.random.default_rng(2)

    def experiment(n: int) -> np.ndarray:
        x = rng.random((n, 2))
        return regressed(x, (strength * x[:, 0] + x[:, 1] + 0.3 * rng.random(n))[:, None])[:, 0, 0]

    known = experiment(100_000)[0]
    inside = [low <= known <= high for _, low, high, _ in (experiment(60) for _ in range(200))]
    assert 0.88 <= np.mean(inside) <= 0.99


def test_a_part_of_the_machines_is_too_few():
    assert tried([DELAY, PAYLOAD], SHORT, samples=14).sensitivity is None
    outcome = tried([DELAY, PAYLOAD], SHORT, samples=15)
    assert outcome.sensitivity.trackers["pd+ff"]["rms_error_deg"].effects["delay_periods"].by_value.n == 15
    few = tried([DELAY, PAYLOAD], SHORT, samples=3)
    assert "needs 15 machines or more" in text_of(sensitivity(few))


@pytest.mark.slow
def test_the_error_that_a_wrong_payload_leaves_to_feedforward_grows_to_both_sides_and_a_push_of_no_duration_pushes_nothing():
    found = tried([*NO_PUSH, PAYLOAD], START, samples=60).sensitivity.trackers["pd+ff"]["rms_error_deg"]
    payload, push = (found.effects[name] for name in ("payload_mass_factor", "push_effort"))
    assert found.ranking == ("payload_mass_factor", "push_effort")
    assert payload.strongest is payload.by_distance
    assert payload.by_distance.value > 0.8
    assert payload.significant
    assert not push.significant
    assert found.explained > 0.9


@pytest.mark.slow
def test_the_record_the_table_and_the_figure_stand_in_the_folder(tmp_path):
    imperfections = [DELAY, "coulomb_friction=[0.0, 1.0]"]
    outcome = tried(imperfections, SHORT, target=tmp_path / "x", trackers=("pd", "lqr"), samples=30)
    assert {path.name for path in (tmp_path / "x").iterdir()} >= {"sensitivity.png", "experiment.png", "results.parquet"}
    said = json.loads((tmp_path / "x" / RECORD).read_text())["sensitivity"]
    assert said["imperfections"]["coulomb_friction.O"] == {"unit": "N.m", "range": [0.0, 1.0]}
    assert said["metrics"]["rms_error_deg"]["unit"] == "deg"
    one = said["trackers"]["pd"]["rms_error_deg"]
    assert set(one["ranking"]) == set(said["imperfections"]) == set(one["effects"])
    assert plain_record(saved_outcome(tmp_path / "x")) == plain_record(outcome)
    text = text_of(sensitivity(outcome))
    assert "coulomb_friction.O" in text
    assert "all together explain" in text


def test_machines_have_their_noise_as_ever():
    hypercube = experiment_of(optimal("knee-reach", SHORT), Settings(samples=5, seed=3))
    assert [hypercube.machine(i).sensors.noise_seed for i in range(5)] == [(3, 1, i) for i in range(5)]


def test_success_says_what_failures_are_owed_to():
    found = tried(["link_length_factor={ coupler = [1.0, 3.0] }", PAYLOAD], SHORT, samples=30).sensitivity
    success, error = (found.trackers["pd+ff"][name] for name in ("success", "rms_error_deg"))
    assert success.ranking[0] == "link_length_factor.coupler"
    assert success.effects["link_length_factor.coupler"].by_value.high < 0
    assert error.effects["payload_mass_factor"].by_value.n < 30  # machines that failed have no error
