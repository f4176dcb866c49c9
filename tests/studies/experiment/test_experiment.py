"""Experiments: the same file whatever ran it, however often it was killed; the same machines for all; samples again."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import linkplan
from linkplan.cli.main import main
from linkplan.models.errors import PlanFileError, ProblemError
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import silent
from linkplan.studies.variations.experiment import block as blocks
from linkplan.studies.variations.experiment import study as conducting
from linkplan.studies.variations.experiment.block import replay
from linkplan.studies.variations.experiment.experiment import Settings, default_imperfections, experiment_of, fall_note
from linkplan.studies.variations.experiment.study import RECORD, RESULTS, run_experiment, saved_experiment
from linkplan.studies.variations.tasks import unfinished as parts
from tests.support.data import ROOT
from tests.support.plans import optimal
from tests.support.refusals import assert_refused

SHORT = "tracking.duration_s=0.01"
# Two whole blocks and the beginning of a third.
SAMPLES = 2 * blocks.BLOCK_SAMPLES + 8
FEW = Settings(trackers=("pd", "pd+ff"), samples=6)


def done(target, settings=FEW, problem="knee-reach", overrides=(SHORT,), **how):
    plan = optimal(problem, *overrides)
    return run_experiment({"name": problem}, None, lambda: plan, settings, target, silent, **how)


@pytest.fixture
def short_blocks(monkeypatch):
    """Let blocks be of two samples."""
    monkeypatch.setattr(blocks, "BLOCK_SAMPLES", 2)


def test_every_tracker_meets_the_same_machines_and_every_figure_is_a_number(tmp_path):
    outcome = done(tmp_path / "x")
    results = outcome.results
    assert list(results["sample"]) == [i for i in range(6) for _ in range(2)]
    assert set(results["tracker"]) == {"pd", "pd+ff"}
    factors = [name for name in results if name.startswith("imperfection.")]
    assert len(factors) > 5
    for name in factors:
        pairs = results[name].reshape(6, 2)
        assert np.array_equal(pairs[:, 0], pairs[:, 1])
        assert len(set(pairs[:, 0])) == 6
    for name, metric in outcome.metrics.items():
        assert metric.unit
        if name != "settling_s":  # the motion has not ended by then
            assert np.all(np.isfinite(results[name]))
    assert not np.any(results["failure"].astype(bool))
    record = json.loads((tmp_path / "x" / RECORD).read_text())
    assert record["trackers"]["pd"]["mean"]["rms_error_deg"]["n"] == 6
    assert record["imperfections"]["delay_periods"] == [0.5, 1.5]


def test_the_results_are_the_same_at_any_batch_size_and_number_of_threads(tmp_path, monkeypatch):
    done(tmp_path / "many", threads=2)
    monkeypatch.setattr(blocks, "_MAX_LOG_BYTES", 1)  # one simulation at a time
    done(tmp_path / "one", threads=1)
    assert (tmp_path / "one" / RESULTS).read_bytes() == (tmp_path / "many" / RESULTS).read_bytes()
    assert (tmp_path / "one" / RECORD).read_bytes() == (tmp_path / "many" / RECORD).read_bytes()


def test_a_goal_that_cannot_be_held_is_told_of():
    """The five-bar's takes 1.86 N.m at O1, which has 1.4: after the motion it falls whatever tracks it."""
    held = experiment_of(optimal("five-bar-reach"), FEW)
    assert "1.86 N.m of act_O1, limit 1.4" in (fall_note(held) or "")
    assert fall_note(experiment_of(optimal("five-bar-reach", "tracking.duration_s=0.4"), FEW)) is None
    assert fall_note(experiment_of(optimal("knee-reach"), FEW)) is None


WORDS = ["experiment", "knee-reach", "--set", SHORT, "--samples", str(SAMPLES), "--trackers", "pd"]
# A command that never comes to its end, so that it is killed before that on any machine.
ENDLESS = """
import sys, time
from linkplan.__main__ import main
from linkplan.studies.variations.experiment import study
if __name__ == "__main__":
    study.finish = lambda *_: time.sleep(600)
    main()
"""


