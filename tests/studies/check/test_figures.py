"""What the figures of `check` show: every coordinate swept, springs in what holds still, units apart."""

from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from linkplan.models.poses.reach import reach
from linkplan.studies.check.draw_kinematic_loop_report import draw_weight, shares
from linkplan.studies.check.draw_mechanism import draw_dependent, draw_holding, inspection_figure
from linkplan.studies.check.inspection import inspect
from linkplan.studies.check.kinematic_loop_report import measure
from tests.support.figures import labels, saved_figures
from tests.support.gripper import REST, STIFFNESS, WEIGHT
from tests.support.mechanism_checks import mechanism_of
from tests.support.tolerances import KNEE, relative_error


def panel() -> Any:
    return Figure().subplots()


def test_what_holds_the_gripper_still_has_its_springs_in_it():
    mechanism = mechanism_of("parallel-gripper")
    axes = panel()
    can = reach(mechanism)
    draw_holding(axes, mechanism, can)
    lines = {str(line.get_label()): np.array(line.get_ydata()) for line in axes.lines}
    q = can.poses[:, mechanism.independent[0]]
    weight = WEIGHT * np.sin(q)
    # The left crank: mirrored, its springs at rest at -REST.
    expected = weight + 2 * STIFFNESS * (q + REST)
    assert relative_error(lines["weight and springs"], expected) < KNEE
    assert relative_error(lines["the weight alone"], weight) < KNEE


def test_the_report_s_own_panel_has_springs_in_it_too():
    mechanism = mechanism_of("parallel-gripper")
    can = reach(mechanism)
    axes = panel()
    draw_weight(axes, measure(mechanism, can.poses, "the reach", coordinate=0))
    drawn = [np.array(line.get_ydata()) for line in axes.lines if len(line.get_xdata())]
    q = can.poses[:, mechanism.independent[0]]
    weight = WEIGHT * np.sin(q)
    assert relative_error(drawn[0], weight + 2 * STIFFNESS * (q + REST)) < KNEE
    assert relative_error(drawn[1], weight) < KNEE


@pytest.mark.slow
def test_the_drawing_of_two_freedoms_sweeps_both(tmp_path, monkeypatch):
    swept: list[int] = []

    def note(axes, mechanism, can):
        swept.append(can.coordinate)
        draw_holding(axes, mechanism, can)

    monkeypatch.setattr("linkplan.studies.check.draw_mechanism.draw_holding", note)
    saved = saved_figures(monkeypatch)
    mechanism = mechanism_of("five-bar")
    inspection_figure(inspect(mechanism, []), tmp_path / "five-bar.png")
    assert swept == [0, 1]
    assert (tmp_path / "five-bar.png").exists()
    first, second = (f"{joint.name} [deg]" for joint in mechanism.independent_joints)
    sketch, dependent = ("x [m]", "z [m]"), "dependent joints [deg]"
    inertia, holding = "reduced inertia [kg m2]", "effort that holds it still [N.m]"
    of_both = [[sketch, (x, dependent), (x, inertia), (x, holding)] for x in (first, second)]
    figure = saved["five-bar.png"]
    assert labels(figure) == [*of_both[0], *of_both[1]]
    for column, axes in enumerate((figure.axes[2], figure.axes[6])):
        can = reach(mechanism, column)
        (position, drawn), *_ = (np.array(line.get_data()) for line in axes.lines)
        assert position == pytest.approx(np.degrees(can.poses[:, mechanism.independent[column]]))
        M = [np.array(mechanism.dynamics.reduced_inertia(q))[column, column] for q in can.poses]
        assert relative_error(drawn, M) < KNEE


def test_lines_of_three_units_are_drawn_as_shares_of_their_largest():
    lines = [
        ("one", np.array([1.0, -4.0]), "1"),
        ("arm", np.array([0.0, 0.5]), "m"),
        ("rate", np.array([3.0, np.inf]), "1/m"),
    ]
    found = shares(lines)
    assert [label for label, *_ in found] == ["one (1 is 4)", "arm (1 is 0.5 m)", "rate (1 is 3 1/m)"]
    assert [values.tolist() for _, values, _ in found] == [[0.25, -1.0], [0.0, 1.0], [1.0, np.inf]]
    assert {unit for *_, unit in found} == {"1"}


def test_the_dotted_lines_over_a_reach_are_named_in_the_legend():
    mechanism = mechanism_of("optimus-knee")
    can, axes = reach(mechanism), panel()
    assert len(can.singular)
    assert can.toggles
    draw_dependent(axes, mechanism, can)
    assert [text.get_text() for text in axes.get_legend().get_texts()][-2:] == ["singular pose", "a joint turns back"]
