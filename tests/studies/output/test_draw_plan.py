"""The figure of a plan with many coordinates, of hinges and slides: every one is drawn, units apart."""

from dataclasses import replace

import numpy as np
import pytest

import linkplan
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.plan.folder import record_of
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import Verdict
from linkplan.planner.problem.problem import Problem
from linkplan.studies.output.document import Table
from linkplan.studies.output.draw_plan import drawn_motion, plan_figure, time_plots
from linkplan.studies.output.figure import figure_of
from linkplan.studies.output.plan_blocks import plan_blocks
from tests.support.arms import LOWER, UPPER
from tests.support.figures import curves, saved_figures
from tests.support.motions import motion_along
from tests.support.plans import optimal
from tests.support.sites import ABOVE, BELOW, arm_of, places_along, plan_of

# A line's points against the cubics that it shows, relative to the largest: a page's numbers have five digits.
DRAWN = 6e-5
KINDS = ["hinge"] * 5 + ["slide"] * 4


def many() -> Plan:
    """Return a motion of nine joints, more than there are colours: from rest to one along cubics."""
    bodies = "".join(
        f'<body pos="{k} 0 0"><joint name="j{k}" type="{kind}" axis="0 1 0"/><geom size="0.1"/></body>'
        for k, kind in enumerate(KINDS)
    )
    motors = "".join(f'<motor name="m{k}" joint="j{k}" ctrlrange="-9 9"/>' for k in range(len(KINDS)))
    mechanism = load_mechanism(f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>")
    n = len(KINDS)
    ends = {f"{end}_{joint.unit}": {} for end in ("start", "goal") for joint in mechanism.joints}
    for joint in mechanism.joints:
        ends[f"start_{joint.unit}"][joint.name] = 0.0
        ends[f"goal_{joint.unit}"][joint.name] = joint.shown(1.0)
    problem = Problem.reach(mechanism, **ends, duration_s=1.0, name="many")
    ones = np.ones((1, n))
    trajectory = motion_along([0.0, 1.0], [0 * ones, 0 * ones, ones, ones], effort=[6 * ones, -6 * ones])
    return Plan(problem=problem, verdict=Verdict(kind="optimal", words="cubics"), trajectory=trajectory)


def test_a_plan_s_page_shows_the_path_of_a_site_and_what_is_forbidden_to_it():
    motion = {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}, "duration_s": 0.6}
    waypoints = [{"at": {"foot": {"x": 0.45}}, "time_s": 0.3}]
    limits = {"foot": {"x": [0.1, 0.5]}}
    plan = plan_of(arm_of(UPPER, LOWER), motion | {"waypoints": waypoints}, limits, mesh={"tolerance_deg": 1e-3})
    axes = next(axes for axes in figure_of(plan_figure(plan)).axes if axes.get_xlabel() == "x [m]")
    lines = {line.get_label(): line.get_xydata() for line in axes.get_lines()}
    path = places_along(plan, per_interval=10)[:, [0, 2]]
    assert lines["path of foot"] == pytest.approx(path, abs=1e-9)
    assert lines["foot at the end"] == pytest.approx(np.array([[0.3, -0.35]]), abs=1e-8)
    assert lines["waypoints of foot"][0, 0] == pytest.approx(0.45)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "z [m]")
    shaded = next(one for one in axes.collections if one.get_facecolor().size and len(one.get_paths()[0].vertices))
    inside = [any(path.contains_point(at) for path in shaded.get_paths()) for at in ((0.05, 0.0), (0.3, 0.0), (0.51, 0.0))]
    assert inside == [True, False, True]


def test_a_plan_without_sites_is_drawn_beside_its_curves():
    axes = figure_of(plan_figure(many())).axes
    assert sum(bool(one.get_ylabel()) for one in axes) == 7  # a panel each of hinges and of slides, and the mechanism
    assert sum(one.get_ylabel() == "z [m]" for one in axes) == 1


def test_a_plan_s_page_has_every_coordinate_s_position_speed_and_effort_in_its_unit(tmp_path, monkeypatch):
    saved = saved_figures(monkeypatch)
    figure_of(plan_figure(many()), tmp_path / "plan.png")
    assert (tmp_path / "plan.png").exists()
    n_hinges = KINDS.count("hinge")

    def cubic(time):
        return 3 * time**2 - 2 * time**3

    def speed(time):
        return 6 * time * (1 - time)

    def effort(time):
        return 6 - 12 * time

    shown = {
        "position [deg]": (n_hinges, lambda time: np.degrees(cubic(time))),
        "position [m]": (len(KINDS) - n_hinges, cubic),
        "speed [deg/s]": (n_hinges, lambda time: np.degrees(speed(time))),
        "speed [m/s]": (len(KINDS) - n_hinges, speed),
        "effort [N.m]": (n_hinges, effort),
        "effort [N]": (len(KINDS) - n_hinges, effort),
    }
    panels = {axes.get_ylabel(): axes for axes in saved["plan.png"].axes if axes.get_xlabel() in ("", "time [s]")}
    assert {label for label in panels if label} == set(shown)
    assert panels["effort [N.m]"].get_xlabel() == "time [s]"
    for label, (n, expected) in shown.items():
        drawn = curves(panels[label])
        lines = [line for name, line in drawn.items() if not name.startswith("limit")]
        assert len(lines) == n
        for time, values in lines:
            np.testing.assert_allclose(values, expected(time), atol=DRAWN * np.abs(expected(time)).max())


