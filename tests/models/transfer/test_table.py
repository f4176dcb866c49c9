"""Tables on adaptive grids: the stated error, the way back, where the map ends, dead centres."""

import functools

import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.transfer.grid import adaptive_grid, interpolated
from linkplan.models.transfer.output_map import motor_map, output_map
from linkplan.models.transfer.table import KnownPoses, TransferTable, transfer_table
from tests.support import parallel_ankle, slider_crank

OUTPUTS = ["ankle_pitch", "ankle_roll"]


@functools.cache
def ankle_table() -> TransferTable:
    mechanism = load_mechanism(parallel_ankle.ankle_text(), independent=OUTPUTS)
    return transfer_table(output_map(mechanism, OUTPUTS), 5e-3)


def bump(points: np.ndarray) -> dict[str, np.ndarray]:
    x, y = points.T
    return {"f": np.exp(-40 * x**2) + 0.1 * y}


def test_a_grid_is_fine_where_the_function_bends_and_keeps_its_tolerance():
    grid = adaptive_grid(bump, [(-1, 1), (0, 1)], 1e-3, ["f"], 10_000)
    widths = np.diff(grid.axes[0])
    assert widths.max() > 4 * widths.min()
    assert len(grid.axes[1]) == 9  # linear in y
    points = np.random.default_rng(3).uniform([-1, 0], [1, 1], (5000, 2))
    off = np.abs(interpolated(grid.axes, grid.values["f"], points) - bump(points)["f"]).max() / grid.scale["f"]
    assert 0 < off < 1.5e-3
    assert 0.5 * off < grid.errors["f"] < 1.5e-3


def test_a_grid_that_may_not_grow_is_refined_where_it_misses_by_most():
    grid = adaptive_grid(bump, [(-1, 1), (0, 1)], 1e-6, ["f"], 200)
    assert 190 <= len(grid.axes[0]) * len(grid.axes[1]) <= 200
    assert np.diff(grid.axes[0]).max() > np.diff(grid.axes[0]).min()


def test_a_grid_that_may_not_grow_states_the_error_that_it_is_left_with():
    grid = adaptive_grid(bump, [(-1, 1), (0, 1)], 1e-6, ["f"], 300)
    assert np.prod([len(axis) for axis in grid.axes]) <= 300
    assert grid.errors["f"] > 1e-6


def test_the_stated_error_is_that_of_the_closed_form_between_the_nodes():
    table = ankle_table()
    points = np.random.default_rng(5).uniform([-0.7, -0.35], [0.5, 0.35], (400, 2))
    exact = np.array([parallel_ankle.ratio(*s) for s in points])
    off = np.abs(table.grid.at("ratio", points) - exact).max() / table.grid.scale["ratio"]
    stated = table.grid.errors["ratio"]
    assert stated < 5e-3
    assert 0.5 * stated < off < 1.5 * stated


def test_the_way_back_leads_from_motor_positions_to_joint_positions():
    inverse = ankle_table().inverse
    points = np.random.default_rng(6).uniform([-0.7, -0.35], [0.5, 0.35], (400, 2))  # the whole range, its edges too
    motors = np.array([[parallel_ankle.motor_angle(side, *s) for side in range(2)] for s in points])
    back = inverse.at("joint_position", motors)
    assert np.all(np.isfinite(back))
    assert np.abs(back - points).max() < 2 * inverse.errors["joint_position"] * inverse.scale["joint_position"]
    assert (inverse.answered, inverse.checked) == (1.0, 2000)
    assert inverse.errors["joint_position"] < 5e-3


def test_nodes_of_the_way_back_say_whether_they_are_reachable():
    inverse = ankle_table().inverse
    status, position = inverse.values["status"].ravel(), inverse.values["joint_position"].reshape(-1, 2)
    inside = np.all((position > [-0.7 - 1e-6, -0.35 - 1e-6]) & (position < [0.5 + 1e-6, 0.35 + 1e-6]), axis=1)
    assert set(status) == {0.0, 1.0, 3.0}
    np.testing.assert_array_equal(np.isnan(position).any(axis=1), status == 1.0)
    assert np.all(inside[status == 0.0])
    for s, motor in zip(position[status == 0.0][::50], inverse.points[status == 0.0][::50], strict=True):
        np.testing.assert_allclose([parallel_ankle.motor_angle(side, *s) for side in range(2)], motor, atol=1e-9)


@pytest.mark.slow
def test_the_way_back_near_dead_centres_answers_nearly_all_and_says_how_many():
    outputs = output_map(load_mechanism("five-bar", independent=["P", "E1"]), ["P", "E1"])
    table = transfer_table(outputs, 2e-2, most_nodes=300)
    axes = table.grid.axes
    points = np.random.default_rng(7).uniform([a[0] for a in axes], [a[-1] for a in axes], (1000, 2))
    poses, status = KnownPoses(table.outputs).at(points)
    motors, _ = motor_map(table.outputs, poses[status == 0])
    answered = np.isfinite(table.inverse.at("joint_position", motors)).all(axis=1).mean()
    assert table.inverse.answered > 0.97
    assert answered == pytest.approx(table.inverse.answered, abs=0.02)


