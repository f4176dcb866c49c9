"""The commands about loops as their users meet them: bode with its measurement and maps, tune."""

import json
import tomllib

import numpy as np
import pytest

from tests.support.figure_texts import text_faults
from tests.support.figures import curves, dots, labels, saved_figures
from tests.support.oscillators import mass_on_a_spring
from tests.support.tolerances_loops import DECAY, KNEE_DB, LONGEST_PERIOD

pytestmark = pytest.mark.usefixtures("placed_figures")

OF_HERTZ = "frequency [Hz]"
# Rounding of a page's numbers.
SHOWN = 1e-3
LABELS = {
    "bode.png": [
        *[(OF_HERTZ, what) for what in ("gain [dB]", "phase [deg]", "difference [dB]", "difference [deg]") for _ in "ab"]
    ],
    "nyquist.png": [("real part of L", "imaginary part of L")],
    "sensitivity.png": [*((OF_HERTZ, "gain [dB]"), (OF_HERTZ, "gain [dB]"), (OF_HERTZ, "gain [dB of (N.m)/rad]"))],
    "margins.png": [
        *(("O [deg]", what) for what in (OF_HERTZ, "margin [deg]", OF_HERTZ)),
        ("", "|S| (blank: unstable; red:\namplifies) [dB]"),
    ],
}


@pytest.mark.slow
def test_bode_measures_draws_and_says_how_well_the_two_agree(ask, tmp_path, monkeypatch):
    saved = saved_figures(monkeypatch)
    folder = tmp_path / "loop"
    command = ["bode", "optimus-knee", "--at-deg", "O=0", "--frequency-hz", "100:2000:4"]
    code, out, err = ask(*command, "-o", str(folder))
    assert code == 0
    assert "differ from the prediction by at most" in out
    assert "sinusoids settled" in err
    assert "sinusoids settled" not in out
    said = json.loads((folder / "bode.json").read_text())
    measured = said["points"][0]["loops"]["pd"]["measured"]["loop"]
    assert len(measured["frequency_hz"]) == len(measured["coherence"]) == 4
    assert max(abs(x) for x in measured["less_predicted_db"]) < KNEE_DB
    assert set(saved) == {path.name for path in folder.glob("*.png")} == set(LABELS)
    assert {name: labels(figure) for name, figure in saved.items()} == LABELS
    bode = np.reshape(saved["bode.png"].axes, (4, 2))
    for row, values in ((0, "gain_db"), (2, "less_predicted_db"), (3, "less_predicted_deg")):
        drawn = np.hstack(dots(bode[row, 0]))
        drawn = drawn[:, np.argsort(drawn[0])]
        assert drawn == pytest.approx(np.array([measured["frequency_hz"], measured[values]]), rel=SHOWN, abs=SHOWN)
    (nyquist,) = dots(saved["nyquist.png"].axes[0])
    assert 20 * np.log10(np.hypot(*nyquist)) == pytest.approx(measured["gain_db"], abs=0.05)
    for axes in saved["sensitivity.png"].axes:
        assert [name for name in curves(axes) if not name.startswith("gain one")] == ["O = 0 deg"]
        drawn = next(dot for dot in dots(axes) if len(dot[0]) > 1)  # one dot alone marks the peak
        assert drawn[0] == pytest.approx(measured["frequency_hz"], rel=SHOWN)
    margins = said["points"][0]["loops"]["pd"]["phase_margin_deg"]
    positions, drawn = curves(saved["margins.png"].axes[1])["phase margin"]
    assert np.interp(0.0, positions, drawn) == pytest.approx(margins, rel=0.05)


def test_bode_of_an_unstable_loop_says_so_and_measures_nothing(ask):
    code, out, err = ask("bode", "optimus-knee", "--kp", "200", "--kd", "10", "--at-deg", "O=0")
    assert code == 1
    assert out.startswith("Unstable at O = 0 deg (1 of 1 pose): kp = 200 N.m/rad, kd = 10 N.m.s/rad")
    assert "not measured: an unstable feedback loop holds no operating point" in out
    assert "sinusoids" not in err