@pytest.mark.slow
def test_killed_twice_with_two_workers_it_is_the_file_of_one_that_was_left_alone(tmp_path):
    target, alone = tmp_path / "killed", tmp_path / "alone"
    for wanted in (1, 2):
        process = subprocess.Popen(
            [sys.executable, "-c", ENDLESS, *WORDS, "--workers", "2", "-o", str(target)], cwd=ROOT, stderr=subprocess.DEVNULL
        )
        there = parts.unfinished(target) / parts.PARTS
        while len(list(there.glob("part-*"))) < wanted and process.poll() is None:
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        assert not target.exists()
    assert main([*WORDS, "-o", str(target)]) == main([*WORDS, "--threads", "1", "-o", str(alone)]) == 0
    assert (target / RESULTS).read_bytes() == (alone / RESULTS).read_bytes()
    assert (target / RECORD).read_bytes() == (alone / RECORD).read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["alone", "killed"]


@pytest.mark.usefixtures("short_blocks")
def test_what_is_done_is_not_run_again(tmp_path, monkeypatch):
    ran = []
    real = conducting.run_block

    def stopping(experiment, block, threads):
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(block)
        return real(experiment, block, threads)

    monkeypatch.setattr(conducting, "run_block", stopping)
    with pytest.raises(KeyboardInterrupt):
        done(tmp_path / "x")
    assert ran == [0, 1]
    assert not (tmp_path / "x").exists()
    left = parts.unfinished(tmp_path / "x") / parts.PARTS / ".linkplan-work-0123456789abcdef"
    left.mkdir()
    (left / "part-00002.parquet").write_text("cut off")
    monkeypatch.setattr(conducting, "run_block", lambda *given: (ran.append(given[1]), real(*given))[1])
    done(tmp_path / "x")
    assert ran == [0, 1, 2]
    done(tmp_path / "y")
    assert (tmp_path / "x" / RESULTS).read_bytes() == (tmp_path / "y" / RESULTS).read_bytes()
    done(tmp_path / "x")
    assert ran == [0, 1, 2, 0, 1, 2]  # whole already
    assert not parts.unfinished(tmp_path / "x").exists()


