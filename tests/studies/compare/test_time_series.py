"""Tracking runs on disk and in figures: every joint, every actuator; soft loops are said."""

import csv
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from linkplan.controllers.imperfections.imperfections import Clock, Imperfections
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import ControlLoop, Rollout
from linkplan.controllers.simulate import simulate
from linkplan.models.errors import ModelError, ProblemError
from linkplan.models.library import built_in_text
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.contacts import contact_pairs
from linkplan.models.poses.reach import reach
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.check.findings import contact_findings
from linkplan.studies.check.softness import soft_closures, softness_error
from linkplan.studies.compare.compare import (
    Comparison,
    build_tracker,
    delay_of,
    mismatch_of,
    run_figures,
    track,
    tracking_reference,
)
from linkplan.studies.compare.comparison_blocks import comparison_blocks, comparison_figure, comparison_notes
from linkplan.studies.compare.named_run import run_columns, save_time_series
from linkplan.studies.output.figure import figure_of
from linkplan.studies.output.plan_blocks import plan_blocks
from linkplan.studies.output.text import text_of
from tests.support.plans import optimal

SOFT = re.sub(r' solref="[^"]*" solimp="[^"]*"', "", built_in_text("optimus-knee"))


@cache
def compared(model: str, **mechanism: str) -> Comparison:
    """Return one PD run on a motion of a model that is followed exactly."""
    joints = {"five-bar": {"O1": -90.0, "O2": -90.0}}.get(model, {"O": 0.0})
    tables = {
        "mechanism": {"model": model, **mechanism},
        "motion": {"kind": "track"},
        "reference": {"amplitude_deg": dict.fromkeys(joints, 3.0), "bias_deg": joints, "frequency_hz": 2.0},
        "tracking": {"kp": 50.0, "kd": 1.0, "period_s": 1e-3, "duration_s": 0.5},
    }
    plan = plan_motion(Problem.from_tables("sine", tables))
    run = track(plan, "pd")
    return Comparison(plan=plan, nominal={"pd": run}, mismatch=None, mismatched={})


