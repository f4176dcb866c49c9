"""The loop report of `linkplan check` along reach and motion, against closed forms, virtual work and MuJoCo."""

import json
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from linkplan.cli.main import main
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.reach import reach, toggles
from linkplan.planner.files.folders import to_json_types
from linkplan.planner.problem.problem import load_problem
from linkplan.studies.check.check_report import largest_forces, path_blocks, pin_table, quantities
from linkplan.studies.check.inspection import inspect
from linkplan.studies.check.kinematic_loop_report import (
    KinematicLoopPath,
    measure,
    measured,
    motion_path,
    reach_sweeps,
    swept,
)
from linkplan.studies.check.path_plots import inspection_figure, path_plots
from linkplan.studies.check.path_quantities import path_figures
from linkplan.studies.output.figure import figure_of
from linkplan.studies.output.text import text_of
from tests.support.data import KNEE_TABLE
from tests.support.drive import line_rates
from tests.support.figures import curves, labels, saved_figures
from tests.support.fourbar import G, knee
from tests.support.gripper import INERTIA, PULLEY, REST, STIFFNESS, WEIGHT
from tests.support.linkages import RSSR, WELDED
from tests.support.mechanism_checks import mechanism_of
from tests.support.slider_crank import CRANK, CRANK_CENTRE, CRANK_MASS, ROD, ROD_CENTRE, ROD_MASS
from tests.support.tolerances import BRACKET_RAD, KNEE, SWEPT_GAP_M, relative_error

CONFIGURATIONS = KNEE_TABLE["configurations"]


@cache
def knee_path() -> KinematicLoopPath:
    """Return the knee's report at the reference's own angles."""
    mechanism = mechanism_of("optimus-knee")
    angles = np.radians([[row["q_O_deg"]] for row in CONFIGURATIONS])
    return measure(mechanism, follow(mechanism, angles), "the reference's angles", coordinate=0)


@cache
def swept_paths(name: str) -> tuple[KinematicLoopPath, ...]:
    mechanism = mechanism_of(name)
    paths = [*map(measured, reach_sweeps(mechanism, [reach(mechanism, column) for column in range(mechanism.dof)]))]
    assert len(paths) == mechanism.dof
    return paths


@cache
def linear_by_knee_angle() -> KinematicLoopPath:
    """Return the linear knee's report with O as its coordinate: the drive's force at the knee."""
    mechanism = load_mechanism("optimus-knee-linear", independent=["O"])
    angles = np.radians(np.linspace(-75.0, 56.27, 40))[:, None]
    return measure(mechanism, follow(mechanism, angles), "knee angles", coordinate=0)


def test_the_knee_s_distance_from_singular_is_the_transmission_angle_s_sine():
    angles = np.radians([row["q_O_deg"] for row in CONFIGURATIONS])
    expected = knee().transmission(angles) / knee().transmission(np.zeros(1))
    assert expected.min() < 0.5 < expected.max()
    assert relative_error(knee_path().singularity, expected) < KNEE


def test_the_linear_knee_s_ratio_inertia_and_torque_at_the_knee_are_virtual_work_s():
    path = linear_by_knee_angle()
    lever = np.array([line_rates(knee(), q)[0] for q in path.positions[:, 0]])
    assert np.ptp(lever) > 0.02, "the lever changes along the swing"
    assert relative_error(path.ratio[:, 0, 0], lever) < KNEE
    assert relative_error(path.reflected_inertia[:, 0], path.reduced_inertia[:, 0, 0] / lever**2) < KNEE
    assert relative_error(path.available_effort[:, 0], 2000.0 * np.abs(lever)[:, None] * [-1.0, 1.0]) < KNEE
    assert relative_error(path.holding_effort[:, 0], path.gravity_effort[:, 0] / lever) < KNEE