@pytest.mark.usefixtures("short_blocks")
def test_another_experiment_is_refused_where_one_stands_whole_or_not(tmp_path, monkeypatch):
    done(tmp_path / "x")
    other = Settings(trackers=("pd", "pd+ff"), samples=6, seed=1)
    with pytest.raises(PlanFileError, match=r"another experiment's results \(seed was 0, now 1\); name a new folder"):
        done(tmp_path / "x", other)
    monkeypatch.setattr(conducting, "run_block", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        done(tmp_path / "y")
    with pytest.raises(PlanFileError, match=r"has parts of an experiment with other settings \(seed was 0, now 1\)"):
        done(tmp_path / "y", other)


def test_two_at_once_are_told_apart(tmp_path):
    asked = {"settings": {"seed": 0}}
    folder = tmp_path / "x.unfinished"
    at_once = pytest.raises(PlanFileError, match="another process is using")
    with parts.working(folder, asked, "a thing"), at_once, parts.working(folder, asked, "a thing"):
        pass


@pytest.mark.usefixtures("short_blocks")
def test_a_full_disk_is_one_line_and_what_was_done_is_kept(tmp_path, monkeypatch):
    import pyarrow.parquet as parquet

    real, count = parquet.write_table, []

    def full(table, place):
        count.append(place)
        real(table, place)
        if len(count) == 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(parquet, "write_table", full)
    with pytest.raises(PlanFileError, match="No space left on device; finished parts are kept") as refused:
        done(tmp_path / "x")
    assert "\n" not in str(refused.value)
    folder = parts.unfinished(tmp_path / "x")
    assert [path.name for path in (folder / parts.PARTS).iterdir()] == ["part-00000.parquet"]


def test_any_sample_can_be_run_again_to_the_same_bits(tmp_path):
    outcome = done(tmp_path / "x")
    again = saved_experiment(tmp_path / "x")
    rollout, said = replay(again, "pd+ff", 3)
    row = np.flatnonzero((outcome.results["sample"] == 3) & (outcome.results["tracker"] == "pd+ff"))[0]
    for name in ("rms_error_deg", "chatter", "energy_j", "loop_gap_um"):
        assert said[name] == outcome.results[name][row]
    assert np.degrees(np.sqrt(np.mean(rollout.error_rad**2))) == pytest.approx(said["rms_error_deg"])
    assert_refused(lambda: replay(again, "pd", 6), "from 0 to 5, got 6", kind=ProblemError)


class Failing:
    """A law that fails for machines that start behind, and has no number for those far ahead."""

    name = "pd"

    def effort(self, k, position, velocity):
        del k, velocity
        if position[0] < np.radians(-49.07):
            raise RuntimeError("behind")
        return [np.nan if position[0] > np.radians(-49.07 + 0.03) else 0.0]


def test_a_tracker_that_fails_on_some_machines_is_counted_and_the_others_stand(tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, "law_of", lambda *_: Failing())
    outcome = done(tmp_path / "x", Settings(trackers=("pd",), samples=12))
    one = outcome.trackers["pd"]
    assert set(one.failures) == {
        "the tracker failed: RuntimeError: behind",
        "the tracker gave an effort that is not a number",
    }
    assert 0 < sum(one.failures.values()) < 12
    assert one.means["rms_error_deg"].n == 12 - sum(one.failures.values())
    assert outcome.results["failure"][one.worst[0]] is not None  # failures are the worst


def test_numbers_of_the_model_are_drawn_by_name_and_those_of_the_problem_by_themselves(tmp_path):
    by_table = ("parameters.payload.mass={ range = [3.5, 4.5] }", "parameters.A.armature={ value = 0.012, sd = 0.001 }")
    by_name = "imperfections.parameters={ 'coupler.length' = { normal = [0.0741, 1e-5] }, 'A.armature' = 0.02 }"
    outcome = done(tmp_path / "x", Settings(trackers=("pd",), samples=6), overrides=(SHORT, *by_table, by_name))
    mass = outcome.results["imperfection.parameters.payload.mass"]
    assert mass.min() >= 3.5
    assert mass.max() <= 4.5
    assert np.ptp(mass) > 0.5
    machine = outcome.experiment.machine(2).machine.parameters
    assert machine["payload.mass"] == mass[2]
    assert machine["A.armature"] == 0.02
    assert 0 < abs(machine["coupler.length"] - 0.0741) < 1e-4
    assert "payload_mass_factor" not in default_imperfections(outcome.experiment.plan)


def test_a_machine_that_cannot_be_built_is_counted_too(tmp_path):
    overrides = (SHORT, "imperfections.link_length_factor={ coupler = [0.5, 3.0] }")
    outcome = done(tmp_path / "x", Settings(trackers=("pd",), samples=12), overrides=overrides)
    (said, count), *_ = outcome.trackers["pd"].failures.items()
    assert "does not close at the start" in said
    assert 0 < count < 12


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("imperfections.delay=1", "did you mean 'delay_periods'"),
        ("imperfections.coulomb_friction={ K = 1 }", "names 'K'"),
        ("imperfections.encoder_resolution_m=1e-3", "independent slides; the mechanism has none"),
        ("imperfections.parameters={ 'coupler.lenght' = 0.07 }", "unknown parameter 'coupler.lenght'"),
        ("imperfections.parameters=1.0", "imperfections.parameters must be a table by name"),
        ("imperfections.push_effort=1", "needs the target of the push: imperfections.push_joint"),
        ("imperfections.push_body='crank'", "needs the force of the push"),
        ("imperfections.torque_constant_factor=[1.1, 0.9]", "must have its low end first"),
    ],
)
def test_imperfections_that_cannot_be_are_refused_when_the_problem_is_read(override, said):
    with pytest.raises(ProblemError, match=said):
        load_problem("knee-reach", [override])


def test_a_loop_too_soft_to_step_is_refused_before_any_sample_runs():
    plan = optimal("knee-reach", SHORT, "imperfections.loop_time_constant_s=1e-5")
    assert_refused(lambda: experiment_of(plan, FEW), "time constant")


def test_a_push_that_no_machine_gets_before_its_run_ends_is_refused():
    push = ("imperfections.push_body=crank", "imperfections.push_force_x_n=5", "imperfections.push_duration_s=0.01")
    with pytest.raises(ProblemError, match=r"push_start_s must be before the end of the run, [\d.]+ s, .*; got 100 or more"):
        experiment_of(optimal("knee-reach", SHORT, *push, "imperfections.push_start_s=100"), FEW)
    assert experiment_of(optimal("knee-reach", SHORT, *push, "imperfections.push_start_s=[0, 0.02]"), FEW).n == FEW.samples


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"trackers": ("pdd",)}, "unknown tracker 'pdd'"),
        ({"trackers": ("pd", "pd")}, "different trackers"),
        ({"samples": 0}, "samples must be a whole number from 1"),
        ({"design": "sobel"}, r"unknown design 'sobel'"),
        ({"tube_deg": -1.0}, "tube_deg must be a positive number"),
    ],
)
def test_settings_that_cannot_be_are_refused(asked, said):
    with pytest.raises(ProblemError, match=said):
        Settings(**asked)


