"""`plan` and `Plan`: the answer, its samples in users' units, its folder; `Planner`."""

import csv
import itertools
import logging
import pickle
import types

import numpy as np
import pytest
from matplotlib.figure import Figure

import linkplan
from linkplan.models.errors import LinkplanError, PlanError, PlanFileError, ProblemError
from linkplan.planner.plan.plan import sample_motion
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.refusals import assert_refused


@pytest.fixture(scope="module")
def plan():
    return linkplan.plan(linkplan.Problem.from_file("knee-reach")).require()


@pytest.fixture(scope="module")
def sine():
    return linkplan.plan("knee-sine").require()


@pytest.fixture(scope="module")
def impossible():
    settings = {"motion.goal_speed_deg_s.O": 1000.0, "limits.speed_deg_s.O": 900.0}
    return linkplan.plan(linkplan.Problem.from_file("knee-reach", settings))


def test_a_plan_is_what_the_planner_found(plan):
    known = plan_motion(load_problem("knee-reach"))
    assert plan.status == "optimal"
    assert plan.message == known.message
    assert plan.objective == pytest.approx(known.objective, rel=1e-9)
    assert plan.duration_s == known.trajectory.duration_s
    assert plan.certificate.passed
    assert len(plan.history) == len(known.history) > 0
    assert plan.require() is plan


def test_a_plan_without_a_motion_says_why_and_is_not_let_through(impossible):
    assert impossible.status == "infeasible"
    assert impossible.duration_s is None
    with pytest.raises(PlanError) as refused:
        impossible.require()
    assert refused.value.plan is impossible
    assert str(refused.value) == impossible.message
    for use in (impossible.sample, impossible.plot, lambda: impossible.save("nowhere"), lambda: linkplan.track(impossible)):
        with pytest.raises(LinkplanError, match=r"cannot .*: the plan has no motion: infeasible"):
            use()


def test_progress_is_told_and_logged(caplog):
    told = []
    with caplog.at_level(logging.INFO, logger="linkplan"):
        linkplan.plan("knee-reach", told.append)
    assert told
    assert [record.getMessage() for record in caplog.records if record.name == "linkplan"] == told


def test_nothing_is_printed_where_nobody_listens(plan, capfd):
    linkplan.plan(plan.problem)
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")


def test_samples_are_in_degrees_and_hold_the_dependent_joints(plan):
    motion = plan.sample([0.0, 0.16])
    assert motion.position_deg["O"] == pytest.approx([-49.07, 56.27])
    assert motion.unit == {"O": "deg", "A": "deg", "C": "deg"}
    assert motion.effort_unit == {"act_O": "N.m"}
    assert motion.speed_deg_s["A"] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert list(motion.acceleration_deg_s2) == list(motion.jerk_deg_s3) == ["O", "A", "C"]
    mechanism = plan.problem.mechanism
    q = np.radians([motion.position_deg[joint.name] for joint in mechanism.joints]).T
    assert np.ptp(motion.position_deg["A"]) > 30
    assert mechanism.gaps_m(q).max() < 1e-12


def test_samples_do_not_depend_on_the_order_or_company_of_their_times(plan):
    times = np.array([0.15, 0.01, 0.08, 0.01])
    together = plan.sample(times)
    for k, time in enumerate(times):
        alone = plan.sample(time)
        assert alone.time_s == time
        assert isinstance(alone.position_deg["A"], float)
        for name, values in together.position_deg.items():
            assert values[k] == pytest.approx(alone.position_deg[name], abs=1e-9)
        assert together.effort["act_O"][k] == alone.effort["act_O"]