def test_the_slider_crank_s_weight_and_pin_force_at_rest_are_statics():
    """The slider bears no load along its guide, so that pin B carries the rod's share of weight, and upright."""
    (path,) = swept_paths("slider-crank")
    share = ROD_MASS * G * ROD_CENTRE / ROD
    arm = CRANK_MASS * CRANK_CENTRE + ROD_MASS * CRANK * (1 - ROD_CENTRE / ROD)
    assert relative_error(path.closure_force[:, 0], np.full(len(path.poses), share)) < KNEE
    assert relative_error(path.gravity_effort[:, 0], G * arm * np.cos(path.positions[:, 0])) < KNEE
    record = path_figures(path)
    upright = {"O": 0.3 + 0.2 - share / G, "A": 0.2 - share / G, "joint B": 0.6 + share / G}  # masses that each carries
    assert {name: force / G for name, force in record.pin_force_n.items()} == {
        name: pytest.approx(np.full(361, mass), rel=1e-9) for name, mass in upright.items()
    }
    (table,) = pin_table([largest_forces(path)])
    assert list(table.rows[1][:2]) == ["O", pytest.approx(upright["O"] * G, rel=1e-3)]


def test_the_largest_force_and_moment_of_a_pin_at_rest_are_the_weight_s_at_its_arm():
    """The centre is 0.1 m beside the pin along its axis, so the moment across the axis is constant, and none is along it."""
    arm = mechanism_of("""<mujoco><worldbody><body><joint name="J" axis="0 1 0" pos="0 0.1 0"/>
      <geom size="0.1" mass="2" pos="0.3 0.2 0"/></body></worldbody><actuator><motor joint="J"/></actuator></mujoco>""")
    (path,) = map(measured, reach_sweeps(arm, (reach(arm),)))
    assert largest_forces(path)["J"][:2] == (pytest.approx(2 * G), pytest.approx(2 * G * 0.1))
    (table,) = pin_table([largest_forces(path)])
    assert [head for head, _ in table.columns][:3] == ["pin", "force", "moment"]


def test_the_gripper_s_cable_has_the_closed_form_s_arm_inertia_and_holding_pull():
    mechanism = load_mechanism("parallel-gripper", independent=["right_crank"])
    (path,) = map(measured, reach_sweeps(mechanism, (reach(mechanism),)))
    assert mechanism.actuators[0].joint is None, "a tendon's, on no joint"
    q = path.positions[:, 0]
    assert relative_error(path.ratio[:, 0, 0], np.full(len(q), -2 * PULLEY)) < KNEE
    assert relative_error(path.reflected_inertia[:, 0], np.full(len(q), INERTIA / (2 * PULLEY) ** 2)) < KNEE
    assert relative_error(path.available_effort[:, 0], np.tile([-40.0 * PULLEY, 0.0], (len(q), 1))) < KNEE
    pull = -(2 * STIFFNESS * (q - REST) + WEIGHT * np.sin(q)) / (2 * PULLEY)
    assert relative_error(path.holding_effort[:, 0], pull) < KNEE
    assert np.any(pull < 0), "where the springs hold the hand further shut than its weight does"
    assert "actuator pull would need" in text_of(path_blocks(path))
    assert f"beyond its limits 0 to 20 N ({np.sum(pull < 0)} of {len(q)} poses)" in text_of(path_blocks(path))


def test_each_of_two_freedoms_is_swept_with_the_other_at_home():
    for column, path in enumerate(swept_paths("five-bar")):
        assert path.coordinate == column
        other = 1 - column
        assert np.ptp(path.positions[:, column]) > 1.0
        assert np.all(path.positions[:, other] == path.mechanism.home[path.mechanism.independent[other]])
        assert path.mechanism.gaps_m(path.poses).max() < SWEPT_GAP_M


def test_each_of_two_motors_feels_the_inertia_that_is_left_with_the_other_free():
    for path in swept_paths("five-bar"):
        M = path.reduced_inertia
        left = M[:, 0, 0] - M[:, 0, 1] ** 2 / M[:, 1, 1]
        assert relative_error(path.reflected_inertia[:, 0], left) < KNEE
        assert np.any(left < 0.5 * M[:, 0, 0]), "the coupling counts"


def test_a_coarse_reach_is_filled_with_closed_poses():
    (path,) = swept_paths("optimus-knee-linear")
    own = reach(mechanism_of("optimus-knee-linear"))
    assert len(own.poses) < 40 < 120 <= len(path.poses)
    assert path.mechanism.gaps_m(path.poses).max() < SWEPT_GAP_M
    assert np.all(np.diff(path.positions[:, 0]) > 0)