def test_the_map_of_a_slider_ends_at_the_crank_s_dead_centres():
    mechanism = load_mechanism("slider-crank", home={"O": 1.0}, independent=["B"])
    (ends,) = transfer_table(output_map(mechanism, ["B"]), 1e-2).ends
    dead = slider_crank.ROD - slider_crank.CRANK, slider_crank.ROD + slider_crank.CRANK
    assert [end.reason for end in ends] == ["singular pose"] * 2
    assert ends[0].position - ends[0].margin == pytest.approx(dead[0], abs=1e-9)
    assert ends[1].position + ends[1].margin == pytest.approx(dead[1], abs=1e-9)


def test_a_motor_s_dead_centre_is_named_and_has_no_way_back():
    # the slide drives: the crank turns on through the poses where the slide's rate is zero
    text = parallel_slide_text()
    mechanism = load_mechanism(text, home={"O": 1.0}, independent=["O"])
    table = transfer_table(output_map(mechanism, ["O"]), 1e-2, ends=[(-1.0, 2.0)])
    ((motor, position),) = table.dead_centres
    assert (motor, table.inverse) == (0, None)
    assert position == pytest.approx(0.0, abs=1e-8)
    assert "dead centre" in table.inverse_note


def parallel_slide_text() -> str:
    """Return the slider-crank with its motor on the slide."""
    from linkplan.models.library import built_in_text
    from tests.support.mechanisms import replaced

    return replaced(built_in_text("slider-crank"), '<motor name="act_O" joint="O"', '<motor name="act_O" joint="B"')


def test_a_range_inside_the_reach_is_taken_and_one_beyond_it_refused():
    mechanism = load_mechanism("optimus-knee", independent=["C"])
    outputs = output_map(mechanism, ["C"])
    grid = transfer_table(outputs, 1e-2, ends=[(-0.2, 0.3)]).grid
    assert (grid.axes[0][0], grid.axes[0][-1]) == (-0.2, 0.3)
    with pytest.raises(Exception, match="range of C is inside"):
        transfer_table(outputs, 1e-2, ends=[(-3.0, 0.3)])


def test_a_constant_ratio_has_no_error():
    mechanism = load_mechanism("parallel-gripper", independent=["right_finger"])
    table = transfer_table(output_map(mechanism, ["right_finger"]), 1e-3)
    assert len(table.grid.axes[0]) < 40
    assert table.grid.errors["ratio_slope"] < 1e-9


def test_off_the_map_there_are_no_numbers_and_a_reason():
    # the five-bar's other loop opens in a part of the box that the two reaches span
    mechanism = load_mechanism("five-bar")
    table = transfer_table(output_map(mechanism, ["O1", "O2"]), 0.5, most_nodes=200)
    status = table.grid.values["status"]
    assert 0 < np.mean(status == 0) < 1
    assert np.isnan(table.grid.values["ratio"][status != 0]).all()
    assert np.isfinite(table.grid.values["ratio"][status == 0]).all()


LONG_ROCKER = """<mujoco><compiler angle="degree"/><default><joint axis="0 -1 0"/>
<geom type="capsule" size="0.01" contype="0" conaffinity="0"/></default><worldbody>
<body name="crank"><joint name="O"/><geom fromto="0 0 0 0 0 .1"/><body name="coupler" pos="0 0 .1"><joint name="A"/>
<geom fromto="0 0 0 .2 0 0"/></body></body><body name="rocker" pos="5 0 0">
<joint name="C"/><geom fromto="0 0 0 0 0 .1"/></body>
</worldbody><equality><connect name="B" body1="coupler" body2="rocker" anchor=".2 0 0"/></equality><actuator>
<motor name="m" joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize("name", ["C", "A"])
def test_a_table_covers_its_reach_where_home_is_next_to_a_dead_centre(name):
    """At home the rocker turns as fast as the crank; the median along the reach is 30 times slower."""
    table = transfer_table(output_map(load_mechanism(LONG_ROCKER, independent=[name]), [name]), 1e-3)
    assert table.known.mean() > 0.9


@pytest.mark.parametrize("high_rad", [1e-100, 1e-13, 4e-8])
def test_a_range_that_rounding_fills_is_refused(high_rad):
    outputs = output_map(load_mechanism(LONG_ROCKER, independent=["C"]), ["C"])
    with pytest.raises(ModelError, match=r"range of C is at least 1e-06 of its reach of 5\.2\d* deg wide, got 0 to "):
        transfer_table(outputs, 1e-3, [(0.0, high_rad)])
    assert transfer_table(outputs, 1e-3, [(0.0, 4e-7)]).known.all()


def test_a_single_joint_without_a_loop_has_a_table():
    text = """<mujoco><worldbody><body><joint name="J" axis="0 1 0" range="-90 90"/><geom size=".1"/></body></worldbody>
    <actuator><motor name="m" joint="J" gear="5"/></actuator></mujoco>"""
    table = transfer_table(output_map(load_mechanism(text), ["J"]), 1e-3)
    np.testing.assert_allclose(table.grid.values["ratio"], 5.0)
    np.testing.assert_allclose(table.inverse.at("joint_position", np.array([[2.5], [-5.0]])), [[0.5], [-1.0]], atol=1e-9)