@pytest.mark.slow
def test_the_command_prints_and_replays(tmp_path, ask, ask_json):
    words = ["experiment", "knee-reach", "--set", SHORT, "--samples", "5", "-o", str(tmp_path / "x")]
    code, out, _ = ask(*words)
    assert code == 0
    assert "success" in out
    code, said = ask_json(*words)
    assert said["trackers"]["lqr"]["success"]["n"] == 5
    code, said = ask_json(
        "track", str(tmp_path / "x"), "--sample", "2", "--tracker", "lqr", "-o", str(tmp_path / "again"), "--parquet"
    )
    assert code == 0
    assert said["sample"]["sample"] == 2
    written = {path.name for path in (tmp_path / "again").iterdir()}
    assert {"track.png", "sample-2-lqr.csv", "sample-2-lqr.parquet"} <= written
    code, _, err = ask("track", str(tmp_path / "x"))
    assert code == 2
    assert "plan.json; a plan is a folder with that and trajectory.npz, as" in err
    code, _, err = ask("experiment", "knee-reach", "--set", SHORT, "--samples", "6", "-o", str(tmp_path / "x"))
    assert code == 2
    assert "samples was 5, now 6" in err


def test_an_empty_table_of_imperfections_means_none_and_a_missing_one_the_defaults_by_name(tmp_path):
    plan = optimal("knee-reach", SHORT)
    none = replace(plan, problem=plan.problem.replace(imperfections={}))
    outcome = run_experiment({"name": "knee-reach"}, None, lambda: none, FEW, tmp_path / "none", silent)
    assert outcome.imperfections == {}
    (note,) = outcome.notes
    assert note.startswith("[imperfections] is empty: all machines are equal")
    assert outcome.sensitivity is None
    errors = outcome.results["rms_error_deg"].reshape(6, 2)
    assert np.ptp(errors, axis=0).max() == 0.0
    (note,) = done(tmp_path / "defaults").notes
    assert "without [imperfections]" in note
    assert "torque_bandwidth_hz" in note


def test_a_tracker_whose_gains_are_too_high_for_its_encoder_is_said_to_chatter(tmp_path):
    fine = ("imperfections.encoder_resolution_deg=1e-4", SHORT)
    coarse = ("imperfections.encoder_resolution_deg=0.05", SHORT)
    (quiet, loud) = (done(tmp_path / name, overrides=how).notes for name, how in (("a", fine), ("b", coarse)))
    assert not any("chatters" in note for note in quiet)
    assert any(note.startswith("pd+ff chatters: the total variation of its effort is") for note in loud)


LIGHT_ANKLE = """
<mujoco>
  <compiler angle="degree" autolimits="true"/>
  <option timestep="5e-4"/>
  <worldbody>
    <body>
      <joint name="ankle" axis="0 1 0" range="-90 90"/>
      <inertial pos="0 0 -0.05" mass="0.5" diaginertia="8e-4 8e-4 8e-4"/>
    </body>
  </worldbody>
  <actuator><motor joint="ankle" ctrlrange="-30 30"/></actuator>
</mujoco>"""


@pytest.mark.slow
def test_lqr_with_its_own_weights_does_not_chatter_on_a_light_ankle():
    varied = {}
    for name, weights in (("own", {}), ("of a heavy machine", {"lqr_position_deg": 1.0, "lqr_velocity_deg_s": 100.0})):
        problem = linkplan.Problem.reach(
            LIGHT_ANKLE,
            start_deg={"ankle": 0.0},
            goal_deg={"ankle": 20.0},
            duration_s=0.4,
            tracking={"period_s": 1e-3, **weights},
        )
        runs = linkplan.experiment(linkplan.plan(problem), trackers=["lqr"], samples=8)
        varied[name] = runs.results["chatter"].mean()
    assert varied["own"] < 50.0  # [N.m]; the plan's own effort varies by 2 N.m
    assert varied["of a heavy machine"] > 1000.0


def test_a_plan_s_reserve_does_not_make_the_machine_s_imperfections_smaller():
    whole, kept = optimal("knee-sprint"), optimal("knee-sprint", "limits.reserve=0.1")
    assert kept.certificate.peak_effort[0] < 0.95 * whole.certificate.peak_effort[0]
    assert default_imperfections(kept) == default_imperfections(whole)
    assert default_imperfections(kept)["coulomb_friction"] == {"O": [0.0, 2.0]}