@pytest.mark.slow
def test_a_mechanism_without_actuators_is_reported_on_too():
    start, end = WELDED.index("<actuator>"), WELDED.index("</actuator>") + len("</actuator>")
    mechanism = load_mechanism(WELDED[:start] + WELDED[end:])
    assert mechanism.n_u == 0
    (path,) = map(measured, reach_sweeps(mechanism, (reach(mechanism),)))
    assert np.array_equal(path.unheld_effort, path.gravity_effort)
    assert np.abs(path.gravity_effort).max() > 0.01
    assert "no actuator holds" in text_of(path_blocks(path))


def test_an_actuator_without_limits_gives_any_effort_where_it_acts_and_none_where_it_does_not():
    text = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/>
      <body pos="0.4 0 0"><joint name="b" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body></body></worldbody>
      <actuator><motor name="m" joint="a"/></actuator></mujoco>"""
    mechanism = load_mechanism(text)
    path = measure(mechanism, mechanism.home[None], "home")
    assert path.available_effort[0].tolist() == [[-np.inf, np.inf], [0.0, 0.0]]
    json.dumps(to_json_types(path_figures(path)), allow_nan=False)


def test_a_models_sites_are_listed_where_mujoco_has_them_at_home(capsys):
    assert main(["check", "five-bar", "--json"]) == 0
    places = json.loads(capsys.readouterr().out)["sites_at_home_m"]
    mechanism = load_mechanism("five-bar")
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(mechanism.home[None])[0]
    mujoco.mj_kinematics(mechanism.model, data)
    assert places["P"] == pytest.approx(data.site("P").xpos, abs=1e-12)
    assert main(["check", "five-bar", "--all"]) == 0
    row = next(line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("P "))
    assert row == ["P", f"{places['P'][0]:.6g}", "0", f"{places['P'][2]:.6g}"]


def test_a_problem_is_reported_on_along_its_reference_with_its_own_limits():
    problem = load_problem("knee-sine", ["limits.effort.act_O=[-80,70]"])
    path = motion_path(problem)
    expected = problem.reference.derivative(path.time_s, 0)
    assert np.array_equal(path.positions, expected)
    assert np.degrees([expected.min(), expected.max()]) == pytest.approx([-49.07, 56.27], abs=KNEE)
    assert np.all(path.available_effort == [-80.0, 70.0])
    assert path.title == "the reference of knee-sine"


def test_a_reach_is_reported_on_from_its_start_to_its_goal():
    path = motion_path(load_problem("five-bar-reach"))
    motion = load_problem("five-bar-reach").motion
    assert relative_error(path.positions[[0, -1]], [motion.start, motion.goal]) < KNEE


@pytest.fixture
def ask_json(capsys):
    """Run `check --json`; return its exit code and what it prints."""

    def run(*argv: str) -> tuple[int, dict]:
        capsys.readouterr()
        code = main(["check", *argv, "--json"])
        return code, json.loads(capsys.readouterr().out)

    return run


@pytest.mark.slow
def test_json_holds_every_sample_of_every_quantity_with_null_for_what_is_infinite(ask_json):
    code, said = ask_json("slider-crank")
    (along,) = said["along"]
    assert code == 0
    n = len(along["q_deg"]["O"])
    assert n == 361
    assert len(along["transmission_ratio"]["act_O"]["O"]) == len(along["closure_force_n"]["B"]) == n
    assert len(along["available_effort"]["O"]) == len(along["reflected_inertia"]["act_O"]) == n
    assert (along["coordinate"], along["time_s"]) == ("O", None)
    assert len(said["branch"]) == 2


@pytest.mark.slow
def test_figures_of_each_sweep_are_written_beside_the_record(ask_json, tmp_path):
    code, said = ask_json("five-bar", "-o", str(tmp_path / "checked"))
    assert code == 0
    files = {path.name for path in (tmp_path / "checked").iterdir()}
    assert files == {".linkplan.json", "check.json", "report.json", "mechanism.png", "loop-1.png", "loop-2.png"}
    assert json.loads((tmp_path / "checked" / "check.json").read_text()) == said


def test_the_table_says_once_what_does_not_change():
    (path,) = swept_paths("optimus-knee")
    text = text_of(path_blocks(path))
    assert "the same at every pose: act_O->O 1, available O -100 to 100 N.m" in text
    rows = [row for row in text.splitlines() if row[:1].isdigit() or (row.startswith("-") and row[1].isdigit())]
    assert len(rows) == 3 * 9, "nine poses, and the sites and angles of bodies at these poses"


@pytest.mark.slow
def test_a_sweep_that_nothing_stops_is_one_turn_from_home():
    mechanism = mechanism_of("cart-pole")
    poses = swept(mechanism, reach(mechanism, 1))
    assert np.ptp(poses[:, 1]) == pytest.approx(2 * np.pi, abs=BRACKET_RAD)


def test_the_other_branch_has_the_other_sign(ask_json):
    crank, coupler, rocker = np.degrees(replace(knee(), branch=-knee().branch).angles(np.zeros(1))[:, 0])
    own = ask_json("optimus-knee")[1]
    other = ask_json("optimus-knee", "--set", f"mechanism.home_deg={{ O = 0.0, A = {coupler - crank}, C = {rocker} }}")[1]
    assert own["problems"] == []
    assert any("joint A is at -158.1 deg at home, outside its range" in problem for problem in other["problems"])
    assert own["home_deg"]["A"] - other["home_deg"]["A"] > 90.0
    assert own["branch"][0] * other["branch"][0] < 0
    assert other["along"][0]["singularity_ratio"][0] > 0, "a share of its own home's"


def test_the_table_tells_weight_alone_from_what_holds_weight_and_springs():
    """The gripper's springs pull against its weight: the cable holds both, and the pins' forces are of both."""
    mechanism = load_mechanism("parallel-gripper")
    (path,) = map(measured, reach_sweeps(mechanism, (reach(mechanism),)))
    columns = {column.head: column.values for column in quantities(path)}
    still = np.zeros(1)
    both = np.array([np.array(mechanism.dynamics.inverse_dynamics(q, still, still)).item() for q in path.poses])
    assert np.abs(both - columns["weight alone left_crank"]).max() > 0.01  # the springs matter
    actuator = mechanism.actuators[0].name
    assert path.ratio[:, 0, 0] * columns[f"hold {actuator}"] == pytest.approx(both, rel=1e-9, abs=1e-12)
    text = text_of(path_blocks(path))
    assert "'weight alone' omits springs; hold and force include weight, springs and constant forces" in text


KEYED = """<mujoco model="keyed"><worldbody><body><joint name="O" axis="0 1 0"/><geom size="0.1"/></body></worldbody>
<actuator><motor joint="O" ctrlrange="-1 1"/></actuator><keyframe><key name="{name}" qpos="0.3"/></keyframe></mujoco>"""


def test_keyframes_of_which_none_is_home_are_said_since_home_is_then_the_reference_pose():
    def said(name: str, **mechanism) -> list[str]:
        found = inspect(load_mechanism(KEYED.format(name=name), **mechanism), ())
        return [note for note in found.notes if "keyframes" in note]

    (note,) = said("stand")
    assert note.startswith("home is the reference pose, because none of the model's keyframes (stand) is named home")
    assert said("home") == []
    assert said("stand", home={"O": 0.3}) == []


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
    figure_of(inspection_figure(inspect(mechanism, [])), tmp_path / "five-bar.png")
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
    found = inspect(load_mechanism(RSSR), [])
    assert len(found.reaches) == 2
    assert {axes.get_xlabel() for axes in figure_of(inspection_figure(found)).axes[1:]} == {"crank [deg]"}


def test_the_dotted_lines_over_a_reach_are_named_in_the_legend():
    mechanism = mechanism_of("optimus-knee")
    found = inspect(mechanism, [])
    assert len(found.reaches[0].singular)
    assert toggles(mechanism)
    axes = figure_of(inspection_figure(found)).axes[1]
    assert [text.get_text() for text in axes.get_legend().get_texts()][-2:] == ["singular pose", "a joint turns back"]
