"""Sensitivity by experiment: known physics, common noise, and what is printed, recorded and drawn."""

import json

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.planner.files.folders import plain_record
from linkplan.planner.search.planning import silent
from linkplan.studies.output.figure import figure_of
from linkplan.studies.output.text import text_of
from linkplan.studies.variations.experiment.block import replay
from linkplan.studies.variations.experiment.experiment import Settings, experiment_of
from linkplan.studies.variations.experiment.experiment_blocks import sensitivity
from linkplan.studies.variations.experiment.sensitivity_blocks import tornado_figure
from linkplan.studies.variations.experiment.study import RECORD, run_experiment, saved_outcome
from tests.support.plans import optimal
from tests.support.refusals import assert_refused

SHORT, START = "tracking.duration_s=0.01", "tracking.duration_s=0.05"
NO_PUSH = ("push_joint='O'", "push_effort=[-50.0, 50.0]", "push_duration_s=0.0")
PAYLOAD, DELAY = "payload_mass_factor=[0.9, 1.1]", "delay_periods=[0.0, 2.0]"


def label_of(sensitivity):
    return list(sensitivity.imperfections)


def tried(design, imperfections, *overrides, target=None, trackers=("pd+ff",), samples=60):
    plan = optimal("knee-reach", *overrides, *(f"imperfections.{one}" for one in imperfections))
    settings = Settings(trackers=trackers, samples=samples, design=design)
    return run_experiment({"name": "knee-reach"}, None, lambda: plan, settings, target, silent)


@pytest.mark.slow
def test_the_error_that_a_wrong_payload_leaves_to_feedforward_is_in_proportion_to_it():
    found = tried("one-at-a-time", [*NO_PUSH, "payload_mass_factor=[1.1, 1.2]"]).sensitivity
    one = found.trackers["pd+ff"]["rms_error_deg"]
    payload, push = (one.effects[name] for name in ("payload_mass_factor", "push_effort"))
    a_tenth, middle, two_tenths = payload["at_low"], one.middle, payload["at_high"]
    assert two_tenths == pytest.approx(2 * a_tenth, rel=0.04)  # but for what the tracker leaves on the modelled machine
    assert two_tenths - middle == pytest.approx(middle - a_tenth, rel=0.01)
    assert payload["importance"] == pytest.approx(two_tenths - a_tenth)
    assert push["importance"] == 0.0  # a push of no duration pushes nothing
    assert found.ranking("pd+ff", "rms_error_deg") == ("payload_mass_factor", "push_effort")


@pytest.mark.slow
def test_morris_and_sobol_find_the_same_and_nothing_in_what_has_no_effect():
    ranges = [*NO_PUSH, "payload_mass_factor=[1.0, 1.1]", "coulomb_friction={ O = [0.0, 0.5] }"]
    ends = tried("one-at-a-time", ranges, START).sensitivity
    for design, samples in (("morris", 40), ("sobol", 160)):
        found = tried(design, ranges, START, samples=samples).sensitivity
        assert found.ranking("pd+ff", "rms_error_deg") == ends.ranking("pd+ff", "rms_error_deg")
        idle = found.importance("pd+ff", "rms_error_deg", "push_effort")
        assert idle.low <= 0.0 <= idle.high
        assert idle.half < 1e-9
        most = max(found.importance("pd+ff", "rms_error_deg", label).value for label in label_of(found))
        assert most > (0.05 if design == "morris" else 0.8)


def test_machines_of_a_group_share_their_noise_so_that_noise_is_no_influence():
    imperfections = [*NO_PUSH, "velocity_noise_deg_s=20.0", PAYLOAD]
    outcome = tried("morris", imperfections, SHORT)
    found, scheme = outcome.sensitivity, outcome.experiment.scheme
    assert label_of(found)[-1] == "noise draw"
    luck, idle = (found.importance("pd+ff", "rms_effort", name).value for name in ("noise draw", "push_effort"))
    assert luck > 0
    assert idle == 0.0
    seeds = [outcome.experiment.machine(i).sensors.noise_seed for i in range(outcome.experiment.n)]
    assert len(set(seeds[: scheme.size])) == 2  # one draw, and another from its step on
    assert len(set(seeds)) == 2 * scheme.n_groups
    row = np.flatnonzero(outcome.results["sample"] == 7)[0]
    assert replay(outcome.experiment, "pd+ff", 7)[1]["rms_effort"] == outcome.results["rms_effort"][row]


def test_machines_of_other_designs_have_their_noise_as_ever():
    plan = optimal("knee-reach", SHORT)
    hypercube = experiment_of(plan, Settings(samples=5, seed=3))
    assert [hypercube.machine(i).sensors.noise_seed for i in range(5)] == [(3, 1, i) for i in range(5)]