def test_a_run_is_saved_with_units_in_its_heads_as_csv_and_npz(tmp_path):
    comparison = compared("five-bar")
    save_time_series(comparison, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["nominal-pd.csv", "nominal-pd.npz"]
    run = comparison.nominal["pd"]
    with (tmp_path / "nominal-pd.csv").open(newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    assert head[:5] == ["time_s", "O1_ref_deg", "O1_deg", "O1_error_deg", "O1_deg_s"]
    assert {"E1_deg", "P_deg", "act_O1_commanded_Nm", "act_O2_applied_Nm", "closure_gap_m"} <= set(head)
    values = dict(zip(head, np.array(rows, dtype=float).T, strict=True))
    assert np.diff(values["time_s"]).min() > 0
    assert values["O2_error_deg"] == pytest.approx(np.degrees(run.error_rad[:, 1]), abs=1e-9)
    assert values["act_O2_applied_Nm"] == pytest.approx(run.applied[:, 1], rel=1e-11, abs=1e-12)
    with np.load(tmp_path / "nominal-pd.npz", allow_pickle=False) as saved:
        assert list(saved) == head
        assert saved["P_deg"] == pytest.approx(values["P_deg"], rel=1e-11)


def test_the_figure_has_every_joint_and_every_actuator():
    comparison = compared("five-bar")
    assert figure_of(comparison_figure(comparison)).get_size_inches()[1] * 110 <= 1080
    figure = figure_of(comparison_figure(comparison, every_joint=True))
    drawn = {axes.get_title(): axes for axes in figure.axes}
    motions = [f"{joint}, desired and tracked" for joint in ("O1", "O2")]
    errors = [f"Size of the error of {joint}" for joint in ("O1", "O2")]
    assert set(drawn) == {*motions, *errors, "E1, tracked", "P, tracked", "Effort of act_O1", "Effort of act_O2"}
    assert drawn["P, tracked"].get_ylabel() == "position [deg]"
    run, columns = comparison.nominal["pd"], run_columns(comparison.plan.problem.mechanism, comparison.nominal["pd"])
    for title, name in ((motions[1], "O2_deg"), ("P, tracked", "P_deg"), ("Effort of act_O2", "act_O2_applied_Nm")):
        shown = drawn[title].lines[0].get_ydata()
        assert shown == pytest.approx(columns[name], abs=1e-4 * np.abs(columns[name]).max()), name
    assert len(run.time_s) == 500


def test_the_table_has_the_peak_of_every_actuator():
    comparison = compared("five-bar")
    text = text_of(comparison_blocks(comparison))
    head = text.split("----")[0]
    assert head.count("peak") == head.count("[N.m]") == 2
    assert head.index("act_O1") < head.index("act_O2")
    for peak in run_figures(comparison.plan, comparison.nominal["pd"])["peak_effort"].values():
        assert f"{peak:.4g}" in text


def test_a_soft_loop_is_said_with_its_gap_and_what_it_does_to_the_joints():
    comparison = compared(SOFT)
    run = comparison.nominal["pd"]
    assert run.gap_m.max() > 1e-4 * comparison.plan.problem.mechanism.extent_m
    (note,) = comparison_notes(comparison)
    assert note.startswith("pd, soft closures: MuJoCo's loops open by up to ")
    assert f"{1e3 * run.gap_m.max():.3g} mm" in note
    assert re.search(r"[A-D] is off by up to [\d.e-]+ deg", note)
    assert 'mechanism.solref = "stiff"' in note
    assert note in text_of(comparison_blocks(comparison))
    assert comparison_notes(compared("optimus-knee")) == []


def test_default_gains_are_said():
    comparison = compared("optimus-knee")
    for given, said in (
        ({}, "kp = 3.7 N.m/rad, kd = 0.059 N.m.s/rad"),
        ({"kp": 200}, "kp = 200 N.m/rad, kd = 0.059 N.m.s/rad"),
    ):
        problem = comparison.plan.problem.replace(tracking=given)
        (note,) = comparison_notes(replace(comparison, plan=replace(comparison.plan, problem=problem)))
        assert note.startswith(f"gains from the inertia at the start: pd used {said}")
        assert "linkplan tune" in note
    problem = comparison.plan.problem.replace(tracking={"kp": 3.7, "kd": 0.059})
    assert comparison_notes(replace(comparison, plan=replace(comparison.plan, problem=problem))) == []


def test_runs_keep_the_torque_speed_line_of_their_motor():
    """Without the line PD goes 2 % beyond it. O is driven directly."""
    plan = compared("optimus-knee").plan
    run = track(plan, "pd")
    stall, no_load = 0.9 * np.abs(run.applied).max(), 2000.0
    problem = plan.problem.replace(motors={"act_O": {"stall_effort": stall, "no_load_speed_deg_s": no_load}})

    def share(run: Rollout) -> float:
        return float(np.abs(run.applied / stall + np.degrees(run.velocity_rad_s) / no_load).max())

    assert share(run) > 1.02
    assert share(track(replace(plan, problem=problem), "pd")) < 1.001


GEARS = """<mujoco model="gears"><default><geom contype="0" conaffinity="0"/></default><worldbody>
  <body name="arm"><joint name="O" axis="0 -1 0"/><geom type="capsule" size="0.01" fromto="0 0 0 0.2 0 0"/></body>
  <body name="flap" pos="0.5 0 0"><joint name="B" axis="0 -1 0"/><geom type="sphere" size="0.05" pos="0.2 0 0"/></body>
  </worldbody><equality><joint name="gear" joint1="B" joint2="O" polycoef="0 -0.5 0 0 0"/></equality>
  <actuator><motor joint="O" ctrlrange="-3 3"/></actuator></mujoco>"""


def test_a_stable_run_that_is_farther_off_than_the_motion_travels_is_said_to_follow_nothing():
    comparison = compared("optimus-knee")
    run = replace(comparison.nominal["pd"], applied=np.zeros((500, 1)))
    assert run.stable
    travel = np.degrees(np.abs(run.reference_rad - run.reference_rad[0]).max())
    assert comparison_notes(comparison) == []
    near, lost = (replace(run, position_rad=run.reference_rad - np.radians(share * travel)) for share in (0.9, 1.1))
    assert comparison_notes(replace(comparison, nominal={"pd": near})) == []
    (note,) = comparison_notes(replace(comparison, nominal={"pd": lost, "near": near}))
    assert note.startswith(f"the motion, which travels {travel:.3g} deg, is not followed: the largest errors are pd by")


def test_a_run_that_ends_early_is_said_with_its_instant_and_reason():
    """Until it ends, its errors may be smaller than those of every other run."""
    comparison = compared("optimus-knee")
    run = comparison.nominal["pd"]
    ended = replace(run, time_s=run.time_s[:31], failure="the tracker gave an effort that is not a number")
    notes = comparison_notes(replace(comparison, nominal={"pd": ended}))
    assert notes == ["pd, nominal, ended at t = 0.03 s: the tracker gave an effort that is not a number"]


def test_gears_that_give_way_are_off_by_an_angle_and_by_no_length():
    comparison = compared(GEARS)
    plan, run = comparison.plan, comparison.nominal["pd"]
    off = np.abs(run.pose_rad[:, 1] + 0.5 * run.pose_rad[:, 0])
    assert off.max() > 1e-4
    assert run.gap_rad == pytest.approx(off)
    assert run.gap_m.max() == 0
    assert run_columns(plan.problem.mechanism, run)["closure_gap_rad"] == pytest.approx(off)
    assert run_figures(plan, run)["loop_gap_max_rad"] == pytest.approx(off.max())
    (note,) = comparison_notes(comparison)
    assert note.startswith(
        f"pd, soft closures: in MuJoCo angles that closures tie are off by up to {off.max():.3g} rad, and B"
    )
    text = text_of(comparison_blocks(comparison))
    assert "gap [urad]" in text
    assert "[um]" not in text
    (row,) = (line for line in text_of(plan_blocks(plan)).splitlines() if line.startswith("gap of the kinematic loops"))
    assert " rad " in row
    assert plan.certificate.closure_gap_rad == 0


def test_a_loop_that_gapes_wide_is_off_by_all_of_it():
    comparison = compared("optimus-knee")
    mechanism, pose = comparison.plan.problem.mechanism, comparison.nominal["pd"].pose_rad
    (dependent, *_), off = mechanism.dependent, np.radians(30.0)
    gaping = np.array(pose)
    gaping[:, dependent] += off
    error = softness_error(mechanism, gaping)
    assert float(re.search(rf"{mechanism.joints[dependent].name} is off by up to ([\d.]+) deg", error)[1]) == pytest.approx(
        30.0, abs=0.1
    )


# Links drawn on one another, as they are where nothing says that they pass side by side.
TOUCHING = """<mujoco model="drawn"><worldbody>
  <body name="base"><geom type="box" size="0.02 0.02 0.02"/>
    <body name="crank"><joint name="O" axis="0 1 0"/><geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.2"/></body>
  </body></worldbody>{contact}
  <actuator><motor joint="O" ctrlrange="-5 5"/></actuator></mujoco>"""


def test_contacts_that_act_in_a_run_are_said_with_the_line_that_leaves_them_out():
    (note,) = comparison_notes(compared(TOUCHING.format(contact="")))
    assert note.startswith("geom 0 of base and geom 1 of crank touch in MuJoCo")
    (line,) = re.findall(r"<exclude [^>]*/>", note)
    (advised,) = contact_findings(*_reached(TOUCHING.format(contact="")), None, "refuse")[0]
    assert line in advised
    assert comparison_notes(compared(TOUCHING.format(contact=f"<contact>{line}</contact>"))) == []


def _reached(text: str) -> tuple:
    mechanism = load_mechanism(text)
    poses = reach(mechanism, 0).poses
    return mechanism, contact_pairs(mechanism, poses), [len(poses)]


def test_one_key_makes_closures_as_stiff_as_check_recommends():
    soft, stiff = load_mechanism(SOFT), load_mechanism(SOFT, solref="stiff")
    (found,) = soft_closures(soft)
    index = stiff.closures[0].index
    assert stiff.model.eq_solref[index] == pytest.approx([float(x) for x in found.stiff_solref.split()])
    assert stiff.source["solref"] == "stiff"
    assert soft_closures(stiff) == ()
    gaped, closed = (compared(SOFT, **key).nominal["pd"].gap_m.max() for key in ({}, {"solref": "stiff"}))
    assert closed < 0.1 * gaped
    with pytest.raises(ModelError, match=r'mechanism.solref is "stiff".*got \'soft\''):
        load_mechanism(SOFT, solref="soft")


def test_a_fraction_of_a_period_of_delay_acts_as_in_an_ensemble():
    plan = optimal("knee-reach")
    mismatch = mismatch_of(plan, 1.0, 0.4)
    assert mismatch.name.endswith("0.4 control periods of delay")
    found = track(plan, "pd", mismatch)
    reference, mechanism = tracking_reference(plan), plan.problem.mechanism
    plant = MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=np.array(plan.problem.limits.actuators_effort)))
    delayed = simulate(
        plant, build_tracker("pd", plan, reference), reference, [Imperfections(clock=Clock(delay_periods=0.4))]
    )
    np.testing.assert_allclose(found.position_rad[:, 0], delayed.pose[:, 0, mechanism.independent[0]], rtol=0, atol=1e-12)
    whole = track(plan, "pd", None)
    assert np.abs(found.position_rad - whole.position_rad).max() > 1e-6


@pytest.mark.parametrize("delay", [-0.5, float("nan"), 1e9])
def test_a_delay_that_is_none_is_refused(delay):
    with pytest.raises(ProblemError, match="delay_periods"):
        delay_of(delay, "delay_periods")