def test_speeds_accelerations_and_jerks_of_joints_and_shown_sites_are_slopes(plan):
    problem = plan.problem.replace(output={"sites": ["B_rocker"]})
    time, step = np.array([0.0301, 0.1003]), 1e-6  # within intervals
    before, after, there = (sample_motion(problem, plan.trajectory, time + by) for by in (-step, step, 0.0))
    joints = ("position_deg", "speed_deg_s", "acceleration_deg_s2", "jerk_deg_s3")
    sites = ("site", "site_speed_m_s", "site_acceleration_m_s2", "site_jerk_m_s3")
    for quantity, rate in (*itertools.pairwise(joints), *itertools.pairwise(sites)):
        for name, found in getattr(there, rate).items():
            slope = (getattr(after, quantity)[name] - getattr(before, quantity)[name]) / (2 * step)
            assert slope == pytest.approx(found, rel=1e-4, abs=1e-6)
            assert np.abs(found).max() > 0.1
    assert list(there.site) == ["B_rocker"]
    assert {"A_deg_s2", "C_deg_s3", "B_rocker_x_m_s3"} <= there.columns().keys()
    assert_refused(lambda: plan.problem.replace(output={"sites": ["tol"]}), "unknown site 'tol' in output.sites")


def test_a_notebook_shows_certificate_proof_and_samples_in_a_line(plan):
    shown = [repr(one) for one in (plan.certificate, plan.sample(), plan.trajectory, plan.prove(existence=False))]
    assert shown[0] == "Certificate(passed; 4 margins)"
    assert shown[1] == "MotionTable(401 instants from 0 to 0.16 s: joints O, A, C; actuators act_O)"
    assert shown[2] == "Trajectory(40 intervals, 0.16 s)"
    assert shown[3].startswith("Proof(proved: ")
    assert max(map(len, shown)) < 100


def test_times_beyond_the_ends_of_a_motion_are_refused_and_a_periodic_one_goes_on(plan, sine):
    for beyond in (1.0, -0.01, [0.0, 0.2]):
        with pytest.raises(ProblemError, match=r"times must be from 0 to 0\.16 s, where the motion ends"):
            plan.sample(beyond)
    assert plan.sample(plan.duration_s).position_deg["O"] == pytest.approx(56.27)
    assert sine.duration_s == pytest.approx(0.25)
    for name, value in sine.sample(0.05).position_deg.items():
        assert sine.sample(0.05 + 3 * 0.25).position_deg[name] == pytest.approx(value, abs=1e-9)
        assert sine.sample(0.05 - 0.25).position_deg[name] == pytest.approx(value, abs=1e-9)