def test_without_noise_there_is_no_luck_and_a_normal_value_is_tried_at_its_ends():
    outcome = tried("one-at-a-time", ["torque_constant_factor={ normal = [1.0, 0.05] }"], SHORT, samples=1)
    assert label_of(outcome.sensitivity) == ["torque_constant_factor.act_O"]
    assert outcome.experiment.values[:, 0] == pytest.approx([1.0, 1 - 1.96 * 0.05, 1 + 1.96 * 0.05], abs=1e-4)


def test_a_means_interval_is_of_independent_machines_alone():
    outcome = tried("sobol", [DELAY, PAYLOAD], SHORT, samples=64)
    assert outcome.experiment.n == 64
    assert outcome.samples == 32
    pairs = outcome.experiment.values[outcome.experiment.scheme.independent]
    assert len(np.unique(pairs, axis=0)) == 32


@pytest.mark.slow
def test_the_record_the_table_and_the_figure_stand_in_the_folder(tmp_path):
    trackers = ("pd", "pd+ff", "lqr", "lqi", "ct")
    imperfections = [DELAY, "coulomb_friction=[0.0, 1.0]", "velocity_noise_deg_s=1.0"]
    outcome = tried("one-at-a-time", imperfections, SHORT, target=tmp_path / "x", trackers=trackers)
    assert {path.name for path in (tmp_path / "x").iterdir()} >= {"sensitivity.png", "results.parquet"}
    said = json.loads((tmp_path / "x" / RECORD).read_text())["sensitivity"]
    assert said["imperfections"]["coulomb_friction.O"] == {"unit": "N.m", "range": [0.0, 1.0]}
    assert said["metrics"]["rms_error_deg"]["unit"] == "deg"
    one = said["trackers"]["pd+ff"]["rms_error_deg"]
    assert set(one["ranking"]) == set(said["imperfections"]) == set(one["effects"])
    ordered = [one["effects"][label]["importance"] for label in one["ranking"]]
    assert ordered == sorted(ordered, reverse=True)
    assert plain_record(saved_outcome(tmp_path / "x")) == plain_record(outcome)
    text = text_of(sensitivity(outcome))
    assert text.count("coulomb_friction.O") >= 1


def test_a_tornados_bars_end_where_the_figure_does_at_the_ends_of_each_range():
    outcome = tried("one-at-a-time", [DELAY, PAYLOAD], SHORT)
    found = outcome.sensitivity
    (axis,) = figure_of(tornado_figure("knee-reach", found, "rms_error_deg")).axes
    one = found.trackers["pd+ff"]["rms_error_deg"]
    bars = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in axis.patches]
    assert [sorted(bar) for bar in bars] == [
        pytest.approx(sorted((one.middle, one.effects[label][name])))
        for label in one.ranking
        for name in ("at_low", "at_high")
    ]
    assert min(effect["importance"] for effect in one.effects.values()) > 1e-4
    assert axis.get_xlabel() == "rms error [deg]"


def test_failures_are_told_and_success_says_what_they_are_owed_to():
    imperfections = ["link_length_factor={ coupler = [1.0, 3.0] }", PAYLOAD]
    outcome = tried("morris", imperfections, SHORT, samples=30)
    found = outcome.sensitivity
    assert found.trackers["pd+ff"]["rms_error_deg"].left_out > 0
    assert found.trackers["pd+ff"]["success"].left_out == 0
    assert found.ranking("pd+ff", "success")[0] == "link_length_factor.coupler"
    assert "omitted from the errors" in text_of(sensitivity(outcome))


def test_python_has_it_as_a_value():
    plan = linkplan.plan(linkplan.Problem.from_file("knee-reach", {"tracking.duration_s": 0.01}))
    asked = {"imperfections": {"delay_periods": [0.0, 2.0], "payload_mass_factor": [0.9, 1.1]}}
    found = linkplan.experiment(plan, ["pd", "lqr"], design="one-at-a-time", **asked)
    assert "which imperfection matters most" in str(found)
    assert "means with" not in str(found)
    assert found.sensitivity.ranking("pd") == ("payload_mass_factor", "delay_periods")
    assert found.sensitivity.importance("pd", "peak_effort")["payload_mass_factor"].value > 0
    assert_refused(lambda: found.sensitivity.ranking("pd", "rms"), "unknown metric 'rms'", kind=ProblemError)
    assert_refused(lambda: found.sensitivity.ranking("mpc"), "unknown tracker 'mpc'", kind=ProblemError)
    assert linkplan.experiment(plan, ["pd"], samples=3, **asked).sensitivity is None