def test_more_coordinates_than_colours_are_told_apart_by_their_styles():
    from linkplan.studies.output.lines import line_style

    looks = [tuple(line_style(k).values()) for k in range(len(KINDS))]
    assert len(set(looks)) == len(KINDS)


def test_an_axis_of_a_constant_shows_no_rounding_errors():
    from linkplan.studies.output.figure import page

    with page(None) as axes:
        axes[0, 0].plot([0.0, 1.0, 2.0], [3.79e-4, 3.79e-4 * (1 + 1e-15), 3.79e-4])
    low, high = axes[0, 0].get_ylim()
    assert low < 3.6e-4
    assert high > 4.0e-4


def test_the_names_of_pins_are_those_of_joints_and_closures():
    from linkplan.models.mechanism import load_mechanism
    from linkplan.studies.output.draw_bodies import draw_poses
    from linkplan.studies.output.figure import page

    mechanism = load_mechanism("optimus-knee", payload="shank")
    with page(None) as axes:
        draw_poses(axes[0, 0], mechanism, np.stack([mechanism.home, mechanism.home]))
    assert {text.get_text() for text in axes[0, 0].texts} == {"O", "A", "B", "C"}
    assert axes[0, 0].get_legend_handles_labels()[1] == ["ground", "crank", "coupler", "rocker", "payload"]
    rod = max((patch.get_xy() for patch in axes[0, 0].patches), key=lambda xy: np.ptp(xy, axis=0).max())
    reach = np.linalg.norm(rod - mechanism.model.body("thigh").pos[[0, 2]], axis=1).max()  # to the foot of the shank
    assert reach == pytest.approx(0.2 + 0.5 * np.sqrt(12 * 0.05 / 4), rel=0.01)


def test_efforts_of_rounding_size_are_drawn_as_zero():
    plan = optimal("knee-reach")
    coasting = replace(plan, trajectory=replace(plan.trajectory, effort=1e-15 * plan.trajectory.effort))
    plots = time_plots(coasting, drawn_motion(coasting))
    for what in ("effort", "power"):
        (line,) = plots[what][0].series
        assert not np.any(line.y)
    assert drawn_motion(plan).u.any()


# A wheel that is started quickly and stopped slowly: it takes more power to start it.
WHEEL = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="J" axis="0 0 1"/>
<geom type="cylinder" size=".1 .01" mass="2"/></body></worldbody>
<actuator><motor name="M" joint="J" ctrlrange="-0.1 0.4"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def plan():
    wheel = linkplan.load_mechanism(WHEEL)
    return linkplan.plan(
        linkplan.Problem.reach(wheel, start_deg={"J": 0.0}, goal_deg={"J": 90.0}, minimize="time")
    ).require()


def test_the_powers_are_those_of_bang_bang_motion(plan):
    """Torque 4 T and then -T of inertia I: the largest speed w of angle A has w^2 (1 / 8 + 1 / 2) I / T = A."""
    inertia, torque = 0.5 * 2 * 0.1**2, 0.1
    speed = np.sqrt(np.pi / 2 * torque / inertia / (1 / 8 + 1 / 2))
    assert plan.certificate.peak_motor_power == pytest.approx([4 * torque * speed], rel=1e-3)
    assert plan.certificate.peak_brake_power == pytest.approx([torque * speed], rel=1e-3)
    assert plan.certificate.peak_power == pytest.approx(plan.certificate.peak_motor_power)


def test_text_and_record_have_both(plan):
    said, certificate = record_of(plan), plan.certificate
    assert said.peak_motor_power_w["M"] == pytest.approx(certificate.peak_motor_power[0])
    assert said.peak_brake_power_w["M"] == pytest.approx(certificate.peak_brake_power[0])
    (demands,) = (block for block in plan_blocks(plan) if isinstance(block, Table) and "Demands" in block.title)
    shown = dict(zip((head for head, _ in demands.columns), demands.rows[0], strict=True))
    assert shown["power as motor"] == pytest.approx(certificate.peak_motor_power[0], rel=1e-3)
    assert shown["as brake"] == pytest.approx(certificate.peak_brake_power[0], rel=1e-3)
