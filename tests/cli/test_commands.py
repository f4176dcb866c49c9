"""The command line as its users meet it: what it prints, its JSON keys, its exit codes, what it leaves on disk."""

import json
import re
from dataclasses import replace

import pytest

from linkplan.planner.plan.folder import read_plan
from linkplan.planner.plan.verdict import Verdict
from tests.support.data import ROOT
from tests.support.plans import planned, saved_plan
from tests.support.tolerances import KNEE
from tests.support.tolerances_planner import CLOSURE_M

KNEE_KEYS = {
    "status", "message", "objective", "duration_s", "peak_effort", "effort_limit", "effort_unit", "certificate", "mesh",
    "time_s", "versions",
}  # fmt: skip
CERTIFICATE_KEYS = {
    "passed", "effort_excess", "dynamics_residual", "closure_gap_m", "integration_error_deg", "joint_margin_deg",
}  # fmt: skip
TRACKER_KEYS = {
    "rms_error_deg", "max_error_deg", "final_error_deg", "peak_effort", "rms_effort", "saturated_fraction",
    "loop_gap_max_m", "stable",
}  # fmt: skip


def test_list_names_every_built_in(ask_json):
    code, said = ask_json("list")
    assert code == 0
    assert set(said["models"]) == {path.stem for path in (ROOT / "models" / "mjcf").glob("*.xml")}
    assert set(said["problems"]) == {path.stem for path in (ROOT / "planner" / "problems").glob("*.toml")}


def test_check_of_the_mended_knee_finds_one_freedom_rank_two_and_no_problem(ask_json):
    code, said = ask_json("check", "optimus-knee", "--at-deg", "O=0", "--at-deg", "O=30")
    assert code == 0
    assert (said["dof"], said["closure_rows"], said["closure_rank"]) == (1, 3, 2)
    assert said["closure_gap_m"] < CLOSURE_M
    assert said["reach_deg"]["O"][1] == pytest.approx(78.52165904546642, abs=KNEE)
    assert said["singular_deg"] == pytest.approx([78.52165904546642], abs=KNEE)
    assert said["toggle_deg"] == pytest.approx([61.43327954622908], abs=KNEE)
    assert said["contacts"] == []
    assert said["problems"] == []
    at_30 = said["points"][1]
    assert at_30["q_deg"]["A"] == pytest.approx(39.74309737680779, abs=KNEE)
    assert at_30["reduced_inertia_kgm2"][0][0] == pytest.approx(0.00021304923174702268, rel=KNEE)
    assert at_30["gravity_effort"]["O"] == pytest.approx(-0.019943993693058087, abs=KNEE)
    assert at_30["effort_map"] == {"act_O": {"O": 1.0}}


@pytest.mark.slow
def test_plan_gives_the_promised_keys_and_saves_a_whole_folder(ask_json, tmp_path):
    code, said = ask_json("plan", "knee-reach", "-o", str(tmp_path / "reach"))
    assert code == 0
    assert set(said) >= KNEE_KEYS
    assert said["status"] == "optimal"
    assert set(said["certificate"]) >= CERTIFICATE_KEYS
    assert said["certificate"]["passed"] is True
    assert said["certificate"]["effort_excess"] == 0
    assert said["effort_unit"] == {"act_O": "N.m"}
    assert said["mesh"] == {"scheme": "radau-3", "intervals": 40}
    assert set(said["time_s"]) == {"build", "solve"}
    files = {path.name for path in (tmp_path / "reach").iterdir()}
    assert files == {".linkplan.json", "plan.json", "trajectory.npz", "trajectory.csv", "plan.png"}
    assert json.loads((tmp_path / "reach" / "plan.json").read_text())["status"] == "optimal"


@pytest.mark.slow
def test_a_feasible_motion_is_saved_and_tracked_under_its_own_word(ask_json, tmp_path, monkeypatch):
    feasible = replace(planned("knee-reach"), verdict=Verdict(kind="feasible", words="a rest and a motion"))
    monkeypatch.setattr("linkplan.api.plans.plan_motion", lambda *_: feasible)
    code, said = ask_json("plan", "knee-reach", "-o", str(tmp_path / "reach"))
    assert (code, said["status"]) == (0, "feasible")
    again = read_plan(tmp_path / "reach")
    assert (again.status, again.message) == ("feasible", "a rest and a motion")
    assert again.require() is again
    assert ask_json("track", str(tmp_path / "reach"))[0] == 0


@pytest.mark.slow
def test_an_infeasible_problem_is_answered_in_a_sentence_and_writes_nothing(ask_json, tmp_path):
    code, said = ask_json("plan", "knee-sine", "--set", "mechanism.payload=shank", "-o", str(tmp_path / "none"))
    assert code == 1
    assert said["status"] == "infeasible"
    assert "the effort of act_O comes to 120 N.m at t = 0.1875 s" in said["message"]
    assert "limit of 100" in said["message"]
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_a_saved_plan_is_tracked_and_compared(ask_json, tmp_path):
    folder = str(saved_plan("knee-reach", tmp_path))
    code, tracked = ask_json("track", folder, "--tracker", "lqr", "-o", str(tmp_path / "tracked"))
    assert code == 0
    assert set(tracked["trackers"]) == {"lqr"}
    assert {path.name for path in (tmp_path / "tracked").iterdir()} == {
        *(".linkplan.json", "track.json", "track.png", "nominal-lqr.csv", "nominal-lqr.npz", "report.json")
    }
    code, compared = ask_json("compare", folder, "-o", str(tmp_path / "compared"))
    assert code == 0
    assert {"timestep_s", "control_period_s", "mujoco", "integrator", "solref"} <= set(compared["loop"])
    for side in (compared, compared["mismatch"]):
        assert set(side["trackers"]) == {"pd", "pd+ff", "lqr"}
        assert all(set(figures) >= TRACKER_KEYS for figures in side["trackers"].values())
    assert compared["mismatch"]["name"] == "payload +20 %, 1 control period of delay"
    assert compared["trackers"]["lqr"] == tracked["trackers"]["lqr"]
    series = {
        f"{side}-{name}.{end}"
        for side in ("nominal", "mismatch")
        for name in ("pd", "pd+ff", "lqr")
        for end in ("csv", "npz")
    }
    written = {path.name for path in (tmp_path / "compared").iterdir()}
    assert written == {".linkplan.json", "compare.json", "compare.png", "report.json", *series}


@pytest.mark.slow
def test_progress_goes_to_stderr_and_results_to_stdout(ask):
    code, out, err = ask("plan", "knee-sprint")
    assert code == 0
    assert "certificate: passed" in out
    lines = re.findall(r"^  plan +(\d+\.\d) s: (.*)$", err, re.MULTILINE)
    assert len(lines) == err.count("\n") > 1
    assert [float(time) for time, _ in lines] == sorted(float(time) for time, _ in lines)
    switched = next(text for _, text in lines if text.startswith("switch times as unknowns"))
    assert float(switched.rpartition("; last objective ")[2]) == pytest.approx(0.12185, abs=0.002)
    assert " s: " not in out


def test_a_folder_of_somebody_elses_is_not_overwritten(ask, tmp_path):
    (tmp_path / "thesis.txt").write_text("three years of work")
    code, out, err = ask("plan", "knee-reach", "-o", str(tmp_path))
    assert (code, out) == (2, "")
    assert "has files but no .linkplan.json of a result" in err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
