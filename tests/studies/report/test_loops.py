"""A feedback loop's report: its numbers are the study's, under their own heads; what does not fit is refused."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.bode.bode_report import bode_report
from linkplan.studies.output.document import Axis, Plane, Plot, Series, Table
from linkplan.studies.output.plan_blocks import radius_figure
from tests.support.reports import blocks

# Digits of a table.
SHOWN = 5e-4


@pytest.fixture(scope="module")
def study():
    knee = load_mechanism("optimus-knee")
    gains = Tracking(kp=200.0, kd=1.0, period_s=1e-4)
    return bode_study(knee, np.radians([[-40.0], [20.0]]), gains, knee.effort_limit, scanned=0)


def test_every_figure_of_the_table_stands_under_its_own_head(study):
    table = blocks(bode_report(study), Table)[0]
    rows = [dict(zip((head for head, _ in table.columns), row, strict=True)) for row in table.rows]
    for row, entry in zip(rows, study.points, strict=True):
        m = entry
        assert row["phase margin"] == pytest.approx(m.phase_margin_deg, rel=SHOWN)
        assert row["gain margin"] == pytest.approx(m.gain_margin_db, rel=SHOWN)
        assert row["largest pole"] == radius_figure(m.spectral_radius)
        assert row["peak of |S|"] == pytest.approx(m.sensitivity_peak, rel=SHOWN)
        assert row["delay margin"] == pytest.approx(1e3 * m.delay_margin_s, rel=SHOWN)
    assert dict(table.columns)["delay margin"] == "ms"


def test_the_open_loop_s_gain_is_one_at_the_crossover(study):
    plot = next(plot for plot in blocks(bode_report(study), Plot) if plot.title == "Open loop L: gain")
    sampled = [series for series in plot.series if series.name]
    for series, entry in zip(sampled, study.points, strict=True):
        gain = np.interp(np.log(entry.crossover_hz), np.log(series.x), series.y)
        assert gain == pytest.approx(0.0, abs=0.05)  # [dB], between samples of a thinned curve


def test_the_least_disk_margin_s_disk_is_not_entered(study):
    (plane,) = blocks(bode_report(study), Plane)
    disk = next(curve for curve in plane.curves if curve.look == "area")
    centre, radius = 0.5 * (max(disk.x) + min(disk.x)), 0.5 * (max(disk.x) - min(disk.x))
    curves = [curve for curve in plane.curves if curve.name.startswith("O = ")]
    assert len(curves) == len(study.points)
    known = [(x, y) for curve in curves for x, y in zip(curve.x, curve.y, strict=True) if x is not None]
    nearest = min(np.hypot(x - centre, y) for x, y in known)
    assert nearest == pytest.approx(radius, rel=0.01)  # it is touched, by the loop whose margin is the least


def test_rows_and_lines_that_do_not_fit_are_refused():
    axis = Axis(label="x", unit="s")
    with pytest.raises(ValueError, match="1 values for 2 columns"):
        Table(title="t", columns=[("a", ""), ("b", "")], rows=[[1]])
    with pytest.raises(ValueError, match="1 values for 2 places"):
        Plot(title="p", group="", x_axis=axis, y_axis=axis, x=[0, 1], series=[Series(name="s", y=[1])])
    with pytest.raises(ValueError, match="1 values for 2 places"):
        Plane(title="p", x_axis=axis, y_axis=axis, curves=[Series(name="c", x=[0, 1], y=[1])])