def test_a_frame_has_the_columns_of_the_saved_table(plan, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", types.SimpleNamespace(DataFrame=dict))
    frame = plan.to_frame()
    with (plan.save(tmp_path / "plan") / "trajectory.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert list(frame) == rows[0]
    assert rows[0][:3] == ["time_s", "O_deg", "O_deg_s"]
    assert np.array(rows[1:], dtype=float) == pytest.approx(np.column_stack(list(frame.values())), rel=1e-9, abs=1e-9)
    assert list(plan.to_frame([0.1])["time_s"]) == [0.1]


def test_a_data_set_has_the_values_of_the_table(plan):
    pytest.importorskip("xarray", reason="xarray is not installed")
    found, table = plan.to_dataset(), plan.to_frame()
    for joint in ("O", "C"):
        assert found.position_deg.sel(joint=joint).values == pytest.approx(table[f"{joint}_deg"].to_numpy(), rel=1e-12)
        assert found.speed_deg_s.sel(joint=joint).values == pytest.approx(table[f"{joint}_deg_s"].to_numpy(), rel=1e-12)
        assert found.joint_unit.sel(joint=joint) == "deg"
    assert found.effort.sel(actuator="act_O").values == pytest.approx(table["act_O_Nm"].to_numpy(), rel=1e-12)
    assert plan.to_dataset(0.1).time_s.values == pytest.approx([0.1])


def test_without_pandas_a_frame_is_refused_in_a_sentence(plan, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(ImportError, match=r"Plan.to_frame needs pandas, which is not installed"):
        plan.to_frame()


def test_a_saved_plan_is_read_as_it_was(plan, tmp_path):
    folder = plan.save(tmp_path / "reach")
    assert {path.name for path in folder.iterdir()} == {
        ".linkplan.json",
        "plan.json",
        "trajectory.npz",
        "trajectory.csv",
        "plan.png",
    }
    again = linkplan.read_plan(folder)
    assert again.status == "optimal"
    assert again.objective == plan.objective
    assert again.problem.to_dict() == plan.problem.to_dict()
    assert again.sample(0.08).position_deg == pytest.approx(plan.sample(0.08).position_deg)
    assert_refused(lambda: linkplan.read_plan(tmp_path), "is not a plan: it has no plan.json", kind=PlanFileError)


def test_a_figure_is_returned_and_saved_where_a_path_is_given(plan, tmp_path):
    figure = plan.plot(tmp_path / "plan.png")
    assert isinstance(figure, Figure)
    assert (tmp_path / "plan.png").is_file()
    position, speed, effort = (axes for axes in figure.axes if axes.get_xlabel() == "time [s]")
    drawn = position.lines[0].get_ydata()
    assert [drawn[0], drawn[-1]] == pytest.approx([-49.07, 56.27])
    assert "deg/s" in speed.get_ylabel()
    assert "N.m" in effort.get_ylabel()


def test_a_plan_says_itself_and_its_record(plan):
    assert str(plan).startswith("knee-reach: optimal")
    assert repr(plan) == "Plan('knee-reach', optimal, 0.16 s)"
    assert plan.to_dict()["certificate"]["passed"] is True
    assert plan.to_dict()["problem"] == plan.problem.to_dict()


def test_a_planner_answers_as_a_fresh_plan_does(plan):
    planner = linkplan.Planner()
    assert planner.plan(plan.problem).objective == pytest.approx(plan.objective, rel=1e-9)
    other = plan.problem.replace(goal_deg={"O": 50.0})
    again = planner.plan(other)
    assert again.history[-1].what == "solved again"
    assert again.objective == pytest.approx(linkplan.plan(other).objective, rel=1e-6)


def test_a_step_is_next_to_the_plan_of_its_problem_in_users_units(plan):
    planner, other = linkplan.Planner(), plan.problem.replace(goal_deg={"O": 54.0})
    assert planner.step(other) is None
    planner.plan(plan.problem)
    step, exact = planner.step(other), linkplan.plan(other)
    assert step.settled
    assert step.sample(0.16).position_deg["O"] == pytest.approx(54.0)
    assert step.duration_s == pytest.approx(0.16)
    away = np.abs(step.sample().position_deg["O"] - exact.sample().position_deg["O"]).max()
    assert away <= step.position_error_deg["O"] + np.degrees(1e-7)
    assert 0 < step.position_error_deg["O"] < 0.01
    assert step.effort_error["act_O"] > 0
    assert "NextMotion" in repr(step)


@pytest.mark.parametrize("problem", [None, 5, {"motion": {}}])
def test_what_is_no_problem_is_refused(problem):
    assert_refused(lambda: linkplan.plan(problem), "the problem must be a Problem", kind=ProblemError)
    assert_refused(lambda: linkplan.Planner().plan(problem), "the problem must be a Problem", kind=ProblemError)


def test_progress_that_cannot_be_called_is_refused_before_any_work(plan):
    with pytest.raises(ProblemError, match=r"progress must be a function of one line of text, got 'loud'"):
        linkplan.plan(plan.problem, "loud")


def test_a_plan_is_proved_when_asked_and_keeps_its_proof(tmp_path):
    plan = linkplan.plan("cart-pole-swing-up", prove=True)
    assert plan.proof.complete
    assert plan.proof.verdict == "proved"
    assert plan.to_dict()["proof"]["proved"]
    assert pickle.loads(pickle.dumps(plan)).proof == plan.proof
    assert "proof: proved" in str(plan)
    again = linkplan.read_plan(plan.save(tmp_path / "swing-up"))
    assert again.proof is None
    assert again.prove().complete


def test_a_plan_comes_with_a_proof_if_there_is_time_for_one(monkeypatch):
    proof = linkplan.plan("cart-pole-swing-up").proof
    assert proof is not None
    assert proof.passed
    monkeypatch.setattr("linkplan.api.plans._PROOF_SECONDS", 0.0)
    monkeypatch.setattr("linkplan.api.plans._PROOF_SHARE", 0.0)
    said: list[str] = []
    assert linkplan.plan("cart-pole-swing-up", said.append).proof is None
    assert any(line.startswith("proof skipped") for line in said)