@pytest.mark.slow
def test_bode_maps_goes_past_the_limit_and_along_the_motion(ask, tmp_path, monkeypatch):
    folder, figures = tmp_path / "whole", saved_figures(monkeypatch)
    command = ["bode", "knee-sine", "--tracker", "pd+ff", "--no-measure", "--map", "--large", "--along", "--json"]
    code, out, _ = ask(*command, "-o", str(folder))
    assert code == 0
    said = json.loads(out)
    assert said["map"]["as_predicted"] == said["map"]["tried_count"] >= 10
    assert len(said["map"]["critical_kd"]) == 9
    assert said["map"]["longest_period_s"] == pytest.approx(2.332e-4, rel=LONGEST_PERIOD)
    assert said["large"]["feasible"][0]["reason"] == "effort of act_O"
    assert max(max(x or 0 for x in row) for row in said["large"]["saturated"]) > 0.5
    assert said["along"]["floquet"]["converges"] is True
    assert said["along"]["floquet"]["log_left_measured"] == pytest.approx(
        said["along"]["floquet"]["log_left_predicted"], rel=DECAY
    )
    assert {path.name for path in folder.glob("*.png")} >= {"map.png", "large.png", "along.png", "bode.png"}
    assert not {file: faults for file, figure in figures.items() if (faults := text_faults(figure))}


@pytest.mark.slow
def test_bode_looks_at_a_pure_damping_gain_too(ask, tmp_path):
    path = tmp_path / "mass.xml"
    path.write_text(mass_on_a_spring().mjcf)
    command = ["bode", str(path), "--kp", "0", "--kd", "5", "--period-s", "2e-3", "--at-m", "0.1", "--no-measure"]
    code, out, _ = ask(*command, "--map", "--json", "-o", str(tmp_path / "mass"))
    assert code == 0
    said = json.loads(out)
    assert said["points"][0]["q_m"] == {"s": pytest.approx(0.1)}
    assert said["map"]["critical_kd"][0]["settles_below_in_mujoco"] is True
    assert said["map"]["critical_kd"][0]["settles_above_in_mujoco"] is False


@pytest.mark.slow
def test_tune_answers_with_gains_or_with_no(ask):
    where = ["--at-deg", "O=-40", "--at-deg", "O=40", "--period-s", "1e-3"]
    code, out, err = ask("tune", "optimus-knee", "--bandwidth-hz", "60", *where)
    assert code == 0
    assert "PD gives 60 Hz and 60 deg at all 2 angles" in out
    assert "at the motor act_O" in out
    assert "grid 1 of" in err
    code, out, _ = ask("tune", "optimus-knee", "--bandwidth-hz", "400", *where, "--delay-periods", "2", "--json")
    assert code == 1
    said = json.loads(out)
    assert said["found"] is False
    assert "cannot give 400 Hz" in said["message"]


@pytest.mark.slow
@pytest.mark.parametrize("tracker", ["pd", "lqr"])
def test_tune_writes_gains_that_a_problem_file_takes_and_a_figure(tracker, ask, tmp_path):
    folder, where = tmp_path / "tuned", ["--at-deg", "O=-40", "--at-deg", "O=40", "--period-s", "1e-3"]
    code, out, _ = ask(
        "tune", "optimus-knee", "--bandwidth-hz", "60", "--tracker", tracker, *where, "--json", "-o", str(folder)
    )
    assert code == 0
    written = {".linkplan.json", "tune.json", "tune.png", "tracking.toml", "report.json"}
    assert {path.name for path in folder.iterdir()} == written
    assert json.loads((folder / "tune.json").read_text()) == json.loads(out)
    table = tomllib.loads((folder / "tracking.toml").read_text())["tracking"]
    settings = [f"tracking.{key}={value!r}" for key, value in table.items()]
    again = [word for setting in settings for word in ("--set", setting)]
    code, out, _ = ask("bode", "optimus-knee", "--tracker", tracker, *where[:4], *again, "--no-measure", "--json")
    assert code == 0  # stable with these gains, and as fast as was asked
    margins = [next(iter(point["loops"].values())) for point in json.loads(out)["points"]]
    assert min(pose["bandwidth_hz"] for pose in margins) >= 60


@pytest.mark.parametrize("option", ["--map", "--large"])
def test_what_needs_a_single_freedom_is_refused_before_any_work(option, ask):
    code, out, err = ask("bode", "five-bar", option)
    assert (code, out) == (2, "")
    assert f"{option} needs a mechanism of one degree of freedom; 'five-bar' has 2" in err
    assert "bode: predicted" not in err
