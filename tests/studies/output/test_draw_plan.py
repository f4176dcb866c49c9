"""The figure of a plan with many coordinates, of hinges and slides: every one is drawn, units apart."""

import numpy as np
from matplotlib.figure import Figure

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.plan import Plan
from linkplan.planner.problem.limits import Limits, free
from linkplan.planner.problem.planning_problem import Motion, PlanningProblem
from linkplan.planner.trajectory import Trajectory
from linkplan.studies.output.draw_plan import draw_effort, draw_position, plan_figure

KINDS = ["hinge"] * 5 + ["slide"] * 4


def many() -> Plan:
    """Return a motion of nine joints, more than there are colours: from rest to one along cubics."""
    bodies = "".join(
        f'<body pos="{k} 0 0"><joint name="j{k}" type="{kind}" axis="0 1 0"/><geom size="0.1"/></body>'
        for k, kind in enumerate(KINDS)
    )
    motors = "".join(f'<motor name="m{k}" joint="j{k}" ctrlrange="-9 9"/>' for k in range(len(KINDS)))
    mechanism = load_mechanism(f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>")
    n, unlimited = len(KINDS), free(len(KINDS))
    problem = PlanningProblem(
        name="many",
        mechanism=mechanism,
        motion=Motion(kind="reach", start=np.zeros(n), goal=np.ones(n), duration_s=1.0),
        objective="effort",
        limits=Limits(effort=mechanism.effort_limit, position=unlimited, speed=unlimited),
    )
    ones = np.ones((1, n))
    trajectory = Trajectory(
        breaks_s=np.array([0.0, 1.0]),
        position=np.array([0 * ones, 0 * ones, ones, ones]),
        velocity=np.array([0 * ones, 3 * ones, 0 * ones]),
        effort=np.array([6 * ones, -6 * ones]),
        start_pose=np.zeros(n),
        periodic=False,
    )
    return Plan(problem=problem, status="optimal", message="cubics", trajectory=trajectory)


def test_more_coordinates_than_colours_are_told_apart_by_their_styles(tmp_path):
    plan_figure(many(), tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 10_000
    axes = Figure().subplots()
    draw_position(axes, many())
    looks = [(line.get_color(), line.get_linestyle()) for line in axes.get_legend_handles_labels()[0]]
    assert len(set(looks)) == len(looks) == len(KINDS)


def test_torques_and_forces_have_an_axis_each():
    figure = Figure()
    axes = figure.subplots()
    draw_effort(axes, many())
    assert [side.get_ylabel() for side in figure.axes] == ["effort [N.m]", "effort [N]"]
    assert axes.get_legend_handles_labels()[1][-1] == "m8 [N]"
