"""What the figures of `check` show: every coordinate swept, springs in what holds still, turning points."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.reach import reach, toggles
from linkplan.studies.check.inspection import inspect
from linkplan.studies.check.kinematic_loop_report import measure
from linkplan.studies.check.path_plots import inspection_figure, path_plots
from tests.support.figures import curves, labels, saved_figures
from tests.support.gripper import REST, STIFFNESS, WEIGHT
from tests.support.linkages import RSSR
from tests.support.mechanism_checks import mechanism_of

# Rounding of a page's numbers, of the largest of their kind.
SHOWN = 1e-4


def test_what_holds_the_gripper_still_has_its_springs_in_it():
    mechanism = mechanism_of("parallel-gripper")
    path = measure(mechanism, reach(mechanism).poses, "the reach", coordinate=0)
    plot = next(plot for plot in path_plots(path) if plot.title.startswith("Effort that holds it still"))
    drawn = {series.name: np.array(series.y, dtype=float) for series in plot.series}
    q = np.radians(np.array(plot.x, dtype=float))
    weight = WEIGHT * np.sin(q)
    # The left crank: mirrored, its springs at rest at -REST.
    both = weight + 2 * STIFFNESS * (q + REST)
    assert drawn["left_crank"] == pytest.approx(both, abs=SHOWN * np.abs(both).max())
    assert drawn["left_crank, weight alone"] == pytest.approx(weight, abs=SHOWN * np.abs(weight).max())


@pytest.mark.slow
def test_the_drawing_of_two_freedoms_sweeps_both(tmp_path, monkeypatch):
    saved = saved_figures(monkeypatch)
    mechanism = mechanism_of("five-bar")
    inspection_figure(inspect(mechanism, []), tmp_path / "five-bar.png")
    assert (tmp_path / "five-bar.png").exists()
    figure = saved["five-bar.png"]
    sketch, shown = ("x [m]", "z [m]"), ("position [deg]", "inertia [kg m2]", "effort [N.m]")
    of_both = [[sketch, *((f"{joint.name} [deg]", what) for what in shown)] for joint in mechanism.independent_joints]
    assert labels(figure) == [*of_both[0], *of_both[1]]
    for column, axes in enumerate((figure.axes[2], figure.axes[6])):
        can, name = reach(mechanism, column), mechanism.independent_joints[column].name
        position, drawn = curves(axes)[name]
        swept = np.degrees(can.poses[:, mechanism.independent[column]])
        M = [np.array(mechanism.dynamics.reduced_inertia(q))[column, column] for q in can.poses]
        assert drawn == pytest.approx(np.interp(position, swept, M), rel=1e-2)


def test_a_rod_s_spin_is_not_drawn_over_its_reach():
    """A delta's figure had the spins of two rods in place of its other motors."""
    found = inspect(load_mechanism(RSSR), [])
    assert len(found.reaches) == 2
    assert {axes.get_xlabel() for axes in inspection_figure(found).axes[1:]} == {"crank [deg]"}


def test_the_dotted_lines_over_a_reach_are_named_in_the_legend():
    mechanism = mechanism_of("optimus-knee")
    found = inspect(mechanism, [])
    assert len(found.reaches[0].singular)
    assert toggles(mechanism)
    axes = inspection_figure(found).axes[1]
    assert [text.get_text() for text in axes.get_legend().get_texts()][-2:] == ["singular pose", "a joint turns back"]
